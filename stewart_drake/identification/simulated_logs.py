"""Robots that are not quite what was drawn, and what their encoders and amplifiers would say: to judge estimates by."""

from __future__ import annotations

import numpy as np

from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.identification.parameters import (
    COULOMB,
    GAIN,
    PARAMETERS,
    SIZE,
    VISCOUS,
    as_robot,
    of_robot,
    with_payload,
)
from stewart_drake.identification.recording import Recording
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics
from stewart_drake.mechanics.kinematics import crank_rates, inverse_kinematics, leg_geometry
from stewart_drake.references import Reference
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

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
    values = of_robot(guess)
    off = np.array([own.kind not in KNOWN for own in PARAMETERS])
    values *= np.where(off, 1.0 + share * rng.uniform(-1.0, 1.0, SIZE), 1.0)
    values[COULOMB] = friction * rng.uniform(0.5, 1.5, LEGS)
    values[VISCOUS] = viscous * rng.uniform(0.5, 1.5, LEGS)
    gains = np.log1p(share * rng.uniform(-1.0, 1.0, LEGS))
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
