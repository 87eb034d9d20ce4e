"""Sensors, estimators and controllers as the functions that a run calls, with the names of what they remember.

A kind is one function and one line in a table here; the linear loop is made by differences, so it asks nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.compiled.constants import ESTIMATOR_MEMORY, LQI_MEMORY, OBSERVER_MEMORY
from stewart_drake.control.computed_torque import ComputedTorqueMemory, computed_torque_tick
from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.control.joint_pid import PidMemory, pid_tick
from stewart_drake.control.lqi import MEMORY_SIZE, flat_tick
from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.estimator import flat_estimate, initial_memory
from stewart_drake.hardware.observer import Observer, flat_observer
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import crank_rates, forward_kinematics, inverse_kinematics, leg_geometry
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import Scenario
from stewart_drake.wording import either

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
    tick = flat_observer(observer, lambda angles, guess: forward_kinematics(robot, angles, guess), compiled=True)

    def from_reading(read: np.ndarray, sent: np.ndarray, memory: np.ndarray) -> np.ndarray:
        return tick(inverse_kinematics(robot, read[:6]) if len(read) == 12 else read, sent, at_rest, memory)

    # Without friction, what is wanted says nothing to it.
    at_rest = np.concatenate([pose, np.zeros(12)])
    still = static_torque(robot, pose, scenario.gravity)
    delay = scenario.command_delay if options.delay is None else options.delay
    memory = observer.initial(pose, np.zeros(6), still, delay)
    moving = np.arange(_O.pose_ahead), np.arange(_O.surplus, _O.missed), np.arange(_O.size, len(memory))
    says = np.arange(_O.pose_ahead, _O.compensation), np.arange(_O.compensation, _O.innovation)
    return Part(from_reading(reading, still, memory), from_reading, np.concatenate(moving), says)


def _lqi(scenario: Scenario) -> Part:
    options: Any = scenario.controller
    tick = flat_tick(scenario.believed_robot, options, scenario.gravity, compiled=True)
    weights = np.array(scenario.tuner.weights)

    def with_weights(measured: np.ndarray, wanted: np.ndarray, memory: np.ndarray) -> np.ndarray:
        return tick(measured, wanted, weights, memory)

    return Part(np.zeros(MEMORY_SIZE), with_weights, np.arange(LQI_MEMORY.integral, LQI_MEMORY.gain), (np.arange(6),))


def _by_law(law: Callable[..., Any], memory: Any) -> Callable[[Scenario], Part]:
    """A controller that is one law of (6,) arrays with an integral among them."""

    def made(scenario: Scenario) -> Part:
        own = scenario.believed_robot, scenario.controller, scenario.gravity

        def tick(measured: np.ndarray, wanted: np.ndarray, before: np.ndarray) -> np.ndarray:
            seen = Measurement(measured[:6], measured[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:])
            return np.concatenate(law(*own, *seen, memory(*before.reshape(-1, 6))))

        integral = 6 * memory._fields.index("integral")
        state = np.arange(integral, integral + 6)
        return Part(np.zeros(6 * len(memory._fields)), tick, state, (np.arange(6),))

    return made


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
CONTROLLERS: Mapping[str, Callable[[Scenario], Part]] = {
    "lqi": _lqi,
    "pid": _by_law(pid_tick, PidMemory),
    "computed_torque": _by_law(computed_torque_tick, ComputedTorqueMemory),
}
"""Kind of controller -> the part; its inputs are measurement (12,) and reference (18,)."""


def part_of(table: Mapping[str, Any], key: str, kind: str) -> Any:
    """The function of a kind.

    Raises:
        ConfigurationError: The kind has no line in the table.
    """
    if kind not in table:
        raise ConfigurationError(f"{key}.kind", kind, f"{either(list(table))}, for a linear loop")
    return table[kind]
