"""How the command of a hobby servo follows from a crank's angle: microseconds of a pulse, or counts of a bus servo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from stewart_drake.base.config import NotNegative, Positive, Section, SixNumbers
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.robot import RobotParameters

if TYPE_CHECKING:
    from stewart_drake.hardware.motors import MotorOptions
    from stewart_drake.hardware.presets import Wire

BEYOND = 1e-6  # [rad] by which a stop may be beyond what a servo reaches.
RATE, SPEED = 50.0, 6.0  # [1/s], [rad/s] of servos of which nothing is known.


def readings_at_home(robot: RobotParameters, zero_at: Sequence[float] = (0.0,) * 6) -> np.ndarray:
    """(6,) [rad] of the servos, with cranks at `zero_at` (6,) [rad] where these read zero."""
    return np.asarray((inverse_kinematics(robot, robot.home_pose) - zero_at) / robot.servo_gains)


def middle_readings(robot: RobotParameters, zero_at: Sequence[float] = (0.0,) * 6) -> np.ndarray:
    """(6,) [rad] of the servos in the middle of their travel, as mounted: `servo_middle`, or those at home."""
    return np.where(np.isnan(robot.servo_middles), readings_at_home(robot, zero_at), robot.servo_middles)


class ServoOptions(Section, key="model.servos"):
    """Six hobby servos on a board, for `export --sketch`. A servo in the middle of its travel has its crank at home.

    angle = servo_middle + direction (command - middle) travel / (largest - smallest command)

    This is the angle of a packet; the crank's is `servo_gain` of its leg times it. `servo_middle` and `servo_gain` are
    keys of the robot's legs, set by hand or by `calibrate`. Commands are the microseconds of a pulse, or counts of a
    bus servo; none is ever beyond the stops of the robot's legs, `crank_angle_range`. A crank with a wrong `direction`
    moves the wrong way, with a wrong `servo_middle` it is off at home, and with a wrong `servo_gain` elsewhere.
    """

    moved_keys: ClassVar[Mapping[str, str]] = {
        "offset": "servo_middle [rad] of the robot's legs: home angle + offset, over servo_gain",
        "gain": "servo_gain of the robot's legs",
    }

    commands: tuple[NotNegative, NotNegative] | None = None
    """Smallest and largest command: pulses [us], or counts of a bus servo; null for those of `motors.preset`."""
    travel: Positive | None = None
    """[rad] that a servo turns from the smallest to the largest command; null for that of `motors.preset`."""
    direction: SixNumbers = (1.0,) * 6
    """[-] 1 where a larger command turns a crank to larger angles, -1 where to smaller ones."""
    speed: Positive | None = None
    """[rad/s] largest speed of a commanded crank; null for the servo's speed without load."""
    rest_after: NotNegative | None = 5.0
    """[s] without a packet, after which a board that holds moves the cranks slowly home; null to hold for ever."""

    def wiring(self, robot: RobotParameters, motors: MotorOptions, zero_at: Sequence[float]) -> Wiring:
        """The numbers for a robot with such motors, and with cranks at `zero_at` (6,) [rad] where a servo reads zero.

        ConfigurationError where a number is missing or does not fit.
        """
        known: Wire | None = getattr(motors.gear, "wiring", None)
        commands, travel = self.commands or (known and known.commands), self.travel or (known and known.travel)
        if commands is None or travel is None:
            allowed = "commands [us] and travel [rad], or model.motors with a preset that has them, such as mg996r"
            raise ConfigurationError("model.servos", None, allowed)
        least, most = commands
        home, ranges = readings_at_home(robot, zero_at), (robot.crank_angle_ranges.T - zero_at) / robot.servo_gains
        zero, middle, half = middle_readings(robot, zero_at), 0.5 * (least + most), 0.5 * travel
        reach = np.stack([zero - half, zero + half])
        angles = np.clip(ranges, *reach)
        for leg, (low, high) in enumerate(reach.T):
            stops = ranges[:, leg]
            if np.isfinite(stops).all() and np.abs(stops - angles[:, leg]).max() > BEYOND:
                allowed = f"within {low:.4g} to {high:.4g} rad, what commands {least:g} to {most:g} reach"
                raise ConfigurationError(f"robot.legs.{leg}.crank_angle_range", stops.tolist(), allowed)
            if not low - BEYOND <= home[leg] <= high + BEYOND:
                allowed = f"within {half:.4g} rad of the servo's reading at home, {home[leg]:.4g} rad"
                raise ConfigurationError(f"robot.legs.{leg}.servo_middle", float(zero[leg]), allowed)
        per_rad = np.array(self.direction) * (most - least) / travel
        ends = np.sort(middle + per_rad * (angles - zero), axis=0)
        within = np.clip(np.stack([np.ceil(ends[0] - BEYOND), np.floor(ends[1] + BEYOND)]), least, most)
        speed = self.speed or getattr(motors, "no_load_speed", None) or SPEED
        kind, rate = (known.kind, known.rate) if known else (None, RATE)
        return Wiring(kind, middle, zero, per_rad, angles, within, home, speed, rate)

    def rules(self) -> None:
        """Two commands, in order, and signs."""
        if not {-1.0, 1.0}.issuperset(self.direction):
            raise ConfigurationError("direction", list(self.direction), "1 or -1, or a list of 6 of them")
        if self.commands is not None and not self.commands[0] < self.commands[1] <= 65535.0:
            raise ConfigurationError("commands", list(self.commands), "a smaller and a larger one, 0 to 65535")


class Wiring(NamedTuple):
    """`ServoOptions` as numbers of each servo, for a robot and its motors; angles are those of packets.

    A crank's angle is `servo_gain` of its leg times the angle of a packet, plus `model.home`.
    """

    kind: str | None  # Of the servos: `rc`, `sts`, `dynamixel`; None where it is not known.
    middle: float  # Command in the middle of the travel.
    zero: np.ndarray  # (6,) [rad] angle of the crank there.
    per_rad: np.ndarray  # (6,) commands per rad, negative where they turn a crank to smaller angles.
    angles: np.ndarray  # (2, 6) [rad] lowest and highest angles of the cranks.
    within: np.ndarray  # (2, 6) smallest and largest commands within these.
    home: np.ndarray  # (6,) [rad] angles of the cranks in the home pose.
    speed: float  # [rad/s] largest speed of a commanded crank.
    rate: float  # [1/s] most commands.

    def commands(self, angles: np.ndarray) -> np.ndarray:
        """Commands (..., 6), whole numbers, at angles (..., 6) [rad]; never beyond `within`."""
        return np.clip(np.floor(self.middle + self.per_rad * (angles - self.zero) + 0.5), *self.within)
