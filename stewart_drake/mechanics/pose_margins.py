"""Measures of a pose in motion, and its margins to all limits: one compiled law.

`scenario.limits` has the same for arrays of poses, and names the margins.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat6, Matrix, Record, Vec3, Vec6, Vec9, Vector, record
from stewart_drake.mechanics.dynamics_laws import loads, twists_of_motion
from stewart_drake.mechanics.kinematics_laws import LEGS, Legs, Robot, cross, dot, turned
from stewart_drake.mechanics.linear_algebra import set_to
from stewart_drake.mechanics.singularities import PoseMeasures, measure_pose

MARGINS = 104
"""Margins of a pose in motion, in the order of `scenario.limits.RULES` and, within a limit, of its `PLACES`."""
Mat12x3 = Annotated[np.ndarray, (12, 3)]


class PoseLimits(Record):
    """Limits of a robot as numbers; infinite, or minus infinity for a least value, where a limit is off."""

    reach: float  # [-] largest extension of a leg.
    euler_pitch: float  # [rad]
    conditioning: float  # [-] least.
    transmission: float  # [-] least.
    joint_swing: float  # [rad]
    clearance: float  # [m] least.
    crank_middle: Vec6  # [rad] middle of the cranks' ranges.
    crank_half: Vec6  # [rad] half of the ranges.
    crank_speed: float  # [rad/s]
    torque: Vec6  # [N m]
    assembly_sign: float  # Sign of the determinant of the rods' lines on this side of the singularities.
    home_rod: Mat12x3  # `Measures.rod` at home.
    thickness: float  # [m] of the links.
    base_reading: Vec9  # [m/s^2, rad/s, rad/s^2] what an inertial unit on the base reads.


class Measures(PoseMeasures):
    """Measures of a pose in motion; NaN, but for `reach_margin`, where a rod cannot span.

    Exactly at a singularity speeds, which have no sign here, and torques are infinite.
    """

    rod: Annotated[np.ndarray, (12, 3)]  # Directions of the rods in P; then in their cranks: along, lateral, e_N.
    angle: Vec6  # [rad] of the cranks.
    distance: Annotated[np.ndarray, (60,)]  # [m] between surfaces of links, by `PLACES`; negative where they overlap.
    torque: Vec6  # [N m] size of the motor torque.
    force: float  # [N], see `strength`.
    moment: float  # [N m]


@njit
def _rod_directions(legs: Legs, out: Matrix) -> None:
    lateral, to_platform = np.empty(3), np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            to_platform[i, k] = legs.rotation[k, i]
    for i in range(6):
        turned(to_platform, legs.e_l[i], out[i])
        cross(legs.e_n[i], legs.crank[i], lateral)
        out[6 + i, 0], out[6 + i, 1] = dot(legs.e_l[i], legs.crank[i]), dot(legs.e_l[i], lateral)
        out[6 + i, 2] = legs.transmission[i]


@njit
def segment_distance(start: Vec3, way: Vec3, other_start: Vec3, other_way: Vec3) -> float:
    """Distance [m] between two segments, by start and vector to the end: Ericson, Real-Time Collision Detection (2005).

    Section 5.1.9.
    """
    uu, uv, vv, ur, vr = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        u, v, r = way[k], other_way[k], start[k] - other_start[k]
        uu += u * u
        uv += u * v
        vv += v * v
        ur += u * r
        vr += v * r
    # For parallel segments any s serves as a start: t follows from it, and s again from the clamped t.
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
def _link_distances(robot: Robot, legs: Legs, thickness: float, out: Vector) -> None:
    """Fills `Measures.distance`: distances of axes of cranks, then rods, in pairs, less the links' thickness [m]."""
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
                out[pair] = segment_distance(start[i], way[i], start[j], way[j]) - thickness
                pair += 1


@njit
def strength(legs: Legs, inverse: Mat6, torque: Vec6, limit: Vec6) -> tuple[float, float]:
    """Largest force [N] and largest moment [N m] that can be exerted in every direction, without the other one.

    To exert the wrench w the motors need T = t + A w, with t the holding torque and A the inverse of the map tau of
    (18), `statics`. Over all forces of size r the term of motor i runs from -r |a_i| to r |a_i|, a_i the three entries
    of row i of A that belong to the force (or to the moment): the largest r is min_i (T_max - |t_i|) / |a_i|, and zero
    where the weight alone is too much.
    """
    force, moment, row = np.inf, np.inf, np.empty(6)
    for i in range(6):
        spare, size = limit[i] - torque[i], abs(legs.lever[i])
        for k in range(6):
            row[k] = inverse[k, i]
        if not spare > 0.0:
            return 0.0, 0.0
        force = min(force, spare / (size * np.sqrt(dot(row[3:], row[3:]))))
        moment = min(moment, spare / (size * np.sqrt(dot(row[:3], row[:3]))))
    return force, moment


@njit
def measure_rows(
    robot: Robot, thickness: float, bases: Matrix, poses: Matrix, rates: Matrix, accelerations: Matrix, out: Measures
) -> None:
    """Fills `Measures` records (n,), which are NaN before."""
    robot = record(robot)
    memory: Any = np.empty(1, LEGS)
    for n in range(len(poses)):
        row: Any = out[n : n + 1]
        legs: Legs = record(memory)
        measure_motion(robot, bases[n], thickness, poses[n], rates[n], accelerations[n], np.inf, legs, record(row))


@njit
def measure_motion(
    robot: Robot,
    base: Vec9,
    thickness: float,
    pose: Vec6,
    rate: Vec6,
    acceleration: Vec6,
    enough: float,
    legs: Legs,
    m: Measures,
) -> bool:
    """Fills the measures of a pose in motion; whether all legs span. `enough`: see `kinematics_laws.conditioning`."""
    inverse, twist, twist_rate = np.empty((6, 6)), np.empty(6), np.empty(6)
    wrench, of_cranks = np.empty(6), np.empty(6)
    twists_of_motion(pose, rate, acceleration, twist, twist_rate)
    for i in range(6):
        for k in range(6):
            inverse[i, k] = 1.0 if i == k else 0.0
    if not measure_pose(robot, pose, twist, 1e-14, enough, legs, inverse, m):
        set_to(m.transmission[:], np.nan)
        return False
    _rod_directions(legs, m.rod[:])
    _link_distances(robot, legs, thickness, m.distance[:])
    singular = m.assembly_sign == 0.0
    for i in range(6):
        m.angle[i] = np.arctan2(legs.sine[i], legs.cosine[i])
        singular = singular or m.transmission[i] == 0.0
    if singular:
        set_to(m.speed[:], np.inf)
        set_to(m.torque[:], np.inf)
        m.force, m.moment = 0.0, 0.0
        return True
    loads(robot, legs, twist, twist_rate, base, wrench, of_cranks)
    for i in range(6):
        force = 0.0
        for k in range(6):
            force += inverse[k, i] * wrench[k]
        m.torque[i], m.speed[i] = abs(legs.lever[i] * force + of_cranks[i]), abs(m.speed[i])
    m.force, m.moment = strength(legs, inverse, m.torque[:], robot.effort_limit[:])
    return True


@njit
def margins_of(limits: PoseLimits, pose: Vec6, m: Measures, out: Vector) -> None:
    """Margins (104,) in the units of the limits; negative outside, NaN where a rod cannot span."""
    for i in range(6):
        out[i] = m.reach_margin[i] - (1.0 - limits.reach)
        out[8 + i] = m.transmission[i] - limits.transmission
        off = m.angle[i] - limits.crank_middle[i]
        out[86 + i] = limits.crank_half[i] - abs(np.arctan2(np.sin(off), np.cos(off)))
        out[92 + i] = limits.crank_speed - m.speed[i]
        out[98 + i] = limits.torque[i] - m.torque[i]
    out[6] = limits.euler_pitch - abs(pose[1])
    out[7] = m.assembly_sign * limits.assembly_sign * m.conditioning - limits.conditioning
    across = np.empty(3)
    for i in range(12):
        cross(m.rod[i], limits.home_rod[i], across)
        swing = np.arctan2(np.sqrt(dot(across, across)), dot(m.rod[i], limits.home_rod[i]))
        out[14 + i] = limits.joint_swing - swing
    for i in range(60):
        out[26 + i] = m.distance[i] - limits.clearance


@njit
def margin_rows(limits: PoseLimits, poses: Matrix, measures: Measures, out: Matrix) -> None:
    """`margins_of` of rows (n,)."""
    for n in range(len(poses)):
        row: Any = measures[n : n + 1]
        margins_of(record(limits), poses[n], record(row), out[n])
