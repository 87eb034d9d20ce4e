"""Crank angles and torques over time: of a log of this package or of a CSV file, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.tables import numbers_to_csv, read_numbers
from stewart_drake.logs.log import SimulationLog, load_log
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS
from stewart_drake.sampling import unwrapped

MAX_BYTES, MAX_ROWS = 300_000_000, 1_000_000
UNEVEN = 0.1
"""[-] of a step by which times may lie beside an even grid."""
QUANTITIES = (
    ("time", "s"),
    *((f"crank_angle_{leg}", "rad") for leg in range(LEGS)),
    *((f"torque_{leg}", "N m") for leg in range(LEGS)),
)
"""What a table has columns of, and the unit in which it is kept."""


@dataclass(frozen=True, eq=False)
class Recording:
    """n readings of six cranks and six torques at an even rate, checked.

    Attributes:
        time: (n,) [s].
        angles: (n, 6) [rad] encoder readings; kept without jumps by whole turns, the first within half a turn.
        torque: (n, 6) [N m] as the motors' amplifiers say.
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
            if not np.isfinite(values).all():
                row = int(np.argwhere(~np.isfinite(values))[0][0])
                raise ConfigurationError(f"{self.source}: row {row + 1}, {name}", values[row], "finite numbers")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if len(self.time) < 2:
            raise ConfigurationError(self.source, f"{len(self.time)} rows", "some seconds of motion")
        steps = np.diff(self.time)
        uneven = np.abs(steps - np.median(steps)) > UNEVEN * np.median(steps)
        if uneven.any() or np.median(steps) <= 0.0:
            row = int(uneven.argmax())
            got = f"{self.time[row]:g} s and then {self.time[row + 1]:g} s in row {row + 2}"
            raise ConfigurationError(f"{self.source}: time", got, "rows at an even rate, without gaps")
        if np.abs(self.angles).max() > 4.0 * math.pi:
            row, leg = np.unravel_index(np.abs(self.angles).argmax(), self.angles.shape)
            allowed = "radians within +-4 pi; degrees go by crank_angle_0_deg"
            raise ConfigurationError(f"{self.source}: row {row + 1}, crank_angle_{leg}", self.angles[row, leg], allowed)
        angles = unwrapped(self.angles)
        angles.flags.writeable = False
        object.__setattr__(self, "angles", angles)
        still = (self.torque == 0.0).all(axis=0)
        if still.any():
            got = "0 in all rows"
            raise ConfigurationError(f"{self.source}: torque_{still.argmax()}", got, "torques that were measured")

    @property
    def rate(self) -> float:
        """[Hz] of the rows."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0])

    def to_csv(self) -> str:
        """A table that `load_recording` reads."""
        return numbers_to_csv(QUANTITIES, np.concatenate([self.time[:, None], self.angles, self.torque], axis=-1))


def load_recording(path: str | Path, guess: RobotParameters, lag: float = 0.0) -> Recording:
    """A recording from a log of this package (.parquet, or a results folder), or from a CSV file with `QUANTITIES`.

    For the lag [s] of a CSV file see `Recording`: torques measured with the angles have 0, commands that are held until
    the next row half a row.
    """
    if Path(path).suffix.lower() != ".csv":
        return of_log(load_log(path), guess, f"log {path}")
    source = f"recording {path}"
    values = read_numbers(path, source, QUANTITIES, MAX_BYTES, MAX_ROWS)
    return Recording(values[:, 0], values[:, 1:7], values[:, 7:], lag, source=source)


def of_log(log: SimulationLog, guess: RobotParameters, source: str = "log") -> Recording:
    """What encoders and amplifiers said in a run: readings by way of the pose that they gave, never the true pose.

    Where the controller sees the robot itself, without encoders, that is what it sees.
    """
    robot = log.scenario.believed_robot
    for name in ("shaft_positions", "platform_joints", "crank_lengths", "rod_lengths", "crank_zero_directions"):
        off = np.abs(getattr(robot, name) - getattr(guess, name)).max()
        if off > 1e-9:
            got = f"a robot whose {name} differ by up to {off:.3g}"
            raise ConfigurationError(source, got, "a log of the robot that is guessed")
    if not log.scenario.estimator.exact:
        got = f"poses of estimator.kind {log.scenario.estimator.kind}, which uses the robot that is guessed"
        raise ConfigurationError(source, got, "poses as they are read: estimator.kind difference")
    # Between two ticks nothing is read, and the torque is held.
    tick, step = log.scenario.controller.period, log.scenario.effective_log_period
    rows = slice(None, None, max(1, round(tick / step)))
    pose = log.signals.get("measured_pose", log["pose"])[rows]
    angles = inverse_kinematics(robot, pose)
    # A torque acts until the next tick. The plant's own steps put an acceleration half a step ahead of its torque.
    lag = 0.5 * (tick - log.scenario.plant.time_step)
    return Recording(log.time[rows], angles, log["torque_applied"][rows], lag, log.scenario.gravity, source)
