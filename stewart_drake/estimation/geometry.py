"""What an instrument and encoders measure on a robot, and its derivatives by everything that a calibration can change.

If a frame of the tracker is unknown, B is where the shafts lie nearest to the guess's, and P where the joints do. An
instrument may measure some coordinates of a pose only: an IMU the three angles, a spirit level roll and pitch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.base.atomic_files import Document
from stewart_drake.estimation import core
from stewart_drake.estimation.core import Parameter
from stewart_drake.hardware.wiring import middle_readings
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
    Parameter("servo_gain", "", "1"),
)
"""Parameters of one leg. Positions are in B and P. `motor_axis` has two small rotations of the guessed axis, about the
crank's two directions. The true angle is servo gain times reading, minus the homing offset; it is counted from the
guess's `crank_zero_direction`, rotated with the axis."""
KINDS = tuple(dict.fromkeys(parameter.kind for parameter in LEG_PARAMETERS))
SHAFT, JOINT, CRANK, ROD, HOMING, GAIN = slice(0, 3), slice(3, 6), 6, 7, 10, 11
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
FITS = {
    "none": (),
    "offsets": ("homing_offset",),
    "servos": ("homing_offset", "servo_gain"),
    "geometry": tuple(kind for kind in KINDS if kind != "servo_gain"),
    "all": KINDS,
}
"""What can be fitted: kinds of parameters by a name; `none` keeps the guess, and fits frames alone."""
KEPT, *CHOSEN = FITS
OFFSET_PRIOR, GAIN_PRIOR = math.radians(2.0), 0.03
"""[rad], [-] standard deviations of homing offsets and servo gains about the guess, before anything is measured: hobby
servos, with horns trimmed by eye. They decide where the data are weak; a tracker's data outweigh them."""
PRIOR = np.diag(
    [{"homing_offset": 1.0 / OFFSET_PRIOR, "servo_gain": 1.0 / GAIN_PRIOR}.get(each.kind, 0.0) for each in PARAMETERS]
)
"""(`SIZE`, `SIZE`) rows whose products with a change are errors of standard deviation 1, by this prior."""
GEOMETRY = np.array([parameter.kind != "servo_gain" for parameter in PARAMETERS[:OF_ROBOT]])
PREFERENCE = np.array([10.0 if parameter.kind == "servo_gain" else 1.0 for parameter in PARAMETERS])
"""Where data do not determine all, gains keep their values first."""
LARGEST_DEVIATION = 0.1  # [-] in `scales`, beyond which a direction counts as unidentifiable
CLOSED = 1e-12  # [m] rod-length error below which forward kinematics has converged
_NEWTON_STEPS = 40
ALL = np.ones(6, dtype=bool)
"""All coordinates of a pose."""
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


def heading_of(turn: np.ndarray) -> np.ndarray:
    """The rotations about z that are nearest to rotations (..., 3, 3)."""
    about_z = np.arctan2(turn[..., 1, 0] - turn[..., 0, 1], turn[..., 0, 0] + turn[..., 1, 1])
    return exponential(np.array([0.0, 0.0, 1.0]) * about_z[..., None])


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
    """Record of the guess after a change (`SIZE`,) [m, rad]; its crank angles are readings times servo gains."""
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
    ranges, gains = guess.crank_angle_ranges + change[HOMING:OF_ROBOT:PER_LEG, None], gains_of(guess, change)
    middles = middle_readings(guess)
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
            "servo_gain": None if gains[leg] == 1.0 else gains[leg],
            "servo_middle": middles[leg],
        }
        for leg in range(LEG_COUNT)
    ]
    return guess.replace(legs=legs)


def values_of(guess: RobotParameters) -> np.ndarray:
    """Parameters (`OF_ROBOT`,) [m, rad] of a guess, whose turns and offsets count as zero."""
    lengths = guess.crank_lengths[:, None], guess.rod_lengths[:, None]
    servos = np.zeros((LEG_COUNT, 3)), guess.servo_gains[:, None]
    return np.hstack([guess.shaft_positions, guess.platform_joints, *lengths, *servos]).ravel()


def gains_of(guess: RobotParameters, change: np.ndarray) -> np.ndarray:
    """Servo gains (6,) [-] of the guess after a change (`SIZE`,)."""
    return guess.servo_gains + change[GAIN:OF_ROBOT:PER_LEG]


def scales(guess: RobotParameters) -> np.ndarray:
    """Change (`SIZE`,) [m, rad, -] that counts as 1 of each parameter: a radian, or the characteristic length."""
    return np.array([guess.characteristic_length if each.unit == "m" else 1.0 for each in PARAMETERS])


def free_directions(
    guess: RobotParameters, known: Collection[str], hold: Collection[str], measured: np.ndarray = ALL
) -> np.ndarray:
    """Orthonormal directions (`SIZE`, k), in `scales`, along which measured coordinates (6,) let parameters change."""
    core.check_choices("known_frames", known, FRAMES)
    constraints = [np.eye(SIZE)[at] for at in without_effect(measured)]
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


def free_frames(known: Collection[str], measured: np.ndarray = ALL) -> np.ndarray:
    """Directions (`SIZE`, k) along which measured coordinates (6,) let the tracker's frames alone change."""
    fixed = without_effect(measured)
    free = [at for at in range(OF_ROBOT, SIZE) if PARAMETERS[at].kind not in known and at not in fixed]
    return np.eye(SIZE)[:, free]


def without_effect(measured: np.ndarray) -> list[int]:
    """Places of numbers of the frames on which measured coordinates (6,) do not depend.

    What measures angles but not all coordinates is an IMU or a level: it finds the vertical by itself, and B is level.
    """
    turns, shifts = bool(measured[:2].any()), bool(measured[3:].any())
    vertical = turns and not measured.all()
    heading = not measured[2] and not measured[3:5].any()
    base = [vertical, vertical, heading, *~measured[3:]]
    marker = [not turns] * 3 + [not shifts] * 3
    return [OF_ROBOT + at for at, fixed in enumerate([*base, *marker]) if fixed]


@dataclass(frozen=True, eq=False)
class PoseModel:
    """A guess, `base` (4, 4): B in the tracker's frame, and `marker` (4, 4): the marker in P; changes count from them.

    `measured` (6,) has the coordinates that are measured; if not all are, `near` (n, 4, 4) has poses near the true
    ones. `at` (n, 4, 4) are poses of P in B, `observed` those of the marker in the tracker's frame, `angles` (n, 6)
    [rad] the readings.
    """

    guess: RobotParameters
    base: np.ndarray = field(default_factory=lambda: np.eye(4))
    marker: np.ndarray = field(default_factory=lambda: np.eye(4))
    measured: np.ndarray = field(default_factory=lambda: ALL)
    near: np.ndarray | None = None

    def frames(self, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return moved(self.base, change[OF_ROBOT : OF_ROBOT + 6]), moved(self.marker, change[OF_ROBOT + 6 :])

    def with_frames(self, change: np.ndarray) -> PoseModel:
        base, marker = self.frames(change)
        return replace(self, base=base, marker=marker)

    def platform(self, change: np.ndarray, observed: np.ndarray) -> np.ndarray:
        """Poses of P by the measured ones, or poses near them."""
        if self.near is not None:
            return self.near
        base, marker = self.frames(change)
        return np.linalg.inv(base) @ observed @ np.linalg.inv(marker)

    def predicted(self, change: np.ndarray, angles: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses of P in B by forward kinematics, from poses near them, and the rod-length errors (n,) [m] left."""
        cranks = gains_of(self.guess, change) * angles
        pose, error, _ = newton(changed_record(self.guess, change), cranks, pose_of(start), CLOSED, _NEWTON_STEPS)
        return transform_of(np.nan_to_num(pose, posinf=0.0, neginf=0.0)), np.nan_to_num(error, nan=np.inf)

    def assembled(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses of P in B of the guess at those of n readings where it can be assembled, and which these are (n,)."""
        home = np.tile(transform_of(self.guess.home_pose), (len(angles), 1, 1))
        at, error = self.predicted(np.zeros(SIZE), angles, home)
        return at[error <= CLOSED], error <= CLOSED

    def closures(self, change: np.ndarray, at: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Errors (n, 6) [m] of the rods' lengths."""
        cranks = gains_of(self.guess, change) * angles
        return rod_length_errors(changed_record(self.guess, change), cranks, pose_of(at))

    def tracker_error(self, change: np.ndarray, at: np.ndarray, observed: np.ndarray) -> np.ndarray:
        """Measured minus predicted poses of the marker, in the k measured coordinates (n, k) [rad, m]."""
        base, marker = self.frames(change)
        there = base @ at @ marker
        if self.measured[:2].any() and not self.measured[2]:
            # The heading is not measured, so it is that of the prediction.
            turn = there[..., :3, :3] @ np.swapaxes(observed[..., :3, :3], -1, -2)
            observed = transform(heading_of(turn) @ observed[..., :3, :3], observed[..., :3, 3])
        return difference(observed, there)[..., self.measured]

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
        tracker = np.diag(np.array([noise.rotation**2] * 3 + [noise.position**2] * 3)[self.measured])
        return core.whitening(tracker + noise.encoder**2 * by_reading @ np.swapaxes(by_reading, -1, -2))
