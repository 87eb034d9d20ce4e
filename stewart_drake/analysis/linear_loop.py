"""The sampled linear loop at poses at rest, opened at the six torques: x+ = A x + B u, y = C x; u = y closes it.

The exact robot without friction, and the controller's side of a run by central differences, with the initial weights
and without learning. The age of readings adds to the delay of commands, in whole ticks, with the same loop. `linearize`
gives the loop at one pose, and the robot alone, for numpy and for python-control.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from stewart_drake.analysis.feasibility import NEAR, sample_poses
from stewart_drake.base.config import Vector6, check_value
from stewart_drake.base.errors import ConfigurationError, RunFailure, UnreachablePoseError, installed_with
from stewart_drake.loop.part import LoopRunner, Part
from stewart_drake.mechanics.dynamics import forward_dynamics, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.mechanics.kinematics_laws import Robot
from stewart_drake.mechanics.linear_algebra import DIFFERENCE_STEP, derivatives
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.scenario.control_side import control_side
from stewart_drake.scenario.scenario import Scenario, load_scenario

_STILL = 1e-7  # [SI units] largest change of a state in a tick at an equilibrium.
_NEWTON_STEPS = 8


class LinearLoops(NamedTuple):
    """Loops at m poses."""

    a: np.ndarray  # (m, n, n).
    b: np.ndarray  # (m, n, 6) per N m.
    c: np.ndarray  # (m, 6, n) [N m].
    period: float  # [s].
    poses: np.ndarray  # (m, 6) [rad, m].
    left_out: tuple[str, ...]  # Reasons why other poses are left out, one sentence per pose.

    @property
    def closed(self) -> np.ndarray:
        """(m, n, n)."""
        return self.a + self.b @ self.c


def poses_to_stand_at(scenario: Scenario, count: int, seed: int) -> np.ndarray:
    """Random poses (count, 6) [rad, m] of the box `NEAR`, scaled to the robot, within the limits of the scenario."""
    robot, rng = scenario.robot, np.random.default_rng(seed)
    box = NEAR.around(robot)
    return sample_poses(robot, box, count, rng, limits=scenario.limits, gravity=scenario.gravity_in_base)


def linear_loops(
    scenario: Scenario, poses: np.ndarray, progress: Callable[[float], None] = lambda _: None
) -> LinearLoops:
    """Loops of a scenario at poses (m, 6) [rad, m]; a pose at which a part fails is left out.

    `progress` gets the number of finished poses.
    """
    period, results, kept, left_out = scenario.controller.period, [], [], []
    if scenario.reading_period != period:
        raise ConfigurationError("estimator.period", scenario.reading_period, "null, for a linear loop of one period")
    if not scenario.motors.by_torque:
        # The matrices do not include dynamics between a command and its torque.
        raise ConfigurationError("motors.kind", scenario.motors.kind, "motors that take torque, for a linear loop")
    if not scenario.controller.feedback:
        raise ConfigurationError("controller.kind", scenario.controller.kind, "one with feedback, for a linear loop")
    # Without friction the robot rests at its target; a safety layer would hide the failure of a part.
    changes: dict[str, object] = {"safety": None, "model.friction": None, "adaptation": None}
    if getattr(scenario.controller, "dead_band", 0.0) > 0.0:
        changes["controller.dead_band"] = 0.0
    if scenario.estimator.imu:
        # The inertial readings depend on the torque at once.
        changes["estimator.imu"] = False
        if scenario.controller_model.imu is not None:
            line = "stewart-drake: the inertial sensor is left out of the linear loop"
            logging.getLogger("stewart_drake").warning(line)
    scenario = scenario.replace(changes)
    sensed = _sensed(scenario.controller_model.reading_size, scenario.robot, poses)
    plants = plant_at(scenario.plant.loaded(scenario.robot), poses, scenario.gravity_in_base, period)
    active = None
    for k, pose in enumerate(poses):
        reading, by_state = (values[k] for values in sensed)
        try:
            side = _ControllersSide(scenario.replace({"reference": {"kind": "hold", "pose": pose}}), reading)
            active = side.choose(active)
            robot_there = PlantAt(*(values[k] for values in plants))
            results.append(_loop(robot_there, by_state, side, scenario.loop_delay, pose))
            kept.append(k)
        except (RunFailure, UnreachablePoseError) as error:
            left_out.append(str(error))
        progress(k + 1.0)
    if not results:
        raise ConfigurationError("scenario", scenario.name, f"a loop with an equilibrium at some pose: {left_out[0]}")
    a, b, c = (np.stack(matrices) for matrices in zip(*results, strict=True))
    observable = _observable(a, c)
    return LinearLoops(
        a[:, observable][:, :, observable], b[:, observable], c[:, :, observable], period, poses[kept], tuple(left_out)
    )


class PlantAt(NamedTuple):
    """Linear model of the robot at poses at rest; its state is the deviation of pose and rate."""

    a: np.ndarray
    b: np.ndarray
    torque: np.ndarray


def plant_at(robots: Robot, poses: np.ndarray, gravity: Gravity, period: float) -> PlantAt:
    """Linear model of a robot with its payload at poses (m, 6), with zero-order hold of the torques over a period."""
    torque, whole = static_torque(robots, poses, gravity), np.zeros((len(poses), 18, 18))
    whole[:, :6, 6:12], whole[:, 6:12, 12:] = np.eye(6), pose_acceleration_map(robots, poses)
    for k, way in enumerate(DIFFERENCE_STEP * np.eye(6)):
        ahead, behind = forward_dynamics(robots, np.stack([poses + way, poses - way]), np.zeros(6), torque, gravity)
        whole[:, 6:12, k] = (ahead - behind) / (2.0 * DIFFERENCE_STEP)
    moves = expm(period * whole)
    return PlantAt(moves[:, :12, :12], moves[:, :12, 12:], torque)


def _sensed(size: int, robot: RobotParameters, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact readings (m, size) at poses (m, 6), crank angles or pose and rate; their derivatives by pose and rate."""
    if size == 12:
        rest = np.concatenate([poses, np.zeros_like(poses)], axis=-1)
        return rest, np.broadcast_to(np.eye(12), (len(poses), 12, 12))
    turned = pose_jacobian(robot, poses)
    return inverse_kinematics(robot, poses), np.concatenate([turned, np.zeros_like(turned)], axis=-1)


class _ControllersSide:
    """The controller's side as one function of reading and memory, near an equilibrium, with the initial weights.

    The memory is the part of the states that affects later torques.
    """

    def __init__(self, scenario: Scenario, reading: np.ndarray) -> None:
        # The inner loop; a ball and its control are not in it.
        loop = control_side(scenario.replace({"ball_control": None}), split=True)
        parts = list(loop.every_part)
        if any(part.system is not None for part in parts):
            raise ConfigurationError("controller.kind", scenario.controller.kind, "no LeafSystem, for a linear loop")
        tuning = [part for part in parts if part.name in ("density", "tuner")]
        weights = {
            part.signal(name): part.initial[name][0] for part in tuning if part.name == "tuner" for name in part.outputs
        }
        parts = [part.connected(**_replaced(part, weights)) for part in parts if part not in tuning]
        outside = {loop.reading: len(reading), **{source.signal: source.size for source in loop.sources}}
        self.runner = LoopRunner(parts, outside, period=scenario.controller.period)
        for source in loop.sources:
            self.runner.signal(source.signal)[:] = source.evaluate(np.zeros(1))[0]
        self.reading, self._memory = reading, self.runner.values[sum(outside.values()) :]
        self._reading, self._torque = self.runner.signal(loop.reading), self.runner.signal("torque")
        # The first tick differs from later ones.
        self._tick(reading)
        self._start, self._active = self._memory.copy(), np.arange(len(self._memory))

    def choose(self, active: np.ndarray | None) -> np.ndarray:
        """Selects these elements of the states as the memory; with None it finds those that affect the torque."""
        self._active = self._leading() if active is None else active
        return self._active

    @property
    def memory(self) -> np.ndarray:
        """(n,) initial value."""
        return self._start[self._active]

    def __call__(self, inputs: np.ndarray) -> np.ndarray:
        """Memory (n,) and torque (6,) [N m] after a tick, from reading and memory before it."""
        self._memory[:] = self._start
        self._memory[self._active] = inputs[len(self.reading) :]
        self._tick(inputs[: len(self.reading)])
        return np.concatenate([self._memory[self._active], self._torque])

    def _tick(self, reading: np.ndarray) -> None:
        self._reading[:] = reading
        self.runner.run()
        self.runner.end()

    def _leading(self) -> np.ndarray:
        n, columns = len(self._start), []
        for way in DIFFERENCE_STEP * np.eye(n):
            try:
                ahead, behind = (self(np.concatenate([self.reading, self._start + step])) for step in (way, -way))
                columns.append(ahead - behind)
            except RunFailure:
                # A flag, such as the sign of a determinant.
                columns.append(np.zeros(n + 6))
        by = np.stack(columns, axis=-1)
        return np.flatnonzero(_observable(by[None, :n], by[None, n:]))


def _replaced(part: Part, signals: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {
        port: signals[source]
        for port in part.inputs
        if isinstance(source := part.source(port), str) and source in signals
    }


def _loop(
    robot: PlantAt, by_state: np.ndarray, side: _ControllersSide, delay: int, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C at the equilibrium, by Newton's method; a RunFailure if there is none.

    The state: the plant's, the memory of the controller's side, delayed commands, newest first.
    """
    x = np.concatenate([np.zeros(12), side.memory, np.tile(robot.torque, delay)])
    n, read, end = len(x), len(side.reading), 12 + len(side.memory)
    a, b, c = np.zeros((n, n)), np.zeros((n, 6)), np.zeros((6, n))
    a[:12, :12], b[:12] = robot.a, robot.b
    a[end + 6 :, end : n - 6] = np.eye(max(0, n - 6 - end))
    for _ in range(_NEWTON_STEPS):
        value, by = derivatives(side, np.concatenate([side.reading + by_state @ x[:12], x[12:end]]))
        by = np.concatenate([by[:, :read] @ by_state, by[:, read:]], axis=1)
        a[12:end, :end] = by[:-6]
        after = np.concatenate([robot.a @ x[:12], value, x[end:]])[:n]
        if delay:
            a[end : end + 6, :end], c[:, n - 6 :], acts = by[-6:], np.eye(6), x[n - 6 :]
        else:
            c[:, :end], acts = by[-6:], value[-6:]
        after[:12] += robot.b @ (acts - robot.torque)
        change = after - x
        # An integral with zero gain may drift.
        observable = _observable(a[None], c[None])
        if np.abs(change[observable]).max() < _STILL:
            return a, b, c
        with contextlib.suppress(np.linalg.LinAlgError):
            x[observable] += np.linalg.solve(
                (np.eye(n) - a - b @ c)[np.ix_(observable, observable)], change[observable]
            )
        if not np.isfinite(x).all():
            break
    raise RunFailure(f"the loop has no equilibrium at {pose.tolist()}", reason="standstill")


def _observable(a: np.ndarray, c: np.ndarray) -> np.ndarray:
    """States (n,) that affect the output at some pose; an integral with zero gain does not."""
    observable, leads = (c != 0.0).any(axis=(0, 1)), (a != 0.0).any(axis=0)
    while True:
        more = observable | leads[observable].any(axis=0)
        if (more == observable).all():
            return np.asarray(observable)
        observable = more


# --- one pose ---


class StateSpace(NamedTuple):
    """x+ = a x + b u, y = c x + d u, sampled every `period` [s]."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray
    period: float

    def to_control(self) -> Any:
        """Converts to a `control.StateSpace` of python-control.

        Raises:
            MissingPackageError: python-control is not installed.
        """
        with installed_with("stewart-drake[control]"):
            import control

        return control.ss(*self)


class Linearization(NamedTuple):
    """Linear models of a scenario at a pose (6,) [rad, m] at rest.

    Attributes:
        pose: The pose.
        torque: (6,) [N m] holding torque.
        plant: The robot, from torques [N m] to pose and rate (12,), Euler angles [rad] and position [m], all as
            deviations.
        loop: The loop opened at the motors, from their torques to the commanded torques.
    """

    pose: np.ndarray
    torque: np.ndarray
    plant: StateSpace
    loop: StateSpace

    def __str__(self) -> str:
        poles = np.linalg.eigvals(self.loop.a + self.loop.b @ self.loop.c)
        radius = np.abs(poles).max()
        return (
            f"linear model at roll, pitch, yaw {np.degrees(self.pose[:3]).round(3).tolist()} deg, "
            f"X, Y, Z {(1e3 * self.pose[3:]).round(3).tolist()} mm\n"
            f"torque at rest: {self.torque.round(4).tolist()} N m\n"
            f"plant: 6 torques -> 12 (pose, rate), {len(self.plant.a)} states\n"
            f"loop: {len(self.loop.a)} states, period {1e3 * self.loop.period:g} ms, broken at the six torques\n"
            f"closed: {'stable' if radius < 1.0 else 'unstable'}, slowest pole {radius:.6f}"
        )


def linearize(scenario: Scenario | str | Path, pose: ArrayLike | None = None) -> Linearization:
    """Linear models of the plant and the loop of a scenario at a pose.

    Args:
        scenario: A scenario, its file or its name: robot, estimator and controller with the initial weights, without
            friction, learning, dead band and inertial sensor.
        pose: (6,) [rad, m]; None for the initial pose.

    Raises:
        ConfigurationError: Not six finite numbers, no equilibrium at the pose, or a part without a linear form.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario)
    at = scenario.start()[0] if pose is None else np.asarray(pose, dtype=float)
    check_value("pose", at, Vector6)
    period = scenario.controller.period
    loops = linear_loops(scenario, at[None])
    robot = plant_at(scenario.plant.loaded(scenario.robot), at[None], scenario.gravity_in_base, period)
    plant = StateSpace(robot.a[0], robot.b[0], np.eye(12), np.zeros((12, 6)), period)
    loop = StateSpace(loops.a[0], loops.b[0], loops.c[0], np.zeros((6, 6)), period)
    return Linearization(at, robot.torque[0], plant, loop)
