"""The monitors of the safety layer: what each sees in a measurement or in a message; pure.

A monitor is an object here and a line in the registry. One of what is measured says by which margin its limit is kept,
of one pose or of a whole motion: a tick and what is refused before a run ask the same function.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.errors import failure_code
from stewart_drake.mechanics import kinematics_core as core
from stewart_drake.mechanics.arrays import arrays_of, last
from stewart_drake.mechanics.kinematics import pose_rate_to_twist, rotation_angle, rotation_matrix
from stewart_drake.registry import BUILT_IN_MONITORS
from stewart_drake.robot import RobotParameters
from stewart_drake.safety.memory import HOLD, MONITORS, RAMP, SafetyInputs, Trip
from stewart_drake.safety.safety_options import SafetyOptions

_ABSURD = 10.0
"""A command of so many times the limit is an error of the controller and no wish for torque."""
_SMALLEST = 1e-9
"""Transmission at a dead centre, for the speed of that crank."""


class Seen(NamedTuple):
    """What measurements mean, led ahead; where that is out of reach, speeds are those of the pose itself.

    Attributes:
        legs: Leg vectors, see `kinematics_core.Legs`.
        reached: (...) whether the pose led ahead is within reach.
        from_home: (2, ...) [rad, m] angle of the rotation and distance from the home pose.
        transmission: (..., 6) [-] sizes; 0 where a rod does not span.
        conditioning: (...) [-]; negative where the rods' determinant has changed its sign, infinite out of reach.
        side: (...) sign of the rods' determinant.
        speed: (..., 6) [rad/s] of the cranks; 0 where the pose itself is out of reach.
        from_reference: (2, ...) [rad, m] likewise, of the pose itself.
    """

    legs: core.Legs
    reached: np.ndarray
    from_home: np.ndarray
    transmission: np.ndarray
    conditioning: np.ndarray
    side: np.ndarray
    speed: np.ndarray
    from_reference: np.ndarray


def see(
    robot: RobotParameters, horizon: float, pose: np.ndarray, rate: np.ndarray, reference: np.ndarray, side: float = 0.0
) -> Seen:
    """What finite measurements mean.

    Args:
        robot: As believed.
        horizon: [s] by which poses are led ahead.
        pose: (..., 6) [rad, m].
        rate: (..., 6) [rad/s, m/s].
        reference: (..., 6) [rad, m].
        side: Sign of the rods' determinant at the start; 0 if that is now.
    """
    ahead, own = pose + horizon * rate, arrays_of(robot, pose)
    reach = last(np, core.reach_margin(own, ahead), 1)
    reached = (reach >= 0.0).all(axis=-1)
    here = (core.reach_margin(own, pose) >= 0.0).all(axis=0)
    # Of a pose that is itself out of reach there is nothing to say; any that is within will do.
    legs = core.legs_at(own, np.where(reached[..., None], ahead, np.where(here[..., None], pose, robot.home_pose)))
    lines, signed = last(np, core.rod_lines(legs), 2), last(np, legs.transmission, 1)
    sigma = np.linalg.svd(lines / np.repeat([robot.characteristic_length, 1.0], 3), compute_uv=False)
    now = np.sign(np.linalg.det(lines))
    crossed = np.where((side != 0.0) & (now != side), -1.0, 1.0)
    along = (lines @ pose_rate_to_twist(pose, rate)[..., None])[..., 0]
    speed = along / (robot.crank_lengths * np.maximum(np.abs(signed), _SMALLEST))
    return Seen(
        legs,
        reached,
        _apart(rotation_matrix(ahead[..., :3]), ahead[..., 3:] - robot.home_pose[3:]),
        np.where(reach >= 0.0, np.abs(signed), 0.0),
        np.where(reached, crossed * sigma[..., -1] / sigma[..., 0], np.inf),
        np.where(reached, now, side),
        np.where((reached | here)[..., None], speed * np.where(signed < 0.0, -1.0, 1.0), 0.0),
        _apart(
            rotation_matrix(pose[..., :3]) @ np.swapaxes(rotation_matrix(reference[..., :3]), -1, -2),
            pose[..., 3:] - reference[..., 3:],
        ),
    )


def _apart(rotation: np.ndarray, way: np.ndarray) -> np.ndarray:
    return np.stack([rotation_angle(rotation), np.linalg.norm(way, axis=-1)])


class Monitor(NamedTuple):
    """A monitor, of what is measured or of messages; neither for what `tick` sees as it cuts commands.

    Where what is measured breaks a limit the robot is taken from its controller; where a message is wrong the last good
    command is held.

    Attributes:
        key: Of `safety`, the value of the limit; null there switches it off.
        margin: (...) or (..., 6) for each leg, of the value of `key` and of `Seen`; negative where the limit is broken.
        rank: Lower ones are asked first: what they see explains the others.
        trips: Leg or -1, and cause, see `Trip`, of the options, `SafetyInputs` and the torque limit [N m]; None where
            nothing is wrong.
        meaning: What the name leaves open, for the message of a run that it ends.
    """

    key: str = ""
    margin: Callable[[Any, Seen], np.ndarray] | None = None
    rank: int = 1
    trips: Callable[[SafetyOptions, SafetyInputs, np.ndarray], tuple[int, int] | None] | None = None
    meaning: str = ""


def _nearer(limit: tuple[float, float], apart: np.ndarray) -> np.ndarray:
    return np.minimum(limit[0] - apart[0], limit[1] - apart[1])


WORKSPACE = Monitor("workspace", lambda limit, seen: _nearer(limit, seen.from_home), rank=0)
CRANK_SPEED = Monitor("crank_speed", lambda limit, seen: limit - np.abs(seen.speed), rank=0)
SERIAL = Monitor("transmission", lambda limit, seen: seen.transmission - limit)
PARALLEL = Monitor("conditioning", lambda limit, seen: seen.conditioning - limit)
FOLLOWING = Monitor("following_error", lambda limit, seen: _nearer(limit, seen.from_reference))


def limits(options: SafetyOptions, seen: Seen) -> Iterator[tuple[str, str, np.ndarray]]:
    """Name, key and margin of each limit that is on, in the order in which they are asked."""
    named = sorted(((name, BUILT_IN_MONITORS[name]) for name in BUILT_IN_MONITORS.names), key=lambda each: each[1].rank)
    for name, monitor in named:
        value = getattr(options, monitor.key) if monitor.margin is not None else None
        if value is not None:
            yield name, monitor.key, monitor.margin(value, seen)


def broken(options: SafetyOptions, seen: Seen) -> Trip | None:
    """The first limit that one measurement breaks."""
    for name, _, margin in limits(options, seen):
        if not margin.min() >= 0.0:
            return Trip(MONITORS.index(name), RAMP, int(margin.argmin()) if margin.ndim else -1)
    return None


def measured(options: SafetyOptions, inputs: SafetyInputs) -> bool:
    """Whether the measurement is one, and can be led ahead."""
    with np.errstate(all="ignore"):
        ahead = inputs.pose + options.horizon * inputs.pose_rate
    return bool(np.isfinite(ahead).all() and np.isfinite(inputs.pose_rate).all())


def failed(options: SafetyOptions, health: tuple[float, float]) -> bool:
    """Whether a sensor or controller has failed; a reading that is stuck has switches of its own."""
    return _stuck(health) or (options.failures and health[0] != 0.0)


def _stuck(health: tuple[float, float]) -> bool:
    return health[0] == failure_code("frozen")


def _failure(options: SafetyOptions, health: tuple[float, float]) -> tuple[int, int] | None:
    cause, leg = (int(x) if np.isfinite(x) else -1 for x in health)
    return (leg, cause) if failed(options, health) and not _stuck(health) else None


def _unmeasured(options: SafetyOptions, inputs: SafetyInputs, limit: np.ndarray) -> tuple[int, int] | None:  # noqa: ARG001
    return (-1, 0) if options.finite and not measured(options, inputs) else None


def _no_number(options: SafetyOptions, inputs: SafetyInputs, limit: np.ndarray) -> tuple[int, int] | None:  # noqa: ARG001
    finite = np.isfinite(inputs.command)
    return (int(finite.argmin()), 0) if options.finite and not finite.all() else None


def _absurd(options: SafetyOptions, inputs: SafetyInputs, limit: np.ndarray) -> tuple[int, int] | None:  # noqa: ARG001
    share = np.abs(inputs.command) / limit
    return (int(share.argmax()), 0) if share.max() > _ABSURD else None


def _late(options: SafetyOptions, inputs: SafetyInputs, limit: np.ndarray) -> tuple[int, int] | None:  # noqa: ARG001
    return (-1, 0) if options.deadline is not None and not inputs.age <= options.deadline else None


def _still(options: SafetyOptions, inputs: SafetyInputs, limit: np.ndarray) -> tuple[int, int] | None:  # noqa: ARG001
    return (int(inputs.sensor[1]), 0) if _stuck(inputs.sensor) else None


def surprising(options: SafetyOptions, inputs: SafetyInputs) -> bool:
    """Whether the robot does what the model of its observer does not explain."""
    return options.innovation is not None and inputs.surprise > options.innovation


def surprise(innovation: np.ndarray, scale: tuple[float, float]) -> float:
    """See `SafetyInputs.surprise`, for innovations (6,) [rad] and `Observer.surprise_scale`."""
    return (float(np.abs(innovation).max()) - scale[0]) / scale[1]


MEASUREMENT = Monitor(trips=_unmeasured)
SENSOR = Monitor(trips=lambda options, inputs, _: _failure(options, inputs.sensor))
CONTROLLER = Monitor(trips=lambda options, inputs, _: _failure(options, inputs.controller))
COMMAND = Monitor(trips=_no_number)
DEADLINE = Monitor(trips=_late)
TORQUE_LIMIT = Monitor(trips=_absurd)
"""What is at the limit for too long `tick` sees, which cuts it; likewise what comes after this."""
TORQUE_RATE = Monitor()
INNOVATION = Monitor()
READING = Monitor(trips=_still, meaning="a sensor repeats itself, or friction holds what it reads")


def unusable(options: SafetyOptions, inputs: SafetyInputs, limit: np.ndarray) -> Trip | None:
    """What is wrong with this tick's messages, apart from what they say."""
    for name in BUILT_IN_MONITORS.names:
        monitor = BUILT_IN_MONITORS[name]
        found = None if monitor.trips is None else monitor.trips(options, inputs, limit)
        if found is not None:
            return Trip(MONITORS.index(name), HOLD, *found)
    return None


def further(options: SafetyOptions, inputs: SafetyInputs) -> Trip | None:
    """What the user's own monitors say of a finite measurement."""
    for index, monitor in enumerate(options.monitors):
        leg = monitor.look(inputs)
        if leg is not None:
            return Trip(len(MONITORS) + index, RAMP, leg)
    return None
