"""What a motion must keep to, and the margins of a sampled motion to each of these limits.

A margin is positive inside, zero at the limit and negative outside, in the limit's own unit. A motion is checked at its
samples only; between them nothing is known but one thing: a sign change of the rods' determinant, a parallel
singularity jumped over, counts as broken `conditioning`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Annotated

import numpy as np
from pydantic import Field

from stewart_drake.config import Positive, Section
from stewart_drake.planning.measures import home_record, measure_motion
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS
from stewart_drake.robot.robot_scale import LENGTH

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


class Bounds(Section, key="bounds"):
    """What a run must keep to for its motion to count as followed. A bound that is null is off.

    A bound acts while the controller is in charge, from the time on when the run has first been inside it: a start that
    is off by more has to come back. Lengths are for the paper's robot; another has them in proportion.
    """

    rotation: Positive | None = math.radians(10.0)
    """[rad] largest angle between the platform and its reference."""
    position: Annotated[Positive | None, LENGTH] = 0.03
    """[m] largest distance between the platform and its reference."""
    loop_gap: Annotated[Positive | None, LENGTH] = 0.001
    """[m] largest distance from a rod's end to its platform joint: beyond it the simulated loops are open."""
    motion_ratio: Positive | None = 0.25
    """[-] least size of the platform's motion over that of its reference, see docs/promises.md. Friction that swallows
    a motion makes it 0."""
    error_ratio: Positive | None = 1.0
    """[-] largest error, after a time for settling, over the size of the reference's motion, see docs/promises.md."""


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
_PAIRS = [pair for pair in itertools.combinations(_LINKS, 2) if pair[0][1] != pair[1][1]]
PLACES: dict[str, list[tuple[int | None, str]]] = {
    **{limit: [(leg, f"leg {leg}") for leg in range(LEGS)] for limit in RULES},
    "euler_pitch": [(None, "platform")],
    "conditioning": [(None, "platform")],
    "joint_swing": [(leg, f"{joint} joint of leg {leg}") for joint in ("ball", "universal") for leg in range(LEGS)],
    "clearance": [(one[1], "{} {} to {} {}".format(*one, *other)) for one, other in _PAIRS],
}
"""Leg and name of each column of a limit's margins."""


def limit_bounds(robot: RobotParameters, limits: Limits) -> dict[str, float]:
    """Value of each limit that is on, in the unit of its margin; `reach` always is."""
    given = {name: getattr(limits, name, None) for name in RULES}
    given["reach"] = 1.0 if limits.reach is None else limits.reach
    given["torque"] = None if limits.torque_fraction is None else limits.torque_fraction * robot.effort_limit
    given["crank_range"] = 0.0 if np.isfinite(robot.crank_angle_ranges).any() else None
    return {name: value for name, value in given.items() if value is not None}


def limit_margins(
    robot: RobotParameters,
    limits: Limits,
    pose: np.ndarray,
    pose_rate: np.ndarray,
    pose_acceleration: np.ndarray,
    gravity: float,
) -> dict[str, np.ndarray]:
    """Margins of a sampled motion (n, 6) to each limit that is on, in the order of `RULES`.

    (n, k) for each limit, a column for each of its `PLACES`. It never raises for a pose out of reach: NaN where a rod
    cannot span, -inf where the quantity itself is infinite. `reach` and `euler_pitch` are known everywhere.
    """
    m = measure_motion(robot, pose, pose_rate, pose_acceleration, gravity)
    reached = m["side"][~np.isnan(m["side"])]
    margins: dict[str, Callable[[float], np.ndarray]] = {
        "reach": lambda bound: m["reach"] - (1.0 - bound),
        "euler_pitch": lambda bound: bound - np.abs(pose[:, 1:2]),
        "conditioning": lambda bound: (m["side"] * reached[:1].sum() * m["conditioning"] - bound)[:, None],
        "transmission": lambda bound: m["transmission"] - bound,
        "joint_swing": lambda bound: bound - m["swing"],
        "clearance": lambda bound: m["distance"] - bound,
        "crank_range": lambda bound: home_record(robot)["half"] - m["stroke"] - bound,
        "crank_speed": lambda bound: bound - m["speed"],
        "torque": lambda bound: bound * robot.effort_shares - m["torque"],
    }
    return {name: margins[name](bound) for name, bound in limit_bounds(robot, limits).items()}
