"""The sampled loop around poses at rest as matrices: x+ = A x + B u, y = C x, broken at the six motors' torques.

u is what the motors give beyond holding still, y what they are told to: u = y closes the loop. The robot is the exact
model without friction under torques held over a control period, discretised exactly; estimator and controller are the
parts that a run has, linearised by central differences at the point where the loop stands still. Saturation, counts of
encoders and friction are not in it; weights stay as the tuner has them at the start.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from stewart_drake.control.computed_torque import ComputedTorqueOptions, computed_torque_part
from stewart_drake.control.joint_pid import PidOptions, pid_part
from stewart_drake.control.lqi import LqiOptions, lqi_part
from stewart_drake.errors import ConfigurationError, RunFailure, UnreachablePoseError
from stewart_drake.hardware.estimator import difference_part
from stewart_drake.hardware.observer import ObserverOptions, observer_part
from stewart_drake.jit import njit, record
from stewart_drake.mechanics import dynamics
from stewart_drake.mechanics.dynamics_laws import forward_dynamics, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.mechanics.kinematics_laws import LEGS, legs_at
from stewart_drake.part import Part
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.plant.closed_chain import loaded
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import Scenario

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


def linear_loops(scenario: Scenario, poses: np.ndarray) -> LinearLoops:
    """The loop of a scenario at poses; where a part of it refuses a pose, that is left out.

    Args:
        scenario: Robot, sensors, estimator, controller, weights, delay; its motion says nothing here.
        poses: (m, 6) [rad, m].

    Raises:
        ConfigurationError: A kind of part that has no linear loop; no pose is left.
        UnreachablePoseError: A pose is out of reach.
    """
    controller, results, kept, left_out = controller_of(scenario), [], [], []
    for k, ground in enumerate(grounds(scenario, poses)):
        try:
            results.append(LoopAt(ground, estimator_at(scenario, ground), controller, scenario.command_delay).loop())
            kept.append(k)
        except (RunFailure, UnreachablePoseError) as error:
            left_out.append(str(error))
    if not results:
        raise ConfigurationError("scenario", scenario.name, f"a loop that stands still at some pose: {left_out[0]}")
    a, b, c = (np.stack(each) for each in zip(*results, strict=True))
    return trimmed(LinearLoops(a, b, c, scenario.controller.period, poses[kept], tuple(left_out)))


def trimmed(loops: LinearLoops) -> LinearLoops:
    """The loops without states that no output ever hears of."""
    heard = _heard(loops.a, loops.c)
    return loops._replace(a=loops.a[:, heard][:, :, heard], b=loops.b[:, heard], c=loops.c[:, :, heard])


# --- the robot -------------------------------------------------------------------------------------------------------


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


def plant_at(robots: np.ndarray, poses: np.ndarray, gravity: float, period: float) -> PlantAt:
    """The robot under torques that are held over a period.

    Args:
        robots: `ROBOT` record of the true one, with what it carries, see `closed_chain.loaded`.
        poses: (m, 6) [rad, m].
        gravity: [m/s^2].
        period: [s].

    Raises:
        UnreachablePoseError: A pose is out of reach.
    """
    torque, legs, whole = np.empty((len(poses), 6)), np.empty(1, LEGS), np.zeros((len(poses), 18, 18))
    whole[:, :6, 6:12] = np.eye(6)
    for pose, held, matrix in zip(poses, torque, whole, strict=True):
        bad = _plant(robots, pose, gravity, legs, held, matrix[6:12])
        if bad >= 0:
            raise UnreachablePoseError(pose, bad, float(legs["reach"][0, bad]))
    moves = expm(period * whole)
    return PlantAt(moves[:, :12, :12], moves[:, :12, 12:], torque)


@njit
def _plant(robots: Any, pose: Any, gravity: float, leg_records: Any, torque: Any, rows: Any) -> int:
    """Torque (6,) at rest, and the derivatives (6, 18) of the acceleration by pose, rate and torque; -1 or a leg."""
    robot, legs, nothing = record(robots), record(leg_records), np.zeros(6)
    bad = legs_at(robot, pose, legs)
    if bad >= 0:
        return bad
    static_torque(robot, legs, gravity, torque)
    by_torque, acceleration = np.empty((6, 6)), np.empty(6)
    pose_acceleration_map(robot, legs, pose, by_torque)
    rows[:, 12:] = by_torque
    for k in range(6):
        for sign in (-1.0, 1.0):
            moved = pose.copy()
            moved[k] += sign * _STEP
            bad = legs_at(robot, moved, legs)
            if bad >= 0:
                return bad
            forward_dynamics(robot, legs, moved, nothing, torque, nothing, gravity, acceleration)
            rows[:, k] += sign / (2.0 * _STEP) * acceleration
    return -1


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
    """What a loop of the scenario stands on at each of the poses (m, 6) [rad, m].

    Raises:
        ConfigurationError: Sensors that have no linear loop.
        UnreachablePoseError: A pose is out of reach.
    """
    readings, by_state = _sensed(scenario.sensors.kind, scenario.robot, poses)
    robot, period = loaded(scenario.robot, scenario.plant), scenario.controller.period
    plants = plant_at(robot, poses, scenario.gravity, period)
    for k, pose in enumerate(poses):
        yield Ground(pose, PlantAt(*(each[k] for each in plants)), readings[k], by_state[k])


def _sensed(kind: str, robot: RobotParameters, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What exact sensors say at poses (m, 6), and its derivative (m, k, 12) by pose and pose rate."""
    if kind == "ideal":
        rest = np.concatenate([poses, np.zeros_like(poses)], axis=-1)
        return rest, np.broadcast_to(np.eye(12), (len(poses), 12, 12))
    if kind == "encoders":
        turned = pose_jacobian(robot, poses)
        return inverse_kinematics(robot, poses), np.concatenate([turned, np.zeros_like(turned)], axis=-1)
    raise ConfigurationError("sensors.kind", kind, "ideal or encoders, for a linear loop")


# --- estimator and controller ----------------------------------------------------------------------------------------


class Linearised(NamedTuple):
    """A part of the loop, to be asked near a standstill.

    Attributes:
        tick: Inputs, and its state as a flat vector, changed in place.
        memory: (n,) its state there.
        kept: Places in it on which the next tick depends.
        says: Places that the rest of the loop gets.
    """

    tick: Callable[..., None]
    memory: np.ndarray
    kept: np.ndarray
    says: np.ndarray

    def __call__(self, inputs: tuple[np.ndarray, ...], state: np.ndarray) -> np.ndarray:
        """What it says, then what it keeps after a tick, from inputs and what it kept before."""
        memory = self.memory.copy()
        memory[self.kept] = state
        self.tick(*inputs, memory)
        return memory[np.concatenate([self.says, self.kept])]


def _linearised(
    part: Part, outputs: tuple[str, ...], keeps: tuple[str, ...], more: tuple[np.ndarray, ...] = ()
) -> Linearised:
    """A part as it is made; `more` inputs always stay as they are."""
    dtype = part.initial.dtype

    def tick(*arguments: np.ndarray) -> None:
        part.tick(*arguments[:-1], *more, arguments[-1].view(dtype))

    memory = part.initial.view(float).copy()
    places = np.arange(len(memory)).view(np.dtype([(name, int, dtype[name].shape) for name in dtype.names or ()]))
    kept, says = (np.concatenate([places[name][0].ravel() for name in names]) for names in (keeps, outputs))
    return Linearised(tick, memory, kept, says)


def estimator_at(scenario: Scenario, ground: Ground) -> Linearised | None:
    """The estimator at a pose, of reading and last command; None where the reading is the measurement.

    Raises:
        ConfigurationError: Another kind.
        RunFailure: It refuses the pose.
    """
    robot, sensors, period, pose = scenario.believed_robot, scenario.sensors, scenario.controller.period, ground.pose
    options, still = scenario.estimator, dynamics.static_torque(scenario.believed_robot, ground.pose, scenario.gravity)
    if isinstance(options, ObserverOptions):
        part = observer_part(
            robot,
            options,
            scenario.gravity,
            period,
            sensors.reading_noise,
            pose,
            np.zeros(6),
            still,
            command_delay=scenario.command_delay,
            size=len(ground.reading),
        )
        # Without friction the reference says nothing to it.
        more = np.concatenate([pose, np.zeros(12)]), np.array([options.expected * scenario.tuner.levels[0]])
        linear = _linearised(part, ("ahead", "compensation"), ("measurement", "disturbance", "commands"), more)
        # Of the commands it has place for more than are under way.
        linear = linear._replace(kept=linear.kept[: 18 + 6 * (1 + options.ahead(scenario.command_delay))])
    elif options.kind == "difference" and len(ground.reading) == 12:
        return None
    elif options.kind == "difference":
        part = difference_part(robot, sensors, period, pose, np.zeros(6))  # type: ignore[arg-type]
        linear = _linearised(part, ("measurement",), ("angles", "crank_rate"))
        of_reading = linear.tick
        linear = linear._replace(tick=lambda reading, sent, state: of_reading(reading, state))  # noqa: ARG005
    else:
        raise ConfigurationError("estimator.kind", options.kind, "difference or observer, for a linear loop")
    linear.tick(ground.reading, still, linear.memory)
    return linear


def controller_of(scenario: Scenario) -> Linearised:
    """The controller, of measurement (12,) and reference (18,), with the split solution of the Riccati equation.

    Raises:
        ConfigurationError: It is a user's own, which may keep its state where nobody sees it.
    """
    options, robot, weights = scenario.controller, scenario.believed_robot, np.array(scenario.tuner.weights)
    if isinstance(options, LqiOptions):
        part = lqi_part(options, robot, scenario.gravity, len(weights), "split")
        return _linearised(part, ("torque",), ("integral",), (weights,))
    if isinstance(options, PidOptions):
        return _linearised(pid_part(options, robot, scenario.gravity), ("torque",), ("crank_integral",))
    if isinstance(options, ComputedTorqueOptions):
        return _linearised(computed_torque_part(options, robot, scenario.gravity), ("torque",), ("integral",))
    raise ConfigurationError("controller.kind", options.kind, "lqi, pid or computed_torque, for a linear loop")


# --- the loop --------------------------------------------------------------------------------------------------------


class Derived(NamedTuple):
    """What a part says and remembers after a tick (k,), and its derivative (k, n)."""

    value: np.ndarray
    by: np.ndarray


class LoopAt(NamedTuple):
    """A pose and what stands there; its state is plant, estimator, controller, last command, older ones."""

    ground: Ground
    estimator: Linearised | None
    controller: Linearised
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
        remembered = [each.memory[each.kept] for each in (self.estimator, self.controller) if each is not None]
        sent = np.tile(self.ground.plant.torque, max(1, self.delay))
        x = np.concatenate([np.zeros(12), *remembered, sent])
        for _ in range(_NEWTON_STEPS):
            estimated = self.estimated(x)
            (a, b, c), change = self.joined(x, estimated, self.controlled(x, estimated))
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
        plant, own, _, sent = self.places()
        reading = self.ground.reading + self.ground.by_state @ x[plant]
        r, n, k = len(reading), len(x), own.stop - own.start
        into = np.zeros((r + 6 + k, n))
        into[:r, plant], into[r : r + 6, sent], into[r + 6 :, own] = self.ground.by_state, np.eye(6), np.eye(k)
        if self.estimator is None:
            return Derived(reading, into[:r])
        estimator = self.estimator
        value, by = _derivatives(
            lambda v: estimator((v[:r], v[r : r + 6]), v[r + 6 :]), np.concatenate([reading, x[sent], x[own]])
        )
        return Derived(value, by @ into)

    def controlled(self, x: np.ndarray, estimated: Derived) -> Derived:
        """What the controller does at a state, by what the estimator tells it and what it remembers."""
        reference = np.concatenate([self.ground.pose, np.zeros(12)])
        at = np.concatenate([estimated.value[:12], x[self.places()[2]]])
        return Derived(*_derivatives(lambda v: self.controller((v[:12], reference), v[12:]), at))

    def joined(
        self, x: np.ndarray, estimated: Derived, answer: Derived
    ) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """A, B, C at a state, and by how much the closed loop's state changes in a tick there."""
        plant, own, remembered, sent = self.places()
        n, k = len(x), remembered.stop - remembered.start
        into = np.zeros((12 + k, n))
        into[:12], into[12:, remembered] = estimated.by[:12], np.eye(k)
        by = answer.by @ into
        # Behind what it says of the platform an observer has a compensation for the command.
        said = len(estimated.value) - (own.stop - own.start)
        command, of_command = answer.value[:6].copy(), by[:6].copy()
        if said > 12:
            command, of_command = command + estimated.value[12:said], of_command + estimated.by[12:said]

        a, b, c, after = np.zeros((n, n)), np.zeros((n, 6)), np.zeros((6, n)), np.zeros(n)
        robot = self.ground.plant
        a[plant, plant], b[plant] = robot.a, robot.b
        a[own], after[own] = estimated.by[said:], estimated.value[said:]
        a[remembered], after[remembered] = by[6:], answer.value[6:]
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
        estimator = 0 if self.estimator is None else len(self.estimator.kept)
        ends = np.cumsum([0, 12, estimator, len(self.controller.kept), 6])
        return tuple(slice(*pair) for pair in itertools.pairwise(ends.tolist()))


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
