"""Poses measured by an instrument, with encoder readings; and the most informative poses to measure."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from stewart_drake.analysis.workspace import LIMIT_NAMES, distances_to_limits
from stewart_drake.base.config import Positive, Section
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import AXES, CRANK_ANGLES, POSE, Chosen, column_name, column_of, read_columns
from stewart_drake.estimation import core, geometry
from stewart_drake.estimation.core import Readings
from stewart_drake.mechanics.kinematics import inverse_kinematics, roll_pitch_yaw
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.limits import ReferenceLimits

_FARTHEST = 1e6  # [m] largest coordinate.
QUANTITIES = (*POSE, *CRANK_ANGLES)
COLUMNS = tuple(column_name(*quantity) for quantity in QUANTITIES)
CANDIDATES = 1500
MARGIN = 0.85  # [-] of a limit that a pose may use: the robot differs from the guess.
AMPLIFICATION = 1.3
"""[-] largest effect of the parameters on a pose, over that at home: near a parallel singularity a robot that differs
from the guess cannot be assembled. A hundred robots off by 1 mm and 1 mrad reached all of 60 planned poses."""
_WAY = np.linspace(0.0, 2.0, 41)
_PASSES, _DRAWS = 20, 20
_ASSESSED = 100  # Poses at which the accuracy of poses is predicted.
_LEVEL = 1e-6  # [rad] a planned 0, in a file.
_GAIN = 1e-6


class MeasurementNoise(Section, key="noise"):
    """Standard deviations of the measurements; independent, and the same in all directions."""

    position: Annotated[Positive, Field(le=1.0)] = 2e-5
    """[m] of the coordinates of a measured position."""
    rotation: Annotated[Positive, Field(le=1.0)] = 1e-4
    """[rad] of a measured orientation, about any axis."""
    encoder: Annotated[Positive, Field(le=1.0)] = 2.0 * math.pi / 2**17 / math.sqrt(12.0)
    """[rad] of an encoder reading. For an encoder limited by its resolution a step over the root of 12: here 17
    bits."""


_AXES = "rpyXYZ"
"""Letters of the coordinates of a pose."""


class Instrument(NamedTuple):
    """What measures poses: coordinates, standard deviations, frames that are known, and what robots are moved by."""

    axes: str  # Coordinates that are measured.
    position: float  # [m]
    rotation: float  # [rad]
    known_frames: tuple[str, ...] = ()
    moves: str = _AXES  # Coordinates that are not zero in the poses to measure.
    fit: str = "servos"  # What it is worth planning for, of `geometry.FITS`.

    @property
    def measured(self) -> np.ndarray:
        """(6,) bool, the coordinates."""
        return np.array([axis in self.axes for axis in _AXES])

    @property
    def noise(self) -> MeasurementNoise:
        return MeasurementNoise(position=self.position, rotation=self.rotation)


_HALF_DEGREE = math.radians(0.5)
INSTRUMENTS = {
    "tracker": Instrument(_AXES, 2e-5, 1e-4, fit="all"),
    "camera": Instrument(_AXES, 5e-4, 5e-3),
    "imu": Instrument("rpy", 5e-4, _HALF_DEGREE),
    "tilt": Instrument("rp", 5e-4, _HALF_DEGREE),
    "level": Instrument("rp", 5e-4, math.radians(0.1), geometry.FRAMES, "yXYZ"),
    "jig": Instrument(_AXES, 2e-4, 2e-3, geometry.FRAMES, "Z"),
}
"""A laser tracker; a camera with a printed marker; an IMU with heading; an accelerometer; a spirit level on the
platform, which is adjusted until it is level; printed parts that hold the platform level in the middle, at heights."""


@dataclass(frozen=True, eq=False)
class Measurements(Readings):
    """Poses (n, 6) [rad, m] of the marker in the tracker's frame, and encoder readings (n, 6) [rad] there; checked.

    Coordinates that are not measured are NaN in all rows.
    """

    pose: np.ndarray
    angles: np.ndarray
    source: str = "poses"

    quantities: ClassVar = QUANTITIES
    columns: ClassVar = {"pose": slice(0, 6), "angles": slice(6, 12)}
    largest: ClassVar = (10_000_000, 10_000)

    def __post_init__(self) -> None:
        self.check()
        # A stroke of pi covers what roll, pitch and yaw can be; an encoder may have been homed a turn away.
        most = np.array([math.pi, math.pi / 2.0, math.pi] + [_FARTHEST] * 3 + [4.0 * math.pi] * 6)
        allowed = (
            "metres, and radians, roll and yaw within +-pi, pitch within +-pi/2, readings within +-4 pi; "
            "name columns _mm for millimetres, _deg for degrees"
        )
        self.refuse(np.abs(self.table) > most * (1.0 + 1e-9), allowed)

    def refuse_repeated(self) -> None:
        """Raises a `ConfigurationError` if a pose comes twice."""
        _, first, which = np.unique(self.pose[:, self.measured], axis=0, return_index=True, return_inverse=True)
        again = np.flatnonzero(first[which.ravel()] != np.arange(len(self)))
        if again.size:
            got = f"the pose of row {first[which.ravel()[again[0]]] + 1} again in row {again[0] + 1}"
            allowed = "measured poses; an instrument never gives the same numbers twice, but a level or a jig (--with)"
            raise ConfigurationError(self.source, got, allowed)

    def refuse_other(self, name: str, robot: RobotParameters) -> None:
        """Raises a `ConfigurationError` if the instrument of that name cannot have measured this."""
        used = INSTRUMENTS[name]
        if used.measured[3:].any() and not self.measured[3:].any():
            allowed = f"what measures no positions, as {self.source} has none: {self.instrument}, or a level"
            raise ConfigurationError("--with", name, allowed)
        if not used.measured.all():
            still = used.measured & [axis not in used.moves for axis in _AXES]
            off = still & (np.abs(self.pose - robot.home_pose) > _LEVEL)
            self.refuse(np.hstack([off, np.zeros_like(off)]), "the planned 0: in all rows the bubble is in the middle")

    @property
    def absent(self) -> np.ndarray:
        return np.isnan(self.table).all(axis=0) & (np.arange(12) < 6)

    @property
    def measured(self) -> np.ndarray:
        """(6,) bool, the coordinates of a pose that are measured."""
        return ~self.absent[:6]

    def only(self, measured: np.ndarray) -> Measurements:
        """The same with some coordinates (6,) alone."""
        return Measurements(np.where(measured, self.pose, np.nan), self.angles, self.source)

    @property
    def instrument(self) -> str:
        """The instrument of `INSTRUMENTS` that is the most likely to measure this."""
        return "tracker" if self.measured[3:].any() else "imu" if self.measured[2] else "tilt"

    @cached_property
    def marker(self) -> np.ndarray:
        return geometry.transform_of(np.nan_to_num(self.pose))


_VECTORS = {
    "quaternion": ("rpy", tuple((f"quaternion_{axis}", "1") for axis in "wxyz")),
    "acceleration": ("rp", tuple((f"acceleration_{axis}", "m/s^2") for axis in "xyz")),
}
"""What IMUs measure in place of angles: the coordinates that follow from it, and its columns."""
_SETS = (_AXES, "rpy", "rp", "rpZ", "XYZ")
"""Coordinates that may be measured together; with others, columns of all six are expected."""


def load_measurements(path: str | Path) -> Measurements:
    """Measured poses of a table with `COLUMNS`, in any order and unit; R = Rz(yaw) Ry(pitch) Rx(roll).

    An IMU gives roll, pitch and yaw alone, or `quaternion_w` to `quaternion_z`; an accelerometer at rest
    `acceleration_x` to `acceleration_z`, which point up, a level roll and pitch. Positions alone are read too.
    """
    source = f"poses file {path}"

    def choose(names: list[str]) -> Chosen:
        words = [name.lower().removeprefix("pose_").split("_") for name in names]
        angle = "reading" if ["reading", "0"] in [word[:2] for word in words] else "crank_angle"
        firsts = {word[0] for word in words}
        letters, wanted = next((_VECTORS[kind] for kind in _VECTORS if kind in firsts), ("", ()))
        free = [at for at, letter in enumerate(_AXES) if not (letters and letter in "rpy")]
        axes = [at for at in free if AXES[at] in firsts]
        if letters + "".join(_AXES[at] for at in axes) not in _SETS:
            axes = free
        wanted = (*wanted, *(POSE[at] for at in axes), *((f"{angle}_{leg}", "rad") for leg in range(6)))
        return {name: column_of(names, name, unit, source) for name, unit in wanted}

    columns = read_columns(path, source, choose, *Measurements.largest)
    pose = np.stack(
        [columns.get(name, np.full(len(columns[next(iter(columns))]), np.nan)) for name, _ in POSE], axis=-1
    )
    for kind, (_, names) in _VECTORS.items():
        if names[0][0] in columns:
            vector = np.stack([columns[name] for name, _ in names], axis=-1)
            if (zero := ~(np.linalg.norm(vector, axis=-1) > 0.0)).any():
                place = f"{source}: row {int(zero.argmax()) + 1}, {kind}"
                raise ConfigurationError(place, vector[zero.argmax()].tolist(), "numbers that are not all zero")
            x, y, z = vector.T[-3:]
            if kind == "quaternion":
                pose[:, :3] = roll_pitch_yaw(Rotation.from_quat(np.roll(vector, -1, axis=-1)).as_matrix())
            else:
                pose[:, :2] = np.stack([np.arctan2(y, z), np.arctan2(-x, np.hypot(y, z))], axis=-1)
    return Measurements(pose, np.stack(list(columns.values())[-6:], axis=-1), source)


@dataclass(frozen=True, eq=False)
class PosePlan:
    """Poses to measure, and what to expect of them."""

    targets: Measurements
    half_width: np.ndarray  # (84,) [m, rad, -] expected of the 95 % intervals; infinite if unidentifiable.
    random_half_width: np.ndarray  # The same of random poses.
    unidentifiable: tuple[str, ...]  # What these poses cannot determine, one sentence each.
    gain: float  # [-] ratio of standard deviations, in the geometric mean, of random poses to these.
    error: tuple[float, float]  # [m], [rad] expected RMS errors of other poses, with the calibrated robot.

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Header and rows: the largest expected interval of the legs, for these poses and random ones, in mm, deg."""
        both = (
            geometry.by_leg(widths, display=True).max(axis=0) for widths in (self.half_width, self.random_half_width)
        )
        columns = [
            ["held" if width == 0.0 else f"{width:.2g}".replace("inf", "unidentifiable") for width in widths]
            for widths in both
        ]
        return ["", "planned", "at random"], [list(row) for row in zip(geometry.table_names(), *columns, strict=True)]


def plan_poses(
    robot: RobotParameters,
    count: int,
    limits: ReferenceLimits | None = None,
    noise: MeasurementNoise | None = None,
    known_frames: Collection[str] = (),
    hold: Collection[str] = ("servo_gain",),
    seed: int = 0,
    candidates: int = CANDIDATES,
    instrument: Instrument = INSTRUMENTS["tracker"],
) -> PosePlan:
    """Most informative poses to calibrate a robot: D-optimal, by Fedorov's exchange.

    V. V. Fedorov, Theory of Optimal Experiments (1972). Starts from a greedy choice, one pose after the other; then
    every pose is exchanged for the best of all, until none is better. By the prior no direction is off by more than a
    tenth of the robot's size.

    Args:
        robot: The guess.
        count: How many poses.
        limits: Limits on the poses and on the straight way from home, with `MARGIN`.
        noise: Of instrument and encoders; None for that of the instrument.
        known_frames: As for `calibrate`.
        hold: As for `calibrate`; by default the servo gains.
        seed: Of the candidates.
        candidates: How many poses to choose from.
        instrument: What measures them.

    Raises:
        ConfigurationError: Fewer poses than determine all parameters, or more than candidates; home breaks a limit.
    """
    noise = instrument.noise if noise is None else noise
    rng, measured, limits = np.random.default_rng(seed), instrument.measured, limits or ReferenceLimits()
    free = geometry.free_directions(robot, known_frames, hold, measured)
    least = free.shape[1] // int(measured.sum()) + 1
    if not least <= count <= candidates // 2:
        raise ConfigurationError("--plan", count, f"a number of poses from {least} to {candidates // 2}")
    pose = candidate_poses(robot, candidates, limits, rng, instrument.moves)
    at, model = geometry.transform_of(pose), geometry.PoseModel(robot, measured=measured)
    angles, size = inverse_kinematics(robot, pose) / robot.servo_gains, geometry.scales(robot)
    ways = size[:, None] * free
    slope = model.tracker_slope(np.zeros(geometry.SIZE), at, angles)
    rows = model.whitening(np.zeros(geometry.SIZE), at, angles, noise) @ slope @ ways
    chosen = _exchange(rows, count)
    choices, prior = (chosen, *rng.choice(len(pose), (20, count))), geometry.PRIOR @ ways
    covariances = [_covariance(rows[choice], prior) for choice in choices]
    widths = [1.96 * np.linalg.norm(ways @ np.linalg.cholesky(matrix), axis=1) for matrix in covariances]
    known = _determined(rows[chosen], free, size)
    widths[0] = np.where(known.undetermined, np.inf, widths[0])
    volume = [np.linalg.slogdet(matrix)[1] / (2.0 * free.shape[1]) for matrix in covariances]
    # What measures whole poses shows them in its frame.
    spread = (ways @ np.linalg.cholesky(covariances[0]))[: geometry.SIZE if measured.all() else geometry.OF_ROBOT]
    return PosePlan(
        Measurements(pose[chosen], angles[chosen], "planned poses"),
        widths[0],
        np.median(widths[1:], axis=0),
        known.unidentifiable_sentences(),
        float(np.exp(np.mean(volume[1:]) - volume[0])),
        _expected_error(robot, limits, spread, rng),
    )


def _determined(rows: np.ndarray, free: np.ndarray, size: np.ndarray) -> core.Estimate:
    """An estimate of nothing, with what rows (n, m, k) along free directions (`SIZE`, k) do not determine."""
    flat = rows.reshape(-1, free.shape[1])
    left, fixed = core.identifiable(flat, free, size, geometry.LARGEST_DEVIATION, geometry.PREFERENCE)
    k = np.eye(left.shape[1])
    return core.Estimate(geometry.PARAMETERS, size, np.zeros(geometry.SIZE), size[:, None] * left, k, k, fixed)


def _expected_error(
    robot: RobotParameters, limits: ReferenceLimits, spread: np.ndarray, rng: np.random.Generator
) -> tuple[float, float]:
    """Expected RMS errors [m], [rad] of other poses, with the first m of `PARAMETERS` off by `spread` (m, k)."""
    pose = candidate_poses(robot, _ASSESSED, limits, rng)
    at, angles = geometry.transform_of(pose), inverse_kinematics(robot, pose) / robot.servo_gains
    slope = geometry.PoseModel(robot).tracker_slope(np.zeros(geometry.SIZE), at, angles)[..., : len(spread)]
    off = (slope @ spread).reshape(len(pose), 2, -1)
    turn, place = np.sqrt(np.mean(np.sum(off**2, axis=-1), axis=0)).tolist()
    return place, turn


def candidate_poses(
    robot: RobotParameters, count: int, limits: ReferenceLimits, rng: np.random.Generator, moves: str = _AXES
) -> np.ndarray:
    """Poses (count, 6) [rad, m] on straight ways from home in all directions, up to where a limit ends them.

    Coordinates that `moves` does not name stay those of home.
    """
    home, size = robot.home_pose, np.array([1.0] * 3 + [robot.characteristic_length] * 3)
    poses = np.empty((0, 6))
    for _ in range(_DRAWS):
        way = rng.standard_normal((count, 6)) * size * [axis in moves for axis in _AXES]
        way /= np.linalg.norm(way / size, axis=1, keepdims=True)
        last, limit = distances_to_limits(robot, limits, home, way, _WAY, most=MARGIN)
        if not last.any():
            got = f"a limit {LIMIT_NAMES[limit[0]]} that is broken on every line from home"
            raise ConfigurationError("limits", got, f"limits of which the home pose uses at most {MARGIN:g}")
        # Nearer to the end than to home: there poses are more informative. The last step is within the limits.
        share = rng.uniform(0.0, 1.0, count) ** (1.0 / 3.0)
        pose = (home + (last * share)[:, None] * way)[last > 0.0]
        calm = _amplification(robot, pose) <= AMPLIFICATION * _amplification(robot, home[None])
        poses = np.concatenate([poses, pose[calm]])
        if len(poses) >= count:
            return poses[:count]
    raise ConfigurationError("limits", f"{len(poses)} poses of {_DRAWS * count} tries", "limits that leave more room")


def _amplification(robot: RobotParameters, pose: np.ndarray) -> np.ndarray:
    """Size (n,) of the derivatives of poses (n, 6) by a robot's parameters, both in `scales`."""
    size = geometry.scales(robot)
    at, angles = geometry.transform_of(pose), inverse_kinematics(robot, pose) / robot.servo_gains
    slope = geometry.PoseModel(robot).tracker_slope(np.zeros(geometry.SIZE), at, angles)
    slope = (slope * size / size[-6:, None])[..., : geometry.OF_ROBOT]
    return np.asarray(np.linalg.norm(slope[..., geometry.GEOMETRY], axis=(1, 2)))


def _exchange(rows: np.ndarray, count: int) -> np.ndarray:
    """Indices (count,) of rows (n, m, k) with the largest determinant of their information."""

    def gains(covariance: np.ndarray, some: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.slogdet(np.eye(rows.shape[1]) + some @ covariance @ np.swapaxes(some, -1, -2))[1])

    def best(covariance: np.ndarray, chosen: list[int]) -> tuple[int, float]:
        gain = gains(covariance, rows)
        gain[chosen] = -np.inf
        return int(gain.argmax()), float(gain.max())

    chosen: list[int] = []
    for _ in range(count):
        chosen.append(best(_covariance(rows[chosen]), chosen)[0])
    for _ in range(_PASSES):
        won = 0.0
        for place, now in enumerate(list(chosen)):
            rest = chosen[:place] + chosen[place + 1 :]
            covariance = _covariance(rows[rest])
            other, gain = best(covariance, rest)
            more = gain - float(gains(covariance, rows[now]))
            if more > _GAIN:
                won += more
                chosen[place] = other
        if won < _GAIN:
            break
    return np.array(chosen)


def _covariance(rows: np.ndarray, prior: np.ndarray | None = None) -> np.ndarray:
    """Covariance (k, k) of the directions, by the size of the robot, rows (n, m, k), and rows (m, k) of a prior."""
    flat = np.concatenate([rows.reshape(-1, rows.shape[2]), *([] if prior is None else [prior])])
    return np.linalg.inv(flat.T @ flat + np.eye(flat.shape[1]) / geometry.LARGEST_DEVIATION**2)
