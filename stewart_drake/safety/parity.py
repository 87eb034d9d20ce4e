"""Parity of the encoders and an inertial sensor on the platform: which of them is wrong.

Six readings give the platform's orientation exactly, and never contradict each other. The inertial sensor gives the
orientation again: gyroscopes turn it, and the direction of gravity corrects its tilt slowly (complementary filter:
R. Mahony, T. Hamel, J.-M. Pflimlin, IEEE Trans. Autom. Control 53, 2008). The difference of the two is a rotation
vector. An encoder that is wrong moves it along a line of its own, one of six, which the Jacobian gives; an inertial
sensor that is wrong moves it along none of them.

There are two bounds: one on the whole difference, and a lower one on its change within a tenth of a second, in which
biases do not count. A sensor that is silent, repeats itself, or has an implausible bias is wrong too.

Gravity is the measured force less the acceleration of the encoders' pose, a second difference over blocks of samples;
the forces are weighted as accelerations are in it. So no push and no blow moves the tilt. Gravity says nothing about a
turn around it, so this part of the orientation follows the encoders slowly.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Record, Vec2, Vec3, Vec6, Vec9, Vec18, record
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.dynamics_laws import add_base_acceleration
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, cross, dot, turned
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to
from stewart_drake.mechanics.rotations import rotation_between, turn_by, turned_back
from stewart_drake.robot.gravity import base_reading
from stewart_drake.safety.wrong_leg import encoder_lines, suspect_leg

if TYPE_CHECKING:
    from stewart_drake.hardware.imu import ImuOptions

ALIGNMENT = 0.5  # [s] from the start in which biases are found.
TILT_TIME, BIAS_TIME, TURN_TIME = 1.5, 10.0, 5.0
"""[s] in which gravity corrects the tilt and the gyroscopes' bias, and encoders the turn around gravity; assumed."""
MOST_TILT = 0.02
"""[rad] largest tilt with which gravity corrects. More of it is an acceleration that wrong readings do not show."""
TILT_MEAN, SAME, OPPOSITE = 0.1, 0.75, 0.5
"""[s] of a mean of this tilt; its distance from the level part of the difference, as a share of that, within which both
are the same; its share of that from which on it is opposite."""
BLOCK = 0.01
"""[s] least time between two positions of a second difference. It is more where noise would show as `MOST_TILT`."""
CHANGE_TIME, CHANGE_PERIODS, CHANGE_SHARE = 0.1, 10.0, 0.2
"""[s], [periods of the sensor] in which the difference may change by this share of its bound, besides noise and errors
of scale."""
SIGMAS, MOUNTING_ERROR = 6.0, 0.01
"""Standard deviations for which bounds have room; [rad] error of the sensor's mounting; assumed."""
LARGEST_RATE, LARGEST_TILT = math.radians(1.0), math.radians(4.0)
"""[rad/s], [rad] by which a bias may be larger: encoders' noise at the start, and a tilt of the base; assumed."""
SILENT, SILENT_PERIODS = 0.2, 5.0  # [s], [periods of the sensor] without a sample after which it has failed.
REPEATS = 10.0  # Samples in a row that noise never repeats to the last bit.
CONFIRMED, LEAST_TIME = 3.0, 0.005
"""Samples in a row beyond a bound, less those within it; [s] that one counts at least where readings fit no pose."""
ITERATIONS, TOLERANCE = 3, 1e-9  # Steps of Newton's method; [m] error of a rod.
AGREES, DIFFERS, CHANGED, FAILED = range(4)
"""DIFFERS: by more than the bound. CHANGED: too fast. FAILED: the sensor, or the readings fit no pose."""


class ParityParams(Record):
    """Parameters of the comparison."""

    period: float  # [s] of a sample.
    tick: float  # [s]
    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    mounting: Mat3  # R_PI of the sensor.
    place: Vec3  # [m] of the sensor in P.
    block: float  # [s] between two positions of a second difference.
    later: float  # [s] by which a sample of the inertial sensor is older than a reading of the encoders.
    bound: float  # [rad] largest difference of the two orientations, infinite for none.
    change_time: float  # [s] in which changes of the difference are compared.
    change: float  # [rad] largest change of the difference in this time.
    share: float  # [-] of the turn by which both may be larger.
    bias: Vec2  # [rad/s, m/s^2] largest plausible biases.
    excess: float  # [m/s^2] by which measured forces may exceed those expected in the mean of `change_time`.
    level: float  # [rad] least difference of which gravity tells whether the inertial sensor is wrong.
    range: float  # [m/s^2] from which on a force is not used.
    silent: float  # [s] longest time without a sample.
    repeats: float  # Times that a sample may be repeated to the last bit.


class ForceBlock(Record):
    """The samples since the last position for a second difference."""

    count: float  # Positions so far.
    weighed: float  # Blocks of which the bias is the mean.
    time: float  # [s]
    impulse: Vec3  # [m/s] integral of the measured force in B.
    path: Vec3  # [m] integral of that.
    last_impulse: Vec3  # Of the block before.
    last_path: Vec3
    place: Vec3  # [m] of the sensor in B at the start of the block.
    step: Vec3  # [m] to there from the start of the block before.


class ParityState(Record):
    """State of the comparison."""

    parity: Vec2  # 1 while the two differ, else 0; the leg whose reading is wrong, -1 for none.
    samples: float  # Number of samples so far.
    elapsed: float  # [s] since the last sample.
    unread: float  # [s] since the last pose.
    pose: Vec6  # [rad, m] of the encoders.
    rotation: Mat3  # R_BP of the inertial sensor.
    rate_bias: Vec3  # [rad/s] of the gyroscopes, in P.
    force_bias: Vec3  # [m/s^2] of the accelerometers, in P.
    difference: Vec3  # [rad] rotation in B from the inertial sensor's orientation to the encoders'.
    change: Vec3  # [rad] of this difference in `change_time`.
    turn: Vec3  # [rad] of the platform in this time.
    swing: Vec3  # [rad] of the platform in `TILT_TIME`.
    tilt: Vec3  # [rad] mean turn in B from the inertial orientation to that by gravity.
    excess: float  # [m/s^2] size of what measured forces exceed those expected, low-passed.
    count: float  # Samples beyond a bound, less those within it.
    result: float  # AGREES ... FAILED of the last tick.
    sample: Vec6  # The last one.
    repeats: float  # Times that it has been repeated.
    block: ForceBlock


@njit
def parity_sample(
    robot: Robot, params: ParityParams, angles: Vec6, imu: Vec6, reference: Vec18, legs: Legs, state: ParityState
) -> int:
    """A sample: readings (6,) [rad] of the encoders; rates [rad/s] and specific force [m/s^2] (6,) of the sensor.

    A sample of the sensor is the mean of its period; after missing ones the encoders' turn is taken instead. Readings
    that are not finite are left out.

    Returns:
        AGREES, DIFFERS, CHANGED or FAILED; `legs` are those of the encoders' pose.
    """
    rates, force, before = np.empty(3), np.empty(3), np.empty((3, 3))
    state.unread += state.elapsed
    if state.samples == 0.0:
        copy_to(state.pose[:], reference[:6])
    laws.rotation(state.pose[:3], before)
    is_read = all_finite(angles)
    fits = is_read and _read(robot, angles, legs, state)
    if state.samples == 0.0 and fits:
        for k in range(3):
            copy_to(state.rotation[k], legs.rotation[k])
    elif state.samples > 0.0:
        turned(params.mounting, imu[:3], rates)
        turned(params.mounting, imu[3:], force)
        late = fits and state.elapsed > 1.5 * params.period
        if late:
            rotation_between(legs.rotation, before, rates)
            turn_by(rates, state.rotation[:])
        else:
            _turn(params, rates, state)
        aligning = state.samples * params.period <= ALIGNMENT
        if fits:
            _compare(params, legs, before, aligning, state)
        _weigh(params, legs, force, fits and not late, aligning, state)
    state.samples += 1.0 if fits or state.samples > 0.0 else 0.0
    contradict = is_read and not fits and state.unread >= CONFIRMED * max(params.period, LEAST_TIME)
    result = FAILED if contradict else _judge(params, imu, state)
    state.elapsed, state.unread = 0.0, 0.0 if fits else state.unread
    state.count = min(max(0.0, state.count + (1.0 if result != AGREES else -1.0)), CONFIRMED)
    return result if contradict or state.count >= CONFIRMED else AGREES


@njit
def _read(robot: Robot, angles: Vec6, legs: Legs, state: ParityState) -> bool:
    """Pose and legs of readings; False, and the last pose, where there is none."""
    pose = state.pose.copy()
    error, _ = laws.forward_kinematics(robot, angles, pose, TOLERANCE, ITERATIONS)
    if not error <= 1e-3 * robot.length or laws.legs_at(robot, pose, legs) >= 0:
        return False
    copy_to(state.pose[:], pose)
    return True


@njit
def _turn(params: ParityParams, rates: Vec3, state: ParityState) -> None:
    """Turns the inertial orientation by a sample of the gyroscopes [rad/s] in P."""
    step, h = np.empty(3), state.elapsed
    for k in range(3):
        rates[k] -= state.rate_bias[k]
    turned(state.rotation, rates, step)
    keep, keep_swing = np.exp(-h / params.change_time), np.exp(-h / TILT_TIME)
    for k in range(3):
        step[k] = h * (step[k] - params.base[3 + k])
        state.change[k] *= keep
        state.turn[k] = keep * state.turn[k] + step[k]
        state.swing[k] = keep_swing * state.swing[k] + step[k]
    turn_by(step, state.rotation[:])


@njit
def _has_changed(params: ParityParams, state: ParityState) -> bool:
    """Whether the difference has changed by more than noise and errors of scale explain."""
    largest = params.change + params.share * np.sqrt(dot(state.turn, state.turn))
    return state.samples * params.period > params.change_time and dot(state.change, state.change) > largest * largest


@njit
def _compare(params: ParityParams, legs: Legs, before: Mat3, aligning: bool, state: ParityState) -> None:
    """Difference of the encoders' orientation from the inertial one, and its change; `before` is that of the last pose.

    While biases are found, as means, the difference corrects all of the orientation, later that around gravity.
    """
    now, step, in_platform = np.empty(3), np.empty(3), np.empty(3)
    rotation_between(legs.rotation, state.rotation, now)
    # The encoders' turn since a sample of this age.
    rotation_between(legs.rotation, before, step)
    around = dot(now, params.base[:3]) / dot(params.base[:3], params.base[:3]) * state.unread / TURN_TIME
    for k in range(3):
        now[k] -= step[k] * params.later / state.unread
        state.change[k] += now[k] - state.difference[k]
    aligning = aligning and not _has_changed(params, state)
    for k in range(3):
        step[k] = now[k] if aligning else around * params.base[k]
        state.difference[k] = now[k] - step[k]
    turn_by(step, state.rotation[:])
    turned_back(state.rotation, step, in_platform)
    share = 1.0 / (state.unread * state.samples) if aligning else 1.0 / BIAS_TIME
    for k in range(3):
        state.rate_bias[k] -= share * in_platform[k]


@njit
def _weigh(params: ParityParams, legs: Legs, force: Vec3, fits: bool, aligning: bool, state: ParityState) -> None:
    """Corrects the tilt by a sample of the accelerometers [m/s^2] in P; while biases are found, finds theirs."""
    block, h, time, length = state.block, state.elapsed, state.block.time + state.elapsed, params.block
    in_base, place, velocity, carried = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    turned(legs.rotation, params.place, place)
    for k in range(3):
        force[k] -= 0.0 if aligning else state.force_bias[k]
        place[k] += state.pose[3 + k]
        velocity[k], carried[k] = block.step[k] / length, params.base[k]
    add_base_acceleration(params.base, place, velocity, carried)
    turned(state.rotation, force, in_base)
    for k in range(3):
        in_base[k] -= carried[k]
        block.path[k] += h * (block.impulse[k] + 0.5 * h * in_base[k])
        block.impulse[k] += h * in_base[k]
    block.time = time
    if not fits or dot(force, force) > params.range * params.range:
        block.count = 0.0
    elif block.count == 0.0 or time >= params.block - 1e-9:
        excess, step = np.empty(3), np.empty(3)
        for k in range(3):
            step[k] = place[k] - block.place[k]
            change = block.path[k] - block.last_path[k] + time * block.last_impulse[k] - step[k] + block.step[k]
            excess[k] = change / time**2
            block.place[k] += step[k]
            block.step[k] = step[k]
            block.last_path[k], block.last_impulse[k] = block.path[k], block.impulse[k]
            block.path[k], block.impulse[k] = 0.0, 0.0
        block.time = 0.0
        block.count += 1.0
        if block.count >= 3.0:
            _tilt(params, excess, time, aligning, state)


@njit
def _tilt(params: ParityParams, excess: Vec3, time: float, aligning: bool, state: ParityState) -> None:
    """Corrects the tilt by what forces in a time [s] exceed the expected ones [m/s^2] in B."""
    step, in_platform, keep = np.empty(3), np.empty(3), np.exp(-time / params.change_time)
    state.excess = keep * state.excess + (1.0 - keep) * np.sqrt(dot(excess, excess))
    if aligning:
        turned_back(state.rotation, excess, in_platform)
        state.block.weighed += 1.0
        for k in range(3):
            state.force_bias[k] += (in_platform[k] - state.force_bias[k]) / state.block.weighed
        return
    cross(excess, params.base[:3], step)
    largest = max(dot(params.base[:3], params.base[:3]), np.sqrt(dot(step, step)) / MOST_TILT)
    for k in range(3):
        step[k] /= largest
        state.tilt[k] += min(1.0, time / TILT_MEAN) * (step[k] - state.tilt[k])
        step[k] *= time / TILT_TIME
        state.difference[k] -= step[k]
    turn_by(step, state.rotation[:])
    turned_back(state.rotation, step, in_platform)
    for k in range(3):
        state.rate_bias[k] -= in_platform[k] / BIAS_TIME


@njit
def _judge(params: ParityParams, imu: Vec6, state: ParityState) -> int:
    """Whether a sample is plausible, and agrees with the encoders."""
    same, plausible, difference = True, True, state.difference
    for k in range(6):
        same = same and imu[k] == state.sample[k]
    copy_to(state.sample[:], imu)
    state.repeats = state.repeats + 1.0 if same else 0.0
    if state.samples * params.period <= params.change_time:
        return AGREES
    for k in range(3):
        plausible = plausible and abs(state.rate_bias[k]) <= params.bias[0]
        plausible = plausible and abs(state.force_bias[k]) <= params.bias[1]
    if not plausible or state.repeats >= params.repeats or state.excess > params.excess:
        return FAILED
    if _has_changed(params, state):
        return CHANGED
    bound = params.bound + params.share * np.sqrt(dot(state.swing, state.swing))
    return DIFFERS if np.sqrt(dot(difference, difference)) > bound else AGREES


@njit
def _is_at_odds(params: ParityParams, difference: Vec3, state: ParityState) -> bool:
    """Whether gyroscopes and gravity contradict each other: the inertial sensor is wrong.

    Gyroscopes that are wrong go from gravity and encoders alike; wrong accelerometers go from both the other way.
    """
    level, apart = np.empty(3), np.empty(3)
    around = dot(difference, params.base[:3]) / dot(params.base[:3], params.base[:3])
    for k in range(3):
        level[k] = difference[k] - around * params.base[k]
        apart[k] = state.tilt[k] - level[k]
    size, odds, along = dot(level, level), dot(state.tilt, state.tilt), dot(state.tilt, level)
    if size < params.level * params.level:
        return False
    return dot(apart, apart) < SAME**2 * size or (along < 0.0 and odds > OPPOSITE**2 * size)


@njit
def _wrong_leg(params: ParityParams, legs: Legs, result: int, state: ParityState) -> int:
    """The leg whose reading is wrong, -1 for none."""
    wrong, down, lines = state.change if result == CHANGED else state.difference, np.zeros(3), np.empty((6, 3))
    if result == FAILED or _is_at_odds(params, wrong, state) or not encoder_lines(legs, lines):
        return -1
    leg, _ = suspect_leg(lines, wrong, down)
    if leg < 0 and result == DIFFERS:
        # Around gravity the inertial sensor has followed the readings.
        length = np.sqrt(dot(params.base[:3], params.base[:3]))
        for k in range(3):
            down[k] = params.base[k] / length
        leg, _ = suspect_leg(lines, wrong, down)
    return leg


@njit
def parity_tick(
    robot: Robot, params: ParityParams, reading: Vec6, imu: Vec6, reference: Vec18, legs: Legs, state: ParityState
) -> None:
    """A tick; `imu` (6,) is NaN where there is no new sample."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    state.elapsed += params.tick
    result = AGREES
    if all_finite(imu):
        result = parity_sample(robot, params, reading, imu, reference, legs, state)
    elif state.elapsed > params.silent:
        result = FAILED
    elif state.parity[0] != 0.0:
        return
    state.result = result
    if result == AGREES or params.bound == np.inf:
        state.parity[0], state.parity[1] = 0.0, -1.0
    elif state.parity[0] == 0.0:
        state.parity[0], state.parity[1] = 1.0, float(_wrong_leg(params, legs, result, state))


def parity_part(context: LoopContext, imu: ImuOptions, bound: float) -> Part:
    """`reading` (6,) [rad], `imu` (6,), `reference` (18,) -> `parity` (2,), for a bound [rad] of the difference."""
    period, robot, base = max(imu.period or 0.0, context.period), context.robot, base_reading(context.gravity)
    if not base[:3].any():
        raise ConfigurationError("safety.parity", bound, "null, without gravity")
    change_time = max(CHANGE_TIME, CHANGE_PERIODS * period)
    turn, shift = (
        float(np.linalg.norm(rows, 2)) for rows in np.split(np.linalg.inv(twist_jacobian(robot, robot.home_pose)), 2)
    )
    noise = change_time * imu.noise(change_time)[:3].max()
    # A second difference of noise has sqrt(6) times its size.
    shift *= math.sqrt(6.0) * context.noise
    block = max(BLOCK, period, math.sqrt(shift / (MOST_TILT * STANDARD_GRAVITY)))
    shift /= block**2
    noise = math.hypot(noise, turn * math.sqrt(2.0) * context.noise)
    share = SIGMAS * imu.scale_error
    force_bias = SIGMAS * imu.accelerometer_bias + (math.sin(LARGEST_TILT) + share) * STANDARD_GRAVITY
    params = ParityParams.new(
        period=period,
        tick=context.period,
        base=base,
        mounting=imu.mounting,
        place=imu.position,
        block=block,
        later=imu.delay - context.reading_age,
        bound=bound,
        change_time=change_time,
        change=CHANGE_SHARE * bound + SIGMAS * noise,
        share=share + MOUNTING_ERROR,
        bias=(SIGMAS * imu.gyro_bias + LARGEST_RATE, force_bias),
        excess=force_bias + SIGMAS * shift,
        level=0.5 * SIGMAS * min(1.0, block / TILT_MEAN) * shift / STANDARD_GRAVITY,
        range=0.99 * imu.accelerometer_range,
        silent=max(SILENT, SILENT_PERIODS * period),
        repeats=REPEATS if (imu.noise(period) > imu.quantum).any() else np.inf,
    )
    inputs, parameters = {"reading": 6, "imu": 6, "reference": 18}, {"robot": laws.robot_record(robot)}
    first = ParityState.new(parity=[0.0, -1.0])
    part = Part("parity", parity_tick, {}, inputs, ("parity",), first, (Legs,))
    return part._replace(parameters=parameters | {"params": params})


@njit
def parity_rows(
    robot: Robot,
    params: ParityParams,
    angles: np.ndarray,
    imu: np.ndarray,
    references: np.ndarray,
    legs: Legs,
    state: ParityState,
    out: np.ndarray,
) -> int:
    """`parity_tick` of rows; differences (n, 3) [rad]. Returns the first row in which the two differ, or -1."""
    first, now = -1, record(state)
    for row in range(len(angles)):
        parity_tick(robot, params, angles[row], imu[row], references[row], legs, state)
        copy_to(out[row], now.difference)
        if now.parity[0] != 0.0 and first < 0:
            first = row
    return first
