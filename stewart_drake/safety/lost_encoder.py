"""Going on with five encoders and the inertial sensor on the platform, after one encoder is lost.

Five encoders leave the platform one freedom: a turn along the line of the lost leg, see `parity.encoder_lines`. The
inertial sensor's orientation gives it, so the angle of the lost crank is one unknown, found by a step of Newton's
method in every tick. Between two samples of the sensor the last rates turn its orientation on.

The replaced reading begins at the angle that the estimator believed, and moves to the true one within `HALT`; in the
same time the reference comes to rest. The estimator and the controller see no jump. While no encoder is lost, reading
and reference pass unchanged.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec1, Vec3, Vec6, Vec12, Vec18, record
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, dot, turned
from stewart_drake.mechanics.linear_algebra import all_finite, any_nonzero, copy_to, set_to
from stewart_drake.mechanics.rotations import rotation_between, turn_by
from stewart_drake.safety.options import SafetyOptions
from stewart_drake.safety.parity import (
    ALIGNMENT,
    FAILED,
    ITERATIONS,
    SILENT_PERIODS,
    TOLERANCE,
    ParityParams,
    ParityState,
    parity_part,
    parity_tick,
)
from stewart_drake.safety.stillness import cranks_at
from stewart_drake.safety.wrong_leg import encoder_lines, suspect_leg

HALT = 0.3  # [s] in which the reference comes to rest, and the replaced reading to the true angle.
SPEED = 0.2  # [rad/s], and [1/s] in characteristic lengths: largest rate on the way home; assumed.
LEAST_LINE = 0.01  # [-] turn of the platform per turn of a crank, below which an orientation does not tell the crank.
SUSPECT, PATIENCE = 0.25, 1.5
"""Share of the bound beyond which a change of the difference names a leg; and up to which none need be named."""
SLOWNESS = 0.4  # Largest product of the observer's bandwidth and the age of the sensor's orientation; assumed.
FIRST_STEPS = 3  # Of Newton's method when an encoder is lost; one in a later tick.
NOT_READY = -2.0
"""In `parity`, in the place of a leg: the inertial sensor cannot replace an encoder now."""
Reaction = Literal["stop", "hold", "home"]


class GoingParams(Record):
    """Parameters of going on."""

    period: float  # [s] of a tick.
    home: Vec6  # [rad, m] pose to which the robot is led; NaN where it is held.
    speed: float  # [m/s] on the way home.
    preview: float  # [s] by which `reference_ahead` is ahead of `reference`.
    most_disturbance: float  # [rad/s^2 per sqrt(s)] that an observer may expect of a replaced reading.


class GoingState(ParityState):
    """State of going on, beside that of the comparison."""

    used_reading: Vec6  # [rad] the reading, with the angle of a lost leg replaced.
    used_reference: Vec18  # The reference, or the way to rest.
    used_reference_ahead: Vec18
    used_disturbance: Vec1  # [rad/s^2 per sqrt(s)] that an observer expects.
    lost: float  # 1 and the lost leg, 0 for none.
    angle: float  # [rad] of the lost crank.
    turned: float  # [rad] its change in the last tick.
    gap: float  # [rad] from this angle to the replaced reading at first.
    since: float  # [s] since the encoder was lost.
    turns: Vec6  # [rad] first readings, from which angles are within half a turn.
    rate: Vec3  # [rad/s] of that sample, in P, without bias.
    start: Vec18  # The reference from which the way to rest begins.


class LossState(Record):
    """What the parts before the estimator know of the end of the last tick."""

    lost_leg: Vec1  # By the safety layer; -1 for none.
    believed: Vec12  # [rad, m] the measurement.


@njit
def quintic(start: Vec18, goal: Vec6, duration: float, time: float, out: Vec18) -> None:
    """Polynomial of minimum jerk from pose, rate and acceleration (18,) to rest at a goal after a duration [s]."""
    left = max(0.0, duration - time)
    for k in range(6):
        out[k], out[6 + k], out[12 + k] = goal[k], 0.0, 0.0
        if left > 0.0:
            p, v, a, h = start[k], start[6 + k], start[12 + k], duration
            d, dv, da = goal[k] - p - h * (v + 0.5 * h * a), -(v + h * a) * h, -a * h * h
            c3, c4, c5 = 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da
            u = time / h
            out[k] = p + time * (v + 0.5 * time * a) + u**3 * (c3 + u * (c4 + u * c5))
            out[6 + k] = v + time * a + u**2 * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)) / h
            out[12 + k] = a + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)) / (h * h)


@njit
def way_to_rest(going: GoingParams, start: Vec18, time: float, out: Vec18) -> None:
    """The reference `time` [s] after it left `start` (18,): it comes to rest, and then goes home if there is one."""
    halt, goal = HALT if any_nonzero(start[6:]) else 0.0, np.empty(6)
    for k in range(6):
        goal[k] = start[k] + 0.5 * halt * start[6 + k]
    if time < halt or np.isnan(going.home[0]):
        quintic(start, goal, halt, time, out)
        return
    rest, turn, distance = np.zeros(18), 0.0, 0.0
    copy_to(rest[:6], goal)
    for k in range(3):
        turn += (going.home[k] - goal[k]) ** 2
        distance += (going.home[3 + k] - goal[3 + k]) ** 2
    # The fastest rate of such a polynomial is 1.875 times its mean.
    duration = 1.875 * max(np.sqrt(turn) / SPEED, np.sqrt(distance) / going.speed)
    quintic(rest, going.home[:], duration, time - halt, out)


@njit
def lost_angle(
    robot: Robot, angles: Vec6, leg: int, rotation: np.ndarray, pose: Vec6, legs: Legs, difference: Vec3
) -> bool:
    """A step of Newton's method for the angle of a leg [rad], in place, with which the orientation is `rotation`.

    `pose` is the guess, then the pose of the angles before the step. False at a singularity, or where an orientation
    does not tell the angle.
    """
    error, _ = laws.forward_kinematics(robot, angles, pose, TOLERANCE, ITERATIONS)
    lines = np.empty((6, 3))
    if not error <= 1e-3 * robot.length or laws.legs_at(robot, pose, legs) >= 0 or not encoder_lines(legs, lines):
        return False
    line = lines[leg]
    squared = dot(line, line)
    if squared < LEAST_LINE * LEAST_LINE:
        return False
    rotation_between(legs.rotation, rotation, difference)
    angles[leg] -= dot(line, difference) / squared
    return True


@njit
def go_on_tick(
    robot: Robot,
    params: ParityParams,
    going: GoingParams,
    reading: Vec6,
    imu: Vec6,
    reference: Vec18,
    reference_ahead: Vec18,
    disturbance: Vec1,
    lost_leg: Vec1,
    believed: Vec12,
    legs: Legs,
    state: GoingState,
) -> None:
    """A tick: the comparison of the readings with the inertial sensor, the replaced reading, the way to rest.

    `imu` (6,) is NaN where there is no new sample; `lost_leg` and `believed` are those of `LossState`.
    """
    body, comparison, options, work, now = record(robot), record(params), record(going), record(legs), record(state)
    angles, cranks, is_first = reading.copy(), np.empty(6), False
    cranks_at(body, believed[:6], work, cranks)
    missing, leg = 0, -1
    for i in range(6):
        missing += 0 if np.isfinite(reading[i]) else 1
        now.turns[i] = reading[i] if np.isnan(now.turns[i]) else now.turns[i]
        cranks[i] = now.turns[i] + np.arctan2(np.sin(cranks[i] - now.turns[i]), np.cos(cranks[i] - now.turns[i]))
    if now.lost == 0.0 and lost_leg[0] >= 0.0 and all_finite(cranks):
        is_first = True
        now.lost, now.angle, now.count = 1.0 + lost_leg[0], cranks[int(lost_leg[0])], 0.0
        now.parity[0], now.parity[1] = 0.0, -1.0
        copy_to(now.pose[:], believed[:6])
        copy_to(now.start[:], reference_ahead)
    if now.lost > 0.0:
        leg = int(now.lost) - 1
        angles[leg] = now.angle + now.turned
    elif missing == 1:
        # Its orientation goes on while the safety layer waits for the reading.
        for i in range(6):
            angles[i] = angles[i] if np.isfinite(angles[i]) else cranks[i]
    now.used_disturbance[0] = disturbance[0] if leg < 0 else min(disturbance[0], options.most_disturbance)
    copy_to(now.used_reference[:], reference)
    copy_to(now.used_reference_ahead[:], reference_ahead)
    if leg >= 0:
        way_to_rest(options, now.start[:], now.since, now.used_reference_ahead[:])
        if now.since >= options.preview:
            way_to_rest(options, now.start[:], now.since - options.preview, now.used_reference[:])
    parity_tick(robot, params, angles, imu, now.used_reference[:], legs, state)
    if all_finite(imu):
        turned(comparison.mounting[:], imu[:3], now.rate[:])
        for k in range(3):
            now.rate[k] -= now.rate_bias[k]
    ready = now.samples * comparison.period > ALIGNMENT and now.elapsed <= SILENT_PERIODS * comparison.period
    copy_to(now.used_reading[:], reading)
    if leg >= 0:
        ready = ready and _replace(body, comparison, angles, leg, is_first, work, now)
        now.since += options.period
    if not ready:
        # Not yet a replacement, or no longer.
        now.parity[0], now.parity[1] = max(now.parity[0], 1.0 if leg >= 0 else 0.0), NOT_READY
    elif leg < 0:
        _name(comparison, work, now)


@njit
def _name(params: ParityParams, legs: Legs, state: GoingState) -> None:
    """Names the leg along whose line the difference has changed, also where it is smaller than the bound.

    A slow error of the sensor's orientation is in the difference, but not in its change. The leg explains what other
    monitors find. A difference that names no leg is given the time to grow.
    """
    lines = np.empty((6, 3))
    if dot(state.change, state.change) > (SUSPECT * params.bound) ** 2 and encoder_lines(legs, lines):
        leg = suspect_leg(lines, state.change, np.zeros(3))[0]
        state.parity[1] = leg if leg >= 0 else state.parity[1]
    is_small = dot(state.difference, state.difference) < (PATIENCE * params.bound) ** 2
    if state.parity[1] < 0.0 and state.result != FAILED and is_small:
        state.parity[0] = 0.0


@njit
def _replace(
    robot: Robot, params: ParityParams, angles: Vec6, leg: int, is_first: bool, legs: Legs, state: GoingState
) -> bool:
    """Finds the angle of the lost leg, and replaces its reading; False if it cannot be found."""
    rotation, step, after = np.empty((3, 3)), np.empty(3), params.later + state.elapsed
    for k in range(3):
        copy_to(rotation[k], state.rotation[k])
    turned(state.rotation[:], state.rate[:], step)
    for k in range(3):
        step[k] = after * (step[k] - params.base[3 + k])
    turn_by(step, rotation)
    found, steps = True, FIRST_STEPS if is_first else 1
    for _ in range(steps):
        found = found and lost_angle(robot, angles, leg, rotation, state.pose[:], legs, step)
    state.turned = angles[leg] - state.angle
    if is_first:
        state.gap, state.turned = -state.turned, 0.0
        # The comparison begins anew.
        copy_to(state.difference[:], step)
        set_to(state.change[:], 0.0)
        state.excess = state.block.count = 0.0
    state.angle = angles[leg]
    u = min(1.0, state.since / HALT)
    state.used_reading[leg] = state.angle + state.gap * (1.0 - u**3 * (10.0 + u * (6.0 * u - 15.0)))
    return found and np.isfinite(state.used_reading[leg])


@njit
def remember(lost: Vec1, measurement: Vec12, state: LossState) -> None:
    """Stores what the next tick has to know of this one."""
    state = record(state)
    state.lost_leg[0] = lost[0]
    copy_to(state.believed[:], measurement)


def reaction(options: SafetyOptions, context: LoopContext) -> Reaction:
    """What is done if an encoder is lost.

    Raises a ConfigurationError where it should be replaced, and cannot be.
    """
    asked, possible = options.on_lost_encoder, context.imu is not None and context.reading == 6
    possible = possible and not context.motors.holds
    if asked in ("hold", "home") and not possible:
        allowed = (
            "stop or null; the others need encoders, an inertial sensor (sensors.imu), and motors that take torque"
        )
        raise ConfigurationError("safety.on_lost_encoder", asked, allowed)
    return asked or ("hold" if possible else "stop")


def going_parts(options: SafetyOptions, context: LoopContext, period: float, preview: float) -> tuple[Part, ...]:
    """`used_reading` (6,), `used_reference` and `used_reference_ahead` (18,), `parity` (2,), and what it remembers.

    For readings in a period [s]. None without encoders and an inertial sensor. The second part runs at the end of a
    tick.
    """
    wanted = reaction(options, context)
    if context.imu is None or context.reading != 6 or (wanted == "stop" and options.parity is None):
        return ()
    robot, bound = context.robot, np.inf if options.parity is None else options.parity
    parity = parity_part(context.ticking(period), context.imu, bound)
    home, speed = robot.home_pose if wanted == "home" else np.nan, SPEED * robot.characteristic_length
    # The older the orientation, the slower the observer: its bandwidth grows with the cube root of this number.
    every = context.imu.period or period
    age = max(1e-6, context.imu.delay - context.reading_age + every - period)
    slow = context.noise * np.sqrt(period) * (SLOWNESS / age) ** 3
    going = GoingParams.new(period=period, home=home, speed=speed, preview=preview, most_disturbance=slow)
    given = {name: parity.initial[name] for name in parity.initial.dtype.names or ()}
    first = GoingState.new(**given, turns=np.nan)
    start = LossState.new(lost_leg=-1.0, believed=np.concatenate([context.pose, context.pose_rate]))
    inputs = {"reading": 6, "imu": 6, "reference": 18, "reference_ahead": 18, "disturbance": 1, "lost_leg": 1}
    outputs = "used_reading", "used_reference", "used_reference_ahead", "used_disturbance", "parity"
    replacing = parity._replace(
        kernel=go_on_tick, inputs=inputs | {"believed": 12}, outputs=outputs, initial=first, period=period
    )
    loss = Part("loss", remember, {}, {"lost": 1, "measurement": 12}, ("lost_leg", "believed"), start, period=period)
    numbers = {**parity.parameters, "going": going}
    return replacing._replace(parameters=numbers), loss._replace(end_of_tick=True)
