"""A scenario near a pose at rest as linear systems: for numpy, and for python-control."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.config import Vector6, check_value
from stewart_drake.errors import installed_with
from stewart_drake.plant.closed_chain import loaded
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.stability.linear_loop import linear_loops, plant_at


class StateSpace(NamedTuple):
    """x+ = a x + b u, y = c x + d u, sampled every `period` [s]."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    period: float

    def to_control(self) -> Any:
        """The same as a `control.StateSpace` of python-control.

        Raises:
            MissingPackageError: python-control is not installed.
        """
        with installed_with("stewart-drake[control]"):
            import control

        return control.ss(*self)


class Linearization(NamedTuple):
    """A scenario near a pose (6,) [rad, m] at rest.

    Attributes:
        pose: The pose.
        torque: (6,) [N m] that holds it.
        plant: The robot: from torques [N m] less those that hold it to pose and rate (12,), Euler angles [rad] and
            position [m], less those of the point.
        loop: The whole loop, broken at the motors: from their torques to the torques that the controller then asks for.
    """

    pose: np.ndarray
    torque: np.ndarray
    plant: StateSpace
    loop: StateSpace


def linearize(scenario: Scenario | str | Path, pose: ArrayLike | None = None) -> Linearization:
    """The plant and the loop of a scenario near a pose.

    Args:
        scenario: A scenario, its file or its name. Its robot, estimator and controller count, with the weights of the
            start; friction is left out.
        pose: (6,) [rad, m]; None takes that of the start.

    Raises:
        ConfigurationError: Not six finite numbers; a pose that cannot be held, or a part that has no linear form.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    at = scenario.start()[0] if pose is None else np.asarray(pose, dtype=float)
    check_value("pose", at, Vector6)
    period = scenario.controller.period
    loops = linear_loops(scenario, at[None])
    robot = plant_at(loaded(scenario.robot, scenario.plant), at[None], scenario.gravity, period)
    plant = StateSpace(robot.a[0], robot.b[0], np.eye(12), np.zeros((12, 6)), period)
    loop = StateSpace(loops.a[0], loops.b[0], loops.c[0], np.zeros((6, 6)), period)
    return Linearization(at, robot.torque[0], plant, loop)
