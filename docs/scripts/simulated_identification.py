"""Robots that are not quite what was drawn, what their logs would say, and what their identifications are worth."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from stewart_drake.estimation.identification import identify
from stewart_drake.estimation.torques import (
    COULOMB,
    ENTRIES,
    GAIN,
    INERTIA,
    KINDS,
    MASS,
    MOMENT,
    PARAMETERS,
    SIZE,
    VISCOUS,
    Recording,
    as_robot,
    values_of,
)
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics
from stewart_drake.mechanics.kinematics import crank_rates, inverse_kinematics, leg_geometry
from stewart_drake.references import Reference
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

KNOWN = ("platform_mass", "platform_moment", "platform_inertia", "rod_mass")


def deviating(
    guess: RobotParameters, rng: np.random.Generator, friction: float, viscous: float, share: float = 0.2
) -> np.ndarray:
    """Parameters (`SIZE`,) of a robot with an unknown payload on it.

    Rods, cranks and rotors are off by a factor of up to 1 + `share` either way, torque constants about their mean too;
    each motor has friction of its own, between half and one and a half of what is given. The platform is the guess's,
    with a point of a tenth to three tenths of its mass up to half the robot's length beside its middle.

    Args:
        guess: What the robot was drawn as.
        rng: For all that is random.
        friction: [N m] of a motor.
        viscous: [N m s/rad] of a motor.
        share: [-] see above.
    """
    values = values_of(guess)
    off = np.array([parameter.kind not in KNOWN for parameter in PARAMETERS])
    values *= np.where(off, 1.0 + share * rng.uniform(-1.0, 1.0, SIZE), 1.0)
    values[COULOMB] = friction * rng.uniform(0.5, 1.5, LEG_COUNT)
    values[VISCOUS] = viscous * rng.uniform(0.5, 1.5, LEG_COUNT)
    gains = np.log1p(share * rng.uniform(-1.0, 1.0, LEG_COUNT))
    values[GAIN] = gains - gains.mean()
    place = 0.5 * guess.characteristic_length * rng.uniform(-1.0, 1.0, 3)
    return with_payload(values, guess.platform_mass * rng.uniform(0.1, 0.3), place)


def recorded(
    guess: RobotParameters,
    values: np.ndarray,
    reference: Reference,
    duration: float,
    rate: float,
    encoders: EncoderOptions,
    torque_noise: float,
    rng: np.random.Generator,
    gravity: float = STANDARD_GRAVITY,
) -> Recording:
    """Readings of a robot that follows a motion exactly.

    Args:
        guess: Geometry.
        values: (`SIZE`,) parameters.
        reference: The motion.
        duration: [s].
        rate: [Hz] of the rows.
        encoders: Steps and noise of the readings.
        torque_noise: [N m] standard deviation of each torque.
        rng: Of the noise.
        gravity: [m/s^2].
    """
    time = np.arange(int(duration * rate) + 1) / rate
    pose, pose_rate, acceleration = reference.evaluate(time)
    angles = inverse_kinematics(guess, pose)
    speed = crank_rates(guess, leg_geometry(guess, pose), pose, pose_rate)
    torque = inverse_dynamics(as_robot(guess, values), pose, pose_rate, acceleration, gravity)
    torque = np.exp(-values[GAIN]) * (torque + values[COULOMB] * np.sign(speed) + values[VISCOUS] * speed)
    return Recording(
        time,
        encoders.read(angles + encoders.noise * rng.standard_normal(angles.shape)),
        torque + torque_noise * rng.standard_normal(torque.shape),
        gravity=gravity,
        source="simulated recording",
    )


def with_payload(values: np.ndarray, mass: float, place: np.ndarray) -> np.ndarray:
    """Parameters (`SIZE`,) with a point of a mass [kg] at a place (3,) [m] in P on the platform."""
    inertia = mass * ((place @ place) * np.eye(3) - np.outer(place, place))
    changed = values.copy()
    changed[MASS] += mass
    changed[MOMENT] += mass * place
    changed[INERTIA] += [inertia[at] for at in ENTRIES]
    return changed


class Setting(NamedTuple):
    """What robots and logs of a study are.

    Attributes:
        guess: What the robots were drawn as.
        motion: By which they are identified.
        unseen: By which they are assessed.
        rate: [Hz] of the logs.
        encoders: Of the readings.
        torque_noise: [N m] standard deviation of each torque.
        coulomb: [N m] of a motor, in the middle.
        viscous: [N m s/rad] likewise.
        duration: [s] of the log that is fitted.
        validation: [s] of that of the unseen motion.
    """

    guess: RobotParameters
    motion: Reference
    unseen: Reference
    rate: float
    encoders: EncoderOptions
    torque_noise: float
    coulomb: float
    viscous: float
    duration: float = 60.0
    validation: float = 20.0


class Trial(NamedTuple):
    """One robot's identification, compared with the truth.

    Attributes:
        payload: [-] error of the payload's mass over it.
        place: [m] of its place.
        coulomb: [-] largest error of a motor's, over it.
        viscous: [-] likewise.
        predicted: [-] error of an unseen log's torques over them, RMS, where no crank sticks.
        by_guess: [-] the same of the guess's torques.
        inside: (32,) whether the 95 % intervals hold the truth; NaN where there is none.
    """

    payload: float
    place: float
    coulomb: float
    viscous: float
    predicted: float
    by_guess: float
    inside: np.ndarray


def run_trial(setting: Setting, seed: int) -> Trial:
    """Identifies a robot of `deviating` from one log.

    Args:
        setting: Whose.
        seed: Of the robot and the noise.
    """
    rng = np.random.default_rng(seed)
    guess = setting.guess
    truth = deviating(guess, rng, setting.coulomb, setting.viscous)
    logs = [
        recorded(guess, truth, motion, seconds, setting.rate, setting.encoders, setting.torque_noise, rng)
        for motion, seconds in ((setting.motion, setting.duration), (setting.unseen, setting.validation))
    ]
    found = identify(guess, logs[:1], validate=logs[1:])
    values, width = found.estimate.values, found.half_width
    off = np.abs(values - values_of(guess) - found.estimate.identifiable_part(truth - values_of(guess)))
    load = truth - values_of(guess)
    mass, place = found.payload

    def worst(part: slice) -> float:
        return float(np.abs(found.values[part] / truth[part] - 1.0).max())

    return Trial(
        abs(mass / load[0] - 1.0),
        float(np.linalg.norm(place - load[1:4] / load[0])),
        worst(COULOMB),
        worst(VISCOUS),
        found.predictions[-1].identified,
        found.predictions[-1].guess,
        np.where(width > 0.0, off <= width, np.nan),
    )


def coverage(trials: Sequence[Trial]) -> dict[str, float]:
    """Share [-] of the intervals that hold the truth: of each kind, and under `all`; NaN where none had one."""
    inside = np.array([trial.inside for trial in trials])
    kinds = {kind: [at for at, parameter in enumerate(PARAMETERS) if parameter.kind == kind] for kind in KINDS}
    kinds["all"] = list(range(len(PARAMETERS)))  # type: ignore[index]
    shares = {}
    for kind, columns in kinds.items():
        some = inside[:, columns]
        shares[str(kind)] = float(np.nanmean(some)) if np.isfinite(some).any() else float("nan")
    return shares
