"""The sampled loop around poses at rest, broken at the six motors' torques: x+ = A x + B u, y = C x; u = y closes it.

The exact robot without friction, estimator and controller of a run by central differences; weights as at the start.
`linearize` gives the loop at one pose, and the robot alone, for numpy and for python-control.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from stewart_drake.config import Vector6, check_value
from stewart_drake.errors import ConfigurationError, RunFailure, UnreachablePoseError, installed_with
from stewart_drake.mechanics.dynamics import forward_dynamics, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_jacobian
from stewart_drake.part import Part, Setup
from stewart_drake.parts import setup_of
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.plant.closed_chain import loaded
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario import Scenario, load_scenario

_STEP = 1e-5  # Of differences, in SI units: poses bend over a tenth of a metre, torques have sixteen digits.
_STILL = 1e-7  # In SI units, by which a state may move in a tick where the loop stands still.
_NEWTON_STEPS = 8


class LinearLoops(NamedTuple):
    """Loops at m poses."""

    a: np.ndarray  # (m, n, n).
    b: np.ndarray  # (m, n, 6) per N m.
    c: np.ndarray  # (m, 6, n) [N m].
    period: float  # [s].
    poses: np.ndarray  # (m, 6) [rad, m].
    left_out: tuple[str, ...]  # What kept other poses out, a sentence each.

    @property
    def closed(self) -> np.ndarray:
        """(m, n, n)."""
        return self.a + self.b @ self.c


def poses_to_stand_at(scenario: Scenario, count: int, seed: int) -> np.ndarray:
    """Poses (count, 6) [rad, m] of the box `NEAR`, scaled to the robot, at which a run of the scenario may rest."""
    robot, rng = scenario.robot, np.random.default_rng(seed)
    box = NEAR.around(robot)
    return sample_poses(robot, box, count, rng, limits=scenario.limits, gravity=scenario.gravity)


def linear_loops(scenario: Scenario, poses: np.ndarray) -> LinearLoops:
    """The loops of a scenario at poses (m, 6) [rad, m]; a pose that a part of it refuses is left out."""
    period, results, kept, left_out = scenario.controller.period, [], [], []
    setup = setup_of(scenario, split=True)._replace(pose_rate=np.zeros(6), friction=0.0)
    sensed = _sensed(scenario.sensors.kind, scenario.robot, poses)
    plants = plant_at(loaded(scenario.robot, scenario.plant), poses, scenario.gravity, period)
    for k, pose in enumerate(poses):
        reading, by_state = (each[k] for each in sensed)
        try:
            still = static_torque(setup.robot, pose, setup.gravity)
            side, memory = _controllers_side(scenario, setup._replace(pose=pose, still=still), reading)
            robot = PlantAt(*(each[k] for each in plants))
            results.append(_loop(robot, reading, by_state, side, memory, setup.delay, pose))
            kept.append(k)
        except (RunFailure, UnreachablePoseError) as error:
            left_out.append(str(error))
    if not results:
        raise ConfigurationError("scenario", scenario.name, f"a loop with an equilibrium at some pose: {left_out[0]}")
    a, b, c = (np.stack(each) for each in zip(*results, strict=True))
    observable = _observable(a, c)
    return LinearLoops(
        a[:, observable][:, :, observable], b[:, observable], c[:, :, observable], period, poses[kept], tuple(left_out)
    )


class PlantAt(NamedTuple):
    """The robot near poses at rest, of state pose and rate less those of the point."""

    a: np.ndarray
    b: np.ndarray
    torque: np.ndarray


def plant_at(robots: np.ndarray, poses: np.ndarray, gravity: float, period: float) -> PlantAt:
    """The robot, a `ROBOT` record with what it carries, at poses (m, 6) under torques that are held over a period."""
    torque, whole = static_torque(robots, poses, gravity), np.zeros((len(poses), 18, 18))
    whole[:, :6, 6:12], whole[:, 6:12, 12:] = np.eye(6), pose_acceleration_map(robots, poses)
    for k, way in enumerate(_STEP * np.eye(6)):
        ahead, behind = forward_dynamics(robots, np.stack([poses + way, poses - way]), np.zeros(6), torque, gravity)
        whole[:, 6:12, k] = (ahead - behind) / (2.0 * _STEP)
    moves = expm(period * whole)
    return PlantAt(moves[:, :12, :12], moves[:, :12, 12:], torque)


def _sensed(kind: str, robot: RobotParameters, poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What exact sensors say at poses (m, 6), and its derivative (m, k, 12) by pose and rate."""
    if kind == "ideal":
        rest = np.concatenate([poses, np.zeros_like(poses)], axis=-1)
        return rest, np.broadcast_to(np.eye(12), (len(poses), 12, 12))
    if kind == "encoders":
        turned = pose_jacobian(robot, poses)
        return inverse_kinematics(robot, poses), np.concatenate([turned, np.zeros_like(turned)], axis=-1)
    raise ConfigurationError("sensors.kind", kind, "ideal or encoders, for a linear loop")


_LINEAR = {
    "estimator": {
        "difference": ("measurement", "angles crank_rate"),
        "observer": ("ahead compensation", "measurement disturbance commands"),
    },
    "controller": {
        "lqi": ("torque", "integral"),
        "pid": ("torque", "crank_integral"),
        "computed_torque": ("torque", "integral"),
    },
}
"""Section -> kind -> fields of its part's state that it says, and those on which its next tick depends."""

_Tick = Callable[[np.ndarray, Mapping[str, np.ndarray]], tuple[np.ndarray, np.ndarray]]


def _ticking(section: str, options: Any, setup: Setup, ports: Mapping[str, np.ndarray]) -> tuple[_Tick, np.ndarray]:
    """A section's part near a standstill: kept, ports -> says, keeps; and what it keeps first."""
    table = _LINEAR[section]
    if options.kind not in table:
        *most, last = table
        allowed = f"{', '.join(most)} or {last}, for a linear loop"
        raise ConfigurationError(f"{section}.kind", options.kind, allowed)
    parts = options.parts(setup)
    if not parts:
        # An estimator whose reading is the measurement.
        return lambda kept, ports: (ports["reading"], kept), np.zeros(0)
    part: Part = parts[0]
    initial, layout = part.initial.copy(), part.initial.dtype.fields
    says, keeps = (
        np.concatenate([np.arange(0), *(layout[name][1] // 8 + np.arange(part.size(name)) for name in names.split())])  # type: ignore[index]
        for names in table[options.kind]
    )
    if options.kind == "observer":
        # Of the commands it has place for more than are under way.
        keeps = keeps[: 18 + 6 * (1 + options.ahead(setup.delay))]
    if section == "estimator":
        # Its first tick is another than those that follow.
        part.tick(*(ports[name] for name in part.inputs), initial)

    def tick(kept: np.ndarray, ports: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        state = initial.copy()
        flat = state.view(float)
        flat[keeps] = kept
        part.tick(*(ports[name] for name in part.inputs), state)
        return flat[says], flat[keeps]

    return tick, initial.view(float)[keeps]


def _controllers_side(
    scenario: Scenario, setup: Setup, reading: np.ndarray
) -> tuple[Callable[[np.ndarray], np.ndarray], np.ndarray]:
    """Estimator and controller as one function of reading and memory, which ends with the command; memory at first."""
    expected = scenario.estimator.expected * scenario.tuner.levels[0]
    ports = {
        # Without friction the reference says nothing to an observer.
        "reference": np.concatenate([setup.pose, np.zeros(12)]),
        "disturbance": np.array([expected]),
        "weights": np.array(setup.tuner.weights),
        "reading": reading,
        "sent": setup.still,
    }
    estimate, estimated = _ticking("estimator", scenario.estimator, setup, ports)
    control, integral = _ticking("controller", scenario.controller, setup, ports)
    ends = np.cumsum([len(reading), len(estimated), len(integral)])

    def side(inputs: np.ndarray) -> np.ndarray:
        said, kept, integral, sent = np.split(inputs, ends)
        said, kept = estimate(kept, ports | {"reading": said, "sent": sent})
        command, integral = control(integral, ports | {"measurement": said[:12]})
        # Behind what it says of the platform an observer has a compensation for the command.
        return np.concatenate([kept, integral, command + said[12:] if len(said) > 12 else command])

    return side, np.concatenate([estimated, integral])


def _loop(
    robot: PlantAt,
    reading: np.ndarray,
    by_state: np.ndarray,
    side: Any,
    memory: np.ndarray,
    delay: int,
    pose: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C where the loop stands still, by Newton's method; a RunFailure where it does not.

    The state: the plant's, the controller's side's with the last command at its end, older commands.
    """
    x = np.concatenate([np.zeros(12), memory, np.tile(robot.torque, max(1, delay))])
    n, end = len(x), 18 + len(memory)
    command, older = slice(end - 6, end), np.arange(end, n)
    a, b, c = np.zeros((n, n)), np.zeros((n, 6)), np.zeros((6, n))
    a[:12, :12], b[:12] = robot.a, robot.b
    a[older, older - 6] = 1.0
    for _ in range(_NEWTON_STEPS):
        value, by = _derivatives(side, np.concatenate([reading + by_state @ x[:12], x[12:end]]))
        a[12:end, :12], a[12:end, 12:end] = by[:, : len(reading)] @ by_state, by[:, len(reading) :]
        after = np.concatenate([robot.a @ x[:12], value, x[end - 6 : n - 6]])
        if delay:
            c[:, n - 6 :], acts = np.eye(6), x[n - 6 :]
        else:
            c, acts = a[command].copy(), value[-6:]
        after[:12] += robot.b @ (acts - robot.torque)
        change = after - x
        # An integral whose gain is zero need not stand still.
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


def _derivatives(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value (m,) and derivative (m, n), by central differences."""
    columns = []
    for k, way in enumerate(_STEP * np.eye(len(at))):
        ahead, behind = at + way, at - way
        columns.append((function(ahead) - function(behind)) / (ahead[k] - behind[k]))
    return function(at), np.stack(columns, axis=-1)


def _observable(a: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Which states (n,) have a way to the output at some pose: an integral with a gain of zero has none."""
    observable, leads = (c != 0.0).any(axis=(0, 1)), (a != 0.0).any(axis=0)
    while True:
        more = observable | leads[observable].any(axis=0)
        if (more == observable).all():
            return np.asarray(observable)
        observable = more


# --- one pose, for others ---


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
