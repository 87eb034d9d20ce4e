"""What a calibration can change: eleven numbers of each leg and twelve of the tracker's two frames, as one vector.

Whoever moves B, and all shafts with it, has the same robot. So where a frame of the tracker is not known, six of its
numbers and six of the robot's say the same, and a convention chooses: B is where the shafts lie nearest to those of the
guess, in the sense of least squares, and P where the platform's joints do. Both conditions are linear in the change of
the positions (of Kabsch's problem they are the optimum).
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from stewart_drake.calibration.frames import exponential
from stewart_drake.errors import ConfigurationError
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

FrameName = Literal["base", "platform"]
FRAMES: tuple[FrameName, ...] = get_args(FrameName)
"""Of the tracker: in it the base B stands still, on the platform P it has a marker."""
Name = Literal["shaft_position", "platform_joint", "crank_length", "rod_length", "motor_axis", "homing_offset"]
NAMES: tuple[Name, ...] = get_args(Name)


class Parameter(NamedTuple):
    """One number of a leg: one of `NAMES`, which of its components (or none), and its unit."""

    name: Name
    axis: str
    unit: Literal["m", "rad"]

    def __str__(self) -> str:
        return f"{self.name} {self.axis}".strip()


OF_LEG = (
    *(Parameter("shaft_position", axis, "m") for axis in "xyz"),
    *(Parameter("platform_joint", axis, "m") for axis in "xyz"),
    Parameter("crank_length", "", "m"),
    Parameter("rod_length", "", "m"),
    Parameter("motor_axis", "about zero", "rad"),
    Parameter("motor_axis", "about quarter", "rad"),
    Parameter("homing_offset", "", "rad"),
)
"""Of one leg: positions in B and P; the motor's axis as a turn of the guess about its crank's directions; the homing
offset is reading minus true angle, counted from the guess's `crank_zero_direction` as that turn leaves it."""
PER_LEG, OF_ROBOT = len(OF_LEG), len(OF_LEG) * LEGS
SIZE = OF_ROBOT + 12
"""Numbers in all: those of legs 0 to 5, then turn and shift of the tracker's frame, then those of the marker's."""
SHAFT, JOINT, CRANK, ROD, HOMING = slice(0, 3), slice(3, 6), 6, 7, 10


LARGEST = 0.1
"""[-] standard deviation of a direction, in `scales`, beyond which it counts as not told: a tenth of the robot's size
is more than anybody's guess is off."""


class Geometry(NamedTuple):
    """A robot's legs, by the names that a `ROBOT` record has: (6, 3) [m] or [-], lengths (6,) [m]."""

    shaft: np.ndarray
    joint: np.ndarray
    crank_length: np.ndarray
    rod_length: np.ndarray
    crank_x: np.ndarray
    crank_y: np.ndarray


def changed(guess: RobotParameters, change: np.ndarray) -> Geometry:
    """The guess's legs after a change (`SIZE`,) [m, rad]; they count crank angles as the encoders do."""
    own = change[:OF_ROBOT].reshape(LEGS, PER_LEG)
    zero, quarter = guess.crank_zero_directions, guess.crank_quarter_directions
    rotation = exponential(own[:, 8:9] * zero + own[:, 9:10] * quarter)
    zero, quarter = (np.einsum("lij,lj->li", rotation, each) for each in (zero, quarter))
    c, s = np.cos(own[:, HOMING, None]), np.sin(own[:, HOMING, None])
    return Geometry(
        guess.shaft_positions + own[:, SHAFT],
        guess.platform_joints + own[:, JOINT],
        guess.crank_lengths + own[:, CRANK],
        guess.rod_lengths + own[:, ROD],
        c * zero - s * quarter,
        s * zero + c * quarter,
    )


def as_robot(guess: RobotParameters, change: np.ndarray) -> RobotParameters:
    """The robot after a change, whose crank angles are the encoders' readings: it takes up the homing offsets."""
    own = changed(guess, change)
    ranges = guess.crank_angle_ranges + change[HOMING:OF_ROBOT:PER_LEG, None]
    legs: list[dict[str, Any]] = [
        {
            "shaft_position": own.shaft[leg],
            "crank_zero_direction": own.crank_x[leg],
            "crank_quarter_direction": own.crank_y[leg],
            "platform_joint": own.joint[leg],
            "crank_length": own.crank_length[leg],
            "rod_length": own.rod_length[leg],
            "branch": int(guess.branches[leg]),
            "crank_angle_range": ranges[leg] if np.isfinite(ranges[leg]).all() else None,
        }
        for leg in range(LEGS)
    ]
    return guess.replace(legs=legs)


def scales(guess: RobotParameters) -> np.ndarray:
    """Change (`SIZE`,) [m, rad] of each parameter that counts as 1: a radian, or the robot's characteristic length."""
    length = guess.characteristic_length
    return np.array([length if each.unit == "m" else 1.0 for each in OF_LEG] * LEGS + ([1.0] * 3 + [length] * 3) * 2)


def free_directions(guess: RobotParameters, known: Collection[FrameName], held: Collection[Name]) -> np.ndarray:
    """Orthonormal directions (`SIZE`, k), in `scales`, in which the parameters may change."""
    from scipy.linalg import null_space

    if set(NAMES) <= set(held):
        raise ConfigurationError("hold", sorted(held), f"some of {', '.join(NAMES)}, not all")
    rows = [row for at, row in enumerate(np.eye(SIZE)[:OF_ROBOT]) if OF_LEG[at % PER_LEG].name in held]
    for frame, name, place, points in (
        ("base", "shaft_position", SHAFT, guess.shaft_positions),
        ("platform", "platform_joint", JOINT, guess.platform_joints),
    ):
        if frame in known:
            start = OF_ROBOT + 6 * FRAMES.index(frame)
            rows += list(np.eye(SIZE)[start : start + 6])
        elif name not in held:  # Held positions are a frame themselves.
            for axis in np.eye(3):
                for moved in (np.tile(axis, (LEGS, 1)), np.cross(axis, points - points.mean(axis=0))):
                    rows.append(np.zeros(SIZE))
                    rows[-1][:OF_ROBOT].reshape(LEGS, PER_LEG)[:, place] = moved / np.linalg.norm(moved)
    return null_space(np.array(rows)) if rows else np.eye(SIZE)
