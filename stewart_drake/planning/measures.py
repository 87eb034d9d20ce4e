"""What tells how far a pose, or a motion at an instant, is from every limit: one compiled law, on all cores.

Serial and parallel singularities are told apart by two measures. `transmission` |e_l . e_N| is zero where a crank is at
its dead centre (serial): the motor moves, the platform does not; `reach` is zero there too. `conditioning` is zero
where the rods' lines lose rank (parallel): the platform moves, the motors do not. The sign of the lines' determinant
tells a pose beyond a parallel singularity from one before it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.dynamics_laws import loads, twists_of_motion
from stewart_drake.mechanics.kinematics import over_rows
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    conditioning,
    crank_rates,
    cross,
    dot,
    legs_at,
    robot_record,
)
from stewart_drake.mechanics.linear_algebra import solve
from stewart_drake.robot import RobotParameters

MEASURES = fields(reach=6, transmission=6, conditioning=(), side=(), swing=12, distance=60, stroke=6, speed=6, torque=6)
"""Measures at a pose and motion; all but `reach` are NaN where a rod cannot span. reach: `LEGS.reach`. transmission:
|e_l . e_N|. conditioning: sigma_min / sigma_max of the rods' lines. side: sign of their determinant. swing: of each rod
from home, seen in the platform, then in its crank [rad]. distance: between the surfaces of links of different legs, in
the order of `limits.PLACES`, negative where they overlap [m]. stroke: of each crank from the middle of its range [rad].
speed: |crank rate| [rad/s]; torque: |motor torque| [N m]; both infinite exactly at a singularity."""

HOME = fields(rod=(12, 3), side=(), middle=6, half=6, radius=(), limit=6)
"""What measures are taken from. rod: directions of the rods at home, as in `rod_directions`. side: `MEASURES.side` at
home. middle, half: of the cranks' ranges [rad]. radius: of the links [m]. limit: each motor's part of the torque that
is allowed, 1 for the strongest."""

POSE_MEASURES = fields(
    reach=(), transmission=(), conditioning=(), ball_swing=(), universal_swing=(), stroke=(), clearance=(),
    holding_torque=(), force=(), moment=(),
)  # fmt: skip
"""Measures at a pose at rest; all but `reach` are NaN where a rod cannot span. reach, transmission: the smallest of a
leg. conditioning: as above, negative where the lines' determinant has not the sign that it has at home; zero at a
parallel singularity. ball_swing, universal_swing: the largest [rad]. stroke: largest distance of a crank from the
middle of its range, as a part of half of it; 0 of a robot without stops. clearance: smallest distance of the surfaces
of links of different legs [m]. holding_torque: the largest [N m]. force, moment: see `strength` [N], [N m]."""

_BLOCK = 1 << 16  # poses between two reports of the progress


@lru_cache(maxsize=128)
def home_record(robot: RobotParameters) -> np.ndarray:
    """What measures of a robot are taken from, a `HOME` record."""
    stops = np.isfinite(robot.crank_angle_ranges)
    low, high = np.where(stops, robot.crank_angle_ranges, [-2.0 * np.pi, 2.0 * np.pi]).T
    made = new_record(
        HOME,
        middle=0.5 * (low + high),
        half=0.5 * (high - low) if stops.any() else np.inf,
        radius=robot.link_radius,
        limit=robot.effort_shares,
    )
    _look_from_home(robot_record(robot), np.array(robot.home_pose, dtype=float), np.empty(1, LEGS), made)
    return made


@njit
def _look_from_home(robots: Any, pose: Any, store: Any, homes: Any) -> None:
    robot, home, legs = record(robots), record(homes), record(store)
    legs_at(robot, pose, legs)
    rod_directions(legs, home.rod[:])
    home.side = solve(legs.line.copy(), np.eye(6))


@njit
def rod_directions(legs: Any, made: Any) -> None:
    """Unit vectors (12, 3) along the rods: in P, then along crank, lateral axis and e_N of their own cranks."""
    lateral = np.empty(3)
    for i in range(6):
        for k in range(3):
            made[i, k] = dot(legs.rotation[:, k], legs.e_l[i])
        cross(legs.e_n[i], legs.crank[i], lateral)
        made[6 + i, 0], made[6 + i, 1] = dot(legs.e_l[i], legs.crank[i]), dot(legs.e_l[i], lateral)
        made[6 + i, 2] = legs.transmission[i]


@njit
def segment_distance(start: Any, way: Any, other_start: Any, other_way: Any) -> float:
    """Shortest distance between two line segments, of start and way (3,) [m], also parallel, crossing or of no length.

    C. Ericson, Real-Time Collision Detection (2005), 5.1.9: the optimum of each line's parameter, clamped in turn.
    """
    uu, uv, vv, ur, vr = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        u, v, r = way[k], other_way[k], start[k] - other_start[k]
        uu += u * u
        uv += u * v
        vv += v * v
        ur += u * r
        vr += v * r
    # Of parallel segments any s will do to start with: t follows from it, and s once more from the clamped t.
    s, tiny, determinant = 0.0, 2.2250738585072014e-308, uu * vv - uv * uv
    if determinant > 2.220446049250313e-16 * uu * vv:
        s = min(1.0, max(0.0, (uv * vr - ur * vv) / determinant))
    t = min(1.0, max(0.0, (uv * s + vr) / max(vv, tiny)))
    s = min(1.0, max(0.0, (uv * t - ur) / max(uu, tiny)))
    square = 0.0
    for k in range(3):
        gap = start[k] - other_start[k] + s * way[k] - t * other_way[k]
        square += gap * gap
    return np.sqrt(square)


@njit
def link_distances(robot: Any, legs: Any, made: Any) -> None:
    """Distances (60,) [m] between the axes of links of different legs: cranks 0 to 5, then rods 0 to 5, in pairs."""
    start, way = np.empty((12, 3)), np.empty((12, 3))
    for i in range(6):
        for k in range(3):
            way[i, k], way[6 + i, k] = robot.crank_length[i] * legs.crank[i, k], robot.rod_length[i] * legs.e_l[i, k]
            start[i, k] = robot.shaft[i, k]
            start[6 + i, k] = start[i, k] + way[i, k]
    pair = 0
    for i in range(12):
        for j in range(i + 1, 12):
            if j != i + 6:
                made[pair] = segment_distance(start[i], way[i], start[j], way[j])
                pair += 1


@njit
def measure(
    robot: Any, home: Any, pose: Any, rate: Any, acceleration: Any, gravity: float, legs: Any, inverse: Any, made: Any
) -> bool:
    """All `MEASURES` at one pose and motion; whether all rods can span.

    Args:
        robot: `ROBOT` record.
        home: `HOME` record.
        pose: (6,) [rad, m].
        rate: (6,) [rad/s, m/s] Euler rates and velocity.
        acceleration: (6,) [rad/s^2, m/s^2] their time derivatives.
        gravity: [m/s^2] along -z of B.
        legs: `LEGS` record, out.
        inverse: (6, 6) out; of the rods' lines, column i that of leg i.
        made: `MEASURES` record, out.
    """
    within = legs_at(robot, pose, legs) < 0
    for i in range(6):
        # So far off that squares leave floating point: beyond any reach.
        made.reach[i] = -np.inf if np.isnan(legs.reach[i]) else legs.reach[i]
    if not within:
        made.transmission[:], made.conditioning, made.side = np.nan, np.nan, np.nan
        made.swing[:], made.distance[:], made.stroke[:] = np.nan, np.nan, np.nan
        made.speed[:], made.torque[:] = np.nan, np.nan
        return False
    rods, normal = np.empty((12, 3)), np.empty(3)
    rod_directions(legs, rods)
    for i in range(12):
        cross(rods[i], home.rod[i], normal)
        made.swing[i] = np.arctan2(np.sqrt(dot(normal, normal)), dot(rods[i], home.rod[i]))
    link_distances(robot, legs, made.distance)
    for pair in range(len(made.distance)):
        made.distance[pair] -= 2.0 * home.radius
    lines = legs.line.copy()
    inverse[:] = 0.0
    dead = False
    for i in range(6):
        inverse[i, i] = 1.0
        made.transmission[i] = abs(legs.transmission[i])
        dead = dead or made.transmission[i] == 0.0
        off = np.arctan2(legs.sine[i], legs.cosine[i]) - home.middle[i]
        made.stroke[i] = abs(np.arctan2(np.sin(off), np.cos(off)))
    made.conditioning, made.side = conditioning(robot, legs, 1e-14), solve(lines, inverse)
    if made.side == 0.0 or dead:
        made.speed[:], made.torque[:] = np.inf, np.inf
        return True
    twist, twist_rate, wrench, own = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    twists_of_motion(pose, rate, acceleration, twist, twist_rate)
    crank_rates(legs, twist, made.speed[:])
    loads(robot, legs, twist, twist_rate, gravity, wrench, own)
    for i in range(6):
        force = 0.0
        for k in range(6):
            force += inverse[k, i] * wrench[k]
        made.torque[i] = abs(legs.lever[i] * force + own[i])
        made.speed[i] = abs(made.speed[i])
    return True


@njit
def strength(legs: Any, inverse: Any, torque: Any, limit: Any) -> Any:
    """Largest moment [N m] and force [N] that can be exerted in every direction, each without the other.

    They are balls inscribed into the image of the torque limits, a box, under the statics map. To exert the wrench w
    the motors need T = t + A w, with t the holding torque and A the inverse of the map tau of (18), `statics`. Over all
    forces of size r the term A_i w of motor i runs from -r |a_i| to +r |a_i|, a_i the three entries of row i of A that
    belong to the force (or to the moment). So r can be exerted in every direction exactly as long as |t_i| + r |a_i| <=
    T_max for all i: the largest is min_i (T_max - |t_i|) / |a_i|. It is zero where the weight alone is too much.
    """
    moment, force = np.inf, np.inf
    for i in range(6):
        spare, size = limit[i] - torque[i], abs(legs.lever[i])
        if not spare > 0.0:
            return 0.0, 0.0
        moment = min(moment, spare / (size * np.sqrt(dot(inverse[:3, i], inverse[:3, i]))))
        force = min(force, spare / (size * np.sqrt(dot(inverse[3:, i], inverse[3:, i]))))
    return moment, force


@njit
def _of_motion(
    robots: Any, homes: Any, gravity: float, poses: Any, rates: Any, accelerations: Any, made: Any
) -> None:  # fmt: skip
    robot, home, store, inverse = record(robots), record(homes), np.empty(1, LEGS), np.empty((6, 6))
    for n in range(len(poses)):
        legs, of_pose = record(store), record(made[n : n + 1])
        measure(robot, home, poses[n], rates[n], accelerations[n], gravity, legs, inverse, of_pose)


@njit
def _of_poses(robots: Any, homes: Any, gravity: float, torque_limit: float, poses: Any, made: Any) -> None:
    robot, home, inverse = record(robots), record(homes), np.empty((6, 6))
    store, measures, still, limit = np.empty(1, LEGS), np.empty(1, MEASURES), np.zeros(6), np.empty(6)
    for i in range(6):
        limit[i] = torque_limit * home.limit[i]
    for n in range(len(poses)):
        legs, m, row = record(store), record(measures), record(made[n : n + 1])
        within = measure(robot, home, poses[n], still, still, gravity, legs, inverse, m)
        row.reach = m.reach.min()
        if within:
            row.transmission, row.conditioning = m.transmission.min(), m.conditioning * m.side * home.side
            row.ball_swing, row.universal_swing = m.swing[:6].max(), m.swing[6:].max()
            row.stroke, row.clearance, row.holding_torque = 0.0, m.distance.min(), 0.0
            for i in range(6):
                row.stroke = max(row.stroke, m.stroke[i] / home.half[i])
                row.holding_torque = max(row.holding_torque, m.torque[i] / home.limit[i])
            row.moment, row.force = strength(legs, inverse, m.torque, limit)


def measure_poses(
    robot: RobotParameters,
    pose: np.ndarray,
    gravity: float = STANDARD_GRAVITY,
    torque_limit: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> np.recarray:
    """`POSE_MEASURES` records (n,) at poses (n, 6) [rad, m].

    `torque_limit` [N m] stands in place of the robot's `effort_limit`; each motor keeps its share of it. `progress` is
    called with the share done.
    """
    pose = np.array(pose, dtype=float, order="C")
    if pose.ndim != 2 or pose.shape[1] != 6 or not np.isfinite(pose).all():
        raise ConfigurationError("pose", pose, "finite numbers of shape (n, 6)")
    limit = robot.effort_limit if torque_limit is None else torque_limit
    shared = (robot_record(robot), home_record(robot), float(gravity), float(limit))
    made = np.full((len(pose), len(POSE_MEASURES.names or ())), np.nan).view(POSE_MEASURES)[:, 0]
    for start in range(0, len(pose), _BLOCK):
        rows = slice(start, start + _BLOCK)
        over_rows(_of_poses, shared, (pose[rows], made[rows]))
        if progress is not None:
            progress(min(1.0, (start + _BLOCK) / len(pose)))
    return made.view(np.recarray)


def measure_motion(
    robot: RobotParameters, pose: np.ndarray, pose_rate: np.ndarray, pose_acceleration: np.ndarray, gravity: float
) -> np.ndarray:
    """`MEASURES` records (n,) of a sampled motion: poses, rates and accelerations (n, 6)."""
    motion = [np.array(each, dtype=float, order="C") for each in (pose, pose_rate, pose_acceleration)]
    made = np.empty(len(motion[0]), dtype=MEASURES)
    over_rows(_of_motion, (robot_record(robot), home_record(robot), float(gravity)), (*motion, made))
    return made
