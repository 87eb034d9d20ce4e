"""Robots side by side: where they can go, how well conditioned they are, how well they follow, with what torque."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping

import numpy as np

from stewart_drake.campaigns.tables import markdown
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import conditioning
from stewart_drake.planning.workspace import Kind, boundary, spanning_grid, spread_directions, survey
from stewart_drake.robot import RobotParameters
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario, load_scenario

SCENARIO = "sway"
"""Whose motion each follows."""
SAMPLES = 40_000
"""Poses in each of the two workspaces."""
DIRECTIONS = 3000
"""Straight ways from home, of which the shortest is what is free in every direction."""
HEADER = (
    "robot",
    "platform joints at [mm]",
    "positions [cm^3]",
    "orientations [% of all]",
    "free in every direction",
    "conditioning at home, worst",
    "torque at rest [N m]",
    "error in motion [mm], [deg]",
    "torque RMS, peak [N m]",
)


def robot_rows(robots: Mapping[str, RobotParameters], progress: Callable[[float], None]) -> list[tuple[str, ...]]:
    """A row for each robot, in texts under `HEADER`.

    Args:
        robots: By name.
        progress: Called with the number of robots done.
    """
    rows = []
    for done, (name, robot) in enumerate(robots.items()):
        rows.append((name, *_poses(robot), *_motion(robot)))
        progress(done + 1.0)
    return rows


def robots_page(rows: list[tuple[str, ...]]) -> str:
    """The rows as a Markdown page."""
    base = load_scenario(SCENARIO)
    about = (
        "Workspaces around home, within the limits of a scenario that gives none: positions without turning,"
        f" orientations without moving, {SAMPLES:,} poses each. Free in every direction: the largest ball of positions "
        "and of Euler angles. Conditioning: smallest over largest singular value of the rods' lines, at home and at "
        f"the worst of these positions. In motion: `{SCENARIO}`, {base.duration:g} s of roll 6 deg, pitch 3 deg and "
        "heave 4 mm at 3 rad/s by the exact-model LQI at 1 kHz, encoders of 17 bits, all weights sized by the robot; "
        "RMSE of the second half."
    )
    page = [
        "# Robots side by side",
        "",
        *textwrap.wrap(about, 120),
        "",
        *markdown(HEADER, rows),
        "",
        "Command: `stewart-drake robots table`.",
        "",
    ]
    return "\n".join(page)


def _poses(robot: RobotParameters) -> tuple[str, ...]:
    limits, home = Scenario(robot=robot).limits, robot.home_pose
    sizes, worst, ways, directions = {}, 0.0, {}, spread_directions(DIRECTIONS)
    kinds: tuple[Kind, Kind] = ("position", "orientation")
    for kind in kinds:
        found = survey(robot, limits, spanning_grid(robot, kind, home, SAMPLES))
        sizes[kind] = found.size(found.connected)
        ways[kind] = float(boundary(robot, limits, kind, home, directions).radius.min())
        if kind == "position" and found.connected.any():
            worst = float(found.measures.conditioning[found.connected].min())
    rest = float(np.abs(static_torque(robot, home)).max())
    return (
        f"{1e3 * robot.characteristic_length:.0f}",
        f"{1e6 * sizes['position']:.3g}",
        f"{100.0 * sizes['orientation']:.2g}",
        f"{1e3 * ways['position']:.1f} mm, {np.degrees(ways['orientation']):.1f} deg",
        f"{conditioning(robot, home):.3f}, {worst:.3f}",
        f"{rest:.3g}",
    )


def _motion(robot: RobotParameters) -> tuple[str, str]:
    log = run(load_scenario(SCENARIO).replace({"robot": robot}))
    figures = run_metrics(log)
    if log.status != "completed":
        return f"{log.status}: {log.reason}", "-"
    error = f"{figures['rmse_norm_mm']:.2g}, {figures['rmse_norm_deg']:.2g}"
    return error, f"{figures['torque_rms']:.3g}, {figures['torque_peak']:.3g}"
