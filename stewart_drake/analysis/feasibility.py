"""Feasibility of motions within `scenario.limits`, largest amplitudes and scales, and random feasible poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from stewart_drake.base.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.base.tables import AXES
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import reach_margin
from stewart_drake.references import Reference
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.robot.robot_scale import PAPER
from stewart_drake.scenario.limits import PLACES, LimitMargin, ReferenceLimits, limit_bounds, limit_margins

SEARCH_RTOL = 1e-4  # Relative width at which the searches for the largest amplitude and scale stop.
SAMPLES_PER_SECOND = 500.0
_HALF_PERIOD_SAMPLES = 257
_SCALE_STEPS = 16
_DRAWN, _MOST_DRAWS = 4096, 500  # Poses drawn at a time, and most times.
_WHOLE_TURN = 1e-3  # [rad] within which an angle counts as a number of whole turns.


@dataclass(frozen=True)
class FeasibilityReport:
    """Result of `check_motion`."""

    # Smallest margins to the limits, in the order of `limits.RULES`. Limits on crank angles are checked where all legs
    # reach; a limit that could be checked nowhere is absent.
    smallest: dict[str, LimitMargin]
    # The earliest broken limit, with the worst place at that instant; None if feasible.
    first_violation: LimitMargin | None

    @property
    def feasible(self) -> bool:
        return self.first_violation is None

    def raise_if_infeasible(self) -> None:
        v = self.first_violation
        if v is not None:
            raise InfeasibleReferenceError(
                v.limit, v.time, v.leg, f"{v.value:.4g} {v.unit}".removesuffix(" -"), v.margin, v.allowed
            )


def check_motion(
    robot: RobotParameters,
    limits: ReferenceLimits,
    time: np.ndarray,
    pose: np.ndarray,
    pose_rate: np.ndarray,
    pose_acceleration: np.ndarray,
    gravity: Gravity,
) -> FeasibilityReport:
    """Margins to all limits along a motion: times (n,) [s], poses (n, 6), rates and accelerations; out of reach too."""
    for name, values in (("pose", pose), ("pose_rate", pose_rate), ("pose_acceleration", pose_acceleration)):
        if values.shape != (len(time), 6) or not np.isfinite(values).all():
            raise ConfigurationError(name, values, f"finite numbers of shape ({len(time)}, 6)")
    refuse_turns("reference", pose, time)
    bounds = limit_bounds(robot, limits)
    margins = limit_margins(robot, limits, pose, pose_rate, pose_acceleration, gravity)

    def at(limit: str, sample: int) -> LimitMargin:
        column = int(np.nanargmin(margins[limit][sample]))
        leg, where = PLACES[limit][column]
        share = float(robot.effort_shares[leg]) if limit == "torque" and leg is not None else 1.0
        margin = float(margins[limit][sample, column])
        return LimitMargin(limit, bounds[limit] * share, margin, float(time[sample]), leg, where)

    known = {limit: values for limit, values in margins.items() if not np.isnan(values).all()}
    smallest = {limit: at(limit, int(np.nanargmin(values)) // values.shape[1]) for limit, values in known.items()}
    broken = {limit: (values < 0.0).any(axis=1) for limit, values in known.items()}
    first = {limit: int(rows.argmax()) for limit, rows in broken.items() if rows.any()}
    if not first:
        return FeasibilityReport(smallest, None)
    limit = min(first, key=lambda limit: first[limit])  # of simultaneous ones the first
    return FeasibilityReport(smallest, at(limit, first[limit]))


def refuse_turns(key: str, pose: np.ndarray, time: np.ndarray) -> None:
    """Rejects poses (n, 6) beyond half a turn, which no measurement of a pose can tell from those within."""
    size = np.abs(pose[:, :3])
    if not (size > math.pi * (1.0 + 1e-9)).any():
        return
    sample, axis = np.unravel_index(size.argmax(), size.shape)
    angle = float(pose[sample, axis])
    same = math.remainder(angle, math.tau)
    if abs(angle) < math.tau or abs(same) < _WHOLE_TURN:
        hint = f"{round(same, 3) + 0.0:g} is the same orientation"
    else:
        hint = f"did you mean {angle:g} deg?"
    got = f"{AXES[axis]} {angle:.4g} rad at t = {time[sample]:.3f} s"
    allowed = f"roll, pitch and yaw within half a turn ({angle:.4g} rad is {math.degrees(angle):.4g} deg: {hint})"
    raise ConfigurationError(key, got, allowed)


def check_reference(
    robot: RobotParameters,
    limits: ReferenceLimits,
    reference: Reference,
    duration: float,
    gravity: Gravity = STANDARD_GRAVITY,
    samples_per_second: float = SAMPLES_PER_SECOND,
) -> FeasibilityReport:
    """`check_motion` of a reference from 0 to a duration [s] > 0, both ends included; gravity in [m/s^2].

    There are at least so many samples; at the default a peak of a 5 Hz signal is met to 5e-4, of 12 Hz to 3e-3.
    """
    for name, value in (("duration", duration), ("samples_per_second", samples_per_second)):
        if not 0.0 < value < math.inf:
            raise ConfigurationError(name, value, "a finite number above 0")
    time = checked_times(duration, samples_per_second)
    return check_motion(robot, limits, time, *reference.evaluate(time), gravity)


def checked_times(duration: float, samples_per_second: float = SAMPLES_PER_SECOND) -> np.ndarray:
    """(n,) [s] from 0 to a duration, both ends included, at least so many a second."""
    return np.linspace(0.0, duration, math.ceil(duration * samples_per_second) + 1)


def largest_amplitude(
    robot: RobotParameters, limits: ReferenceLimits, axis: int, frequency_hz: float, gravity: Gravity
) -> float:
    """Largest A [rad] or [m] for which home + a sin(2 pi f t) along one axis (0..5) is feasible for every a <= A.

    At an offset x the acceleration is -(2 pi f)^2 x whatever the amplitude, and the squared speed runs from 0 to (2 pi
    f)^2 (A^2 - x^2). Crank speeds grow with it and motor torques are linear in it: its two ends decide, and bisection
    finds A to a relative 1e-4. Angles end at pi. Zero where home itself is not feasible; frequency zero is the range at
    rest.
    """
    omega = 2.0 * math.pi * frequency_hz
    # The speeds' sign changes no margin, so trough to peak covers the whole period; then the same offsets at rest.
    phase = np.linspace(-math.pi / 2.0, math.pi / 2.0, _HALF_PERIOD_SAMPLES)
    along = np.eye(6)[axis]
    offset = np.tile(np.sin(phase), 2)[:, None] * along
    speed = np.concatenate([omega * np.cos(phase), np.zeros_like(phase)])[:, None] * along

    def feasible(amplitude: float) -> bool:
        motion = robot.home_pose + amplitude * offset, amplitude * speed, -(omega**2) * amplitude * offset
        return not any((values < 0.0).any() for values in limit_margins(robot, limits, *motion, gravity).values())

    # No platform joint is further from its shaft than crank and rod together.
    joints, shafts = (np.linalg.norm(points, axis=-1) for points in (robot.platform_joints, robot.shaft_positions))
    span = float((robot.crank_lengths + robot.rod_lengths + joints).max() + shafts.max())
    most = math.pi if axis < 3 else span + float(np.linalg.norm(robot.home_pose[3:]))
    if not feasible(0.0):
        return 0.0
    return most if feasible(most) else bisect(feasible, 0.0, most)


def amplitude_table(
    robot: RobotParameters, limits: ReferenceLimits, frequencies: Iterable[float], gravity: Gravity
) -> np.ndarray:
    """`largest_amplitude` (n, 6) [rad, m] of every axis at every frequency [Hz]."""
    return np.array([[largest_amplitude(robot, limits, axis, f, gravity) for axis in range(6)] for f in frequencies])


def largest_scale(
    robot: RobotParameters,
    limits: ReferenceLimits,
    make_reference: Callable[[float], Reference],
    duration: float,
    gravity: Gravity,
) -> float:
    """Largest scale in [0, 1], to 1e-4, with all smaller ones of 16 steps feasible."""
    return largest_share(
        lambda scale: check_reference(robot, limits, make_reference(scale), duration, gravity).feasible
    )


def largest_share(feasible: Callable[[float], bool]) -> float:
    """Largest share in [0, 1], to 1e-4, with all smaller ones of 16 steps feasible."""
    shares = np.linspace(0.0, 1.0, _SCALE_STEPS + 1).tolist()
    first = next((at for at, share in enumerate(shares) if not feasible(share)), None)
    if first is None:
        return 1.0
    return bisect(feasible, shares[first - 1], shares[first]) if first else 0.0


def bisect(feasible: Callable[[float], bool], low: float, high: float) -> float:
    """Last feasible value of a bisection between `low`, feasible, and `high`, infeasible."""
    smallest = SEARCH_RTOL**2 * high
    while high - low > SEARCH_RTOL * high and high > smallest:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if feasible(middle) else (low, middle)
    return low


# --- poses drawn from a box ---


class Region(NamedTuple):
    """A box of poses around home: name, half width (6,) [rad, m], description."""

    name: str
    half_width: tuple[float, ...]
    words: str

    def around(self, robot: RobotParameters) -> Region:
        """The box scaled to a robot: shifts are in proportion to its size."""
        size = robot.characteristic_length / PAPER.characteristic_length
        if size == 1.0:
            return self
        shifts = tuple(size * shift for shift in self.half_width[3:])
        return Region(self.name, (*self.half_width[:3], *shifts), f"{self.words}; shifts times {size:.3g}, by its size")


NEAR = Region(
    "near",
    (math.pi / 6.0,) * 3 + (0.06, 0.06, 0.05),
    "turns up to 30 deg about each axis, 60 mm in X and Y and 50 mm in Z to either side of home, all at once",
)
"""Box of the controlled motions: the paper's largest angle, the Z of (38), and room to the sides."""


def sample_poses(
    robot: RobotParameters,
    region: Region,
    count: int,
    rng: np.random.Generator,
    least_margin: float = 1e-6,
    limits: ReferenceLimits | None = None,
    gravity: Gravity = STANDARD_GRAVITY,
) -> np.ndarray:
    """Random poses (count, 6) in a box, in reach by `least_margin` and within `limits`; fewer if few are."""
    kept, drawn = np.empty((0, 6)), 0
    while len(kept) < count and drawn < _MOST_DRAWS * _DRAWN:
        poses = robot.home_pose + rng.uniform(-1.0, 1.0, (_DRAWN, 6)) * region.half_width
        poses = poses[reach_margin(robot, poses).min(axis=-1) > least_margin]
        if limits is not None:
            at_rest = np.zeros_like(poses)
            margins = limit_margins(robot, limits, poses, at_rest, at_rest, gravity)
            poses = poses[np.all([(margin >= 0.0).all(axis=-1) for margin in margins.values()], axis=0)]
        kept, drawn = np.concatenate([kept, poses]), drawn + _DRAWN
    if not len(kept):
        within = "" if limits is None else ", within its limits"
        raise ConfigurationError("robot", robot, f"a robot that reaches a pose of this box{within}: {region.words}")
    return kept[:count]
