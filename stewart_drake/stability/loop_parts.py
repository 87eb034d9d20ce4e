"""Sensors, estimators and controllers as the functions that a run calls, with the names of what they remember.

A kind is one function and one line in a table here; the linear loop is made by differences, so it asks nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.compiled.constants import ESTIMATOR_MEMORY, OBSERVER_MEMORY
from stewart_drake.control.parts import ControllerSite
from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.estimator import flat_estimate, initial_memory
from stewart_drake.hardware.observer import Observer
from stewart_drake.hardware.observing import observer_part
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import crank_rates, inverse_kinematics, leg_geometry
from stewart_drake.registry import CONTROLLERS
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import Scenario
from stewart_drake.wording import either

_STEP, _NOTHING = 1e-5, 1e-4
"""By which entries of a memory are moved, and the share of it that counts as no effect: rounding."""

_E, _O = ESTIMATOR_MEMORY, OBSERVER_MEMORY


class Reading(NamedTuple):
    """What sensors say near poses, while they are exact.

    Attributes:
        value: (m, k) at rest.
        by_state: (m, k, 12) derivative by pose and pose rate.
    """

    value: np.ndarray
    by_state: np.ndarray


class Part(NamedTuple):
    """A part of the loop that ticks.

    Attributes:
        memory: (n,) before the first tick.
        tick: Inputs, memory (n,) -> memory (n,) of the next tick.
        state: Entries of the memory on which the next tick depends.
        says: Entries that the rest of the loop gets, one group after the other.
    """

    memory: np.ndarray
    tick: Callable[..., np.ndarray]
    state: np.ndarray
    says: tuple[np.ndarray, ...]


def _exact_state(robot: RobotParameters, poses: np.ndarray) -> Reading:  # noqa: ARG001 - the same for all
    rest = np.concatenate([poses, np.zeros_like(poses)], axis=-1)
    return Reading(rest, np.broadcast_to(np.eye(12), (len(poses), 12, 12)))


def _crank_angles(robot: RobotParameters, poses: np.ndarray) -> Reading:
    units = np.broadcast_to(np.eye(6), (len(poses), 6, 6))
    at = np.broadcast_to(poses[:, None], units.shape)
    turned = crank_rates(robot, leg_geometry(robot, at), at, units)
    return Reading(
        inverse_kinematics(robot, poses),
        np.concatenate([turned.swapaxes(-1, -2), np.zeros_like(turned)], axis=-1),
    )


def _difference(scenario: Scenario, pose: np.ndarray, reading: np.ndarray) -> Part:
    if len(reading) == 12:
        return Part(np.zeros(12), lambda state, sent, memory: state, np.arange(0), (np.arange(12),))  # noqa: ARG005
    options: Any = scenario.sensors
    estimate = flat_estimate(scenario.believed_robot, options, scenario.controller.period, compiled=True)
    state = np.arange(_E.angles, _E.held)
    memory = estimate(reading, initial_memory(pose))
    return Part(memory, lambda angles, sent, memory: estimate(angles, memory), state, (np.arange(12),))  # noqa: ARG005


def _observer(scenario: Scenario, pose: np.ndarray, reading: np.ndarray) -> Part:
    robot, sensors = scenario.believed_robot, scenario.sensors
    options: Any = scenario.estimator
    observer = Observer(robot, options, scenario.gravity, scenario.controller.period, sensors.reading_noise)
    still = static_torque(robot, pose, scenario.gravity)
    delay = options.ahead(scenario.command_delay)
    memory, observe = observer_part(observer, observer.initial(pose, np.zeros(6), still, delay), len(reading), True)

    def tick(read: np.ndarray, sent: np.ndarray, before: np.ndarray) -> np.ndarray:
        # Without friction, what is wanted says nothing to it.
        return observe(read, sent, at_rest, expected, before)

    at_rest = np.concatenate([pose, np.zeros(12)])
    expected = np.array([options.expected * scenario.tuner.levels.start])
    moving = np.arange(_O.pose_ahead), np.arange(_O.surplus, _O.missed), np.arange(_O.size, len(memory))
    says = np.arange(_O.pose_ahead, _O.compensation), np.arange(_O.compensation, _O.innovation)
    return Part(tick(reading, still, memory), tick, np.concatenate(moving), says)


def controller_part(scenario: Scenario) -> Part:
    """The controller as a run has it; its inputs are measurement (12,) and reference (18,).

    Raises:
        ConfigurationError: It is a user's own, which may keep its state where nobody sees it.
    """
    options, robot, weights = scenario.controller, scenario.believed_robot, np.array(scenario.tuner.weights)
    made = CONTROLLERS.plain(options.kind)
    if made is None:
        known = [kind for kind in CONTROLLERS.kinds if CONTROLLERS.plain(kind) is not None]
        raise _no_loop("controller", options.kind, known)
    memory, law = made(options, ControllerSite(robot, scenario.gravity, len(weights), compiled=True))
    more = (weights,) if options.weighted else ()

    def tick(measured: np.ndarray, wanted: np.ndarray, before: np.ndarray) -> np.ndarray:
        return law(measured, wanted, *more, before)

    at_home = np.concatenate([robot.home_pose, np.zeros(12)])
    return Part(memory, tick, _kept(tick, (at_home[:12], at_home), memory), (np.arange(6),))


def _kept(tick: Callable[..., np.ndarray], inputs: tuple[np.ndarray, ...], memory: np.ndarray) -> np.ndarray:
    """Entries of a memory on which the next tick depends, at a point where it may stand still."""
    before = tick(*inputs, memory)
    after, steps = tick(*inputs, before), _STEP * np.eye(len(memory))
    return np.flatnonzero([np.abs(tick(*inputs, before + step) - after).max() > _NOTHING * _STEP for step in steps])


READINGS: Mapping[str, Callable[[RobotParameters, np.ndarray], Reading]] = {
    "ideal": _exact_state,
    "encoders": _crank_angles,
}
"""Kind of sensors -> what they say of the true robot at poses (m, 6)."""
ESTIMATORS: Mapping[str, Callable[[Scenario, np.ndarray, np.ndarray], Part]] = {
    "difference": _difference,
    "observer": _observer,
}
"""Kind of estimator -> the part at a pose (6,) with a reading there; its inputs are reading and last command."""


def part_of(table: Mapping[str, Any], key: str, kind: str) -> Any:
    """The function of a kind.

    Raises:
        ConfigurationError: The kind has no line in the table.
    """
    if kind not in table:
        raise _no_loop(key, kind, list(table))
    return table[kind]


def _no_loop(key: str, kind: str, known: list[str]) -> ConfigurationError:
    return ConfigurationError(f"{key}.kind", kind, f"{either(known)}, for a linear loop")
