"""Tables of a robot: the numbers of its file, its legs, and figures at the home pose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stewart_drake.mechanics.dynamics import static_torque, task_inertia
from stewart_drake.mechanics.kinematics import leg_geometry
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.limits import measure_poses

Sheet = tuple[str, Sequence[str], Sequence[Sequence[str]]]  # Title, header and rows of texts.
_BODIES = (
    *("home_height", "characteristic_length", "link_radius", "effort_limit", "rotor_inertia"),
    *("platform_mass", "platform_center_of_mass", "platform_inertia", "platform_products"),
    *("rod_mass", "rod_inertia", "crank_mass", "crank_inertia", "base_mass", "base_inertia"),
)


def robot_sheets(robot: RobotParameters) -> list[Sheet]:
    """Masses and inertias, geometry of the legs, and figures at the home pose."""
    bodies = []
    for name in _BODIES:
        text = " ".join((robot.__pydantic_fields__[name].description or "").split())
        unit, _, words = text.removeprefix("[").partition("]")
        bodies.append((name, ", ".join(f"{x:.6g}" for x in np.ravel(getattr(robot, name))), unit, words.strip(" ;")))
    if (robot.servo_gains != 1.0).any():
        gains = ", ".join(f"{gain:.6g}" for gain in robot.servo_gains)
        bodies.append(("servo_gain", gains, "-", "of legs 0 to 5: angle that a crank turns over the one commanded"))
    home = leg_geometry(robot, robot.home_pose)
    angles, stops = np.degrees(home.crank_angles), np.degrees(robot.crank_angle_ranges)
    torque = static_torque(robot, robot.home_pose)
    legs, at_home = [], []
    for leg in range(6):
        zero = _rounded(robot.crank_zero_directions[leg], 3)
        quarter = _rounded(robot.crank_quarter_directions[leg], 3)
        shaft, joint = (_rounded(1e3 * points[leg], 2) for points in (robot.shaft_positions, robot.platform_joints))
        lengths = f"{1e3 * robot.crank_lengths[leg]:g}, {1e3 * robot.rod_lengths[leg]:g}"
        legs.append((str(leg), shaft, zero, quarter, joint, lengths))
        ends = f"{stops[leg, 0]:.1f} to {stops[leg, 1]:.1f}" if np.isfinite(stops[leg]).any() else "none"
        sizes = f"{abs(home.transmission[leg]):.3f}", f"{torque[leg]:.4g}, {robot.effort_limits[leg]:g}"
        at_home.append((str(leg), f"{robot.branches[leg]:+.0f}", f"{angles[leg]:.2f}", ends, *sizes))
    (measures,) = measure_poses(robot, robot.home_pose[None])
    share = 100.0 * measures.holding_torque / robot.effort_limit
    figures = [
        ("conditioning of the rods' lines", f"{measures.conditioning:.3f}", "-"),
        ("smallest gap between links of two legs", f"{1e3 * measures.clearance:.2f}", "mm"),
        ("effective inertia in heave, with motors and rods", f"{task_inertia(robot, robot.home_pose)[5, 5]:.4g}", "kg"),
        ("largest torque at rest, of the effort limit", f"{share:.1f}", "%"),
    ]
    of_leg = ("leg", "shaft in B [mm]", "crank at 0", "crank at pi/2", "joint in P [mm]", "crank, rod [mm]")
    there = ("leg", "branch", "angle [deg]", "stops [deg]", "transmission [-]", "torque at rest, limit [N m]")
    return [
        ("bodies and motors", ("key", "value", "unit", "what it is"), bodies),
        ("legs", of_leg, legs),
        ("at home", there, at_home),
        ("figures at home", ("", "value", "unit"), figures),
    ]


def _rounded(values: np.ndarray, digits: int) -> str:
    return " ".join(f"{round(x, digits) + 0.0:.{digits}f}" for x in values)
