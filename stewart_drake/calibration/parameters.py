"""What a calibration can change: eleven numbers of each leg and twelve of the tracker's two frames, as one vector.

The frames of the robot are not given by nature: whoever moves B, and all shafts with it, has the same robot. So where a
frame of the tracker is not known, six of its numbers and six of the robot's say the same, and a convention must choose:
B is where the shafts lie nearest to those of the guess, in the sense of least squares, and P where the platform's
joints do. Both conditions are linear in the change of the positions (of Kabsch's problem they are the optimum).
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import cross
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

FrameName = Literal["base", "platform"]
FRAMES: tuple[FrameName, ...] = get_args(FrameName)
"""Of the tracker: in it the base B stands still, on the platform P it has a marker."""
Name = Literal["shaft_position", "platform_joint", "crank_length", "rod_length", "motor_axis", "homing_offset"]
NAMES: tuple[Name, ...] = get_args(Name)


class Parameter(NamedTuple):
    """One number of a leg.

    Attributes:
        name: One of `NAMES`.
        axis: Which of its components; empty where there is one.
        unit: rad or m.
    """

    name: Name
    axis: str
    unit: str


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
_SHAFT, _JOINT = slice(0, 3), slice(3, 6)
_CRANK, _ROD, _TILT, _HOMING = 6, 7, slice(8, 10), 10


class Geometry(NamedTuple):
    """A robot's legs as a calibration sees them.

    Attributes:
        shafts: (6, 3) [m] in B.
        joints: (6, 3) [m] in P.
        cranks: (6,) [m] lengths.
        rods: (6,) [m] lengths.
        zeros: (6, 3) [-] directions of the cranks at angle 0.
        quarters: (6, 3) [-] at pi/2.
        homing: (6,) [rad] reading minus true angle.
        turning: (6, 3, 2) [-] rotation in B of each crank's plane per change of its two angles.
    """

    shafts: np.ndarray
    joints: np.ndarray
    cranks: np.ndarray
    rods: np.ndarray
    zeros: np.ndarray
    quarters: np.ndarray
    homing: np.ndarray
    turning: np.ndarray


def changed(guess: RobotParameters, change: np.ndarray) -> Geometry:
    """The guess's legs after a change (`SIZE`,) [m, rad] of the parameters."""
    of_legs = change[:OF_ROBOT].reshape(LEGS, PER_LEG)
    axes = np.stack([guess.crank_zero_directions, guess.crank_quarter_directions], axis=-1)
    turn = np.einsum("lij,lj->li", axes, of_legs[:, _TILT])
    rotation = exponential(turn)
    return Geometry(
        guess.shaft_positions + of_legs[:, _SHAFT],
        guess.platform_joints + of_legs[:, _JOINT],
        guess.crank_lengths + of_legs[:, _CRANK],
        guess.rod_lengths + of_legs[:, _ROD],
        np.einsum("lij,lj->li", rotation, guess.crank_zero_directions),
        np.einsum("lij,lj->li", rotation, guess.crank_quarter_directions),
        of_legs[:, _HOMING],
        left_jacobian(turn) @ axes,
    )


def as_robot(guess: RobotParameters, change: np.ndarray) -> RobotParameters:
    """The robot after a change, whose crank angles are the encoders' readings: it takes up the homing offsets.

    Raises:
        ConfigurationError: It cannot be a robot, see `RobotParameters`.
    """
    own = changed(guess, change)
    c, s = np.cos(own.homing)[:, None], np.sin(own.homing)[:, None]
    zeros, quarters = c * own.zeros - s * own.quarters, s * own.zeros + c * own.quarters
    ranges = guess.crank_angle_ranges + own.homing[:, None]
    legs: list[dict[str, Any]] = [
        {
            "shaft_position": own.shafts[leg],
            "crank_zero_direction": zeros[leg],
            "crank_quarter_direction": quarters[leg],
            "platform_joint": own.joints[leg],
            "crank_length": own.cranks[leg],
            "rod_length": own.rods[leg],
            "branch": int(guess.branches[leg]),
            "crank_angle_range": ranges[leg] if np.isfinite(ranges[leg]).all() else None,
        }
        for leg in range(LEGS)
    ]
    return guess.replace(legs=legs)


def change_to(guess: RobotParameters, robot: RobotParameters) -> np.ndarray:
    """The change (`SIZE`,) [m, rad] that makes of a guess another robot, frames left alone: undoes `as_robot`."""
    change = np.zeros((LEGS, PER_LEG))
    change[:, _SHAFT] = robot.shaft_positions - guess.shaft_positions
    change[:, _JOINT] = robot.platform_joints - guess.platform_joints
    change[:, _CRANK] = robot.crank_lengths - guess.crank_lengths
    change[:, _ROD] = robot.rod_lengths - guess.rod_lengths
    zero, quarter = guess.crank_zero_directions, guess.crank_quarter_directions
    axis, other = cross(zero, quarter), cross(robot.crank_zero_directions, robot.crank_quarter_directions)
    # The turn that takes one motor axis to the other on the shortest way lies across both, so in the crank's plane.
    across = cross(axis, other)
    sine = np.linalg.norm(across, axis=-1)
    angle = np.arctan2(sine, np.sum(axis * other, axis=-1))
    turn = across * np.divide(angle, sine, out=np.ones(LEGS), where=sine > 0.0)[:, None]
    change[:, 8], change[:, 9] = np.sum(turn * zero, axis=-1), np.sum(turn * quarter, axis=-1)
    rotation = exponential(turn)
    c, s = (np.einsum("lij,lj,li->l", rotation, v, robot.crank_zero_directions) for v in (zero, quarter))
    change[:, _HOMING] = np.arctan2(-s, c)
    return np.concatenate([change.ravel(), np.zeros(12)])


def scales(guess: RobotParameters) -> np.ndarray:
    """Change (`SIZE`,) [m, rad] of each parameter that counts as 1: a radian, or the robot's characteristic length."""
    length = guess.characteristic_length
    of_leg = [length if each.unit == "m" else 1.0 for each in OF_LEG]
    return np.array(of_leg * LEGS + ([1.0] * 3 + [length] * 3) * 2)


def free_directions(guess: RobotParameters, known: Collection[FrameName], held: Collection[Name]) -> np.ndarray:
    """Orthonormal directions (`SIZE`, k), in `scales`, in which the parameters may change.

    Args:
        guess: The robot as believed.
        known: Frames of the tracker that are those of the robot.
        held: Parameters that keep their value.

    Raises:
        ConfigurationError: Nothing is left to change.
    """
    from scipy.linalg import null_space

    rows = [_unit(column) for column in range(OF_ROBOT) if OF_LEG[column % PER_LEG].name in held]
    for frame, name, place, points in (
        ("base", "shaft_position", _SHAFT, guess.shaft_positions),
        ("platform", "platform_joint", _JOINT, guess.platform_joints),
    ):
        if frame in known:
            start = OF_ROBOT + 6 * FRAMES.index(frame)
            rows += [_unit(column) for column in range(start, start + 6)]
        elif name not in held:
            # Held positions are a frame themselves.
            rows += list(_alignment(points, place))
    basis: np.ndarray = np.eye(SIZE) if not rows else null_space(np.array(rows))
    if set(NAMES) <= set(held):
        raise ConfigurationError("hold", sorted(held), f"some of {', '.join(NAMES)}, not all")
    return basis


def exponential(turn: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(turn.reshape(-1, 3)).as_matrix().reshape(*turn.shape, 3))


def logarithm(rotation: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) [rad] of rotation matrices (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def skew(vector: np.ndarray) -> np.ndarray:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(vector, -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*vector.shape, 3)


def left_jacobian(turn: np.ndarray) -> np.ndarray:
    """(..., 3, 3) with Exp(turn + d) = Exp(left_jacobian d) Exp(turn), of rotation vectors (..., 3) [rad]."""
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    matrix = skew(turn)
    return np.eye(3) + first * matrix + second * (matrix @ matrix)


def _unit(column: int) -> np.ndarray:
    row = np.zeros(SIZE)
    row[column] = 1.0
    return row


def _alignment(points: np.ndarray, place: slice) -> np.ndarray:
    """Rows (6, `SIZE`) that are zero for changes of six points which neither shift nor turn them as a whole."""
    rows = np.zeros((6, SIZE))
    columns = rows[:, :OF_ROBOT].reshape(6, LEGS, PER_LEG)
    centred = points - points.mean(axis=0)
    # Scaled as the rows of what is held, so that all have a say in what counts as zero.
    columns[:3, :, place] = np.eye(3)[:, None, :] / np.sqrt(LEGS)
    columns[3:, :, place] = np.moveaxis(skew(centred), 0, 1) / np.linalg.norm(centred)
    return rows
