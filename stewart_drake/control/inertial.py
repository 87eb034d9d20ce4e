"""The observer with an inertial sensor (IMU): one filter for the angles of the cranks and six inertial readings.

Prediction, commands and delays are those of `observer`. The errors are those of the sensor's place and axes: along each
of its three axes a rotation and a displacement. They are six chains

    distance' = speed,  speed' = model + push + white noise,  push' = white noise,  bias' = white noise,

with the covariance of each in the state. The noise of the angles and the unknown accelerations of the cranks reach a
chain through the inverse Jacobian. A gyroscope measures speed + bias, an accelerometer the mean acceleration of its
period + bias. Without inertial readings all chains have the same gains, and these are the observer's.

The torque against a disturbance stays that of the observer without inertial readings, so that the loop keeps its
margins: an acceleration that is fed back at once would depend on the model's inertia up to the highest frequency. The
difference of the two observers is linear and small, so it is carried along instead of a second observer.

A mean over the last period belongs to that time, so the acceleration since the last tick is the fifth element of a
chain while a tick is computed. A reading that is older than that of the angles is compared with what was expected then,
plus all corrections since.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import (
    Mat3,
    Mat4,
    Mat5,
    Mat6x7,
    Mat7x5,
    Matrix,
    Record,
    TickResult,
    Vec1,
    Vec3,
    Vec5,
    Vec6,
    Vec18,
    Vector,
    record,
)
from stewart_drake.control.estimator import DifferenceParams, DifferenceState
from stewart_drake.control.imu_model import MOST_TICKS, ImuModel, imu_model
from stewart_drake.control.observer import (
    WHITE_SHARE,
    ObserverParams,
    ObserverState,
    bandwidth,
    begin,
    innovate,
    kalman_gains,
    look_ahead,
    rests_at_target,
)
from stewart_drake.loop.part import Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics_laws import add_base_acceleration
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics_laws import OK, PARALLEL, Legs, Robot, dot
from stewart_drake.mechanics.linear_algebra import copy_to, largest_size, set_to, solve

if TYPE_CHECKING:
    from stewart_drake.hardware.imu import ImuOptions

DISTANCE, SPEED, PUSH, BIAS, ACCELERATION = range(5)
"""Elements of a chain; the last one only within a tick."""


class InertialMemory(Record):
    """What the filter remembers; rates are those of the sensor's place."""

    bias: Vec6  # [rad/s, m/s^2] of the readings.
    before: Vec6  # [rad/s, m/s] angular velocity and velocity in B after the last correction.
    covariance: Annotated[np.ndarray, (6, 4, 4)]  # Of the chains: distance, speed, push, bias; zero at first.
    expected: Annotated[np.ndarray, (MOST_TICKS + 1, 6)]  # By tick less `corrected`, oldest first.
    corrected: Vec6  # [rad/s, m/s^2] sum of all corrections: of rates, also by way of `pushed`; of the push.
    # Distance, speed and push of the chains of the observer without inertial readings, less those here.
    plain: Annotated[np.ndarray, (6, 3)]
    plain_push: Vec6  # [rad/s^2] of the cranks, the same difference.
    pushed: Vec3  # [rad/s^2] sum of all corrections of the angular push.
    waiting: Annotated[np.ndarray, (MOST_TICKS + 1, 6)]  # The last `early` + 1 readings, oldest first.


class InertialState(InertialMemory, ObserverState):
    """State of the observer with an inertial sensor."""


@njit
def inertial_tick(
    robot: Robot,
    params: ObserverParams,
    model: ImuModel,
    first_params: DifferenceParams,
    friction: Friction,
    reading: Vector,
    imu: Vec6,
    net_torque: Vec6,
    reference: Vec18,
    disturbance: Vec1,
    legs: Legs,
    estimate: DifferenceState,
    state: InertialState,
) -> TickResult:
    """One tick, as `observer_tick`; `imu` (6,) [rad/s, m/s^2] is NaN where there is no new reading."""
    robot, params, model, legs, state = record(robot), record(params), record(model), record(legs), record(state)
    pose, rate, early = np.empty(6), np.empty(6), int(model.early)
    for row in range(early):
        copy_to(state.waiting[row], state.waiting[row + 1])
    copy_to(state.waiting[early], imu)
    if state.assembly_sign == 0.0:
        status, leg, margin = begin(robot, params, record(first_params), reading, legs, record(estimate), state)
        _start(params, model, state)
        return status, leg, margin
    status, leg, margin = innovate(robot, params, reading, net_torque, legs, pose, rate, state)
    if status != OK:
        return status, leg, margin
    break_away = largest_size(record(friction).break_away[:])
    held = rests_at_target(params, break_away, legs, disturbance[0], pose, reference)
    if not _correct(params, model, disturbance[0], held, pose, rate, legs, state):
        copy_to(state.measurement[:6], pose)
        return PARALLEL, -1, 0.0
    return look_ahead(robot, params, legs, state.plain_push[:], state)


@njit
def _start(params: ObserverParams, model: ImuModel, state: InertialState) -> None:
    """Sets what is expected of the first readings: those of a steady motion."""
    turn, axes, arm, twist, carried = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(6), np.empty(6)
    laws.rotation(state.read[:3], turn)
    laws.twist_of(state.read[:6], state.read[6:], twist)
    _sensor_frame(model, turn, axes, arm)
    _move(twist, arm, 1.0, state.before[:])
    _carry(params, model, state.read[3:6], arm, state.before[:], carried)
    for row in range(int(model.lag + model.ticks)):
        for k in range(3):
            state.expected[row, k] = dot(axes[k], twist[:3]) + dot(axes[k], carried[:3])
            state.expected[row, 3 + k] = dot(axes[k], carried[3:])
    if model.early > 0.0:
        # The first readings are too old to be of use.
        for row in range(int(model.early)):
            set_to(state.waiting[row], np.nan)


@njit
def _sensor_frame(model: ImuModel, turn: Mat3, axes: Mat3, arm: Vec3) -> None:
    """Axes of the sensor in B, as rows, and its place from P [m] in B, at a rotation R_BP."""
    laws.turned(turn, model.position[:], arm)
    for k in range(3):
        for i in range(3):
            axes[k, i] = 0.0
            for m in range(3):
                axes[k, i] += turn[i, m] * model.mounting[m, k]


@njit
def _carry(params: ObserverParams, model: ImuModel, origin: Vec3, arm: Vec3, twist: Vec6, out: Vec6) -> None:
    """Rate and specific force (6,) in B that the base gives a sensor, `arm` [m] from P [m], with a twist in B."""
    place = np.empty(3)
    for k in range(3):
        place[k] = origin[k] + arm[k]
        out[k] = params.base[3 + k] - model.rest * params.base[6 + k]
        out[3 + k] = params.base[k]
    add_base_acceleration(params.base, place, twist[3:], out[3:])


@njit
def _move(twist: Vec6, arm: Vec3, sign: float, out: Vec6) -> None:
    """Twist at a place `arm` [m] from P where `sign` is 1; with -1 the twist of P from that at the place."""
    for k in range(3):
        out[k] = twist[k]
    out[3] = twist[3] + sign * (twist[1] * arm[2] - twist[2] * arm[1])
    out[4] = twist[4] + sign * (twist[2] * arm[0] - twist[0] * arm[2])
    out[5] = twist[5] + sign * (twist[0] * arm[1] - twist[1] * arm[0])


@njit
def predict_chain(covariance: Mat4, h: float, white: float, wander: float, drift: float, out: Mat5) -> None:
    """Covariance (5, 5) of a chain after a period h [s], with variances of the three noises in it."""
    half = 0.5 * h * h
    for i in range(4):
        for k in range(4):
            out[i, k] = covariance[i, k]
    for k in range(4):
        out[DISTANCE, k] += h * out[SPEED, k] + half * out[PUSH, k]
        out[SPEED, k] += h * out[PUSH, k]
    for i in range(4):
        out[i, DISTANCE] += h * out[i, SPEED] + half * out[i, PUSH]
        out[i, SPEED] += h * out[i, PUSH]
    for k in range(4):
        out[ACCELERATION, k] = out[k, ACCELERATION] = out[PUSH, k]
    out[ACCELERATION, ACCELERATION] = out[PUSH, PUSH]
    for i in range(5):
        into = half if i == DISTANCE else h if i == SPEED else 1.0 if i == ACCELERATION else 0.0
        out[i, DISTANCE] += white * into * half
        out[i, SPEED] += white * into * h
        out[i, ACCELERATION] += white * into
    out[PUSH, PUSH] += wander
    out[BIAS, BIAS] += drift


@njit
def measure_chain(covariance: Mat5, by: Vec5, error: float, variance: float, gain: Vec5, correction: Vec5) -> None:
    """Takes a measurement of `by` times a chain: `error` is measured minus predicted, before all corrections.

    `gain` is work space.
    """
    total = variance
    for i in range(5):
        gain[i] = 0.0
        for k in range(5):
            gain[i] += covariance[i, k] * by[k]
        error -= by[i] * correction[i]
    for i in range(5):
        total += by[i] * gain[i]
    for i in range(5):
        share = gain[i] / total
        correction[i] += share * error
        for k in range(5):
            covariance[i, k] -= share * gain[k]


@njit
def _expect(
    params: ObserverParams, model: ImuModel, twist: Vec6, carried: Vec6, axes: Mat3, before: Vec6, out: Vec6, size: Vec6
) -> None:
    """Readings (6,) without bias at a sensor's twist, and sizes of rate and acceleration for the errors of scale.

    `carried` (6,) is of the base, `before` (6,) the twist a tick ago.
    """
    rest, turned, swing = model.rest, np.empty(3), np.empty(3)
    for k in range(3):
        rate, force, size[3 + k] = dot(carried[:3], axes[k]), dot(carried[3:], axes[k]), 0.0
        for i in range(3):
            rate += axes[k, i] * (twist[i] - rest / params.period * (twist[i] - before[i]))
            size[3 + k] += axes[k, i] * (twist[3 + i] - before[3 + i]) / params.period
        out[k], size[k], turned[k] = rate, rate, force + size[3 + k]
    # The axes are those of the reading's middle.
    laws.cross(out[:3], turned, swing)
    for k in range(3):
        out[3 + k] = turned[k] + rest * swing[k]


@njit
def _cranks_to_sensor(legs: Legs, innovation: Vec6, axes: Mat3, arm: Vec3, out: Mat6x7) -> float:
    """Rotations and displacements along the sensor's axes per crank, and in the last column those of the innovation.

    Returns the sign of the determinant of the rods' lines, 0 if singular.
    """
    lines, column, place = legs.line.copy(), np.empty(6), np.empty(6)
    for i in range(6):
        for k in range(6):
            out[i, k] = legs.lever[i] if i == k else 0.0
        out[i, 6] = legs.lever[i] * innovation[i]
    sign = solve(lines, out)
    for i in range(7):
        for k in range(6):
            column[k] = out[k, i]
        _move(column, arm, 1.0, place)
        for k in range(3):
            out[k, i], out[3 + k, i] = dot(axes[k], place[:3]), dot(axes[k], place[3:])
    return sign


@njit
def _correct(
    params: ObserverParams,
    model: ImuModel,
    density: float,
    held: bool,
    pose: Vec6,
    rate: Vec6,
    legs: Legs,
    state: InertialState,
) -> bool:
    """Corrects the predicted pose and rate by all readings; sets `state.read`. False at a singularity.

    The push stays where it is `held`.
    """
    axes, arm, twist, here = np.empty((3, 3)), np.empty(3), np.empty(6), np.empty(6)
    expected, size, by_crank, carried = np.empty(6), np.empty(6), np.empty((6, 7)), np.empty(6)
    _sensor_frame(model, legs.rotation[:], axes, arm)
    laws.twist_of(pose, rate, twist)
    _move(twist, arm, 1.0, here)
    if _cranks_to_sensor(legs, state.innovation[:], axes, arm, by_crank) != state.assembly_sign:
        return False
    _carry(params, model, pose[3:], arm, here, carried)
    _expect(params, model, here, carried, axes, state.before[:], expected, size)
    corrections, work, depth = np.empty((6, 5)), np.empty((7, 5)), int(model.lag + model.ticks) - 1
    for k in range(6):
        set_to(corrections[k], 0.0)
        if k < 3:
            # What the push of now would have done since then, instead of the pushes that were predicted with.
            state.corrected[k] += params.period * state.pushed[k]
        awaited = 0.0
        for n in range(int(model.lag), depth + 1):
            late = n * params.period * state.pushed[k] if k < 3 else 0.0
            at = expected[k] if n == 0 else state.expected[depth - n, k] + state.corrected[k] - late
            awaited += at / model.ticks
        read = state.waiting[0, k]
        error = read - state.bias[k] - awaited if abs(read) < model.range[k] else np.nan
        _correct_chain(params, model, density, k, by_crank, error, size[k], state.covariance[k], work, corrections[k])
    _correct_plain(params, density, held, by_crank, corrections, state)
    for row in range(depth - 1):
        copy_to(state.expected[row], state.expected[row + 1])
    for k in range(6):
        state.bias[k] += corrections[k, BIAS]
        if held:
            corrections[k, PUSH] = 0.0
        if k < 3:
            state.pushed[k] += corrections[k, PUSH]
        state.corrected[k] += corrections[k, SPEED if k < 3 else PUSH]
        expected[k] += corrections[k, SPEED if k < 3 else ACCELERATION] - state.corrected[k]
    copy_to(state.expected[max(depth - 1, 0)], expected)
    _apply(axes, arm, corrections, here, pose, rate, legs, state)
    return True


@njit
def _correct_chain(
    params: ObserverParams,
    model: ImuModel,
    density: float,
    k: int,
    by_crank: Mat6x7,
    error: float,
    size: float,
    covariance: Mat4,
    work: Mat7x5,
    correction: Vec5,
) -> None:
    """A tick of the k-th chain; `error` of the inertial reading is NaN where there is none. `work` is overwritten."""
    h, speed = params.period, bandwidth(params.noise, density, params.period)
    whole, by, gain = work[:5], work[5], work[6]
    set_to(by, 0.0)
    share = 0.0  # Variance of the chain per variance of a crank.
    for i in range(6):
        share += by_crank[k, i] * by_crank[k, i]
    noise = share * params.noise * params.noise
    # White noise as in `kalman_gains`.
    white = noise * (WHITE_SHARE * (speed * h) ** 2 / (h * h)) ** 2
    if covariance[0, 0] == 0.0:
        covariance[DISTANCE, DISTANCE], covariance[SPEED, SPEED] = noise, noise * speed**2
        covariance[PUSH, PUSH], covariance[BIAS, BIAS] = noise * speed**4, model.bias[k]
    predict_chain(covariance, h, white, share * density * density * h, model.drift[k], whole)
    by[DISTANCE] = 1.0
    measure_chain(whole, by, by_crank[k, 6], noise, gain, correction)
    if not np.isnan(error):
        by[DISTANCE], by[BIAS], by[SPEED] = 0.0, 1.0, 1.0 if k < 3 else 0.0
        variance = model.variance[k] + (model.scale_error * size) ** 2
        for n in range(int(model.lag), int(model.lag + model.ticks)):
            # The mean of a tick that is n ticks old.
            part = 1.0 / model.ticks
            if n == 0:
                by[ACCELERATION] = -model.rest * part if k < 3 else part
            elif k < 3:
                by[PUSH] -= (n * h + model.rest) * part
                variance += white * h * h * n * part
            else:
                by[PUSH] += part
                variance += white * part * part
        measure_chain(whole, by, error, variance, gain, correction)
    for i in range(4):
        for j in range(4):
            covariance[i, j] = whole[i, j]


@njit
def _correct_plain(
    params: ObserverParams, density: float, held: bool, by_crank: Mat6x7, corrections: Matrix, state: InertialState
) -> None:
    """A tick of the observer that has no inertial readings, as the difference of its chains from those with them."""
    h, gains = params.period, np.empty(3)
    gains[0], gains[1], gains[2] = kalman_gains(params.noise, density, h)
    for k in range(6):
        plain = state.plain[k]
        plain[DISTANCE] += h * (plain[SPEED] + 0.5 * h * plain[PUSH])
        plain[SPEED] += h * plain[PUSH]
        error = by_crank[k, 6] - plain[DISTANCE]
        for n in range(3):
            if n != PUSH or not held:
                plain[n] += gains[n] * error - corrections[k, n]


@njit
def _apply(
    axes: Mat3,
    arm: Vec3,
    corrections: Matrix,
    here: Vec6,
    pose: Vec6,
    rate: Vec6,
    legs: Legs,
    state: InertialState,
) -> None:
    """Adds the corrections of the chains to pose, rate and disturbance; sets `state.read`."""
    changes, along, change, predicted = np.empty((3, 6)), np.empty(6), np.empty(6), pose.copy()
    for n in range(3):
        for i in range(3):
            along[i], along[3 + i] = 0.0, 0.0
            for k in range(3):
                along[i] += axes[k, i] * corrections[k, n]
                along[3 + i] += axes[k, i] * corrections[3 + k, n]
        if n == SPEED:
            for k in range(6):
                state.before[k] = here[k] + along[k]
        _move(along, arm, -1.0, changes[n])
    laws.rate_of(predicted, changes[DISTANCE], change)
    for k in range(6):
        pose[k] += change[k]
    laws.rate_of(predicted, changes[SPEED], change)
    for k in range(6):
        rate[k] += change[k]
    copy_to(state.read[:6], pose)
    copy_to(state.read[6:], rate)
    laws.crank_rates(legs, changes[PUSH], change)
    for i in range(6):
        state.disturbance[i] += change[i]
        along[i] = 0.0
    for i in range(3):
        for k in range(3):
            along[i] += axes[k, i] * state.plain[k, PUSH]
            along[3 + i] += axes[k, i] * state.plain[3 + k, PUSH]
    _move(along, arm, -1.0, change)
    laws.crank_rates(legs, change, state.plain_push[:])


def with_imu(part: Part, options: ImuOptions, period: float, reading_age: float) -> Part:
    """The part of an observer, with an input `imu` (6,) [rad/s, m/s^2] after the reading; as `imu_model`."""
    inputs = {"reading": part.inputs["reading"], "imu": 6, **part.inputs}
    initial = InertialState.new(**{name: part.initial[name] for name in part.initial.dtype.names or ()})
    parameters = {"robot": part.parameters["robot"], "params": part.parameters["params"]}
    parameters |= {"model": imu_model(options, period, reading_age), **part.parameters}
    return part._replace(kernel=inertial_tick, inputs=inputs, initial=initial, parameters=parameters)
