"""What tracker and encoders would say of a robot, and the derivatives of that by everything a calibration can change.

Where a tracker's frame is not known, B is where the shafts lie nearest to the guess's, and P where the joints do.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import newton, roll_pitch_yaw, rotation_matrix
from stewart_drake.mechanics.kinematics_laws import robot_record
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

if TYPE_CHECKING:
    from stewart_drake.calibration.poses import MeasurementNoise

FrameName = Literal["base", "platform"]
FRAMES: tuple[FrameName, ...] = get_args(FrameName)
"""Of the tracker: in it the base B stands still, on the platform P it has a marker."""
Name = Literal["shaft_position", "platform_joint", "crank_length", "rod_length", "motor_axis", "homing_offset"]
NAMES: tuple[Name, ...] = get_args(Name)


class Parameter(NamedTuple):
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
IN_THOUSANDTHS = tuple(f"{own} [m{own.unit}]".replace("_", " ") for own in OF_LEG)
PER_LEG, OF_ROBOT = len(OF_LEG), len(OF_LEG) * LEGS
SIZE = OF_ROBOT + 12
"""Numbers in all: those of legs 0 to 5, then turn and shift of the tracker's frame, then those of the marker's."""
SHAFT, JOINT, CRANK, ROD, HOMING = slice(0, 3), slice(3, 6), 6, 7, 10
LARGEST = 0.1  # [-] standard deviation of a direction, in `scales`, beyond which it counts as unidentifiable
CLOSED = 1e-12  # [m] rod-length error at which a pose counts as that of the readings
STILL = np.eye(4)
_NEWTON_STEPS = 40
_KEYS = (
    *("shaft_position", "platform_joint", "crank_length", "rod_length"),
    *("crank_zero_direction", "crank_quarter_direction"),
)
_STEP = 1e-5  # [m, rad]


def exponential(turn: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of rotation vectors (3,) or (n, 3) [rad]."""
    return np.asarray(Rotation.from_rotvec(turn).as_matrix())


def logarithm(rotation: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3), by less than half a turn."""
    across = 0.5 * np.stack([rotation[..., i, j] - rotation[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1)
    sine, cosine = np.linalg.norm(across, axis=-1), 0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0)
    ratio = np.divide(np.arctan2(sine, cosine), sine, out=np.ones_like(sine), where=sine > 0.0)
    return np.asarray(across * ratio[..., None])


def transform(rotation: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Frames (..., 4, 4) of rotations (..., 3, 3) and shifts (..., 3) [m]."""
    frame = np.zeros((*shift.shape[:-1], 4, 4))
    frame[..., :3, :3], frame[..., :3, 3], frame[..., 3, 3] = rotation, shift, 1.0
    return frame


def transform_of(pose: np.ndarray) -> np.ndarray:
    return transform(rotation_matrix(pose[..., :3]), pose[..., 3:])


def pose_of(frame: np.ndarray) -> np.ndarray:
    """Poses (..., 6) [rad, m] of frames (..., 4, 4)."""
    return np.concatenate([roll_pitch_yaw(frame[..., :3, :3]), frame[..., :3, 3]], axis=-1)


def moved(frame: np.ndarray, step: np.ndarray) -> np.ndarray:
    """A frame, and then a turn about where it leads and a shift, `step` (6,) [rad, m]."""
    return transform(exponential(step[:3]) @ frame[..., :3, :3], frame[..., :3, 3] + step[3:])


def difference(frame: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Turn and shift (..., 6) [rad, m] from another frame to this one: undoes `moved`."""
    turn = logarithm(frame[..., :3, :3] @ np.swapaxes(other[..., :3, :3], -1, -2))
    return np.concatenate([turn, frame[..., :3, 3] - other[..., :3, 3]], axis=-1)


def derivative(function: Callable[[np.ndarray], np.ndarray], size: int) -> np.ndarray:
    """Derivatives (..., size) at zero of a function (...) of `size` numbers, by central differences."""
    return np.stack([function(row) - function(-row) for row in _STEP * np.eye(size)], axis=-1) / (2.0 * _STEP)


def changed(guess: RobotParameters, change: np.ndarray) -> dict[str, np.ndarray]:
    """The guess's legs after a change (`SIZE`,) [m, rad], as in a `ROBOT` record; they count angles as the encoders."""
    own = change[:OF_ROBOT].reshape(LEGS, PER_LEG)
    zero, quarter = guess.crank_zero_directions, guess.crank_quarter_directions
    rotation = exponential(own[:, 8:9] * zero + own[:, 9:10] * quarter)
    zero, quarter = (np.einsum("lij,lj->li", rotation, each) for each in (zero, quarter))
    c, s = np.cos(own[:, HOMING, None]), np.sin(own[:, HOMING, None])
    return {
        "shaft": guess.shaft_positions + own[:, SHAFT],
        "joint": guess.platform_joints + own[:, JOINT],
        "crank_length": guess.crank_lengths + own[:, CRANK],
        "rod_length": guess.rod_lengths + own[:, ROD],
        "crank_x": c * zero - s * quarter,
        "crank_y": s * zero + c * quarter,
    }


def as_robot(guess: RobotParameters, change: np.ndarray) -> RobotParameters:
    own = changed(guess, change)
    names = dict(zip(own, _KEYS, strict=True))
    ranges = guess.crank_angle_ranges + change[HOMING:OF_ROBOT:PER_LEG, None]
    legs: list[dict[str, Any]] = [
        {
            **{names[name]: values[leg] for name, values in own.items()},
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
                for shift in (np.tile(axis, (LEGS, 1)), np.cross(axis, points - points.mean(axis=0))):
                    rows.append(np.zeros(SIZE))
                    rows[-1][:OF_ROBOT].reshape(LEGS, PER_LEG)[:, place] = shift / np.linalg.norm(shift)
    return null_space(np.array(rows)) if rows else np.eye(SIZE)


@dataclass(frozen=True, eq=False)
class Model:
    """A guess, `base` (4, 4): B in the tracker's frame, and `marker` (4, 4): the marker in P; changes count from them.

    `at` (n, 4, 4) are poses of P in B, `observed` of the marker in the tracker's frame, `angles` (n, 6)
    [rad] the readings.
    """

    guess: RobotParameters
    base: np.ndarray = field(default_factory=lambda: STILL)
    marker: np.ndarray = field(default_factory=lambda: STILL)

    def frames(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return moved(self.base, change[OF_ROBOT : OF_ROBOT + 6]), moved(self.marker, change[OF_ROBOT + 6 :])

    def with_frames(self, change: np.ndarray) -> Model:
        base, marker = self.frames(change)
        return replace(self, base=base, marker=marker)

    def platform(self, change: np.ndarray, observed: np.ndarray) -> np.ndarray:
        base, marker = self.frames(change)
        return np.linalg.inv(base) @ observed @ np.linalg.inv(marker)

    def predicted(self, change: np.ndarray, angles: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses of P in B that forward kinematics makes of readings, from poses near to them; errors (n,) [m] left."""
        robot = robot_record(self.guess).copy()
        for name, values in changed(self.guess, change).items():
            robot[name] = values
        pose, off, _ = newton(robot, angles, pose_of(start), CLOSED, _NEWTON_STEPS)
        return transform_of(np.nan_to_num(pose, posinf=0.0, neginf=0.0)), np.nan_to_num(off, nan=np.inf)

    def assembled(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses of P in B at those of n readings at which the guess can be assembled, and which these are (n,)."""
        home = np.tile(transform(np.eye(3), self.guess.home_pose[3:]), (len(angles), 1, 1))
        at, off = self.predicted(np.zeros(SIZE), angles, home)
        return at[off <= CLOSED], off <= CLOSED

    def closures(self, change: np.ndarray, at: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Errors (n, 6) [m] of the rods' lengths."""
        own = changed(self.guess, change)
        crank = np.cos(angles)[..., None] * own["crank_x"] + np.sin(angles)[..., None] * own["crank_y"]
        rod = np.einsum("nij,lj->nli", at[:, :3, :3], own["joint"]) + at[:, None, :3, 3] - own["shaft"]
        rod = rod - own["crank_length"][:, None] * crank
        return np.asarray(np.linalg.norm(rod, axis=-1) - own["rod_length"])

    def tracker_error(self, change: np.ndarray, at: np.ndarray, observed: np.ndarray) -> np.ndarray:
        """Measured minus predicted poses of the marker (n, 6) [rad, m]."""
        base, marker = self.frames(change)
        return difference(observed, base @ at @ marker)

    def closure_slope(self, change: np.ndarray, observed: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Derivatives (n, 6, `SIZE`) of the closures at measured poses."""
        of_legs = self._leg_slope(change, self.platform(change, observed), angles)
        of_frames = derivative(
            lambda s: self.closures(change, self.platform(change + _frames(s), observed), angles), 12
        )
        return np.concatenate([of_legs, of_frames], axis=-1)

    def tracker_slope(
        self, change: np.ndarray, at: np.ndarray, angles: np.ndarray, observed: np.ndarray | None = None
    ) -> np.ndarray:
        """Derivatives (n, 6, `SIZE`) of the tracker's error at predicted poses; None: where it errs by nothing."""
        if observed is None:
            base, marker = self.frames(change)
            observed = base @ at @ marker
        of_frames = derivative(lambda step: self.tracker_error(change + _frames(step), at, observed), 12)
        error_by_pose = derivative(lambda step: self.tracker_error(change, moved(at, step), observed), 6)
        closure_by_pose = derivative(lambda step: self.closures(change, moved(at, step), angles), 6)
        # The pose moves so that all legs stay closed.
        of_legs = -error_by_pose @ np.linalg.solve(closure_by_pose, self._leg_slope(change, at, angles))
        return np.concatenate([of_legs, of_frames], axis=-1)

    def _leg_slope(self, change: np.ndarray, at: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Derivatives (n, 6, `OF_ROBOT`) of the closures, of each leg by its own numbers."""
        every = np.concatenate([np.tile(np.eye(PER_LEG), (LEGS, 1)), np.zeros((12, PER_LEG))])
        made = np.zeros((len(angles), LEGS, LEGS, PER_LEG))
        own = derivative(lambda step: self.closures(change + every @ step, at, angles), PER_LEG)
        made[:, range(LEGS), range(LEGS)] = own
        return made.reshape(len(angles), LEGS, OF_ROBOT)

    def whitening(self, change: np.ndarray, at: np.ndarray, angles: np.ndarray, noise: MeasurementNoise) -> np.ndarray:
        """Inverse roots (n, 6, 6) of the covariance of the tracker's error, the encoders' share included."""
        by_reading = self.tracker_slope(change, at, angles)[..., HOMING:OF_ROBOT:PER_LEG]
        own = np.diag([noise.rotation**2] * 3 + [noise.position**2] * 3)
        covariance = own + noise.encoder**2 * by_reading @ np.swapaxes(by_reading, -1, -2)
        return np.linalg.inv(np.linalg.cholesky(covariance))


def _frames(step: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros(OF_ROBOT), step])
