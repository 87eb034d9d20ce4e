"""Writes docs/results/robots.md, or a table of robots of your own: workspace, conditioning, torque, error in motion.

python docs/scripts/write_robots.py
python docs/scripts/write_robots.py desk.yaml servo_hexapod --out robots.md     # names or YAML files
"""

import argparse
from pathlib import Path
from typing import get_args

import numpy as np

from stewart_drake import load_robot, load_scenario, run, run_metrics
from stewart_drake.analysis.workspace import Kind, boundary, spanning_grid, spread_directions, survey
from stewart_drake.base.markdown import markdown_table
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import conditioning
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_files import robot_names
from stewart_drake.scenario.scenario import Scenario

SCENARIO = "sway"
SAMPLES = 40_000
DIRECTIONS = 3000  # Straight ways from home, of which the shortest is what is free in every direction
HEADER = (
    "robot",
    "positions [cm^3]",
    "orientations [%]",
    "free in all directions",
    "conditioning: home, worst",
    "torque at rest [N m]",
    "error [mm], [deg]",
)


PAGE = """# Robots side by side

How large are the workspaces of the robots that are shipped, and how exactly do they follow the same motion?
Command: `python docs/scripts/write_robots.py`.

{table}

- *Workspaces* around home, within the default limits of a scenario: positions with the orientation of home, and
  orientations at the position of home; {samples:,} poses for both. *Free in all directions*: radius of the largest ball
  around home, for positions and for Euler angles.
- *Conditioning*: smallest singular value of the matrix of the six rods' lines over the largest one, at home and at the
  worst of these positions.
- *Error*: RMSE over the second half of the scenario `{scenario}`: {duration} s of roll 6 deg, pitch 3 deg and heave
  4 mm at 3 rad/s, with the exact-model LQI at 1 kHz, encoders of 17 bits, and weights scaled to the robot.
"""


def robots_page(rows: list[tuple[str, ...]]) -> str:
    """The page of rows of text, see `HEADER`."""
    duration = f"{load_scenario(SCENARIO).duration:g}"
    return PAGE.format(table=markdown_table(HEADER, rows), samples=SAMPLES, scenario=SCENARIO, duration=duration)


def _poses(robot: RobotParameters) -> tuple[str, ...]:
    limits, home, directions = Scenario(robot=robot).limits, robot.home_pose, spread_directions(DIRECTIONS)
    spaces, free = {}, {}
    for kind in get_args(Kind):
        spaces[kind] = survey(robot, limits, spanning_grid(robot, kind, home, SAMPLES))
        free[kind] = float(boundary(robot, limits, kind, home, directions).radius.min())
    sizes = {kind: each.size(each.connected) for kind, each in spaces.items()}
    places = spaces["position"]
    worst = float(places.measures.conditioning[places.connected].min(initial=1.0)) if places.connected.any() else 0.0
    return (
        f"{1e6 * sizes['position']:.3g}",
        f"{100.0 * sizes['orientation']:.2g}",
        f"{1e3 * free['position']:.1f} mm, {np.degrees(free['orientation']):.1f} deg",
        f"{conditioning(robot, home):.3f}, {worst:.3f}",
        f"{float(np.abs(static_torque(robot, home)).max()):.3g}",
    )


def _motion(robot: RobotParameters) -> str:
    log = run(load_scenario(SCENARIO).replace({"robot": robot}))
    figures = run_metrics(log)
    if log.status != "completed":
        return f"{log.status}: {log.reason}"
    return f"{figures['rmse_norm_mm']:.2g}, {figures['rmse_norm_deg']:.2g}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", default=robot_names())
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results" / "robots.md")
    given = parser.parse_args()
    robots = {name: load_robot(name) for name in given.names}
    rows = [(name, *_poses(robot), _motion(robot)) for name, robot in robots.items()]
    given.out.write_text(robots_page(rows), encoding="utf-8")
