"""One tick of the LQI as a pure function, (19)-(34), by the paper's model or by the exact one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple, get_args

import numpy as np

from stewart_drake.compiled.constants import LQI_CHOICES, LQI_MEMORY, LQI_NUMBERS, filled
from stewart_drake.control.inputs import Measurement, Setpoint, checked_legs, out_of_reach
from stewart_drake.control.lqi_options import Feedforward, LqiOptions, Saturation
from stewart_drake.control.parts import ControllerSite
from stewart_drake.control.riccati import riccati_gain, solve_drake, split_gain
from stewart_drake.control.state_space import (
    AXES,
    INTEGRAL,
    POSITION,
    RATE,
    STATES,
    discretize,
    input_matrix,
    mass_diagonal,
    state_matrix,
)
from stewart_drake.errors import (
    NotFiniteError,
    RiccatiError,
    RunFailure,
    SingularPoseError,
    UnreachablePoseError,
)
from stewart_drake.mechanics.dynamics import inverse_dynamics, pose_acceleration_map, static_torque_of_legs
from stewart_drake.mechanics.force_map import force_map_of_legs
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import Sampled


class LqiMemory(NamedTuple):
    """What a tick says, and what the next one needs of it.

    Attributes:
        torque: (6,) [N m].
        error: (6,) [rad, m] measured pose minus setpoint.
        integral: (6,) [rad s, m s] z for the next tick.
        gain: (6, 18) K.
        feedforward: (6,) [N m] part of the torque.
        weights: (4,) q_e, q_v, q_z, r of this tick; zeros before the first.
        held: Ticks in a row that were bridged.
    """

    torque: np.ndarray
    error: np.ndarray
    integral: np.ndarray
    gain: np.ndarray
    feedforward: np.ndarray
    weights: np.ndarray
    held: float

    def flat(self) -> np.ndarray:
        """All in one vector (137,), in the order of the attributes."""
        return np.concatenate([*self[:3], self.gain.ravel(), *self[4:6], [self.held]])

    @classmethod
    def from_flat(cls, values: np.ndarray) -> LqiMemory:
        """Inverse of `flat`."""
        at = LQI_MEMORY
        return cls(
            values[: at.error],
            values[at.error : at.integral],
            values[at.integral : at.gain],
            values[at.gain : at.feedforward].reshape(6, 18),
            values[at.feedforward : at.weights],
            values[at.weights : at.held],
            values[at.held],
        )


MEMORY_SIZE: int = LQI_MEMORY.size
FlatTick = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def initial_memory() -> LqiMemory:
    """Memory before the first tick."""
    return LqiMemory.from_flat(np.zeros(MEMORY_SIZE))


def block_weights(weights: np.ndarray) -> np.ndarray:
    """q_e, q_v, q_z, r from either the paper's pair omega_Q, omega_R, (27), or all four.

    Raises:
        RiccatiError: Neither two nor four numbers, or one that is not positive and finite.
    """
    weights = np.asarray(weights, dtype=float)
    if weights.shape == (2,):
        weights = weights[[0, 0, 0, 1]]
    if weights.shape != (4,) or not (np.isfinite(weights) & (weights > 0.0)).all():
        raise RiccatiError(f"no gain for weights {weights.tolist()}: two or four are needed, positive and finite")
    return weights


def lqi_gain(acceleration_map: np.ndarray, options: LqiOptions, weights: np.ndarray) -> np.ndarray:
    """K of (31) for M^-1 tau at the present pose, u = -K [e; z] in the paper's state order.

    Args:
        acceleration_map: (6, 6) M^-1 tau.
        options: Period, discretisation, solver and `weight_length`.
        weights: (2,) omega_Q, omega_R of (27), or (4,) q_e, q_v, q_z, r; all > 0.

    Returns:
        (6, 18).

    Raises:
        RiccatiError: No stabilising solution.
    """
    q_e, q_v, q_z, r = (float(w) for w in block_weights(weights))
    if options.solver == "split":
        blocks = (q_e, q_v, q_z, r)
        return split_gain(acceleration_map, options.period, blocks, options.discretization, options.length)
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), options.period, options.discretization)
    scale = np.array([options.length**2] * 3 + [1.0] * 3)
    q = np.zeros(STATES)
    q[POSITION], q[RATE], q[INTEGRAL] = q_e * scale, q_v * scale, q_z * scale
    big_r = r * np.eye(AXES)
    return riccati_gain(a, b, big_r, solve_drake(a, b, np.diag(q), big_r))


def lqi_tick(
    robot: RobotParameters,
    options: LqiOptions,
    gravity: float,
    measurement: Measurement,
    setpoint: Setpoint,
    weights: np.ndarray,
    memory: LqiMemory,
    compiled: bool = False,
) -> LqiMemory:
    """The LQI of one tick: B(t) from the present pose, discretisation, Riccati, (34), feedforward, limits, (23).

    Deviation: u = -K e as in (34), not (30). The integral grows by period * e after it has been used.

    Args:
        robot: Geometry and masses as the controller believes them.
        options: See `LqiOptions`.
        gravity: [m/s^2] for the feedforward; 0 switches the gravity torque off.
        measurement: Pose and rate now.
        setpoint: Reference now.
        weights: (2,) omega_Q, omega_R, or (4,) q_e, q_v, q_z, r; all > 0.
        memory: Of the tick before, see `initial_memory`.
        compiled: By numba where it can be, with `solver: split`.

    Raises:
        NotFiniteError: Measurement, setpoint or the torque that comes of them.
        UnreachablePoseError, SingularPoseError: See `checked_legs`; also where `feedforward_at` is the reference and
            that is out of reach or exactly singular.
        RiccatiError: See `lqi_gain`.
    """
    if compiled and options.compiles:
        tick = _compiled_tick(robot, options, gravity)
        weights = np.asarray(weights, dtype=float)
        return LqiMemory.from_flat(tick(np.concatenate(measurement), np.concatenate(setpoint), weights, memory.flat()))
    if not np.isfinite(measurement.pose_rate).all():
        raise NotFiniteError("measured pose rate", measurement.pose_rate)
    if not all(np.isfinite(part).all() for part in setpoint):
        raise NotFiniteError("reference", np.concatenate(setpoint))
    legs = checked_legs(robot, options, measurement.pose)
    weights = block_weights(weights)
    force_map = force_map_of_legs(robot, legs, options.force_map)
    mass = mass_diagonal(robot)
    if options.model == "exact":
        acceleration_map = pose_acceleration_map(robot, measurement.pose)
    else:
        acceleration_map = force_map / mass[:, None]
    gain = lqi_gain(acceleration_map, options, weights)
    integral = memory.integral
    if options.bumpless and memory.weights[0] > 0.0 and np.any(memory.weights != weights):
        before = lqi_gain(acceleration_map, options, memory.weights)
        integral = _integral_for(gain, before[:, INTEGRAL] @ integral)

    feedforward = np.zeros(AXES)
    if options.feedforward == "full":
        at = setpoint if options.feedforward_at == "reference" else measurement
        try:
            feedforward = inverse_dynamics(robot, at.pose, at.pose_rate, setpoint.pose_acceleration, gravity)
        except np.linalg.LinAlgError:
            raise SingularPoseError("parallel", at.pose, 0.0, options.min_conditioning) from None
    elif options.feedforward != "none" and gravity != 0.0:
        feedforward = static_torque_of_legs(robot, legs, gravity)
    if options.feedforward == "platform":
        feedforward = feedforward + np.linalg.solve(force_map, mass * setpoint.pose_acceleration)

    error = measurement.pose - setpoint.pose
    wanted = feedforward - gain @ _state(error, measurement.pose_rate - setpoint.pose_rate, integral)
    if not np.isfinite(wanted).all():
        raise NotFiniteError("torque", wanted)
    torque, grown = wanted, integral + options.period * error
    if options.saturation != "none":
        torque = np.clip(wanted, -robot.effort_limits, robot.effort_limits)
        cut = wanted - torque
        if options.saturation == "back_calculation" and cut.any():
            grown = grown + min(1.0, options.period / options.reset_time) * _integral_for(gain, cut)
        elif cut.any():
            grown = integral
    integral = grown
    if options.integral_limit is not None:
        bound = np.repeat(options.integral_limit, 3)
        integral = np.clip(integral, -bound, bound)
    return LqiMemory(torque, error, integral, gain, feedforward, weights, 0.0)


def held_tick(
    robot: RobotParameters,
    options: LqiOptions,
    gravity: float,
    measurement: Measurement,
    setpoint: Setpoint,
    weights: np.ndarray,
    memory: LqiMemory,
    compiled: bool = False,
) -> LqiMemory:
    """`lqi_tick`, where up to `hold_ticks` failures in a row are bridged by the last good gain and feedforward.

    A measurement or setpoint that is not finite is bridged by the last torque. z stands still meanwhile.

    Raises:
        RunFailure: As `lqi_tick`, where no good tick came before or they failed too often in a row.
    """
    try:
        return lqi_tick(robot, options, gravity, measurement, setpoint, weights, memory, compiled)
    except RunFailure:
        if memory.weights[0] == 0.0 or memory.held >= options.hold_ticks:
            raise
    held = memory._replace(held=memory.held + 1.0)
    if not (np.isfinite(measurement.pose).all() and np.isfinite(measurement.pose_rate).all()):
        return held
    error = measurement.pose - setpoint.pose
    state = _state(error, measurement.pose_rate - setpoint.pose_rate, memory.integral)
    torque = memory.feedforward - memory.gain @ state
    if not np.isfinite(torque).all():
        return held
    if options.saturation != "none":
        torque = np.clip(torque, -robot.effort_limits, robot.effort_limits)
    return held._replace(torque=torque, error=error)


def flat_tick(robot: RobotParameters, options: LqiOptions, gravity: float, compiled: bool = False) -> FlatTick:
    """`held_tick` on flat vectors: (measurement (12,), setpoint (18,), weights, memory (137,)) -> memory (137,)."""
    fast = _compiled_tick(robot, options, gravity) if compiled and options.compiles else None

    def tick(measured: np.ndarray, wanted: np.ndarray, weights: np.ndarray, memory: np.ndarray) -> np.ndarray:
        if fast is not None:
            try:
                return fast(measured, wanted, weights, memory)
            except RunFailure:
                if options.hold_ticks == 0:
                    raise
        measurement, setpoint = Measurement(measured[:6], measured[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:])
        before = LqiMemory.from_flat(memory)
        return held_tick(robot, options, gravity, measurement, setpoint, weights, before, compiled).flat()

    return tick


def lqi_part(options: LqiOptions, site: ControllerSite) -> Sampled:
    """`flat_tick` as a part of a loop."""
    return Sampled(np.zeros(MEMORY_SIZE), flat_tick(site.robot, options, site.gravity, site.compiled))


def _state(error: np.ndarray, rate_error: np.ndarray, integral: np.ndarray) -> np.ndarray:
    state = np.empty(STATES)
    state[POSITION], state[RATE], state[INTEGRAL] = error, rate_error, integral
    return state


def _integral_for(gain: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """The z (6,) for which K_z z is `torque` (6,)."""
    try:
        return np.linalg.solve(gain[:, INTEGRAL], torque)
    except np.linalg.LinAlgError:
        raise RiccatiError("the gain of the integral is singular") from None


@lru_cache(maxsize=16)
def _compiled_tick(robot: RobotParameters, options: LqiOptions, gravity: float) -> FlatTick:
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled import control, mechanism

    packed = mechanism.pack(robot)
    limits: Sequence[float] = (np.inf, np.inf) if options.integral_limit is None else options.integral_limit
    numbers = filled(
        LQI_NUMBERS,
        period=options.period,
        gravity=gravity,
        length=options.length,
        min_transmission=options.min_transmission,
        min_conditioning=options.min_conditioning,
        integral_angle=limits[0],
        integral_position=limits[1],
        reset_time=options.reset_time,
    )
    choices = filled(
        LQI_CHOICES,
        exact_model=options.model == "exact",
        printed_map=options.force_map == "printed",
        feedforward=get_args(Feedforward).index(options.feedforward),
        at_reference=options.feedforward_at == "reference",
        exact_hold=options.discretization == "exact",
        saturation=get_args(Saturation).index(options.saturation),
        bumpless=options.bumpless,
    ).astype(np.int64)

    def tick(measured: np.ndarray, wanted: np.ndarray, weights: np.ndarray, memory: np.ndarray) -> np.ndarray:
        result = np.empty(MEMORY_SIZE)
        status, leg, value = control.lqi_tick(packed, numbers, choices, measured, wanted, weights, memory, result)
        if status != mechanism.OK:
            raise _failure(options, status, leg, value, measured, wanted, weights)
        return result

    return tick


def _failure(
    options: LqiOptions,
    status: int,
    leg: int,
    value: float,
    measured: np.ndarray,
    wanted: np.ndarray,
    weights: np.ndarray,
) -> RunFailure:
    """What the reference would have raised."""
    from stewart_drake.compiled import mechanism

    at_reference = status >= mechanism.AT_REFERENCE
    status -= mechanism.AT_REFERENCE * at_reference
    pose = np.array(wanted[:6] if at_reference else measured[:6])
    if status == mechanism.NOT_FINITE:
        names = ("measured pose", "measured pose rate", "reference", "torque")
        return NotFiniteError(names[leg], (pose, measured[6:], wanted, value)[leg])
    if status == mechanism.UNREACHABLE:
        error = UnreachablePoseError(pose, leg, value)
        return error if at_reference else out_of_reach(error, options)
    if status == mechanism.SERIAL:
        return SingularPoseError("serial", pose, value, options.min_transmission, leg)
    if status == mechanism.PARALLEL:
        return SingularPoseError("parallel", pose, value, options.min_conditioning)
    try:
        block_weights(weights)
    except RiccatiError as error:
        return error
    return RiccatiError(f"no gain at pose {pose.tolist()}: M^-1 tau is singular or its gain leaves floating point")
