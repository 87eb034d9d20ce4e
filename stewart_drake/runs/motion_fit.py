"""Making a motion feasible: smaller about its centre, or slower."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from stewart_drake.control.user_controller import user_code
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code import ControllerError
from stewart_drake.planning.feasibility import SEARCH_RTOL, FeasibilityReport, bisect, check_reference, largest_scale
from stewart_drake.planning.limits import Limits
from stewart_drake.references import AdjustedReference, Reference
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import Scenario

_NUDGES = 100


def motion_report(scenario: Scenario) -> FeasibilityReport:
    """`check_reference` of a scenario's whole run."""
    # Where numbers overflow a limit is broken, or the check names the signal; warnings would only add noise.
    with np.errstate(all="ignore"):
        try:
            with user_code(scenario):
                return check_reference(
                    scenario.robot, scenario.limits, scenario.reference, scenario.duration, scenario.gravity
                )
        except ControllerError as error:
            raise ConfigurationError(
                "reference", scenario.reference, f"a motion that does not raise ({error})"
            ) from None
        except ConfigurationError as error:
            if error.key not in ("pose", "pose_rate", "pose_acceleration"):
                raise
            allowed = f"a motion whose {error.key} stays finite"
            raise ConfigurationError("reference", scenario.reference, allowed) from None


def fit_amplitude(
    robot: RobotParameters,
    limits: Limits,
    reference: Reference,
    duration: float,
    gravity: float,
    samples_per_second: float = 500.0,
) -> tuple[Reference, float]:
    """The motion made smaller about its centre (`references.center_of`) until it is feasible, and its size [-].

    To a relative 1e-4, as `largest_scale` finds it, so that each smaller size tried is feasible too; the motion itself
    and 1 if it is feasible. Arguments as in `check_reference`.
    """
    checked = (duration, gravity, samples_per_second)
    if check_reference(robot, limits, reference, *checked).feasible:
        return reference, 1.0
    check_reference(robot, limits, adjusted(reference, scale=0.0), *checked).raise_if_infeasible()
    scale = largest_scale(robot, limits, lambda scale: adjusted(reference, scale=scale), *checked)
    return adjusted(reference, scale=scale), scale


def fit_speed(
    robot: RobotParameters,
    limits: Limits,
    reference: Reference,
    duration: float,
    gravity: float,
    samples_per_second: float = 500.0,
) -> tuple[Reference, float]:
    """The motion made slower until it is feasible.

    Slowed by k a crank's speed is 1/k, and its motor's torque static + (torque - static) / k^2, of what it was at the
    same pose. Where standing still is feasible, every k above the smallest feasible one is therefore feasible too, and
    bisection finds it. Limits of the poses alone do not depend on k.

    Returns:
        The motion that is feasible over slowdown * duration, and its slowdown >= 1 [-], to a relative 1e-4; the motion
        itself and 1 if it is feasible.
    """

    def report(slowdown: float, rate: float = samples_per_second) -> FeasibilityReport:
        slower = adjusted(reference, slowdown=slowdown)
        return check_reference(robot, limits, slower, slowdown * duration, gravity, rate)

    if report(1.0).feasible:
        return reference, 1.0
    check_reference(robot, limits, _Still(reference), duration, gravity, samples_per_second).raise_if_infeasible()
    # On the way, at the same poses whatever the slowdown; in the end at the full rate.
    speed = bisect(lambda speed: report(1.0 / speed, samples_per_second * speed).feasible, 0.0, 1.0)
    if speed > 0.0:
        for slowdown in (1.0 + SEARCH_RTOL * np.arange(_NUDGES)) / speed:
            if report(float(slowdown)).feasible:
                return adjusted(reference, slowdown=float(slowdown)), float(slowdown)
    raise ConfigurationError("reference", reference, "a motion that is feasible at some speed above zero")


def adjusted(reference: Reference, scale: float = 1.0, slowdown: float = 1.0) -> AdjustedReference:
    """A motion made smaller and slower; one that is adjusted already is not wrapped again."""
    if isinstance(reference, AdjustedReference):
        return dataclasses.replace(reference, scale=scale * reference.scale, slowdown=slowdown * reference.slowdown)
    motion: Any = reference
    return AdjustedReference(motion=motion, scale=scale, slowdown=slowdown)


@dataclasses.dataclass(frozen=True)
class _Still:
    """A motion's poses, at each of them standing still."""

    reference: Reference

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pose, rate, acceleration = self.reference.evaluate(time)
        return pose, np.zeros_like(rate), np.zeros_like(acceleration)
