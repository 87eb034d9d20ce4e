"""What tracker and encoders measure on a robot, and its derivatives by everything that a calibration can change.

If a frame of the tracker is unknown, B is where the shafts lie nearest to the guess's, and P where the joints do.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.base.atomic_files import Document
from stewart_drake.estimation import core
from stewart_drake.estimation.core import Parameter
from stewart_drake.mechanics.kinematics import newton, rod_length_errors, roll_pitch_yaw, rotation_matrix
from stewart_drake.mechanics.kinematics_laws import Robot, robot_record
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEG_COUNT

if TYPE_CHECKING:
    from stewart_drake.estimation.poses import MeasurementNoise

FRAMES = ("base", "platform")
"""Frames of the tracker: in its own frame the base B is at rest, on the platform P it has a marker."""
LEG_PARAMETERS = (
    *(Parameter("shaft_position", axis, "m") for axis in "xyz"),
    *(Parameter("platform_joint", axis, "m") for axis in "xyz"),
    Parameter("crank_length", "", "m"),
    Parameter("rod_length", "", "m"),
    Parameter("motor_axis", "about zero", "rad"),
    Parameter("motor_axis", "about quarter", "rad"),
    Parameter("homing_offset", "", "rad"),
)
"""Parameters of one leg. Positions are in B and P. `motor_axis` has two small rotations of the guessed axis, about the
crank's two directions. The homing offset is reading minus true angle; the true angle is counted from the guess's
`crank_zero_direction`, rotated with the axis."""
KINDS = tuple(dict.fromkeys(parameter.kind for parameter in LEG_PARAMETERS))
SHAFT, JOINT, CRANK, ROD, HOMING = slice(0, 3), slice(3, 6), 6, 7, 10
PARAMETERS = (
    *(parameter._replace(owner=f"leg {leg}") for leg in range(LEG_COUNT) for parameter in LEG_PARAMETERS),
    *(
        Parameter(frame, f"frame {what} {axis}", unit)
        for frame in FRAMES
        for what, unit in (("turn", "rad"), ("shift", "m"))
        for axis in "xyz"
    ),
)
"""Parameters of legs 0 to 5, then rotation and translation of the tracker's frame, then of the marker's frame."""
SIZE, PER_LEG, OF_ROBOT = len(PARAMETERS), len(LEG_PARAMETERS), len(LEG_PARAMETERS) * LEG_COUNT
LARGEST_DEVIATION = 0.1  # [-] in `scales`, beyond which a direction counts as unidentifiable
CLOSED = 1e-12  # [m] rod-length error below which forward kinematics has converged
_NEWTON_STEPS = 40
_STEP = 1e-5  # [m, rad] of finite differences
_FRAME_STEPS = np.eye(SIZE)[OF_ROBOT:]
_LEG_STEPS = np.hstack([np.tile(np.eye(PER_LEG), LEG_COUNT), np.zeros((PER_LEG, 12))])
"""Finite-difference steps that change a parameter of all legs at once: the closure of a leg depends on its own
parameters only."""


def by_leg(values: np.ndarray, display: bool = False) -> np.ndarray:
    """Values (`OF_ROBOT` or `SIZE`,) as (6, `PER_LEG`), on request in the units of texts."""
    factors = [parameter.display[1] if display else 1.0 for parameter in LEG_PARAMETERS]
    return values[:OF_ROBOT].reshape(LEG_COUNT, PER_LEG) * factors


def table_names() -> list[str]:
    """Names of `LEG_PARAMETERS` with the units of texts."""
    return [f"{parameter} [{parameter.display[0]}]".replace("_", " ") for parameter in LEG_PARAMETERS]


def exponential(turn: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of rotation vectors (3,) or (n, 3) [rad]."""
    return np.asarray(Rotation.from_rotvec(turn).as_matrix())


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
    """A frame after a turn about its origin and a shift, `step` (6,) [rad, m], along fixed axes."""
    return transform(exponential(step[:3]) @ frame[..., :3, :3], frame[..., :3, 3] + step[3:])


def difference(frame: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Turn and shift (n, 6) [rad, m] from other frames (n, 4, 4) to these: undoes `moved`."""
    turn = Rotation.from_matrix(frame[..., :3, :3] @ np.swapaxes(other[..., :3, :3], -1, -2)).as_rotvec()
    return np.concatenate([turn, frame[..., :3, 3] - other[..., :3, 3]], axis=-1)


def steps(frames: np.ndarray) -> np.ndarray:
    """Turns and shifts (n, 6) [rad, m] to each of n frames from the one before it, in a ring."""
    return difference(frames, np.roll(frames, 1, axis=0))


def derivative(function: Callable[[np.ndarray], np.ndarray], directions: np.ndarray) -> np.ndarray:
    """Derivatives (..., k) at zero of a function (...) of n numbers along directions (k, n), by central differences."""
    return np.stack([function(row) - function(-row) for row in _STEP * directions], axis=-1) / (2.0 * _STEP)


def changed_record(guess: RobotParameters, change: np.ndarray) -> Robot:
    """Record of the guess after a change (`SIZE`,) [m, rad]; its crank angles are the encoders' readings."""
    legs = by_leg(change)
    zero, quarter = guess.crank_zero_directions, guess.crank_quarter_directions
    rotation = exponential(legs[:, 8:9] * zero + legs[:, 9:10] * quarter)
    zero, quarter = (np.einsum("lij,lj->li", rotation, axes) for axes in (zero, quarter))
    c, s = np.cos(legs[:, HOMING, None]), np.sin(legs[:, HOMING, None])
    record = robot_record(guess).copy()
    record["shaft"] += legs[:, SHAFT]
    record["joint"] += legs[:, JOINT]
    record["crank_length"] += legs[:, CRANK]
    record["rod_length"] += legs[:, ROD]
    record["crank_x"], record["crank_y"] = c * zero - s * quarter, s * zero + c * quarter
    return record


def as_robot(guess: RobotParameters, change: np.ndarray) -> RobotParameters:
    (record,) = changed_record(guess, change)
    ranges = guess.crank_angle_ranges + change[HOMING:OF_ROBOT:PER_LEG, None]
    legs: list[Document] = [
        {
            "shaft_position": record["shaft"][leg],
            "platform_joint": guess.tool_rotation @ record["joint"][leg] + guess.tool_position,
            "crank_length": record["crank_length"][leg],
            "rod_length": record["rod_length"][leg],
            "crank_zero_direction": record["crank_x"][leg],
            "crank_quarter_direction": record["crank_y"][leg],
            "branch": int(guess.branches[leg]),
            "crank_angle_range": ranges[leg] if np.isfinite(ranges[leg]).all() else None,
        }
        for leg in range(LEG_COUNT)
    ]
    return guess.replace(legs=legs)


def values_of(guess: RobotParameters) -> np.ndarray:
    """Parameters (`OF_ROBOT`,) [m, rad] of a guess, whose turns and offsets count as zero."""
    lengths = guess.crank_lengths[:, None], guess.rod_lengths[:, None]
    return np.hstack([guess.shaft_positions, guess.platform_joints, *lengths, np.zeros((LEG_COUNT, 3))]).ravel()


def scales(guess: RobotParameters) -> np.ndarray:
    """Change (`SIZE`,) [m, rad] of each parameter that counts as 1: a radian, or the robot's characteristic length."""
    return np.array([guess.characteristic_length if each.unit == "m" else 1.0 for each in PARAMETERS])


def free_directions(guess: RobotParameters, known: Collection[str], hold: Collection[str]) -> np.ndarray:
    """Orthonormal directions (`SIZE`, k), in `scales`, in which the parameters may change."""
    core.check_choices("known_frames", known, FRAMES)
    constraints = []
    for frame, kind, columns, points in (
        ("base", "shaft_position", SHAFT, guess.shaft_positions),
        ("platform", "platform_joint", JOINT, guess.platform_joints),
    ):
        # Points that are held define the frame themselves.
        for axis in np.eye(3) if frame not in known and kind not in hold else ():
            for shift in (np.tile(axis, (LEG_COUNT, 1)), np.cross(axis, points - points.mean(axis=0))):
                constraints.append(np.zeros(SIZE))
                constraints[-1][:OF_ROBOT].reshape(LEG_COUNT, PER_LEG)[:, columns] = shift / np.linalg.norm(shift)
    return core.free_directions(PARAMETERS, KINDS, hold, known, constraints)


@dataclass(frozen=True, eq=False)
class PoseModel:
    """A guess, `base` (4, 4): B in the tracker's frame, and `marker` (4, 4): the marker in P; changes count from them.

    `at` (n, 4, 4) are poses of P in B, `observed` those of the marker in the tracker's frame, `angles` (n, 6) [rad] the
    readings.
    """

    guess: RobotParameters
    base: np.ndarray = field(default_factory=lambda: np.eye(4))
    marker: np.ndarray = field(default_factory=lambda: np.eye(4))

    def frames(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return moved(self.base, change[OF_ROBOT : OF_ROBOT + 6]), moved(self.marker, change[OF_ROBOT + 6 :])

    def with_frames(self, change: np.ndarray) -> PoseModel:
        base, marker = self.frames(change)
        return replace(self, base=base, marker=marker)

    def platform(self, change: np.ndarray, observed: np.ndarray) -> np.ndarray:
        base, marker = self.frames(change)
        return np.linalg.inv(base) @ observed @ np.linalg.inv(marker)

    def predicted(self, change: np.ndarray, angles: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses of P in B by forward kinematics, from poses near them, and the rod-length errors (n,) [m] left."""
        pose, error, _ = newton(changed_record(self.guess, change), angles, pose_of(start), CLOSED, _NEWTON_STEPS)
        return transform_of(np.nan_to_num(pose, posinf=0.0, neginf=0.0)), np.nan_to_num(error, nan=np.inf)

    def assembled(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses of P in B of the guess at those of n readings where it can be assembled, and which these are (n,)."""
        home = np.tile(transform_of(self.guess.home_pose), (len(angles), 1, 1))
        at, error = self.predicted(np.zeros(SIZE), angles, home)
        return at[error <= CLOSED], error <= CLOSED

    def closures(self, change: np.ndarray, at: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Errors (n, 6) [m] of the rods' lengths."""
        return rod_length_errors(changed_record(self.guess, change), angles, pose_of(at))

    def tracker_error(self, change: np.ndarray, at: np.ndarray, observed: np.ndarray) -> np.ndarray:
        """Measured minus predicted poses of the marker (n, 6) [rad, m]."""
        base, marker = self.frames(change)
        return difference(observed, base @ at @ marker)

    def closure_slope(self, change: np.ndarray, observed: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Derivatives (n, 6, `SIZE`) of the closures at measured poses."""

        def closures(step: np.ndarray) -> np.ndarray:
            return self.closures(change + step, self.platform(change + step, observed), angles)

        of_legs = self._leg_slope(change, self.platform(change, observed), angles)
        return np.concatenate([of_legs, derivative(closures, _FRAME_STEPS)], axis=-1)

    def tracker_slope(
        self, change: np.ndarray, at: np.ndarray, angles: np.ndarray, observed: np.ndarray | None = None
    ) -> np.ndarray:
        """Derivatives (n, 6, `SIZE`) of the tracker's error at predicted poses; None for a tracker without error."""
        if observed is None:
            base, marker = self.frames(change)
            observed = base @ at @ marker
        of_frames = derivative(lambda step: self.tracker_error(change + step, at, observed), _FRAME_STEPS)
        error_by_pose = derivative(lambda step: self.tracker_error(change, moved(at, step), observed), np.eye(6))
        closure_by_pose = derivative(lambda step: self.closures(change, moved(at, step), angles), np.eye(6))
        # The pose moves so that all legs stay closed.
        of_legs = -error_by_pose @ np.linalg.solve(closure_by_pose, self._leg_slope(change, at, angles))
        return np.concatenate([of_legs, of_frames], axis=-1)

    def _leg_slope(self, change: np.ndarray, at: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Derivatives (n, 6, `OF_ROBOT`) of the closures: zero of each leg by the numbers of the others."""
        slope = np.zeros((len(angles), LEG_COUNT, LEG_COUNT, PER_LEG))
        by_leg = derivative(lambda step: self.closures(change + step, at, angles), _LEG_STEPS)
        slope[:, range(LEG_COUNT), range(LEG_COUNT)] = by_leg
        return slope.reshape(len(angles), LEG_COUNT, OF_ROBOT)

    def whitening(self, change: np.ndarray, at: np.ndarray, angles: np.ndarray, noise: MeasurementNoise) -> np.ndarray:
        """Weights (n, 6, 6) of the tracker's error by its covariance, the encoders' share included."""
        by_reading = self.tracker_slope(change, at, angles)[..., HOMING:OF_ROBOT:PER_LEG]
        tracker = np.diag([noise.rotation**2] * 3 + [noise.position**2] * 3)
        return core.whitening(tracker + noise.encoder**2 * by_reading @ np.swapaxes(by_reading, -1, -2))
