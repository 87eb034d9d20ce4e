"""Robots of other sizes: the changes of a study, made for the paper's, in the size of another."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from stewart_drake.base.config import to_plain
from stewart_drake.references import AdjustedReference, HoldReference, Reference, SumReference, center_of
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import LENGTH, PAPER
from stewart_drake.runs.checks import adjusted, fit_amplitude
from stewart_drake.scenario.limits import ReferenceLimits
from stewart_drake.scenario.scenario import Scenario

MARGIN = 0.7
"""Of the largest feasible size of a motion, where it is not feasible as it stands: the controller's lag needs room."""
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
            return reference.replace(**{name: tuple((MARGIN * share * np.array(size)).tolist())})
    return adjusted(reference, scale=MARGIN * share)
