"""Robots of other sizes: the changes of a study, made for the paper's, in the size of another; robots side by side."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, get_args

import numpy as np

from stewart_drake.analysis.workspace import Kind, boundary, spanning_grid, spread_directions, survey
from stewart_drake.base.config import to_plain
from stewart_drake.base.markdown import markdown_table
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import conditioning
from stewart_drake.references import AdjustedReference, HoldReference, Reference, SumReference, center_of
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import LENGTH, PAPER
from stewart_drake.runs.checks import adjusted, fit_amplitude
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.limits import ReferenceLimits
from stewart_drake.scenario.scenario import Scenario, load_scenario

MARGIN = 0.7
"""Of the largest feasible size of a motion, where it is not feasible as it stands: the controller's lag needs room."""
SCENARIO = "sway"
SAMPLES = 40_000
DIRECTIONS = 3000  # Straight ways from home, of which the shortest is what is free in every direction
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
_TORQUES = {
    *(("plant", key) for key in ("motor_friction", "coulomb", "break_away")),
    *(("motors", "ripple"), ("motors", "resolution"), ("link", "size")),
}
"""Section and last part of the keys that hold torques of motors."""
_WRENCHES = {("disturbances", key) for key in ("wrench", "impulse", "rms")}


def scale_to_robot(changes: Mapping[str, Any], base: Scenario) -> dict[str, Any]:
    """Scenario key -> value as it is for the robot of `base`; the same for the paper's.

    Torques go with the effort limit, lengths with the characteristic length, payloads with the platform's mass.
    """
    if base.robot == PAPER:
        return dict(changes)
    made = {key: _scaled(key.split("."), value, base.robot) for key, value in changes.items()}
    if "reference" in made:
        duration = float(made.get("duration", base.duration))
        reference: Any = base.replace({"reference": made["reference"]}).reference
        made["reference"] = to_plain(_fit_reference(base.robot, base.limits, reference, duration, base.gravity))
    return made


def _scaled(path: list[str], value: Any, robot: RobotParameters) -> Any:
    """A value at a key, or a section whose values are sized one by one."""
    if path == ["initial_offset"]:
        return list(LENGTH.value(tuple(value), robot))
    section = "model.robot" if path[:2] == ["model", "robot"] else path[0]
    if ".".join(path) != section and value is not None and not isinstance(value, str):
        factor = _factor(section, path[-1], robot)
        if factor is not None:
            return (np.array(value) * factor).tolist()
    if isinstance(value, Mapping):
        return {key: _scaled([*path, key], each, robot) for key, each in value.items()}
    if isinstance(value, list):
        return [_scaled(path, each, robot) if isinstance(each, Mapping) else each for each in value]
    return value


def _factor(section: str, key: str, robot: RobotParameters) -> Any:
    """By what a value grows from the paper's robot to another; None for not at all."""
    torque = robot.effort_limit / PAPER.effort_limit
    length = robot.characteristic_length / PAPER.characteristic_length
    if section == "model.robot":
        return np.array(getattr(robot, key)) / np.array(getattr(PAPER, key))
    if (section, key) in _TORQUES:
        return torque
    if (section, key) in _WRENCHES:
        return np.repeat([torque, torque / length], 3)
    payload = {"payload_mass": robot.platform_mass / PAPER.platform_mass, "payload_position": length}
    return payload.get(key) if section == "plant" else None


@lru_cache(maxsize=64)
def _fit_reference(
    robot: RobotParameters, limits: ReferenceLimits, reference: Any, duration: float, gravity: float
) -> Reference:
    """A motion about the robot's home, made smaller where it is not feasible."""
    home = tuple(robot.home_pose.tolist())
    if not np.allclose(center_of(reference), home, rtol=0.0, atol=1e-9):
        if isinstance(reference, SumReference):
            reference = SumReference(parts=reference.parts, center=home)
        elif not isinstance(reference, AdjustedReference):
            reference = SumReference(parts=(HoldReference(pose=home), reference))
    _, share = fit_amplitude(robot, limits, reference, duration, gravity)
    if share >= 1.0:
        return reference
    for name in ("amplitude", "excursion"):
        size = getattr(reference, name, ())
        if np.shape(size) == (6,):
            return dataclasses.replace(reference, **{name: tuple((MARGIN * share * np.array(size)).tolist())})
    return adjusted(reference, scale=MARGIN * share)


def robot_rows(robots: Mapping[str, RobotParameters], progress: Callable[[float], None]) -> list[tuple[str, ...]]:
    rows = []
    for done, (name, robot) in enumerate(robots.items(), 1):
        rows.append((name, *_poses(robot), *_motion(robot)))
        progress(float(done))
    return rows


def robots_page(rows: list[tuple[str, ...]]) -> str:
    about = (
        "Workspaces around home, within the limits of a scenario that gives none: positions without turning,"
        f" orientations without moving, {SAMPLES:,} poses each. Free in every direction: the largest ball of positions "
        "and of Euler angles. Conditioning: smallest over largest singular value of the rods' lines, at home and at "
        f"the worst of these positions. In motion: `{SCENARIO}`, {load_scenario(SCENARIO).duration:g} s of roll 6 deg, "
        "pitch 3 deg and heave 4 mm at 3 rad/s by the exact-model LQI at 1 kHz, encoders of 17 bits, all weights sized "
        "by the robot; RMSE of the second half."
    )
    table = markdown_table(HEADER, rows)
    return (
        f"# Robots side by side\n\n{textwrap.fill(about, 120)}\n\n{table}\n\nCommand: `stewart-drake robots table`.\n"
    )


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
        f"{1e3 * robot.characteristic_length:.0f}",
        f"{1e6 * sizes['position']:.3g}",
        f"{100.0 * sizes['orientation']:.2g}",
        f"{1e3 * free['position']:.1f} mm, {np.degrees(free['orientation']):.1f} deg",
        f"{conditioning(robot, home):.3f}, {worst:.3f}",
        f"{float(np.abs(static_torque(robot, home)).max()):.3g}",
    )


def _motion(robot: RobotParameters) -> tuple[str, str]:
    log = run(load_scenario(SCENARIO).replace({"robot": robot}))
    figures = run_metrics(log)
    if log.status != "completed":
        return f"{log.status}: {log.reason}", "-"
    error = f"{figures['rmse_norm_mm']:.2g}, {figures['rmse_norm_deg']:.2g}"
    return error, f"{figures['torque_rms']:.3g}, {figures['torque_peak']:.3g}"
