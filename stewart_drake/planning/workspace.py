"""What the robot can do at each of many poses: the mechanics of `kinematics_core`, poses on the last axis.

The same quantities as in `kinematics`, `limits` and `dynamics`, several times faster: in blocks that fit the cache, by
a pool of threads (numpy lets go of the interpreter inside its loops).

Serial and parallel singularities are told apart by two measures. `transmission` |e_l . e_N| is zero where a crank is at
its dead centre (serial): the motor moves, the platform does not; `reach` is zero there too. `conditioning` is zero
where the rods' lines lose rank (parallel): the platform moves, the motors do not. Its sign is that of the rods'
determinant relative to home, so that a pose beyond a parallel singularity is known from one before it.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics import kinematics_core as core
from stewart_drake.mechanics.arrays import Robot, cross, dot, fitted, namespace, numpy_robot
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.dynamics_core import weight
from stewart_drake.planning.limits import crank_strokes
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

_BLOCK = 1024  # poses at a time: 15 pairs of legs each, arrays of 120 kB, a dozen of them alive
_REACH_BLOCK = 8192
_NEARLY_SINGULAR = 1e-3
_ONE, _OTHER = np.array(list(itertools.combinations(range(LEGS), 2))).T


@dataclass(frozen=True)
class PoseMeasures:
    """Measures of n poses, each (n,); all but `reach` are NaN where a rod cannot span.

    Attributes:
        reach: [-] smallest 1 - |C| / sqrt(A^2 + B^2) of a leg; negative where a rod cannot span.
        transmission: [-] smallest |e_l . e_N| of a leg; zero at a serial singularity.
        conditioning: [-] sigma_min / sigma_max as in `kinematics.conditioning`, negative where the rods' determinant
            has not the sign that it has at home; zero at a parallel singularity.
        ball_swing: [rad] largest swing of a rod from home, seen in the platform.
        universal_swing: [rad] largest swing of a rod from home, seen in its crank.
        stroke: [-] largest distance of a crank from the middle of its range, as a part of half of it; 0 without stops.
        clearance: [m] smallest distance of the surfaces of links of different legs; negative where they overlap.
        holding_torque: [N m] largest |motor torque| at rest; infinite exactly at a parallel singularity.
        force: [N] largest force, without moment about P, that can be exerted in any direction whatever.
        moment: [N m] largest moment, without force, that can be exerted in any direction whatever.
    """

    reach: np.ndarray
    transmission: np.ndarray
    conditioning: np.ndarray
    ball_swing: np.ndarray
    universal_swing: np.ndarray
    stroke: np.ndarray
    clearance: np.ndarray
    holding_torque: np.ndarray
    force: np.ndarray
    moment: np.ndarray


def measure_poses(
    robot: RobotParameters,
    pose: np.ndarray,
    gravity: float = STANDARD_GRAVITY,
    torque_limit: float | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> PoseMeasures:
    """Every measure of `PoseMeasures` at every pose.

    Force and moment are balls inscribed into the image of the torque limits, a box, under the statics map. To exert
    the wrench w the motors need T = t + A w, with t the holding torque and A the inverse of the map tau of (18),
    `statics`. Over all forces of size r the term A_i w of motor i runs from -r |a_i| to +r |a_i|, a_i the three entries
    of row i that belong to the force (or to the moment). So r can be exerted in every direction exactly as long as
    |t_i| + r |a_i| <= T_max for all i: the largest is min_i (T_max - |t_i|) / |a_i|. It is zero where the weight alone
    is too much.

    Args:
        robot: Geometry, masses, effort limit.
        pose: (n, 6) [rad, m].
        gravity: [m/s^2] along -z of B.
        torque_limit: [N m] T_max in place of the robot's `effort_limit`; each motor keeps its share of it.
        workers: Threads; None takes one for each processor.
        progress: Called with the share done, 0 to 1.

    Returns:
        What the functions of those modules give, to rounding: 1e-12 relative, but for `conditioning` (1e-11 absolute),
        the swings (1e-8 rad, worst at 180 deg), `transmission` at a dead centre (1e-8 absolute), and torque, force and
        moment near a parallel singularity (1e-14 / conditioning relative).

    Raises:
        ConfigurationError: Poses that are not finite or not (n, 6).
    """
    pose = np.asarray(pose, dtype=float)
    if pose.ndim != 2 or pose.shape[1] != 6 or not np.isfinite(pose).all():
        raise ConfigurationError("pose", pose, "finite numbers of shape (n, 6)")
    limit = robot.effort_limit if torque_limit is None else torque_limit
    table = np.full((len(fields(PoseMeasures)), len(pose)), np.nan)
    table[0] = smallest_reach(robot, pose)
    within = np.flatnonzero(table[0] >= 0.0)
    home = _HomeRods.of(robot)

    def fill(first: int) -> None:
        block = within[first : first + _BLOCK]
        table[1:, block] = _measure(robot, home, pose[block], gravity, limit)

    starts = range(0, len(within), _BLOCK)
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            for done, _ in enumerate(pool.map(fill, starts)):
                if progress is not None:
                    progress((done + 1) / len(starts))
        finally:
            pool.shutdown(cancel_futures=True)
    return PoseMeasures(*table)


def smallest_reach(robot: RobotParameters, pose: np.ndarray) -> np.ndarray:
    """The measure `PoseMeasures.reach` alone, at a fiftieth of the cost of all; (n,) [-] of poses (n, 6) [rad, m]."""
    reach = np.empty(len(pose))
    for first in range(0, len(pose), _REACH_BLOCK):
        block = slice(first, first + _REACH_BLOCK)
        reach[block] = core.reach_margin(numpy_robot(robot), pose[block]).min(axis=0)
    return reach


@dataclass(frozen=True)
class _HomeRods:
    """What the swings and the side of a parallel singularity are told from."""

    in_platform: np.ndarray  # (3, 6)
    in_crank: np.ndarray  # (3, 6) along the crank, its lateral axis (quarter x zero), and e_N
    side: float  # sign of the rods' determinant

    @staticmethod
    def of(robot: RobotParameters) -> _HomeRods:
        own = numpy_robot(robot)
        legs = core.legs_at(own, robot.home_pose)
        in_platform = np.einsum("ck,cl->kl", legs.rotation, legs.e_l)
        return _HomeRods(in_platform, _in_crank(own, legs), float(np.sign(core.determinant(legs))) or 1.0)


def _in_crank(robot: Robot, legs: core.Legs) -> np.ndarray:
    """(3, 6, ...) directions of the rods along the cranks, their lateral axes and e_N."""
    lateral = cross(namespace(robot.zeros), robot.quarters, robot.zeros)
    return np.stack([dot(legs.e_l, legs.crank), dot(legs.e_l, lateral), legs.transmission])


def _measure(
    robot: RobotParameters, home: _HomeRods, pose: np.ndarray, gravity: float, torque_limit: float
) -> np.ndarray:
    """All fields of `PoseMeasures` but the first, (9, n), of poses within reach."""
    own = fitted(numpy_robot(robot), 1)
    legs = core.legs_at(own, pose)
    conditioning, inverse = _invert(robot, home, core.rod_lines(legs))
    shares = robot.effort_shares[:, None]
    return np.stack(
        [
            np.abs(legs.transmission).min(axis=0),
            conditioning,
            _largest_swing(legs.e_l, np.einsum("ckn,kl->cln", legs.rotation, home.in_platform)),
            _largest_swing(_in_crank(own, legs), home.in_crank[:, :, None]),
            _largest_stroke(robot, legs.cranks),
            _smallest_distance(own, legs) - 2.0 * robot.link_radius,
            *_strength(core.levers(own, legs), weight(own, legs, gravity), inverse, torque_limit, shares),
        ]
    )


def _invert(robot: RobotParameters, home: _HomeRods, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed conditioning (n,) and the inverse [twist component, leg] (6, 6, n) of the rods' lines (6, 6, n).

    The singular values come from the eigenvalues of rows rows', at half the cost; where squaring would lose digits,
    from the singular value decomposition. The inverse of a singular matrix is infinite.
    """
    rows = np.ascontiguousarray(lines.transpose(2, 1, 0))
    determinant = np.linalg.det(rows)
    singular = determinant == 0.0
    scaled = rows.copy()
    scaled[..., :3] /= robot.characteristic_length
    square = np.linalg.eigvalsh(scaled @ scaled.swapaxes(-1, -2))
    ratio = np.sqrt(np.maximum(square[:, 0], 0.0) / square[:, -1])
    small = np.flatnonzero(ratio < _NEARLY_SINGULAR)
    if small.size:
        sigma = np.linalg.svd(scaled[small], compute_uv=False)
        ratio[small] = sigma[:, -1] / sigma[:, 0]
    rows[singular] = np.eye(6)
    inverse = np.ascontiguousarray(np.linalg.inv(rows).transpose(1, 2, 0))
    inverse[..., singular] = np.inf
    return ratio * np.sign(determinant) * home.side, inverse


def _strength(
    lever: np.ndarray,
    weight: tuple[np.ndarray, np.ndarray],
    inverse: np.ndarray,
    torque_limit: float,
    shares: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Holding torque, force and moment, each (n,).

    Args:
        lever: (6, n) [m] torque over rod force.
        weight: What gravity takes to hold, of `dynamics_core.weight`: no force but along z, no moment about it.
        inverse: (6, 6, n) of the rods' lines.
        torque_limit: [N m].
        shares: (6, 1) [-] `RobotParameters.effort_shares`.
    """
    wrench, own = weight
    with np.errstate(invalid="ignore", divide="ignore"):
        rod_force = inverse[0] * wrench[0] + inverse[1] * wrench[1] + inverse[5] * wrench[5]
        torque = np.abs(lever * rod_force + own)
        # At a parallel singularity infinities of both signs meet in the sum: no torque holds.
        torque[np.isnan(torque)] = np.inf
        spare = torque_limit * shares - torque
        size = np.abs(lever)
        moment, force = (
            np.where(spare > 0.0, spare / (size * np.sqrt(dot(part, part))), 0.0).min(axis=0)
            for part in (inverse[:3], inverse[3:])
        )
    return (torque / shares).max(axis=0), force, moment


def _largest_swing(now: np.ndarray | tuple[np.ndarray, ...], then: np.ndarray) -> np.ndarray:
    """Largest angle (n,) [rad] over the legs between unit vectors, from the chord between their ends."""
    chord = sum((one - other) ** 2 for one, other in zip(now, then, strict=True))
    return 2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(np.max(chord, axis=0)), 1.0))


def _largest_stroke(robot: RobotParameters, cranks: core.Cranks) -> np.ndarray:
    """`PoseMeasures.stroke` (n,); angles are formed for robots with stops alone."""
    if not np.isfinite(robot.crank_angle_ranges).any():
        return np.zeros(cranks.sine.shape[1:])
    stroke, half = crank_strokes(robot, core.crank_angles(cranks))
    return np.asarray((stroke / half).max(axis=-1))


def _smallest_distance(robot: Robot, legs: core.Legs) -> np.ndarray:
    """Smallest distance (n,) [m] between centre lines of links of different legs.

    `limits.segment_distance` with unit directions, so that a link's parameter is the length along it.
    """
    shaft, crank, a = np.broadcast_to(robot.shafts, legs.crank.shape), legs.crank, robot.cranks
    links = ((shaft, crank, a), (shaft + a * crank, legs.e_l, robot.rods))
    of_one = [(start[:, _ONE], direction[:, _ONE], length[_ONE]) for start, direction, length in links]
    of_other = [(start[:, _OTHER], direction[:, _OTHER], length[_OTHER]) for start, direction, length in links]
    smallest = np.full((len(_ONE), crank.shape[-1]), np.inf)
    for (start, u, end), (other_start, v, other_end) in itertools.product(of_one, of_other):
        r = start - other_start
        uv, ur, vr = dot(u, v), dot(u, r), dot(v, r)
        determinant = 1.0 - uv * uv
        skew = determinant > np.finfo(float).eps
        s = np.clip((uv * vr - ur) / np.where(skew, determinant, 1.0), 0.0, end) * skew
        t = np.clip(uv * s + vr, 0.0, other_end)
        s = np.clip(uv * t - ur, 0.0, end)
        r += s * u
        r -= t * v
        np.minimum(smallest, dot(r, r), out=smallest)
    return np.sqrt(smallest.min(axis=0))
