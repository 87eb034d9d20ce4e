"""Scales the changes of a study, written for the paper's robot, to a robot of another size."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from stewart_drake.base.config import to_plain
from stewart_drake.references import AdjustedReference, HoldReference, Reference, SumReference, center_of
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.robot.robot_scale import LENGTH, PAPER
from stewart_drake.runs.checks import adjusted, fit_amplitude
from stewart_drake.scenario.limits import ReferenceLimits
from stewart_drake.scenario.scenario import Scenario

MARGIN = 0.7
"""Share of the largest feasible size that an infeasible motion gets: the controller's lag needs room."""
_TORQUES = {
    *(("plant", key) for key in ("motor_friction", "coulomb", "break_away")),
    *(("motors", "ripple"), ("motors", "resolution"), ("link", "size")),
}
"""Section and last part of the keys that hold torques of motors."""
_WRENCHES = {("disturbances", key) for key in ("wrench", "impulse", "rms")}


def scale_to_robot(changes: Mapping[str, object], base: Scenario) -> dict[str, object]:
    """Scenario key -> value, scaled to the robot of `base`; unchanged for the paper's robot.

    Torques scale with the effort limit, lengths with the characteristic length, payloads with the platform's mass.
    """
    if base.robot == PAPER:
        return dict(changes)
    scaled = {key: _scaled(key.split("."), value, base.robot) for key, value in changes.items()}
    if "reference" in scaled:
        moved = base.replace({key: scaled[key] for key in ("reference", "duration") if key in scaled})
        reference: Any = moved.reference
        fitted = _fit_reference(base.robot, base.limits, reference, moved.duration, base.gravity_in_base)
        scaled["reference"] = to_plain(fitted)
    return scaled


def _scaled(path: list[str], value: Any, robot: RobotParameters) -> object:
    """A scaled value, or a section with scaled values, at the parts of a key."""
    if path == ["initial_offset"]:
        return list(LENGTH.value(tuple(value), robot))
    section = "model.robot" if path[:2] == ["model", "robot"] else path[0]
    if ".".join(path) != section and value is not None and not isinstance(value, str):
        factor = _factor(section, path[-1], robot)
        if factor is not None:
            return (np.array(value) * factor).tolist()
    if isinstance(value, Mapping):
        return {key: _scaled([*path, key], item, robot) for key, item in value.items()}
    if isinstance(value, list):
        return [_scaled(path, item, robot) if isinstance(item, Mapping) else item for item in value]
    return value


def _factor(section: str, key: str, robot: RobotParameters) -> float | np.ndarray | None:
    """Ratio of a value between a robot and the paper's; None for a value that does not scale."""
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
    robot: RobotParameters, limits: ReferenceLimits, reference: Any, duration: float, gravity: Gravity
) -> Reference:
    """A motion about the robot's home pose, made smaller if it is not feasible."""
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
