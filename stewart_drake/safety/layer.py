"""The safety layer as a part of a loop: flat vectors in and out, tick by tick."""

from __future__ import annotations

import numpy as np

from stewart_drake.errors import failure_code
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.frozen import FROZEN_SIZE, flat_frozen
from stewart_drake.safety.memory import MEMORY_SIZE, SafetyInputs, initial_memory
from stewart_drake.safety.monitors import surprise
from stewart_drake.safety.safety_options import SafetyOptions
from stewart_drake.safety.tick import flat_tick
from stewart_drake.sampling import Sampled


def safety_part(
    robot: RobotParameters,
    options: SafetyOptions,
    gravity: float,
    period: float,
    initial: np.ndarray,
    compiled: bool,
    quantum: float,
    surprise_scale: tuple[float, float] = (0.0, 1.0),
) -> Sampled:
    """`safety_tick`, and before it the look for a sensor that repeats itself.

    Args:
        robot: As the controller believes it to be.
        options: Limits and reactions.
        gravity: [m/s^2].
        period: [s] tick period.
        initial: (6,) [N m] that hold the robot at its start; what is held where the very first command is bad.
        compiled: See `Scenario.compiled`.
        quantum: [rad] of a count of the encoders.
        surprise_scale: Of the innovations, see `Observer.surprise_scale`.

    Returns:
        Its tick takes command (6,) [N m], measurement (12,), reference (18,), age [ticks] of the command, health of
        sensors and of controller as `sampling.ill` tells it, readings (6,) [rad] of encoders or None, innovation (6,)
        [rad] of an observer or None, pose (6,) [rad, m] that a sensor reads where an observer stands behind it or None,
        and memory (82,), which begins with torque (6,), and numbers of level and monitor,
        leg or -1.
    """
    tick = flat_tick(robot, options, gravity, period, compiled)
    look = flat_frozen(robot, options, quantum, compiled)

    def whole(
        command: np.ndarray,
        measured: np.ndarray,
        reference: np.ndarray,
        age: float,
        sensor: tuple[float, float],
        controller: tuple[float, float],
        angles: np.ndarray | None,
        innovation: np.ndarray | None,
        pose: np.ndarray | None,
        memory: np.ndarray,
    ) -> np.ndarray:
        wanted, seen = reference[:6], memory[MEMORY_SIZE:]
        frozen, seen = look(angles, measured[:6] if pose is None else pose, wanted, seen)
        if frozen is not None:
            sensor = failure_code("frozen"), frozen
        surprised = 0.0 if innovation is None else surprise(innovation, surprise_scale)
        inputs = SafetyInputs(command, measured[:6], measured[6:], wanted, age, sensor, controller, surprised)
        return np.concatenate([tick(inputs, memory[:MEMORY_SIZE]), seen])

    return Sampled(np.concatenate([initial_memory(initial).flat(), np.full(FROZEN_SIZE, np.nan)]), whole)
