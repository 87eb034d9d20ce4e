"""Disturbance observer: estimates pose and rate of the platform and unmodelled crank accelerations from crank angles.

A tick has three steps:

1. Predict: the exact model moves pose and rate by one period, under the last command and the estimated disturbance.
2. Correct: the innovation, reading minus predicted angle, corrects pose, rate and disturbance. The gains are those of
   the steady Kalman filter of one crank,

       theta' = rate,  rate' = model + disturbance + white noise,  disturbance' = white noise,
       reading = theta + white noise.

   All readings have the same noise, so the gains are the same for all cranks.
3. Look ahead: the model predicts pose, rate and disturbance torque at the time when the command of this tick acts.

A disturbance as a state: C. Johnson, IEEE Trans. Autom. Control 16, 1971. With stiction such a state makes the crank
hunt: the disturbance grows until the crank breaks away and moves too far. So for motors with friction the disturbance
is kept constant while the reference rests and all cranks have arrived within the noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Flag, Natural, Positive
from stewart_drake.base.errors import ConfigurationError, Status
from stewart_drake.base.families import imported
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, TickResult, Vec1, Vec2, Vec6, Vec9, Vec12, Vec18, Vector, record
from stewart_drake.control import estimator
from stewart_drake.control.estimator import (
    DifferenceOptions,
    DifferenceParams,
    DifferenceState,
    EstimatorOptions,
    difference_params,
    pose_of_angles,
)
from stewart_drake.loop.part import HEALTHY, LoopContext, Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics import pose_acceleration_map
from stewart_drake.mechanics.dynamics_laws import forward_dynamics, multiply_by_crank_inertia
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics import pose_jacobian
from stewart_drake.mechanics.kinematics_laws import OK, PARALLEL, SERIAL, UNREACHABLE, Legs, Robot, dot, legs_at
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, largest_size, set_to, solve, spectral_factor
from stewart_drake.robot.gravity import base_reading

SMALLEST_NOISE = 1e-5  # [rad] least noise of readings in the observer: no model is more accurate.
# A crank has arrived if its error is below the larger of two bounds:
ARRIVED = 6.0  # [standard deviations of a reading]
SLIP = 4.0  # [break_away / (inertia bandwidth^2)] about half of the jump of a crank that hunts.
# [-] white noise of the acceleration, in units of disturbance / bandwidth. It damps the poles of the filter: the disk
# margin of the loop is 0.49 with it, 0.37 without.
WHITE_SHARE = 1.5
AT_REST = 1e-4  # [rad/s] rate of all cranks below which the reference is at rest.
LONGEST_DELAY = 100  # [ticks] from a reading to the time when the command computed from it acts.
FARTHEST = 0.3  # [s] longest prediction; assumed.
MISSING = 7  # Status of an encoder that is missing for too long.
AT_FIRST = 16  # Added to the statuses of `pose_of_angles` in the first tick.
STATUSES = {
    UNREACHABLE: Status("unreachable_pose", "reading", of_leg=True),
    SERIAL: Status("crank_dead_centre", "state.measurement", of_leg=True),
    PARALLEL: Status("parallel_singularity", "state.measurement"),
    MISSING: Status("encoder", "reading", True, "encoder readings {at}: encoder {leg} is missing or rejected"),
}
STATUSES |= {
    AT_FIRST + status: ending._replace(
        signal=ending.signal.replace("candidate", "measurement"), last=ending.last.replace("measurement", "read")
    )
    for status, ending in estimator.STATUSES.items()
}


class ObserverOptions(EstimatorOptions):
    """Steady Kalman filter with the exact model of the robot, see docs/observer.md."""

    moved_keys: ClassVar[Mapping[str, str]] = {"delay": "model.delay"}
    knobs = (("disturbance", "observer: disturbance"),)
    kind: Literal["observer"] = "observer"
    disturbance: Annotated[Positive, Field(le=1e6)] = 16.0
    """[rad/s^2 per sqrt(s)] expected change of a crank's unmodelled acceleration in a second; low is quiet, high is
    stiff. With the noise of the readings it sets the bandwidth."""
    max_innovation: Positive = 0.05
    """[rad] largest innovation, reading minus prediction; a reading beyond it is rejected."""
    hold_ticks: Annotated[Natural, Field(le=1000)] = 10
    """Missing readings in a row that the model may replace before the run ends."""
    imu: Flag = True
    """Whether it uses the inertial sensor of the model, if there is one."""

    @property
    def disturbance_density(self) -> float:
        return self.disturbance

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        part = observer_part(self, context)
        if not self.imu or context.imu is None:
            return (part,)
        # Imported here: it extends this observer.
        return (imported("control.inertial:with_imu")(part, context.imu, context.period, context.reading_age),)


Commands = Annotated[np.ndarray, (LONGEST_DELAY + 1, 6)]


class ObserverParams(Record):
    """Parameters of the observer."""

    period: float  # [s]
    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    noise: float  # [rad] standard deviation of a reading.
    max_innovation: float  # [rad] innovation above which a reading is rejected.
    hold_ticks: float  # [ticks] in a row without a reading after which the run ends.
    mobility: float  # [1/(kg m^2)] largest acceleration of a crank per torque of its motor.
    age: float  # [ticks] age of a reading.
    ahead: float  # [ticks] from the time of a reading to the time when the command computed from it acts.


class ObserverState(Record):
    """State of the observer."""

    # Outputs.
    measurement: Vec12  # [rad, m] pose now, and its rate.
    predicted: Vec12  # [rad, m] pose when the command of this tick acts, and its rate.
    disturbance_torque: Vec6  # [N m] torque that compensates the disturbance when the command acts.
    innovation: Vec6  # [rad] readings minus predictions; 0 for a missing reading.
    health: Vec2  # See `loop.part.HEALTHY`.
    # Memory.
    read: Vec12  # [rad, m] corrected pose at the time of the reading, and its rate.
    next: Vec12  # [rad, m] predicted pose one tick after the reading, and its rate; used with a delay.
    disturbance: Vec6  # [rad/s^2] unmodelled acceleration of the cranks.
    missed: Vec6  # [ticks] in a row without a reading.
    assembly_sign: float  # Sign of the determinant of the rods' lines; 0 before the first tick.
    commands: Commands  # [N m] the last `ahead` + 1, oldest first.


@njit
def bandwidth(noise: float, disturbance: float, period: float) -> float:
    """Bandwidth [rad/s] of the observer: geometric mean of its three poles in continuous time.

    Args:
        noise: [rad] standard deviation of a reading.
        disturbance: [rad/s^2 per sqrt(s)] expected change of the unmodelled acceleration.
        period: [s].
    """
    return (disturbance / (noise * np.sqrt(period))) ** (1.0 / 3.0)


@njit
def kalman_gains(noise: float, disturbance: float, period: float) -> tuple[float, float, float]:
    """Gains of the steady Kalman filter of one crank, in closed form; arguments as for `bandwidth`.

    The transfer functions from disturbance and white acceleration to the angle are h^2 (z + 1) / (2 d^3) and
    h^2 (z + 1) / (2 d^2), with d = z - 1 and the period h. So the spectrum of the readings is proportional to
    u^3 + (a/4 + g/16) u^2 + (a + g/2) u + g, with g = disturbance^2 h^5 / noise^2, a = white^2 h^3 / noise^2 and u as
    in `spectral_factor`. The stable factor of the spectrum has the poles of the filter.

    Returns:
        Gains from the innovation to the angle [-], its rate [1/s] and the disturbance [1/s^2].
    """
    turn = bandwidth(noise, disturbance, period) * period
    wandering, white = turn**6, WHITE_SHARE**2 * turn**4
    c2, c1, c0, low = spectral_factor(0.25 * white + wandering / 16.0, white + 0.5 * wandering, wandering)
    return (c2 + 0.25 * c0) * low, c1 * low / period, c0 * low / period**2


@njit
def predict(
    robot: Robot, params: ObserverParams, torque: Vec6, disturbance: Vec6, pose: Vec6, rate: Vec6, legs: Legs
) -> TickResult:
    """Moves pose and rate by one period under a torque [N m] and a disturbance [rad/s^2], in place.

    Returns status, leg or -1, and margin, as `observer_tick` does.
    """
    acceleration, h = np.empty(6), params.period
    bad = legs_at(robot, pose, legs)
    if bad >= 0:
        return SERIAL, bad, legs.reach_margin[bad]
    if not forward_dynamics(robot, legs, pose, rate, torque, disturbance, params.base[:], acceleration):
        return PARALLEL, -1, 0.0
    for k in range(6):
        pose[k] += h * (rate[k] + 0.5 * h * acceleration[k])
        rate[k] += h * acceleration[k]
    return OK, -1, 0.0


@njit
def observer_tick(
    robot: Robot,
    params: ObserverParams,
    first_params: DifferenceParams,
    friction: Friction,
    reading: Vector,
    net_torque: Vec6,
    reference: Vec18,
    disturbance: Vec1,
    legs: Legs,
    estimate: DifferenceState,
    state: ObserverState,
) -> TickResult:
    """One tick: predicts, corrects by the accepted readings, looks ahead; changes `state` in place.

    The inputs `reading`, `net_torque`, `reference` and `disturbance` are described in `observer_part`. `first_params`
    are parameters of `pose_of_angles`, for the first tick. `legs` and `estimate` are work space and are overwritten.

    Returns:
        Status, a key of `STATUSES` or 0; the leg that it is about, or -1; and its margin.
    """
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    break_away = largest_size(record(friction).break_away[:])
    if state.assembly_sign == 0.0:
        return begin(robot, params, record(first_params), reading, legs, record(estimate), state)
    pose, rate = np.empty(6), np.empty(6)
    status, leg, margin = innovate(robot, params, reading, net_torque, legs, pose, rate, state)
    if status == OK:
        status, leg, margin = _correct(params, break_away, reference, disturbance[0], pose, rate, legs, state)
    if status != OK:
        return status, leg, margin
    return look_ahead(robot, params, legs, np.zeros(6), state)


@njit
def begin(
    robot: Robot,
    params: ObserverParams,
    first_params: DifferenceParams,
    reading: Vector,
    legs: Legs,
    estimate: DifferenceState,
    state: ObserverState,
) -> TickResult:
    """The first tick: computes the pose from the readings by forward kinematics; the rate is the initial one."""
    estimate.started, estimate.missed, estimate.assembly_sign = 0.0, 0.0, 0.0
    copy_to(estimate.measurement[:], state.measurement[:])
    copy_to(estimate.angles[:], reading[:6])
    if reading.size == 12:
        set_to(estimate.angles[:], np.nan)
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
    return look_ahead(robot, params, legs, np.zeros(6), state)


@njit
def innovate(
    robot: Robot,
    params: ObserverParams,
    reading: Vector,
    net_torque: Vec6,
    legs: Legs,
    pose: Vec6,
    rate: Vec6,
    state: ObserverState,
) -> TickResult:
    """Predicts `pose` and `rate` at the time of the reading, with `legs` there; sets `state.innovation`."""
    cosine, sine = np.empty(6), np.empty(6)
    for i in range(6):
        cosine[i], sine[i] = np.cos(reading[i]), np.sin(reading[i])
    if reading.size == 12:
        bad = legs_at(robot, reading[:6], legs)
        if bad >= 0 and all_finite(reading[:6]):
            return UNREACHABLE, bad, legs.reach_margin[bad]
        for i in range(6):
            cosine[i] = legs.cosine[i] if bad < 0 else np.nan
            sine[i] = legs.sine[i] if bad < 0 else np.nan
    for row in range(int(params.ahead)):
        copy_to(state.commands[row], state.commands[row + 1])
    # If a command is not finite, the safety layer has sent the last one again, and so does this.
    if all_finite(net_torque):
        copy_to(state.commands[int(params.ahead)], net_torque)
    start = state.read[:] if params.ahead == 0.0 else state.next[:]
    copy_to(pose, start[:6])
    copy_to(rate, start[6:])
    if params.ahead == 0.0:
        status, leg, margin = predict(robot, params, state.commands[0], state.disturbance[:], pose, rate, legs)
        if status != OK:
            return status, leg, margin
    bad = legs_at(robot, pose, legs)
    if bad >= 0:
        copy_to(state.measurement[:6], pose)
        return SERIAL, bad, legs.reach_margin[bad]
    worst = 0
    for i in range(6):
        # Innovation: angle from prediction to reading, within half a turn.
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
    return OK, -1, 0.0


@njit
def _correct(
    params: ObserverParams,
    break_away: float,
    reference: Vec18,
    density: float,
    pose: Vec6,
    rate: Vec6,
    legs: Legs,
    state: ObserverState,
) -> TickResult:
    """Corrects the predicted pose and rate by the innovations of the angles; sets `state.read`."""
    to_angle, to_rate, to_disturbance = kalman_gains(params.noise, density, params.period)
    # Corrections of the six angles and rates -> twists of the platform.
    lines, twists, change = legs.line.copy(), np.empty((6, 2)), np.empty(6)
    for i in range(6):
        twists[i, 0] = legs.lever[i] * to_angle * state.innovation[i]
        twists[i, 1] = legs.lever[i] * to_rate * state.innovation[i]
    sign = solve(lines, twists)
    if sign != state.assembly_sign:
        copy_to(state.measurement[:6], pose)
        return PARALLEL, -1, 0.0
    predicted, pose_twist, rate_twist = pose.copy(), np.empty(6), np.empty(6)
    for k in range(6):
        pose_twist[k], rate_twist[k] = twists[k, 0], twists[k, 1]
    laws.rate_of(predicted, pose_twist, change)
    for k in range(6):
        pose[k] += change[k]
    laws.rate_of(predicted, rate_twist, change)
    for k in range(6):
        rate[k] += change[k]
    copy_to(state.read[:6], pose)
    copy_to(state.read[6:], rate)
    if not rests_at_target(params, break_away, legs, density, pose, reference):
        for i in range(6):
            state.disturbance[i] += to_disturbance * state.innovation[i]
    return OK, -1, 0.0


@njit
def rests_at_target(
    params: ObserverParams, break_away: float, legs: Legs, density: float, pose: Vec6, reference: Vec18
) -> bool:
    """True if the motors have stiction, the reference is at rest and all cranks have arrived at its angles."""
    if break_away <= 0.0:
        return False
    speed = bandwidth(params.noise, density, params.period)
    arrived = max(ARRIVED * params.noise, SLIP * break_away * params.mobility / (speed * speed))
    difference, error, target = np.empty(6), np.empty(6), np.empty(6)
    for k in range(6):
        difference[k] = pose[k] - reference[k]
    laws.twist_of(pose, difference, error)
    laws.twist_of(pose, reference[6:12], target)
    for i in range(6):
        # Error and rate of a crank, times its lever.
        distance = dot(legs.line[i, :3], error[:3]) + dot(legs.line[i, 3:], error[3:])
        rate = dot(legs.line[i, :3], target[:3]) + dot(legs.line[i, 3:], target[3:])
        lever = abs(legs.lever[i])
        if not (abs(distance) <= arrived * lever and abs(rate) <= AT_REST * lever):
            return False
    return True


@njit
def look_ahead(robot: Robot, params: ObserverParams, legs: Legs, more: Vec6, state: ObserverState) -> TickResult:
    """Predicts the present and the time when the command acts; computes the disturbance torque for that time.

    That torque is also against `more` (6,) [rad/s^2], accelerations of the cranks.
    """
    predicted, torque = state.predicted, np.empty((6, 1))
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
    for i in range(6):
        torque[i, 0] = -(state.disturbance[i] + more[i])
    if not multiply_by_crank_inertia(robot, legs, torque):
        return PARALLEL, -1, 0.0
    copy_to(state.disturbance_torque[:], torque[:, 0])
    return OK, -1, 0.0


def observer_part(options: ObserverOptions, context: LoopContext) -> Part:
    """The observer as a part of a loop.

    Inputs:
        reading: (6,) [rad] crank angles, NaN for a missing one; or (12,) [rad, m] pose and its rate.
        net_torque: (6,) [N m] the last command minus the friction.
        reference: (18,) the present reference.
        disturbance: (1,) [rad/s^2 per sqrt(s)] expected change of the unmodelled acceleration in a second.

    Outputs: measurement, predicted, disturbance_torque, innovation; see `ObserverState`.
    """
    robot, period, age = context.robot, context.period, round(context.reading_age / context.period)
    ahead = age + context.delay
    if ahead > (most := min(int(FARTHEST / period), LONGEST_DELAY)):
        reason = f"{FARTHEST:g} s or {LONGEST_DELAY} of an observer's ticks; without this key it is"
        if age > most:
            allowed = f"at most {most * period:g} s, {reason} sensors.delay"
            raise ConfigurationError("model.reading_age", context.reading_age, allowed)
        raise ConfigurationError("model.delay", context.delay, f"at most {most - age}, {reason} command_delay")
    # [1/(kg m^2)] acceleration of a crank per torque of its motor, at home.
    mobility = np.diag(pose_jacobian(robot, robot.home_pose) @ pose_acceleration_map(robot, robot.home_pose))
    params = ObserverParams.new(
        options,
        period=period,
        base=base_reading(context.gravity),
        noise=context.noise,
        mobility=mobility.max(),
        age=age,
        ahead=ahead,
    )
    start = np.concatenate([context.pose, context.pose_rate])
    initial = ObserverState.new(measurement=start, predicted=start, read=start, health=HEALTHY)
    initial["commands"][0, : ahead + 1] = context.initial_torque
    first = difference_params(DifferenceOptions(), period)
    numbers = {"robot": laws.robot_record(robot), "params": params, "first_params": first}
    numbers["friction"] = context.friction.record()
    inputs = {"reading": context.reading, "net_torque": 6, "reference": 18, "disturbance": 1}
    outputs = "measurement", "predicted", "disturbance_torque", "innovation"
    part = Part("observer", observer_tick, {}, inputs, outputs, initial, (Legs, DifferenceState), STATUSES)
    return part._replace(connections={"disturbance": np.array([options.disturbance])}, parameters=numbers)
