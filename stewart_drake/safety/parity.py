"""Parity of the encoders and an inertial sensor on the platform: which of them is wrong.

Six readings give the platform's orientation exactly, and never contradict each other. The inertial sensor gives the
orientation again: gyroscopes turn it, and the direction of gravity corrects its tilt slowly (complementary filter:
R. Mahony, T. Hamel, J.-M. Pflimlin, IEEE Trans. Autom. Control 53, 2008). The difference of the two is a rotation
vector. An encoder that is wrong moves it along a line of its own, one of six, which the Jacobian gives; an inertial
sensor that is wrong moves it along none of them.

Gravity says nothing about a turn around it, so this part of the orientation follows the encoders slowly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Mat6x3, Record, Vec2, Vec3, Vec6, Vec18, record
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, cross, dot, turned
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, set_to, solve
from stewart_drake.robot.gravity import gravity_vector

if TYPE_CHECKING:
    from stewart_drake.hardware.imu import ImuOptions

ALIGNMENT = 0.5  # [s] from the start in which biases are found; the robot's readings are believed in that time.
TILT_TIME, BIAS_TIME, TURN_TIME = 1.0, 20.0, 5.0
"""[s] in which gravity corrects the tilt and the gyroscopes' bias, and encoders the turn around gravity; assumed."""
TRUSTED_FORCE = 0.2  # Share of gravity by which the specific force may differ from the expected one.
MOST_TILT = 0.02
"""[rad] largest tilt with which gravity corrects. A larger one is an acceleration, as of a robot with a fault."""
CONFIRMED = 3.0  # Samples in a row beyond the bound, less those within it.
ONE_LINE, OTHER_LINES = 0.35, 0.7
"""Share of the difference that is off a leg's line, below which the leg is named; and its largest share of that of the
next leg."""
ITERATIONS, TOLERANCE = 3, 1e-9  # Steps of Newton's method; [m] error of a rod.
AGREES, DIFFERS = 0, 1


class ParityParams(Record):
    """Parameters of the comparison."""

    period: float  # [s] of a sample.
    gravity: Vec3  # [m/s^2] in B.
    mounting: Mat3  # R_PI of the sensor.
    place: Vec3  # [m] of the sensor in P.
    later: float  # [s] by which a sample of the inertial sensor is older than a reading of the encoders.
    bound: float  # [rad] largest difference of the two orientations.


class ParityState(Record):
    """State of the comparison."""

    parity: Vec2  # 1 while the two differ, else 0; the leg whose reading is wrong, -1 for none.
    samples: float  # Number of samples so far.
    pose: Vec6  # [rad, m] of the encoders.
    rotation: Mat3  # R_BP of the inertial sensor.
    rate_bias: Vec3  # [rad/s] of the gyroscopes, in P.
    force_bias: Vec3  # [m/s^2] of the accelerometers, in P.
    true_rate: Vec3  # [rad/s] of the encoders in a sample of the alignment, in P.
    true_force: Vec3  # [m/s^2] likewise.
    difference: Vec3  # [rad] rotation in B from the inertial sensor's orientation to the encoders'.
    count: float  # Samples beyond the bound, less those within it.


@njit
def turn_by(vector: Vec3, matrix: Mat3) -> None:
    """Turns a rotation matrix by a rotation vector [rad] in its outer frame, in place (Rodrigues)."""
    angle = np.sqrt(dot(vector, vector))
    s = np.sin(angle) / angle if angle > 1e-8 else 1.0
    c = (1.0 - np.cos(angle)) / angle**2 if angle > 1e-8 else 0.5
    axis, first, second = np.empty(3), np.empty(3), np.empty(3)
    for column in range(3):
        for k in range(3):
            axis[k] = matrix[k, column]
        cross(vector, axis, first)
        cross(vector, first, second)
        for k in range(3):
            matrix[k, column] += s * first[k] + c * second[k]


@njit
def rotation_between(matrix: Mat3, other: Mat3, out: Vec3) -> None:
    """Rotation vector [rad] of `matrix` times the transpose of `other`, of angles below pi."""
    trace, first, second, product = 0.0, np.empty(3), np.empty(3), np.empty(3)
    set_to(out, 0.0)
    for m in range(3):
        for k in range(3):
            first[k], second[k] = matrix[k, m], other[k, m]
        trace += dot(first, second)
        # The vector of the skew part of sum_m a_m b_m^T is half the sum of b_m x a_m.
        cross(second, first, product)
        for k in range(3):
            out[k] += 0.5 * product[k]
    sine = np.sqrt(dot(out, out))
    angle = np.arctan2(sine, 0.5 * (trace - 1.0))
    scale = angle / sine if sine > 1e-9 else 1.0
    for k in range(3):
        out[k] *= scale


@njit
def turned_back(matrix: Mat3, vector: Vec3, out: Vec3) -> None:
    """Transpose of a matrix times a vector."""
    for i in range(3):
        out[i] = matrix[0, i] * vector[0] + matrix[1, i] * vector[1] + matrix[2, i] * vector[2]


@njit
def sensor_acceleration(place: Vec3, reference: Vec18, out: Vec3) -> None:
    """Acceleration [m/s^2] in B of a place (3,) [m] in P, in the motion of a reference (18,)."""
    turn, arm, omega, alpha, drift = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    rpy = reference[:3]
    laws.rotation(rpy, turn)
    turned(turn, place, arm)
    laws.angular_velocity(rpy, reference[6:9], omega)
    laws.angular_velocity(rpy, reference[12:15], alpha)
    laws.euler_drift(rpy, reference[6:9], drift)
    inner, outer = np.empty(3), np.empty(3)
    cross(omega, arm, inner)
    cross(omega, inner, outer)
    for k in range(3):
        alpha[k] += drift[k]
    cross(alpha, arm, inner)
    for k in range(3):
        out[k] = reference[15 + k] + inner[k] + outer[k]


@njit
def encoder_lines(legs: Legs, out: Mat6x3) -> bool:
    """Turn of the platform [rad] in B per radian of each crank, rows (6, 3); False at a singularity."""
    columns, lines = np.zeros((6, 6)), legs.line.copy()
    for i in range(6):
        columns[i, i] = legs.lever[i]
    if solve(lines, columns) == 0.0:
        return False
    for i in range(6):
        for k in range(3):
            out[i, k] = columns[k, i]
    return True


@njit
def suspect_leg(lines: Mat6x3, difference: Vec3) -> tuple[int, float]:
    """The leg along whose line (6, 3) a difference (3,) [rad] lies, and the error [rad] of its reading; -1 for none.

    None: the inertial sensor is wrong, or more than one encoder.
    """
    size = np.sqrt(dot(difference, difference))
    leg, error, best, second = -1, 0.0, np.inf, np.inf
    for i in range(6):
        squared, along, rest = dot(lines[i], lines[i]), dot(lines[i], difference), 0.0
        for k in range(3):
            rest += (difference[k] - along / squared * lines[i, k]) ** 2
        rest = np.sqrt(rest) / size
        if rest < best:
            leg, error, best, second = i, along / squared, rest, best
        elif rest < second:
            second = rest
    if best < ONE_LINE and best < OTHER_LINES * second:
        return leg, error
    return -1, 0.0


@njit
def parity_sample(
    robot: Robot, params: ParityParams, angles: Vec6, imu: Vec6, reference: Vec18, legs: Legs, state: ParityState
) -> int:
    """A sample: readings (6,) [rad] of the encoders; rates [rad/s] and specific force [m/s^2] (6,) of the sensor.

    A sample of the sensor is the mean of the time since the last one.

    Returns:
        AGREES or DIFFERS; `legs` are those of the encoders' pose. Samples that are not finite are left out.
    """
    if not (all_finite(angles) and all_finite(imu)):
        return AGREES
    pose, before = state.pose[:], np.empty((3, 3))
    is_first = state.samples == 0.0
    if is_first:
        copy_to(pose, reference[:6])
    laws.rotation(pose[:3], before)
    error, _ = laws.forward_kinematics(robot, angles, pose, TOLERANCE, ITERATIONS)
    if not error <= 1e-3 * robot.length or laws.legs_at(robot, pose, legs) >= 0:
        return AGREES
    if is_first:
        for k in range(3):
            copy_to(before[k], legs.rotation[k])
    rates, force, expected = np.empty(3), np.empty(3), np.empty(3)
    turned(params.mounting, imu[:3], rates)
    turned(params.mounting, imu[3:], force)
    sensor_acceleration(params.place, reference, expected)
    for k in range(3):
        expected[k] -= params.gravity[k]
    state.samples += 1.0
    if state.samples * params.period <= ALIGNMENT:
        _align(params, legs, before, rates, force, expected, state)
        return AGREES
    _turn(params, legs, before, rates, force, expected, state)
    size = np.sqrt(dot(state.difference, state.difference))
    state.count = max(0.0, state.count + (1.0 if size > params.bound else -1.0))
    state.count = min(state.count, CONFIRMED)
    return DIFFERS if state.count >= CONFIRMED else AGREES


@njit
def _align(
    params: ParityParams, legs: Legs, before: Mat3, rates: Vec3, force: Vec3, expected: Vec3, state: ParityState
) -> None:
    """Finds both biases as means; the orientation is that of the encoders."""
    turn, share, late = np.empty(3), 1.0 / state.samples, params.later / params.period
    rotation_between(legs.rotation, before, turn)
    true_rate, true_force = np.empty(3), np.empty(3)
    turned_back(legs.rotation, turn, true_rate)
    turned_back(legs.rotation, expected, true_force)
    for k in range(3):
        true_rate[k] /= params.period
        if state.samples == 1.0:
            state.true_rate[k], state.true_force[k] = true_rate[k], true_force[k]
        # What a sample of its age shows.
        rate = true_rate[k] - late * (true_rate[k] - state.true_rate[k])
        measurable = true_force[k] - late * (true_force[k] - state.true_force[k])
        state.rate_bias[k] += share * (rates[k] - rate - state.rate_bias[k])
        state.force_bias[k] += share * (force[k] - measurable - state.force_bias[k])
        turn[k] *= -late
        copy_to(state.rotation[k], legs.rotation[k])
    copy_to(state.true_rate[:], true_rate)
    copy_to(state.true_force[:], true_force)
    turn_by(turn, state.rotation[:])


@njit
def _turn(
    params: ParityParams, legs: Legs, before: Mat3, rates: Vec3, force: Vec3, expected: Vec3, state: ParityState
) -> None:
    """Turns the inertial orientation, corrects it by gravity, and compares it with the encoders'."""
    rotation, step, h = state.rotation[:], np.empty(3), params.period
    for k in range(3):
        rates[k] -= state.rate_bias[k]
        force[k] -= state.force_bias[k]
    turned(rotation, rates, step)
    for k in range(3):
        step[k] *= h
    turn_by(step, rotation)
    # Gravity: the tilt that turns the measured force into the expected one.
    measured, tilt, in_platform = np.empty(3), np.zeros(3), np.empty(3)
    turned(rotation, force, measured)
    weight, largest = np.sqrt(dot(expected, expected)), np.sqrt(dot(params.gravity, params.gravity))
    if abs(np.sqrt(dot(measured, measured)) - weight) < TRUSTED_FORCE * largest:
        cross(measured, expected, tilt)
        share = h / (TILT_TIME * max(weight**2, np.sqrt(dot(tilt, tilt)) / MOST_TILT))
        for k in range(3):
            tilt[k] *= share
        turn_by(tilt, rotation)
        turned_back(rotation, tilt, in_platform)
        for k in range(3):
            state.rate_bias[k] -= in_platform[k] / BIAS_TIME
    difference = state.difference[:]
    rotation_between(legs.rotation, rotation, difference)
    # Around gravity: the encoders.
    around = dot(difference, params.gravity) / largest**2 * h / TURN_TIME
    for k in range(3):
        step[k] = around * params.gravity[k]
    turn_by(step, rotation)
    turned_back(rotation, step, in_platform)
    for k in range(3):
        state.rate_bias[k] -= in_platform[k] / BIAS_TIME
    # The encoders' turn since a sample of this age.
    rotation_between(legs.rotation, before, step)
    for k in range(3):
        difference[k] -= step[k] * params.later / h


@njit
def parity_tick(
    robot: Robot, params: ParityParams, reading: Vec6, imu: Vec6, reference: Vec18, legs: Legs, state: ParityState
) -> None:
    """A tick; `imu` (6,) is NaN where there is no new sample."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    if parity_sample(robot, params, reading, imu, reference, legs, state) == AGREES:
        state.parity[0], state.parity[1] = 0.0, -1.0
    elif state.parity[0] == 0.0:
        lines = np.empty((6, 3))
        leg = suspect_leg(lines, state.difference)[0] if encoder_lines(legs, lines) else -1
        state.parity[0], state.parity[1] = 1.0, float(leg)


def parity_part(context: LoopContext, imu: ImuOptions, bound: float) -> Part:
    """`reading` (6,) [rad], `imu` (6,), `reference` (18,) -> `parity` (2,), for a bound [rad] of the difference."""
    params = ParityParams.new(
        period=imu.period or context.period,
        gravity=gravity_vector(context.gravity),
        mounting=imu.mounting,
        place=imu.position,
        later=imu.delay - context.reading_age,
        bound=bound,
    )
    inputs, parameters = {"reading": 6, "imu": 6, "reference": 18}, {"robot": laws.robot_record(context.robot)}
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
    """`parity_sample` of rows; differences (n, 3) [rad]. Returns the first row that differs, or -1."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    first = -1
    for row in range(len(angles)):
        result = parity_sample(robot, params, angles[row], imu[row], references[row], legs, state)
        copy_to(out[row], state.difference)
        if result == DIFFERS and first < 0:
            first = row
    return first
