"""An observer of the platform's motion: pose, rate and what no model explains, from readings of the cranks' angles.

Between ticks the exact model predicts; what no model explains is one acceleration of each crank that wanders. A reading
corrects all three by the steady Kalman filter of theta' = rate, rate' = model + disturbance + white noise,
disturbance' = white noise, reading = theta + white noise, the same for each crank: noise is alike in all directions
there. Of a disturbance as a state: C. Johnson, IEEE Trans. Autom. Control 16, 1971.

A motor that sticks makes such a state hunt: it grows until the crank breaks away and jumps too far. So for motors with
friction it stays as it is while the reference rests and all cranks stand where it wants them, as far as readings tell.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Natural, Positive
from stewart_drake.base.errors import ConfigurationError, Status
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.control import estimator
from stewart_drake.control.estimator import (
    STATE,
    DifferenceOptions,
    EstimatorOptions,
    difference_params,
    pose_of_angles,
)
from stewart_drake.loop.part import HEALTHY, LoopContext, Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.mechanics.dynamics_laws import forward_dynamics, task_inertia
from stewart_drake.mechanics.kinematics import pose_jacobian
from stewart_drake.mechanics.kinematics_laws import OK, PARALLEL, SERIAL, UNREACHABLE, dot, legs_at
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, solve, spectral_factor

SMALLEST_NOISE = 1e-5  # [rad] that readings have at least for the observer: finer than that no model is.
ARRIVED = 6.0  # Standard deviations of a reading within which a crank stands where it is wanted, whatever its friction.
SLIP = 4.0  # [-] the same in break_away / (inertia bandwidth^2): about half of what a crank that hunts jumps by.
# [-] white noise of an acceleration, in units of the disturbance over the bandwidth. It damps the filter's poles: the
# disk margin of the loop with it is 0.49, without some 0.37.
WHITE_SHARE = 1.5
RESTS = 1e-4  # [rad/s] a crank that is to turn more slowly is to rest.
LONGEST_DELAY = 100  # [ticks] from what is read to a command that acts; the state has place for so many.
FARTHEST = 0.3  # [s] beyond which a prediction says nothing any more; assumed.
MISSING, AT_FIRST = 7, 16
"""Status of an encoder that is missing for too long, and what those of the first tick are more."""
_STATUSES = {
    UNREACHABLE: Status("unreachable_pose", "reading", of_leg=True),
    SERIAL: Status("crank_dead_centre", "state.measurement", of_leg=True),
    PARALLEL: Status("parallel_singularity", "state.measurement"),
    MISSING: Status("encoder", "reading", True, "encoder readings {at}: encoder {leg} is missing or rejected"),
}
_STATUSES |= {
    AT_FIRST + status: ending._replace(
        signal=ending.signal.replace("candidate", "measurement"), last=ending.last.replace("measurement", "read")
    )
    for status, ending in estimator.STATUSES.items()
}


class ObserverOptions(EstimatorOptions):
    """A Kalman filter with the exact model of the robot, see docs/observer.md."""

    moved_keys: ClassVar[Mapping[str, str]] = {"delay": "model.delay"}
    knobs = (("disturbance", "observer: disturbance"),)
    kind: Literal["observer"] = "observer"
    disturbance: Annotated[Positive, Field(le=1e6)] = 16.0
    """[rad/s^2 per sqrt(s)] expected change in a second of each crank's unmodelled acceleration; low is quiet, high is
    stiff. With the noise of the readings it sets the bandwidth."""
    max_innovation: Positive = 0.05
    """[rad] largest innovation, reading minus prediction; a reading beyond it is rejected."""
    hold_ticks: Annotated[Natural, Field(le=1000)] = 10
    """Missing readings in a row that the model may replace before the run ends."""

    @property
    def disturbance_density(self) -> float:
        return self.disturbance

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        return (observer_part(self, context),)


_PARAMS = fields(period=(), gravity=(), noise=(), max_innovation=(), hold_ticks=(), mobility=(), age=(), ahead=())
"""period [s]. gravity [m/s^2]. noise: of a reading [rad]. max_innovation [rad]. hold_ticks [ticks]. mobility: largest
acceleration of a crank for its own torque [1/(kg m^2)]. age: of a reading, ahead: from what it tells to the time when
the command of its tick acts [ticks]."""
_STATE = fields(
    measurement=12, predicted=12, disturbance_torque=6, innovation=6, health=2,
    read=12, next=12, disturbance=6, missed=6, assembly_sign=(), commands=(LONGEST_DELAY + 1, 6),
)  # fmt: skip
"""measurement: pose and rate now [rad, m and 1/s]. predicted: likewise when the command of this tick will act.
disturbance_torque: against what is not explained, for the command [N m]. innovation: readings less what was expected of
them, 0 where one is missing [rad]. read: pose and rate at the time of which the reading tells. next: what they will
be a tick later, where a delay makes the observer look ahead. disturbance: acceleration of the cranks that the model
does not explain [rad/s^2]. missed: ticks in a row without a reading. assembly_sign: of the rods' determinant, 0 before
the first tick. commands: the last `ahead` + 1, oldest first [N m]."""


@njit
def bandwidth(noise: float, disturbance: float, period: float) -> float:
    """[rad/s] of the observer: geometric mean of its three poles in continuous time."""
    return (disturbance / (noise * np.sqrt(period))) ** (1.0 / 3.0)


@njit
def kalman_gains(noise: float, disturbance: float, period: float) -> tuple[float, float, float]:
    """Gains of the steady Kalman filter of one crank, in closed form: of angle [-], rate [1/s], disturbance [1/s^2].

    With g = disturbance^2 h^5 / noise^2 and a = white^2 h^3 / noise^2 for a white acceleration, the spectrum of the
    readings is proportional to u^3 + (a/4 + g/16) u^2 + (a + g/2) u + g, see `spectral_factor`: disturbance and
    acceleration reach the angle through h^2 (z + 1) / 2 d^3 and h^2 (z + 1) / 2 d^2, d = z - 1. Its factor has the
    filter's poles.
    """
    turn = bandwidth(noise, disturbance, period) * period
    wandering, white = turn**6, WHITE_SHARE**2 * turn**4
    c2, c1, c0, low = spectral_factor(0.25 * white + wandering / 16.0, white + 0.5 * wandering, wandering)
    return (c2 + 0.25 * c0) * low, c1 * low / period, c0 * low / period**2


@njit
def predict(robot: Any, params: Any, torque: Any, disturbance: Any, pose: Any, rate: Any, legs: Any) -> Any:
    """Moves pose and rate (6,) by a period under torque (6,) [N m], in place; status, leg, margin as `_observe`."""
    acceleration, h = np.empty(6), params.period
    bad = legs_at(robot, pose, legs)
    if bad >= 0:
        return SERIAL, bad, legs.reach_margin[bad]
    if not forward_dynamics(robot, legs, pose, rate, torque, disturbance, params.gravity, acceleration):
        return PARALLEL, -1, 0.0
    for k in range(6):
        pose[k] += h * (rate[k] + 0.5 * h * acceleration[k])
        rate[k] += h * acceleration[k]
    return OK, -1, 0.0


@njit
def observer_tick(
    robot: Any, params: Any, first_params: Any, friction: Any, reading: Any, net_torque: Any, reference: Any,
    disturbance: Any, legs: Any, estimate: Any, state: Any,
) -> Any:  # fmt: skip
    """One tick: predicts, corrects by the readings that are accepted, looks ahead; status, leg or -1, margin.

    Takes `Robot`, `_PARAMS`, the parameters of the first tick (see `_begin`), `FRICTION`, then the inputs of
    `observer_part`, `Legs` and `estimator.STATE`, both overwritten, and `_STATE`.
    """
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    break_away = record(friction).break_away.max()
    if state.assembly_sign == 0.0:
        return _begin(robot, params, record(first_params), reading, legs, record(estimate), state)
    return _observe(robot, params, break_away, reading, net_torque, reference, disturbance[0], legs, state)


@njit
def _begin(robot: Any, params: Any, first_params: Any, reading: Any, legs: Any, estimate: Any, state: Any) -> Any:
    """The first tick: the pose that its readings tell by `pose_of_angles`, and the rate of the state."""
    estimate.started, estimate.missed, estimate.assembly_sign = 0.0, 0.0, 0.0
    copy_to(estimate.measurement[:], state.measurement[:])
    copy_to(estimate.angles[:], reading[:6])
    if reading.size == 12:
        estimate.angles[:] = np.nan
        if all_finite(reading[:6]) and legs_at(robot, reading[:6], legs) < 0:
            for i in range(6):
                estimate.angles[i] = np.arctan2(legs.sine[i], legs.cosine[i])
    angles = estimate.angles.copy()
    status, leg, margin = pose_of_angles(robot, first_params, angles, legs, estimate)
    if status != OK:
        copy_to(state.measurement[:6], estimate.candidate[:])
        return AT_FIRST + status, leg, margin
    copy_to(state.read[:6], estimate.measurement[:6])
    copy_to(state.read[6:], state.measurement[6:])
    state.assembly_sign = estimate.assembly_sign
    return _look_ahead(robot, params, legs, state)


@njit
def _observe(
    robot: Any, params: Any, break_away: float, reading: Any, net_torque: Any, reference: Any, density: float,
    legs: Any, state: Any,
) -> Any:  # fmt: skip
    """A tick after the first; status, leg or -1, margin."""
    cosine, sine = np.empty(6), np.empty(6)
    for i in range(6):
        cosine[i], sine[i] = np.cos(reading[i]), np.sin(reading[i])
    if reading.size == 12:
        bad = legs_at(robot, reading[:6], legs)
        if bad >= 0 and all_finite(reading[:6]):
            return UNREACHABLE, bad, legs.reach_margin[bad]
        for i in range(6):
            cosine[i], sine[i] = (legs.cosine[i], legs.sine[i]) if bad < 0 else (np.nan, np.nan)
    for row in range(int(params.ahead)):
        copy_to(state.commands[row], state.commands[row + 1])
    # What is not a number no motor gives; the safety layer repeats the last command for it.
    if all_finite(net_torque):
        copy_to(state.commands[int(params.ahead)], net_torque)
    status, leg, margin = _correct(robot, params, break_away, cosine, sine, reference, density, state, legs)
    if status != OK:
        return status, leg, margin
    return _look_ahead(robot, params, legs, state)


@njit
def _correct(
    robot: Any, params: Any, break_away: float, cosine: Any, sine: Any, reference: Any, density: float, state: Any,
    legs: Any,
) -> Any:  # fmt: skip
    """Prediction and correction; pose and rate in the state become those of the reading."""
    h = params.period
    pose, rate = state.next[:6].copy(), state.next[6:].copy()
    if params.ahead == 0.0:
        pose, rate = state.read[:6].copy(), state.read[6:].copy()
        status, leg, margin = predict(robot, params, state.commands[0], state.disturbance[:], pose, rate, legs)
        if status != OK:
            return status, leg, margin
    bad = legs_at(robot, pose, legs)
    if bad >= 0:
        copy_to(state.measurement[:6], pose)
        return SERIAL, bad, legs.reach_margin[bad]
    to_angle, to_rate, to_disturbance = kalman_gains(params.noise, density, h)
    worst = 0
    for i in range(6):
        # Of the reading against the crank expected, within half a turn.
        c, s = legs.cosine[i], legs.sine[i]
        state.innovation[i] = np.arctan2(sine[i] * c - cosine[i] * s, cosine[i] * c + sine[i] * s)
        if abs(state.innovation[i]) <= params.max_innovation:
            state.missed[i] = 0.0
        else:
            state.innovation[i] = 0.0
            state.missed[i] += 1.0
        if state.missed[i] > state.missed[worst]:
            worst = i
    if state.missed[worst] > params.hold_ticks:
        return MISSING, worst, 0.0
    lines, turned, change = legs.line.copy(), np.empty((6, 2)), np.empty(6)
    for i in range(6):
        turned[i, 0] = legs.lever[i] * to_angle * state.innovation[i]
        turned[i, 1] = legs.lever[i] * to_rate * state.innovation[i]
    sign = solve(lines, turned)
    if sign != state.assembly_sign:
        copy_to(state.measurement[:6], pose)
        return PARALLEL, -1, 0.0
    predicted = pose.copy()
    laws.rate_of(predicted, turned[:, 0], change)
    pose += change
    laws.rate_of(predicted, turned[:, 1], change)
    rate += change
    copy_to(state.read[:6], pose)
    copy_to(state.read[6:], rate)
    if not _stands(params, break_away, legs, density, pose, reference):
        for i in range(6):
            state.disturbance[i] += to_disturbance * state.innovation[i]
    return OK, -1, 0.0


@njit
def _stands(params: Any, break_away: float, legs: Any, density: float, pose: Any, reference: Any) -> bool:
    """Whether a robot with friction in its motors is to rest, and does where it is wanted."""
    if break_away <= 0.0:
        return False
    turn = bandwidth(params.noise, density, params.period)
    arrived = max(ARRIVED * params.noise, SLIP * break_away * params.mobility / (turn * turn))
    off, wanted = np.empty(6), np.empty(6)
    laws.angular_velocity(pose[:3], pose[:3] - reference[:3], off[:3])
    laws.angular_velocity(pose[:3], reference[6:9], wanted[:3])
    for k in range(3, 6):
        off[k], wanted[k] = pose[k] - reference[k], reference[6 + k]
    for i in range(6):
        apart = dot(legs.line[i, :3], off[:3]) + dot(legs.line[i, 3:], off[3:])
        turning = dot(legs.line[i, :3], wanted[:3]) + dot(legs.line[i, 3:], wanted[3:])
        lever = abs(legs.lever[i])
        if not (abs(apart) <= arrived * lever and abs(turning) <= RESTS * lever):
            return False
    return True


@njit
def _look_ahead(robot: Any, params: Any, legs: Any, state: Any) -> Any:
    """The rest of a tick: what is now and when its command acts, and what the disturbance takes then."""
    predicted, inertia = state.predicted, np.empty((6, 6))
    copy_to(predicted[:], state.read[:])
    for row in range(int(params.ahead) + 1):
        if row > 0:
            status, leg, margin = predict(
                robot, params, state.commands[row], state.disturbance[:], predicted[:6], predicted[6:], legs
            )
            if status != OK:
                return status, leg, margin
        if row == 1:
            copy_to(state.next[:], predicted)
        if row == int(params.age):
            copy_to(state.measurement[:], predicted[:])
    bad = legs_at(robot, predicted[:6], legs)
    if bad >= 0:
        return SERIAL, bad, legs.reach_margin[bad]
    # T = -J^-T M J^-1 (disturbance).
    task_inertia(robot, legs, inertia)
    lines, transposed = legs.line.copy(), np.ascontiguousarray(legs.line.T)
    twist, wrench = np.empty((6, 1)), np.zeros((6, 1))
    for i in range(6):
        twist[i, 0] = legs.lever[i] * state.disturbance[i]
    if solve(lines, twist) == 0.0:
        return PARALLEL, -1, 0.0
    for k in range(6):
        for m in range(6):
            wrench[k, 0] += inertia[k, m] * twist[m, 0]
    solve(transposed, wrench)
    for i in range(6):
        state.disturbance_torque[i] = -legs.lever[i] * wrench[i, 0]
    return OK, -1, 0.0


def observer_part(options: ObserverOptions, context: LoopContext) -> Part:
    """The observer; its outputs are the first fields of `_STATE`.

    Inputs: reading, (6,) angles of the cranks [rad], NaN for one that is missing, or (12,) pose [rad, m] and its rate;
    net_torque (6,) [N m] the last command, less what of it the friction takes; reference (18,) wanted now; disturbance
    (1,) [rad/s^2 per sqrt(s)] to expect.
    """
    robot, period, age = context.robot, context.period, round(context.reading_age / context.period)
    ahead = age + context.delay
    if ahead > (most := min(int(FARTHEST / period), LONGEST_DELAY)):
        reason = f"{FARTHEST:g} s or {LONGEST_DELAY} of an observer's ticks; without this key it is"
        if age > most:
            allowed = f"at most {most * period:g} s, {reason} sensors.delay"
            raise ConfigurationError("model.reading_age", context.reading_age, allowed)
        raise ConfigurationError("model.delay", context.delay, f"at most {most - age}, {reason} command_delay")
    # [1/(kg m^2)] acceleration of a crank for its own torque, at home.
    mobility = np.diag(pose_jacobian(robot, robot.home_pose) @ pose_acceleration_map(robot, robot.home_pose))
    params = new_record(
        _PARAMS,
        options,
        period=period,
        gravity=context.gravity,
        noise=context.noise,
        mobility=mobility.max(),
        age=age,
        ahead=ahead,
    )
    start = np.concatenate([context.pose, context.pose_rate])
    initial = new_record(_STATE, measurement=start, predicted=start, read=start, health=HEALTHY)
    initial["commands"][0, : ahead + 1] = context.initial_torque

    first = difference_params(DifferenceOptions(), period)
    numbers = {"robot": laws.robot_record(robot), "params": params, "first_params": first}
    numbers["friction"] = context.friction.record()
    inputs = {"reading": context.reading, "net_torque": 6, "reference": 18, "disturbance": 1}
    outputs, expected = (
        ("measurement", "predicted", "disturbance_torque", "innovation"),
        np.array([options.disturbance]),
    )
    part = Part("observer", observer_tick, {}, inputs, outputs, initial, (laws.Legs, STATE), _STATUSES)
    return part._replace(connections={"disturbance": expected}, parameters=numbers)
