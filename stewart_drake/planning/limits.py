"""What a motion must keep to, and the margins of a sampled motion to each of these limits.

A margin is positive inside, zero at the limit and negative outside, in the limit's own unit. A motion is judged at its
samples only; between them nothing is known but one thing: a sign change of the rods' determinant, a parallel
singularity jumped over, counts as broken `conditioning`.
"""

from __future__ import annotations

import itertools
import math
from typing import Annotated

import numpy as np
from pydantic import Field

from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.mechanics.kinematics import (
    LegGeometry,
    cross,
    leg_geometry,
    line_conditioning,
    pose_rate_to_twist,
    reach_margin,
    rod_lines,
    rotation_matrix,
)
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS
from stewart_drake.robot.robot_scale import LENGTH
from stewart_drake.section import Positive, Section

_CLEARANCE_BLOCK = 2048  # samples at a time: 60 pairs of links each, some 30 MB of temporaries


Ratio = Annotated[Positive, Field(le=1.0)]


class Limits(Section, key="limits"):
    """What a motion must keep to; None switches a limit off.

    The paper gives none of these; the defaults are assumptions of this project.
    """

    reach: Ratio | None = 0.98
    """[-] largest |C| / sqrt(A^2 + B^2) of a crank equation; None leaves 1, beyond which a rod cannot span."""
    euler_pitch: Annotated[Positive, Field(le=math.pi / 2.0)] | None = math.radians(85.0)
    """[rad] largest |pitch|: poses and their rates are given in Euler angles, singular at pi/2."""
    conditioning: Ratio | None = 0.05
    """[-] smallest sigma_min / sigma_max of the rods' lines, `kinematics.conditioning`."""
    transmission: Ratio | None = 0.2
    """[-] smallest |e_l . e_N| of a leg."""
    joint_swing: Annotated[Positive, Field(le=math.pi)] | None = math.radians(65.0)
    """[rad] largest swing of a rod from home, seen in the platform (ball) and in its crank (universal joint). The
    paper's own reference (37), (38) needs 63.1 deg at the universal joint of leg 2."""
    clearance: Annotated[Positive | None, LENGTH] = 0.005
    """[m] smallest distance between the surfaces of links (cranks, rods) of different legs; for another
    robot than the paper's in proportion."""
    crank_speed: Positive | None = 10.0
    """[rad/s] largest |theta'|."""
    torque_fraction: Positive | None = 1.0
    """[-] largest |motor torque| of the exact inverse dynamics, as a part of `RobotParameters.effort_limit`."""


RULES = {
    "reach": ("-", "|C| / sqrt(A^2 + B^2) <= {:g}"),
    "euler_pitch": ("rad", "|pitch| <= {:.4g} rad"),
    "conditioning": ("-", "sigma_min / sigma_max of the rods' lines >= {:g}, without crossing zero"),
    "transmission": ("-", "|e_l . e_N| >= {:g}"),
    "joint_swing": ("rad", "swing of the rod from home <= {:.4g} rad"),
    "clearance": ("m", "distance of the links' surfaces >= {:g} m"),
    "crank_range": ("rad", "distance of the crank angle from its stops >= {:g} rad"),
    "crank_speed": ("rad/s", "|crank speed| <= {:g} rad/s"),
    "torque": ("N m", "|motor torque| <= {:g} N m"),
}
"""Unit of the margin and wording of each limit, in the order in which simultaneous violations are named."""

_LINKS = [("crank", leg) for leg in range(LEGS)] + [("rod", leg) for leg in range(LEGS)]
_PAIRS = np.array([p for p in itertools.combinations(range(2 * LEGS), 2) if _LINKS[p[0]][1] != _LINKS[p[1]][1]])
PLACES: dict[str, list[tuple[int | None, str]]] = {
    **{limit: [(leg, f"leg {leg}") for leg in range(LEGS)] for limit in RULES},
    "euler_pitch": [(None, "platform")],
    "conditioning": [(None, "platform")],
    "joint_swing": [(leg, f"{joint} joint of leg {leg}") for joint in ("ball", "universal") for leg in range(LEGS)],
    "clearance": [(_LINKS[i][1], "{} {} to {} {}".format(*_LINKS[i], *_LINKS[j])) for i, j in _PAIRS],
}
"""Leg and name of each column of a limit's margins."""


def segment_distance(start: np.ndarray, end: np.ndarray, other_start: np.ndarray, other_end: np.ndarray) -> np.ndarray:
    """Shortest distance between two line segments, also parallel, crossing or of no length.

    C. Ericson, Real-Time Collision Detection (2005), 5.1.9: the optimum of each line's parameter, clamped in turn.

    Args:
        start: (..., 3) [m] one end of the first segment.
        end: (..., 3) [m] its other end.
        other_start: (..., 3) [m] one end of the second segment.
        other_end: (..., 3) [m] its other end.

    Returns:
        (...) [m].
    """
    u, v, r = end - start, other_end - other_start, start - other_start
    uu, uv, vv = (np.einsum("...i,...i->...", *pair) for pair in ((u, u), (u, v), (v, v)))
    ur, vr = np.einsum("...i,...i->...", u, r), np.einsum("...i,...i->...", v, r)
    tiny = np.finfo(float).tiny
    # Of parallel segments any s will do to start with: t follows from it, and s once more from the clamped t.
    determinant = uu * vv - uv * uv
    skew = determinant > np.finfo(float).eps * uu * vv
    s = np.where(skew, np.clip((uv * vr - ur * vv) / np.where(skew, determinant, 1.0), 0.0, 1.0), 0.0)
    t = np.clip((uv * s + vr) / np.maximum(vv, tiny), 0.0, 1.0)
    s = np.clip((uv * t - ur) / np.maximum(uu, tiny), 0.0, 1.0)
    return np.asarray(np.linalg.norm(r + s[..., None] * u - t[..., None] * v, axis=-1))


def limit_bounds(robot: RobotParameters, limits: Limits) -> dict[str, float]:
    """Value of each limit that is on, in the unit of its margin; `reach` always is."""
    given = {name: getattr(limits, name, None) for name in RULES}
    given["reach"] = 1.0 if limits.reach is None else limits.reach
    given["torque"] = None if limits.torque_fraction is None else limits.torque_fraction * robot.effort_limit
    given["crank_range"] = 0.0 if np.isfinite(robot.crank_angle_ranges).any() else None
    return {name: value for name, value in given.items() if value is not None}


def crank_strokes(robot: RobotParameters, crank_angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far cranks (..., 6) [rad] are from the middle of their range, and half of it (6,); a leg without has 2 pi."""
    stops = np.isfinite(robot.crank_angle_ranges)
    low, high = np.where(stops, robot.crank_angle_ranges, [-2.0 * math.pi, 2.0 * math.pi]).T
    off = crank_angles - 0.5 * (low + high)
    return np.abs(np.arctan2(np.sin(off), np.cos(off))), 0.5 * (high - low)


def smallest_clearance(robot: RobotParameters, pose: np.ndarray) -> float:
    """[m] smallest distance between the surfaces of links of different legs at a pose (6,) in reach."""
    return float(_link_distance(robot, leg_geometry(robot, pose[None]), pose[None]).min())


def limit_margins(
    robot: RobotParameters,
    limits: Limits,
    pose: np.ndarray,
    pose_rate: np.ndarray,
    pose_acceleration: np.ndarray,
    gravity: float,
) -> dict[str, np.ndarray]:
    """Margins of a sampled motion to each limit that is on; never raises for a pose out of reach.

    Args:
        robot: Geometry, masses, effort limit.
        limits: What to check.
        pose: (n, 6) [rad, m].
        pose_rate: (n, 6) [rad/s, m/s] Euler rates and velocity.
        pose_acceleration: (n, 6) [rad/s^2, m/s^2] their time derivatives.
        gravity: [m/s^2] along -z of B.

    Returns:
        (n, k) per limit, in the order of `RULES`, a column for each of its `PLACES`. NaN where a rod cannot span, -inf
        where the quantity itself is infinite. `reach` and `euler_pitch` are known everywhere.
    """
    bounds = limit_bounds(robot, limits)
    reach = reach_margin(robot, pose)
    reachable = np.all(reach >= 0.0, axis=-1)
    margins = {"reach": reach - (1.0 - bounds["reach"])}
    if "euler_pitch" in bounds:
        margins["euler_pitch"] = bounds["euler_pitch"] - np.abs(pose[:, 1:2])
    legs = leg_geometry(robot, pose[reachable])
    motion = (pose[reachable], pose_rate[reachable], pose_acceleration[reachable])
    for limit, values in _leg_margins(robot, bounds, legs, *motion, gravity).items():
        margins[limit] = np.full((len(pose), values.shape[1]), np.nan)
        margins[limit][reachable] = values
    return margins


def _leg_margins(
    robot: RobotParameters,
    bounds: dict[str, float],
    legs: LegGeometry,
    pose: np.ndarray,
    pose_rate: np.ndarray,
    pose_acceleration: np.ndarray,
    gravity: float,
) -> dict[str, np.ndarray]:
    """The margins (n, k) that need crank angles; all poses within reach."""
    margins: dict[str, np.ndarray] = {}
    wrench_map = np.swapaxes(rod_lines(legs), -1, -2)
    determinant = np.linalg.det(wrench_map)
    if "conditioning" in bounds:
        same_side = np.sign(determinant) * np.sign(determinant[:1])
        margins["conditioning"] = (same_side * line_conditioning(robot, legs) - bounds["conditioning"])[:, None]
    if "transmission" in bounds:
        margins["transmission"] = np.abs(legs.transmission) - bounds["transmission"]
    if "joint_swing" in bounds:
        margins["joint_swing"] = bounds["joint_swing"] - _joint_swing(robot, legs, pose)
    if "clearance" in bounds:
        margins["clearance"] = _link_distance(robot, legs, pose) - bounds["clearance"]
    if "crank_range" in bounds:
        stroke, half = crank_strokes(robot, legs.crank_angles)
        margins["crank_range"] = half - stroke
    # Exactly at a singularity rates or forces are infinite and the model cannot be asked.
    regular = (determinant != 0.0) & (legs.transmission != 0.0).all(axis=-1)
    if "crank_speed" in bounds:
        twist = pose_rate_to_twist(pose[regular], pose_rate[regular])
        along_rod = np.einsum("nji,nj->ni", wrench_map[regular], twist)
        margins["crank_speed"] = np.full((len(pose), LEGS), -np.inf)
        speed = along_rod / (robot.crank_lengths * legs.transmission[regular])
        margins["crank_speed"][regular] = bounds["crank_speed"] - np.abs(speed)
    if "torque" in bounds:
        torque = inverse_dynamics(robot, pose[regular], pose_rate[regular], pose_acceleration[regular], gravity)
        margins["torque"] = np.full((len(pose), LEGS), -np.inf)
        margins["torque"][regular] = bounds["torque"] * robot.effort_shares - np.abs(torque)
    return {limit: margins[limit] for limit in RULES if limit in margins}


def _joint_swing(robot: RobotParameters, legs: LegGeometry, pose: np.ndarray) -> np.ndarray:
    """Angle (n, 12) [rad] of each rod to its direction at home, in the platform, then in its crank."""

    def directions(of: LegGeometry, at: np.ndarray) -> np.ndarray:
        in_platform = of.e_l @ rotation_matrix(at[..., :3])
        axes = np.stack([of.crank, cross(of.e_n, of.crank), of.e_n], axis=-2)
        in_crank = np.einsum("...ij,...j->...i", axes, of.e_l)
        return np.concatenate([in_platform, in_crank], axis=-2)

    now, home = directions(legs, pose), directions(leg_geometry(robot, robot.home_pose), robot.home_pose)
    swing: np.ndarray = np.arctan2(np.linalg.norm(cross(now, home), axis=-1), np.sum(now * home, axis=-1))
    return swing


def _link_distance(robot: RobotParameters, legs: LegGeometry, pose: np.ndarray) -> np.ndarray:
    """Distance (n, 60) [m] between the surfaces of links of different legs; negative where they overlap."""
    tips = robot.shaft_positions + robot.crank_lengths[:, None] * legs.crank
    start = np.concatenate([np.broadcast_to(robot.shaft_positions, tips.shape), tips], axis=-2)
    end = np.concatenate([tips, legs.arm + pose[:, None, 3:]], axis=-2)
    one, other = _PAIRS.T
    distance = np.empty((len(pose), len(_PAIRS)))
    for first in range(0, len(pose), _CLEARANCE_BLOCK):
        block = slice(first, first + _CLEARANCE_BLOCK)
        s, e = start[block], end[block]
        distance[block] = segment_distance(s[:, one], e[:, one], s[:, other], e[:, other])
    return distance - 2.0 * robot.link_radius
