"""Limits on a motion, and margins of poses and motions to them: one compiled law, on all cores.

A margin is positive inside, in the unit of the limit. A motion is checked at its samples; between them, a sign change
of the rods' determinant, a parallel singularity that was crossed, counts as broken `conditioning`. `transmission`
|e_l . e_N| is zero where a crank is at its dead centre (serial), `conditioning` where the rods' lines lose rank
(parallel).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Positive, Section
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.mechanics import reach_laws
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import over_rows
from stewart_drake.mechanics.kinematics_laws import robot_record
from stewart_drake.mechanics.pose_margins import MARGINS, Measures, PoseLimits, margin_rows, measure_rows
from stewart_drake.mechanics.singularities import PLANNED
from stewart_drake.robot import Gravity, RobotParameters, base_reading
from stewart_drake.robot.leg import JOINT_SWING
from stewart_drake.robot.robot_scale import LENGTH

Ratio = Annotated[Positive, Field(le=1.0)]


class ReferenceLimits(Section, key="limits"):
    """Limits on the reference motion; null switches a limit off.

    The paper gives none of these; the defaults are assumptions of this project.
    """

    reach: Ratio | None = 0.98
    """[-] largest extension of a leg, where 1 is the end of its reach: |C| / sqrt(A^2 + B^2) of the crank equation.
    null means 1, beyond which the rod cannot reach its joint."""
    euler_pitch: Annotated[Positive, Field(le=math.pi / 2.0)] | None = math.radians(85.0)
    """[rad] largest |pitch|; the Euler angles of a pose are singular at pi/2."""
    conditioning: Ratio | None = PLANNED.conditioning
    """[-] smallest distance from a parallel singularity, a pose that the rods cannot hold: sigma_min / sigma_max of the
    rods' lines."""
    transmission: Ratio | None = PLANNED.transmission
    """[-] smallest distance of a crank from its dead centre, in line with its rod: |e_l . e_N|, the cosine of the angle
    between the rod and the velocity of the crank's end."""
    joint_swing: Annotated[Positive, Field(le=math.pi)] | None = JOINT_SWING
    """[rad] largest swing of a rod from home, at the platform (ball joint) and at its crank (universal joint). The
    reference of the paper (37), (38) needs 63.1 deg at the universal joint of leg 2."""
    clearance: Annotated[Positive | None, LENGTH] = 0.005
    """[m] smallest distance between the surfaces of cranks and rods of different legs; the default scales with the
    robot."""
    crank_speed: Positive | None = 10.0
    """[rad/s] largest crank speed that the reference may need."""
    torque_fraction: Positive | None = 1.0
    """[-] largest |motor torque| of the exact inverse dynamics, as a fraction of `robot.effort_limit`."""


class SuccessCriteria(Section, key="bounds"):
    """Bounds that a run must keep for its motion to count as followed; null switches a bound off.

    A bound applies while the controller is in charge, from when the run is first inside it; a run that never gets
    inside is lost. The default lengths scale with the robot.
    """

    rotation: Positive | None = math.radians(10.0)
    """[rad] largest rotation error, the angle between platform and reference."""
    position: Annotated[Positive | None, LENGTH] = 0.03
    """[m] largest position error, the distance between platform and reference."""
    loop_gap: Annotated[Positive | None, LENGTH] = 0.001
    """[m] largest gap between a rod's end and its platform joint; a larger one opens the simulated closed chain."""
    crank_angle: Positive | None = 0.35
    """[rad] largest distance of a crank from where it should be on a machine; beyond it `drive` slows down and
    stops."""
    motion_ratio: Positive | None = 0.25
    """[-] smallest size of the platform's motion over its reference's, see docs/promises.md. Friction that holds the
    robot makes it 0. Null lets a single crank stand still, too."""
    error_ratio: Positive | None = 1.0
    """[-] largest error after settling, over the size of the reference's motion, see docs/promises.md."""


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
"""Units of the margins and wording of the limits, in the order in which simultaneous violations are named."""

_LINKS = [(kind, leg) for kind in ("crank", "rod") for leg in range(6)]
_PAIRS = [pair for pair in itertools.combinations(_LINKS, 2) if pair[0][1] != pair[1][1]]
PLACES: dict[str, list[tuple[int | None, str]]] = {
    **{limit: [(leg, f"leg {leg}") for leg in range(6)] for limit in RULES},
    "euler_pitch": [(None, "platform")],
    "conditioning": [(None, "platform")],
    "joint_swing": [(leg, f"{joint} joint of leg {leg}") for joint in ("ball", "universal") for leg in range(6)],
    "clearance": [(one[1], "{} {} to {} {}".format(*one, *other)) for one, other in _PAIRS],
}
"""Leg and name of the columns of a limit's margins."""
_ENDS = [0, *itertools.accumulate(len(PLACES[limit]) for limit in RULES)]
COLUMNS = {limit: slice(*ends) for limit, ends in zip(RULES, itertools.pairwise(_ENDS), strict=True)}
"""Columns of a limit in the margins of `pose_margins.margins_of`."""


@dataclass(frozen=True)
class LimitMargin:
    """The margin to one limit at one instant and place."""

    limit: str  # Name of the limit, one of `RULES`.
    bound: float  # The limit's value in `unit`.
    margin: float  # Signed distance to it in `unit`; negative is outside, -inf where the quantity itself is infinite.
    time: float  # [s].
    leg: int | None  # Leg 0..5, for `clearance` the first of the two; None where the limit belongs to the platform.
    where: str  # The place in words, such as `rod 1 to rod 2`.

    @property
    def unit(self) -> str:
        """Unit of value, bound and margin."""
        return RULES[self.limit][0]

    @property
    def value(self) -> float:
        """The limited quantity in `unit`; its size where it has a sign or is a vector."""
        return self.bound + self.margin if ">=" in RULES[self.limit][1] else self.bound - self.margin

    @property
    def allowed(self) -> str:
        """What is allowed, and where, in words."""
        return f"{RULES[self.limit][1].format(self.bound)} ({self.where})"


def limit_bounds(robot: RobotParameters, limits: ReferenceLimits) -> dict[str, float]:
    """Values of the limits that are on, in the unit of the margin; `reach` always is."""
    given = {name: getattr(limits, name, None) for name in RULES}
    given["reach"] = 1.0 if limits.reach is None else limits.reach
    given["torque"] = None if limits.torque_fraction is None else limits.torque_fraction * robot.effort_limit
    given["crank_range"] = 0.0 if np.isfinite(robot.crank_angle_ranges).any() else None
    return {name: value for name, value in given.items() if value is not None}


def limit_margins(
    robot: RobotParameters,
    limits: ReferenceLimits,
    pose: np.ndarray,
    pose_rate: np.ndarray,
    pose_acceleration: np.ndarray,
    gravity: Gravity,
) -> dict[str, np.ndarray]:
    """Margins (n, k) of a motion (n, 6) to the limits that are on, by `PLACES`; NaN where a rod cannot span.

    `gravity`: see `measure`.
    """
    m = measure(robot, pose, pose_rate, pose_acceleration, gravity)
    reached = m["assembly_sign"][~np.isnan(m["assembly_sign"])]
    numbers, rows = pose_limits(robot, limits, 0.0), np.empty((len(m), MARGINS))
    numbers["assembly_sign"] = reached[:1].sum()
    over_rows(margin_rows, (numbers,), (np.array(pose, dtype=float, order="C"), m, rows))
    return {name: rows[:, COLUMNS[name]] for name in limit_bounds(robot, limits)}


def pose_limits(robot: RobotParameters, limits: ReferenceLimits, gravity: Gravity) -> PoseLimits:
    """The limits as numbers, on the side of the singularities on which home is."""
    bounds, home = limit_bounds(robot, limits), _at_home(robot)
    least = {"conditioning", "transmission", "clearance"}
    given = {
        name: bounds.get(name, -np.inf if name in least else np.inf) for name in PoseLimits.fields if name in RULES
    }
    half, middle = _ranges(robot)
    arrays = {"torque": given.pop("torque") * robot.effort_shares, "crank_middle": middle, "crank_half": half}
    arrays |= {"home_rod": home["rod"], "assembly_sign": home["assembly_sign"]}
    return PoseLimits.new(**given, **arrays, thickness=2.0 * robot.link_radius, base_reading=base_reading(gravity))


def space_of(
    robot: RobotParameters, limits: ReferenceLimits, gravity: Gravity, weight: float | None = None
) -> reach_laws.Space:
    """A robot with its limits, and a weight [m/rad] of turns; None for the robot's characteristic length."""
    numbers = {"robot": robot_record(robot), "limits": pose_limits(robot, limits, gravity)}
    return reach_laws.Space.new(**numbers, weight=weight or robot.characteristic_length)


SLACK = 0.01
"""Share of a limit, or [rad] of a stop, by which the motion of a run may exceed it: a small tracking error is no
excursion."""


def longest_excursion(
    robot: RobotParameters, limits: ReferenceLimits, time: np.ndarray, pose: np.ndarray, pose_rate: np.ndarray
) -> tuple[LimitMargin, float, float] | None:
    """For a motion (n, 6) of a run: its worst margin to the limit that was broken most of the time.

    Also the share of that time, and its begin [s]; None for a motion within its limits. Torques and `reach` do not
    count: the motors limit the ones, and what was reached is within reach.
    """
    bounds, excursions = limit_bounds(robot, limits), {}
    for limit, margins in limit_margins(robot, limits, pose, pose_rate, np.zeros_like(pose), 0.0).items():
        if limit not in ("reach", "torque") and (margins < -SLACK * (bounds[limit] or 1.0)).any():
            beyond = (margins < 0.0).any(axis=1)
            row, column = np.unravel_index(np.nanargmin(margins), margins.shape)
            worst = LimitMargin(limit, bounds[limit], margins[row, column], time[row], *PLACES[limit][column])
            excursions[limit] = worst, float(beyond.mean()), float(time[beyond.argmax()])
    return max(excursions.values(), key=lambda excursion: excursion[1], default=None)


POSE_MEASURES = (
    *("reach_margin", "transmission", "conditioning", "ball_swing", "universal_swing", "stroke", "clearance"),
    *("holding_torque", "force", "moment"),
)
"""Measures at a pose at rest, NaN where a rod cannot span, but for `reach_margin`. reach_margin, transmission: the
smallest of a leg. conditioning: negative where the lines' determinant has not the sign that it has at home; zero at a
parallel singularity. ball_swing, universal_swing: the largest [rad]. stroke: largest distance of a crank from the
middle of its range, over half of it; 0 of a robot without stops. clearance: smallest distance of the surfaces
of links of different legs [m]. holding_torque: the largest [N m]. force, moment: see `strength` [N], [N m]."""

_BLOCK = 1 << 16  # poses whose measures are kept at a time


def measure(
    robot: RobotParameters, pose: np.ndarray, pose_rate: np.ndarray, pose_acceleration: np.ndarray, gravity: Gravity
) -> np.ndarray:
    """`Measures` records (n,) of a motion (n, 6).

    `gravity` may be a reading (n, 9) of the base's inertial unit for every row.
    """
    readings = gravity if isinstance(gravity, np.ndarray) and gravity.ndim == 2 else base_reading(gravity)
    bases = np.array(np.broadcast_to(readings, (len(pose), 9)), dtype=float, order="C")
    motion = [np.array(rows, dtype=float, order="C") for rows in (pose, pose_rate, pose_acceleration)]
    measures = np.full((len(motion[0]), Measures.layout.itemsize // 8), np.nan).view(Measures.layout)[:, 0]
    over_rows(measure_rows, (robot_record(robot), 2.0 * robot.link_radius), (bases, *motion, measures))
    return measures


def measure_poses(robot: RobotParameters, pose: np.ndarray, gravity: Gravity = STANDARD_GRAVITY) -> np.recarray:
    """`POSE_MEASURES` records (n,) at poses (n, 6) [rad, m]."""
    pose = np.asarray(pose, dtype=float)
    if pose.ndim != 2 or pose.shape[1] != 6 or not np.isfinite(pose).all():
        raise ConfigurationError("pose", pose, "finite numbers of shape (n, 6)")
    measures = np.recarray(len(pose), [(name, float) for name in POSE_MEASURES])
    for start in range(0, len(pose), _BLOCK):
        rows = slice(start, start + _BLOCK)
        still = np.zeros_like(pose[rows])
        m = measure(robot, pose[rows], still, still, gravity)
        half, stroke = _stroke(robot, m)
        ball, universal = np.hsplit(_swing(robot, m), 2)
        least = {"reach_margin": m["reach_margin"], "transmission": m["transmission"], "clearance": m["distance"]}
        most = {"ball_swing": ball, "universal_swing": universal, "stroke": stroke / half}
        most["holding_torque"] = m["torque"] / robot.effort_shares
        results = {"conditioning": m["conditioning"] * m["assembly_sign"] * _at_home(robot)["assembly_sign"]}
        results |= {"force": m["force"], "moment": m["moment"]}
        results |= {name: values.min(axis=1) for name, values in least.items()}
        results |= {name: values.max(axis=1) for name, values in most.items()}
        for name, values in results.items():
            measures[name][rows] = values
    return measures


@lru_cache(maxsize=128)
def _at_home(robot: RobotParameters) -> np.void:
    still = np.zeros((1, 6))
    return measure(robot, robot.home_pose[None], still, still, 0.0)[0]


def _swing(robot: RobotParameters, measures: np.ndarray) -> np.ndarray:
    """Swings (n, 12) [rad] of the rods from home, at the ball joints, then at the universal joints."""
    (a, b, c), (x, y, z) = np.moveaxis(measures["rod"], -1, 0), _at_home(robot)["rod"].T
    across = np.sqrt((b * z - c * y) ** 2 + (c * x - a * z) ** 2 + (a * y - b * x) ** 2)
    return np.arctan2(across, a * x + b * y + c * z)


def _ranges(robot: RobotParameters) -> tuple[np.ndarray, np.ndarray]:
    """Half (6,) [rad] and middle (6,) of the cranks' ranges; infinite halves of a robot without stops."""
    stops = np.isfinite(robot.crank_angle_ranges)
    low, high = np.where(stops, robot.crank_angle_ranges, [-2.0 * np.pi, 2.0 * np.pi]).T
    return 0.5 * (high - low) if stops.any() else np.full(6, np.inf), 0.5 * (low + high)


def _stroke(robot: RobotParameters, measures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Half of the cranks' ranges (6,) [rad], and how far (n, 6) [rad] the cranks are from the middle of theirs."""
    half, middle = _ranges(robot)
    off = measures["angle"] - middle
    return half, np.abs(np.arctan2(np.sin(off), np.cos(off)))
