"""The sampled loop around poses at rest as matrices: x+ = A x + B u, y = C x, broken at the six motors' torques.

u is what the motors give beyond holding still, y what they are told to: u = y closes the loop. The robot is the exact
model without friction under torques held over a control period, discretised exactly; estimator and controller are the
functions that a run calls, linearised by central differences at the point where the loop stands still. Saturation,
counts of encoders and friction are not in it; weights stay as the tuner has them at the start.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from stewart_drake.errors import ConfigurationError, RunFailure, UnreachablePoseError
from stewart_drake.mechanics.arrays import AnyRobot
from stewart_drake.mechanics.dynamics import forward_dynamics, pose_acceleration_map, static_torque
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.plant.closed_chain import loaded
from stewart_drake.scenario import Scenario
from stewart_drake.stability.loop_parts import ESTIMATORS, READINGS, Part, controller_part, part_of

_STEP = 1e-5
"""Of differences, in SI units: poses bend over a tenth of a metre, torques have sixteen digits."""
STILL = 1e-7
"""In SI units, by which a state may move in a tick where the loop stands still."""
_NEWTON_STEPS = 8


class LinearLoops(NamedTuple):
    """Loops at m poses, see the text of this file.

    Attributes:
        a: (m, n, n).
        b: (m, n, 6) per N m.
        c: (m, 6, n) [N m].
        period: [s].
        poses: (m, 6) [rad, m].
        left_out: What kept other poses out, a sentence each.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    period: float
    poses: np.ndarray
    left_out: tuple[str, ...]

    @property
    def closed(self) -> np.ndarray:
        """(m, n, n) of the closed loop."""
        return self.a + self.b @ self.c


def poses_to_stand_at(scenario: Scenario, count: int, seed: int) -> np.ndarray:
    """Poses (count, 6) [rad, m] of the near box, in the robot's size, at which a run of the scenario may stand.

    Raises:
        ConfigurationError: There are none.
    """
    robot, rng = scenario.robot, np.random.default_rng(seed)
    box = NEAR.around(robot)
    return sample_poses(robot, box, count, rng, limits=scenario.limits, gravity=scenario.gravity).poses


class PlantAt(NamedTuple):
    """The robot near poses at rest; its state is pose and rate less those of the point.

    Attributes:
        a: (m, 12, 12).
        b: (m, 12, 6) per N m.
        torque: (m, 6) [N m] that holds it there.
    """

    a: np.ndarray
    b: np.ndarray
    torque: np.ndarray


def plant_at(robot: AnyRobot, poses: np.ndarray, gravity: float, period: float) -> PlantAt:
    """The robot under torques that are held over a period.

    Args:
        robot: The true one, with what it carries.
        poses: (m, 6) [rad, m].
        gravity: [m/s^2].
        period: [s].

    Raises:
        UnreachablePoseError: A pose is out of reach.
    """
    torque = static_torque(robot, poses, gravity)
    steps = _STEP * np.concatenate([np.eye(6), -np.eye(6)])
    moved = poses[:, None] + steps
    found = forward_dynamics(robot, moved, np.zeros_like(moved), np.broadcast_to(torque[:, None], moved.shape), gravity)
    stiffness = ((found[:, :6] - found[:, 6:]) / (2.0 * _STEP)).swapaxes(-1, -2)
    whole = np.zeros((len(poses), 18, 18))
    whole[:, :6, 6:12] = np.eye(6)
    whole[:, 6:12, :6] = stiffness
    whole[:, 6:12, 12:] = pose_acceleration_map(robot, poses)
    moves = expm(period * whole)
    return PlantAt(moves[:, :12, :12], moves[:, :12, 12:], torque)


def linear_loops(scenario: Scenario, poses: np.ndarray) -> LinearLoops:
    """The loop of a scenario at poses; where a part of it refuses a pose, that is left out.

    Args:
        scenario: Robot, sensors, estimator, controller, weights, delay; its motion says nothing here.
        poses: (m, 6) [rad, m].

    Raises:
        ConfigurationError: A kind of part that has no linear loop; no pose is left.
        UnreachablePoseError: A pose is out of reach.
    """
    controller, estimator_of = controller_part(scenario), part_of(ESTIMATORS, "estimator", scenario.estimator.kind)
    found, kept, left_out = [], [], []
    for k, ground in enumerate(grounds(scenario, poses)):
        try:
            estimator = estimator_of(scenario, ground.pose, ground.reading)
            found.append(Site(ground, estimator, controller, scenario.command_delay).loop())
            kept.append(k)
        except (RunFailure, UnreachablePoseError) as error:
            left_out.append(str(error))
    if not found:
        raise ConfigurationError("scenario", scenario.name, f"a loop that stands still at some pose: {left_out[0]}")
    a, b, c = (np.stack(each) for each in zip(*found, strict=True))
    return trimmed(LinearLoops(a, b, c, scenario.controller.period, poses[kept], tuple(left_out)))


def trimmed(loops: LinearLoops) -> LinearLoops:
    """The loops without states that no output ever hears of."""
    heard = _heard(loops.a, loops.c)
    return loops._replace(a=loops.a[:, heard][:, :, heard], b=loops.b[:, heard], c=loops.c[:, :, heard])


class Derived(NamedTuple):
    """What a part says and remembers after a tick (k,), and its derivative (k, n)."""

    value: np.ndarray
    by: np.ndarray


class Ground(NamedTuple):
    """A pose, the robot there, and what its sensors say.

    Attributes:
        pose: (6,) [rad, m].
        plant: See `PlantAt`, of this pose.
        reading: (k,) at rest.
        by_state: (k, 12) its derivative by pose and pose rate.
    """

    pose: np.ndarray
    plant: PlantAt
    reading: np.ndarray
    by_state: np.ndarray


def grounds(scenario: Scenario, poses: np.ndarray) -> Iterator[Ground]:
    """What a loop of the scenario stands on at each of the poses (m, 6) [rad, m]; see `linear_loops`."""
    said = part_of(READINGS, "sensors", scenario.sensors.kind)(scenario.robot, poses)
    robot, period = loaded(scenario.robot, scenario.plant), scenario.controller.period
    plants = plant_at(robot, poses, scenario.gravity, period)
    for k, pose in enumerate(poses):
        yield Ground(pose, PlantAt(*(each[k] for each in plants)), said.value[k], said.by_state[k])


class Site(NamedTuple):
    """A pose and what stands there."""

    ground: Ground
    estimator: Part
    controller: Part
    delay: int

    def loop(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A, B, C around the point where the loop stands still."""
        x = self.still()
        estimated = self.estimated(x)
        return self.joined(x, estimated, self.controlled(x, estimated))[0]

    def still(self) -> np.ndarray:
        """The state (n,) at which the loop stands still, found by Newton's method from this pose.

        Raises:
            RunFailure: There is none.
        """
        estimated, remembered = self.estimator.memory[self.estimator.state], np.zeros(len(self.controller.state))
        sent = np.tile(self.ground.plant.torque, max(1, self.delay))
        x = np.concatenate([np.zeros(12), estimated, remembered, sent])
        for _ in range(_NEWTON_STEPS):
            told = self.estimated(x)
            (a, b, c), change = self.joined(x, told, self.controlled(x, told))
            # An integral that nobody hears, its gain zero, need not stand still.
            heard = _heard(a[None], c[None])
            if np.abs(change[heard]).max() < STILL:
                return x
            with contextlib.suppress(np.linalg.LinAlgError):
                x[heard] += np.linalg.solve((np.eye(len(x)) - a - b @ c)[np.ix_(heard, heard)], change[heard])
            if not np.isfinite(x).all():
                break
        raise RunFailure(f"the loop does not stand still at {self.ground.pose.tolist()}", reason="standstill")

    def estimated(self, x: np.ndarray) -> Derived:
        """What the estimator does at a state, by the state of the loop."""
        (_, _, value, by_state), (plant, estimated, _, sent) = self.ground, self.places()
        n, r, n_e = len(x), len(value), len(self.estimator.state)
        says, by = _derivatives(
            lambda v: _ticked(self.estimator, (v[:r], v[r : r + 6]), v[r + 6 :]),
            np.concatenate([value + by_state @ x[plant], x[sent], x[estimated]]),
        )
        into = np.zeros((r + 6 + n_e, n))
        into[:r, plant], into[r : r + 6, sent], into[r + 6 :, estimated] = by_state, np.eye(6), np.eye(n_e)
        return Derived(says, by @ into)

    def controlled(self, x: np.ndarray, told: Derived) -> Derived:
        """What the controller does at a state, by what the estimator tells it and what it remembers."""
        reference = np.concatenate([self.ground.pose, np.zeros(12)])
        at = np.concatenate([told.value[:12], x[self.places()[2]]])
        return Derived(*_derivatives(lambda v: _ticked(self.controller, (v[:12], reference), v[12:]), at))

    def joined(
        self, x: np.ndarray, told: Derived, answer: Derived
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """A, B, C at a state, and by how much the closed loop's state changes in a tick there."""
        plant, estimated, remembered, sent = self.places()
        says, of_estimator = told
        n, n_c = len(x), len(self.controller.state)
        into = np.zeros((12 + n_c, n))
        into[:12], into[12:, remembered] = of_estimator[:12], np.eye(n_c)
        answers, of_controller = answer.value, answer.by @ into

        added = sum(map(len, self.estimator.says[1:]))
        command, of_command = answers[:6].copy(), of_controller[:6].copy()
        if added:
            command, of_command = command + says[12:18], of_command + of_estimator[12:18]

        a, b, c, after = np.zeros((n, n)), np.zeros((n, 6)), np.zeros((6, n)), np.zeros(n)
        robot = self.ground.plant
        a[plant, plant], b[plant] = robot.a, robot.b
        a[estimated], after[estimated] = of_estimator[12 + added :], says[12 + added :]
        a[remembered], after[remembered] = of_controller[6:], answers[6:]
        a[sent], after[sent] = of_command, command
        older = np.arange(sent.stop, n)
        a[older, older - 6], after[older] = 1.0, x[older - 6]
        if self.delay:
            c[:, n - 6 :], acts = np.eye(6), x[n - 6 :]
        else:
            c, acts = of_command, command
        after[plant] = robot.a @ x[plant] + robot.b @ (acts - robot.torque)
        return (a, b, c), after - x

    def places(self) -> tuple[slice, ...]:
        """Of plant, estimator, controller and last command in the state."""
        ends = np.cumsum([0, 12, len(self.estimator.state), len(self.controller.state), 6])
        return tuple(slice(*pair) for pair in itertools.pairwise(ends))


def _ticked(part: Part, inputs: tuple[np.ndarray, ...], state: np.ndarray) -> np.ndarray:
    """What a part says, then its state after a tick, from inputs and its state before."""
    memory = part.memory.copy()
    memory[part.state] = state
    after = part.tick(*inputs, memory)
    return np.concatenate([*(after[each] for each in part.says), after[part.state]])


def _derivatives(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value (m,) and derivative (m, n) of a function of (n,), by central differences."""
    columns = []
    for k in range(len(at)):
        ahead, behind = at.copy(), at.copy()
        ahead[k], behind[k] = ahead[k] + _STEP, behind[k] - _STEP
        columns.append((function(ahead) - function(behind)) / (ahead[k] - behind[k]))
    return function(at), np.stack(columns, axis=-1)


def _heard(a: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Which states (n,) have a way to the output at some pose: an integral with a gain of zero has none."""
    heard, leads = (c != 0.0).any(axis=(0, 1)), (a != 0.0).any(axis=0)
    while True:
        more = heard | leads[heard].any(axis=0)
        if (more == heard).all():
            return np.asarray(heard)
        heard = more
