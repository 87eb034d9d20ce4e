"""From logs of crank angles and torques to equations: read, checked, filtered, one row of the model for each instant.

One filter for angles and torques. Where a crank turns slowly or back its row has no say, nor where the filter smears.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.interpolate
import scipy.ndimage
import scipy.signal

from stewart_drake.errors import ConfigurationError, ForwardKinematicsError, UnreachablePoseError
from stewart_drake.files.tables import CRANK_ANGLES, numbers_to_csv, read_numbers, refuse_cells
from stewart_drake.identification.parameters import BODIES, COULOMB, GAIN, SIZE, VISCOUS, unit_robots
from stewart_drake.logs.log import SimulationLog, load_log
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, inverse_dynamics
from stewart_drake.mechanics.kinematics import crank_rates, forward_kinematics, inverse_kinematics, leg_geometry
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS
from stewart_drake.sampling import unwrapped

MAX_BYTES, MAX_ROWS = 300_000_000, 1_000_000
UNEVEN = 0.1  # [-] of a step by which times may lie beside an even grid
QUANTITIES = (("time", "s"), *CRANK_ANGLES, *((f"torque_{leg}", "N m") for leg in range(LEGS)))
BANDWIDTH, ROWS_A_PERIOD = 15.0, 12.0
"""[Hz] where the filter lets half of the amplitude through, and least rows in one of its periods."""
SLOW = 0.05  # [rad/s] of a crank below which its friction may stick
_OVERSAMPLING, _SMEAR, _EDGE, _SHORTEST = 6.0, 0.5, 2.0, 20.0
"""In periods of the bandwidth: rows a period, how far the filter smears, what the ends lose, what must be left."""
_HOMOTOPY = 4


@dataclass(frozen=True, eq=False)
class Recording:
    """n readings of six cranks and six torques at a constant rate, checked.

    Attributes:
        time: (n,) [s].
        angles: (n, 6) [rad] encoder readings; kept without jumps by whole turns, the first within half a turn.
        torque: (n, 6) [N m] as reported by the motors' amplifiers.
        lag: [s] from a row's time to the middle of that over which its torque acts.
        gravity: [m/s^2].
        source: What it is called in messages, such as the file's name.

    Raises:
        ConfigurationError: Wrong shapes; a value that is not finite; angles beyond two turns; gaps in time; torques
            that are always zero.
    """

    time: np.ndarray
    angles: np.ndarray
    torque: np.ndarray
    lag: float = 0.0
    gravity: float = STANDARD_GRAVITY
    source: str = "recording"

    def __post_init__(self) -> None:
        for name, shape in (("time", ()), ("angles", (LEGS,)), ("torque", (LEGS,))):
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != (len(self.time), *shape):
                wanted = ", ".join(map(str, ("n", *shape)))
                raise ConfigurationError(f"{self.source}: {name}", values.shape, f"numbers of shape ({wanted})")
            object.__setattr__(self, name, values)
        refuse_cells(self.source, QUANTITIES, self.table, ~np.isfinite(self.table), "a finite number")
        if len(self.time) < 2:
            raise ConfigurationError(self.source, f"{len(self.time)} rows", "some seconds of motion")
        steps = np.diff(self.time)
        uneven = np.abs(steps - np.median(steps)) > UNEVEN * np.median(steps)
        if uneven.any() or np.median(steps) <= 0.0:
            row = int(uneven.argmax())
            got = f"{self.time[row]:g} s and then {self.time[row + 1]:g} s in row {row + 2}"
            raise ConfigurationError(f"{self.source}: time", got, "rows at a constant rate, without gaps")
        beyond = np.abs(self.angles) > 4.0 * math.pi
        allowed = "radians within +-4 pi; for degrees name the columns crank_angle_0_deg to crank_angle_5_deg"
        refuse_cells(self.source, CRANK_ANGLES, self.angles, beyond, allowed)
        object.__setattr__(self, "angles", unwrapped(self.angles))
        for values in (self.time, self.angles, self.torque):
            values.flags.writeable = False
        still = (self.torque == 0.0).all(axis=0)
        if still.any():
            got = "0 in all rows"
            raise ConfigurationError(f"{self.source}: torque_{still.argmax()}", got, "measured torques")

    @property
    def rate(self) -> float:
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    @property
    def table(self) -> np.ndarray:
        return np.concatenate([self.time[:, None], self.angles, self.torque], axis=-1)

    def to_csv(self) -> str:
        return numbers_to_csv(QUANTITIES, self.table)


def load_recording(path: str | Path, guess: RobotParameters, lag: float = 0.0) -> Recording:
    """A recording from a log of this package (.parquet, or a folder), or a CSV file with `QUANTITIES` and a lag [s]."""
    if Path(path).suffix.lower() != ".csv":
        return of_log(load_log(path), guess, f"log {path}")
    source = f"recording {path}"
    values = read_numbers(path, source, QUANTITIES, MAX_BYTES, MAX_ROWS)
    return Recording(values[:, 0], values[:, 1:7], values[:, 7:], lag, source=source)


def of_log(log: SimulationLog, guess: RobotParameters, source: str = "log") -> Recording:
    """What encoders and amplifiers said in a run: readings by way of the pose that they gave, never the true pose."""
    robot = log.scenario.believed_robot
    for name in ("shaft_positions", "platform_joints", "crank_lengths", "rod_lengths", "crank_zero_directions"):
        off = np.abs(getattr(robot, name) - getattr(guess, name)).max()
        if off > 1e-9:
            got = f"a robot whose {name} differ by up to {off:.3g}"
            raise ConfigurationError(source, got, "a log of the guessed robot")
    if not log.scenario.estimator.exact:
        got = f"poses of estimator.kind {log.scenario.estimator.kind}, which uses the guessed robot"
        raise ConfigurationError(source, got, "poses straight from the encoders; run with estimator.kind=difference")
    # Between two ticks nothing is read, and the torque is held.
    tick, step = log.scenario.controller.period, log.scenario.effective_log_period
    rows = slice(None, None, max(1, round(tick / step)))
    angles = inverse_kinematics(robot, log.signals.get("measured_pose", log["pose"])[rows])
    # A torque acts until the next tick. The plant's own steps put an acceleration half a step ahead of its torque.
    lag = 0.5 * (tick - log.scenario.plant.time_step)
    return Recording(log.time[rows], angles, log["torque_applied"][rows], lag, log.scenario.gravity, source)


@dataclass(frozen=True, eq=False)
class Samples:
    """n instants: torques [N m], `bodies` (n, 6, 14), `known` torques, `sign` of cranks' `rates` [rad/s], rows `used`.

    `pieces` are the recordings, `step` [s] is between instants, of which `repeats` lie in half a period of the filter.
    """

    time: np.ndarray
    torque: np.ndarray
    bodies: np.ndarray
    known: np.ndarray
    sign: np.ndarray
    rates: np.ndarray
    used: np.ndarray
    pieces: tuple[slice, ...]
    step: float
    repeats: float
    source: str

    def predicted(self, values: np.ndarray) -> np.ndarray:
        """Torques (n, 6) [N m] that logs of a robot with parameters (`SIZE`,) say."""
        friction = values[COULOMB] * self.sign + values[VISCOUS] * self.rates
        return np.exp(-values[GAIN]) * (self.bodies @ values[BODIES] + self.known + friction)

    def derivative(self, values: np.ndarray) -> np.ndarray:
        """Of `predicted` by the parameters, (n, 6, `SIZE`)."""
        slope, own = np.zeros((*self.torque.shape, SIZE)), np.arange(LEGS)
        slope[..., BODIES] = self.bodies
        slope[:, own, COULOMB.start + own] = self.sign
        slope[:, own, VISCOUS.start + own] = self.rates
        slope *= np.exp(-values[GAIN])[:, None]
        slope[:, own, GAIN.start + own] = -self.predicted(values)
        return slope


def samples_of(guess: RobotParameters, recording: Recording, bandwidth: float | None = None) -> Samples:
    """Equations of a recording; what moves the robot should lie well below the filter's bandwidth [Hz]."""
    time, rate, source = recording.time, recording.rate, recording.source
    if bandwidth is None:
        bandwidth = min(BANDWIDTH, rate / ROWS_A_PERIOD)
    if not 0.0 < bandwidth <= rate / 5.0:
        allowed = f"above 0, at most {rate / 5.0:g} Hz, a fifth of the rows' rate"
        raise ConfigurationError("bandwidth", bandwidth, allowed)
    length, least = time[-1] - time[0], (2.0 * _EDGE + _SHORTEST) / bandwidth
    if length < least:
        raise ConfigurationError(source, f"{length:.3g} s", f"at least {least:.3g} s of motion")
    sos = scipy.signal.butter(4, bandwidth, fs=rate, output="sos")

    def smooth(values: np.ndarray) -> np.ndarray:
        return np.asarray(scipy.signal.sosfiltfilt(sos, values, axis=0))

    even = np.linspace(time[0], time[-1], len(time))
    angles = smooth(recording.angles)
    rates = np.gradient(angles, even, axis=0)
    thin = max(1, int(rate / (_OVERSAMPLING * bandwidth)))
    motion = scipy.interpolate.make_interp_spline(even[::thin], poses_of(guess, angles[::thin], source), k=5)
    torque = scipy.interpolate.make_interp_spline(even, smooth(recording.torque), k=3)
    at = even[::thin]
    at = at[(at > at[0] + _EDGE / bandwidth) & (at < at[-1] - _EDGE / bandwidth)]
    middle = np.searchsorted(even, at - 0.5 / rate)
    smear = 2 * int(_SMEAR * rate / bandwidth) + 1
    # By what a crank's rate is at least around an instant; where it changes its sign, zero.
    slowest = np.maximum(
        scipy.ndimage.minimum_filter1d(rates, smear, axis=0), -scipy.ndimage.maximum_filter1d(rates, smear, axis=0)
    )
    exact = samples_of_motion(guess, at, (motion(at), motion(at, 1), motion(at, 2)), recording.gravity, source)
    return replace(
        exact,
        torque=torque(at - recording.lag),
        sign=smooth(np.sign(rates))[middle],
        used=slowest[middle] > SLOW,
        repeats=rate / (2.0 * bandwidth * thin),
    )


def samples_of_motion(
    guess: RobotParameters,
    time: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    gravity: float,
    source: str = "motion",
) -> Samples:
    """Equations of a motion known exactly, without torques: inverse dynamics once for each parameter of the bodies."""
    pose, rate, _ = motion
    *columns, known = (inverse_dynamics(robot, *motion, gravity) for robot in unit_robots(guess))
    speed = crank_rates(guess, leg_geometry(guess, pose), pose, rate)
    used, step = np.abs(speed) > SLOW, float(time[1] - time[0])
    torque, bodies = np.zeros_like(known), np.stack(columns, axis=-1)
    return Samples(time, torque, bodies, known, np.sign(speed), speed, used, (slice(0, len(time)),), step, 1.0, source)


def together(parts: Sequence[Samples]) -> Samples:
    ends = np.cumsum([0, *(len(part.time) for part in parts)]).tolist()
    arrays = ("time", "torque", "bodies", "known", "sign", "rates", "used")
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays}
    return Samples(
        **joined,
        pieces=tuple(slice(start, end) for start, end in itertools.pairwise(ends)),
        step=max(part.step for part in parts),
        repeats=max(part.repeats for part in parts),
        source=", ".join(part.source for part in parts),
    )


def poses_of(guess: RobotParameters, angles: np.ndarray, source: str) -> np.ndarray:
    """Poses (n, 6) [rad, m] of crank angles (n, 6) [rad], followed from home in a few steps."""
    home = inverse_kinematics(guess, guess.home_pose)
    pose, stray = np.broadcast_to(guess.home_pose, angles.shape), np.inf
    try:
        for share in np.linspace(0.0, 1.0, _HOMOTOPY + 1)[1:]:
            pose = forward_kinematics(guess, home + share * (angles - home), pose)
        off = inverse_kinematics(guess, pose) - angles
        stray = float(np.abs(np.arctan2(np.sin(off), np.cos(off))).max())
    except (ForwardKinematicsError, UnreachablePoseError):
        pass
    if stray > 1e-6:
        allowed = "readings of the guessed robot, in radians, or in degrees if the columns are named so"
        raise ConfigurationError(source, "crank angles at which the robot cannot be assembled", allowed)
    return pose
