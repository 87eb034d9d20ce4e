"""The numbers of a robot in words: what its file says, leg by leg, and what follows from them at home."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from stewart_drake.mechanics.dynamics import static_torque, task_inertia
from stewart_drake.mechanics.kinematics import leg_geometry
from stewart_drake.planning.measures import measure_poses
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

Sheet = tuple[str, Sequence[str], Sequence[tuple[str, ...]]]
"""Title, header and rows of texts."""


def bodies(robot: RobotParameters) -> Sheet:
    """Masses, inertias and what all legs share."""
    names = [
        *("home_height", "characteristic_length", "link_radius", "effort_limit", "rotor_inertia"),
        *("platform_mass", "platform_center_of_mass", "platform_inertia", "platform_products"),
        *("rod_mass", "rod_inertia", "crank_mass", "crank_inertia", "base_mass", "base_inertia"),
    ]
    rows = []
    for name in names:
        text = " ".join((robot.__pydantic_fields__[name].description or "").split())
        unit, _, words = text.removeprefix("[").partition("]")
        value = getattr(robot, name)
        numbers = ", ".join(f"{each:.6g}" for each in np.ravel(value))
        rows.append((name, numbers, unit, words.strip(" ;")))
    return "bodies and motors", ("key", "value", "unit", "what it is"), rows


def legs(robot: RobotParameters) -> Sheet:
    """Geometry of each leg."""
    header = ("leg", "shaft in B [mm]", "crank at 0", "crank at pi/2", "joint in P [mm]", "crank, rod [mm]")
    rows = []
    for leg in range(LEGS):
        vectors = (robot.crank_zero_directions[leg], robot.crank_quarter_directions[leg])
        places = (1e3 * robot.shaft_positions[leg], 1e3 * robot.platform_joints[leg])
        lengths = f"{1e3 * robot.crank_lengths[leg]:g}, {1e3 * robot.rod_lengths[leg]:g}"
        zero, quarter = (" ".join(f"{round(x, 3) + 0.0:.3f}" for x in vector) for vector in vectors)
        shaft, joint = (" ".join(f"{round(x, 2) + 0.0:.2f}" for x in place) for place in places)
        rows.append((str(leg), shaft, zero, quarter, joint, lengths))
    return "legs", header, rows


def at_home(robot: RobotParameters) -> Sheet:
    """What follows from the numbers at the home pose."""
    home = leg_geometry(robot, robot.home_pose)
    angles = np.degrees(home.crank_angles)
    stops = np.degrees(robot.crank_angle_ranges)
    torque = static_torque(robot, robot.home_pose)
    header = ("leg", "branch", "angle [deg]", "stops [deg]", "transmission [-]", "torque at rest, limit [N m]")
    rows = []
    for leg in range(LEGS):
        ends = f"{stops[leg, 0]:.1f} to {stops[leg, 1]:.1f}" if np.isfinite(stops[leg]).any() else "none"
        rest = f"{torque[leg]:.4g}, {robot.effort_limits[leg]:g}"
        own = (str(leg), f"{robot.branches[leg]:+.0f}", f"{angles[leg]:.2f}", ends)
        rows.append((*own, f"{abs(home.transmission[leg]):.3f}", rest))
    return "at home", header, rows


def figures(robot: RobotParameters) -> Sheet:
    """Single figures at the home pose."""
    heave = task_inertia(robot, robot.home_pose)[5, 5]
    home = measure_poses(robot, np.array([robot.home_pose]))
    share = 100.0 * home.holding_torque[0] / robot.effort_limit
    rows = [
        ("conditioning of the rods' lines", f"{home.conditioning[0]:.3f}", "-"),
        ("smallest gap between links of two legs", f"{1e3 * home.clearance[0]:.2f}", "mm"),
        ("inertia felt in heave, motors and rods included", f"{heave:.4g}", "kg"),
        ("largest torque at rest, of the effort limit", f"{share:.1f}", "%"),
    ]
    return "figures at home", ("", "value", "unit"), rows


SHEETS: tuple[Callable[[RobotParameters], Sheet], ...] = (bodies, legs, at_home, figures)
"""In the order in which they are shown."""
