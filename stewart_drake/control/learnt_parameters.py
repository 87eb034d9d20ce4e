"""What the regression has learnt: parameters of other parts, and numbers with their intervals, compiled."""

from __future__ import annotations

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Vec3, Vector, record
from stewart_drake.control.regression_records import RegressionParams, RegressionState, joint_unknowns, moment_unknowns
from stewart_drake.control.square_root_filter import (
    COULOMB,
    DAMPING,
    DELAY,
    DRIVE,
    HEAD,
    MOTOR_COULOMB,
    MOTOR_DAMPING,
    MOTOR_DRIVE,
    N_JOINT,
    N_MOTOR,
    N_SHARED,
    variance_along,
)
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics_laws import Robot
from stewart_drake.mechanics.linear_algebra import set_to

LEAST_DAMPING, MOST_DAMPING, MOST_COULOMB = -0.1, 0.6, 0.4
"""Bounds [s/rad] and [-], over the torque limit. If the delay of the model is too long, the estimated damping is
negative."""
HALF_WIDTH = 1.96
"""Half of a 95 % interval over the standard deviation."""


@njit
def write_parameters(params: RegressionParams, model: Robot, friction: Friction, state: RegressionState) -> None:
    """Writes the parameters of other parts by the applied numbers; `model` and `friction` are those at first."""
    shared, model_friction = state.applied_shared, record(friction)
    head, links = _mass_factors(params, shared)
    robot = state.robot
    robot.rod_mass, robot.rod_inertia = links * model.rod_mass, links * model.rod_inertia
    robot.crank_mass, robot.platform_mass = links * model.crank_mass, head * model.platform_mass
    for i in range(6):
        robot.crank_inertia[i] = links * model.crank_inertia[i]
    for k in range(3):
        robot.platform_moment[k] = head * model.platform_moment[k]
        robot.platform_inertia[k] = head * model.platform_inertia[k]
        for n in range(3):
            robot.platform_tensor[k, n] = head * model.platform_tensor[k, n]
    for k in range(moment_unknowns(state)):
        robot.platform_moment[k] += links * shared[N_SHARED + k]
    state.command_lead[0] = shared[DELAY]
    for i in range(6):
        damping, coulomb = _friction_of(params, state.applied_per_motor[i], shared, i)
        drive = np.exp(-(shared[DRIVE] + state.applied_per_motor[i, MOTOR_DRIVE])) if params.by_gain == 1.0 else 1.0
        viscous = drive * damping - params.servo_damping
        excess = model_friction.break_away[i] - model_friction.coulomb[i]
        if params.cautious == 1.0:
            viscous *= 1.0 - _uncertainty(params, state, i, MOTOR_DAMPING) ** 2 if viscous > 0.0 else 1.0
            known = 1.0 - _uncertainty(params, state, i, MOTOR_COULOMB) ** 2
            coulomb, excess = known * coulomb, known * excess
        state.gain[i] = drive * params.gain[i]
        state.friction.coulomb[i] = drive * coulomb
        state.friction.break_away[i] = drive * coulomb + excess
        state.friction.viscous[i] = viscous
    if joint_unknowns(state) > 0:
        state.joints.viscous = _joint_friction(params, state, len(shared) - N_JOINT)
        state.joints.coulomb = _joint_friction(params, state, len(shared) - N_JOINT + 1)


@njit
def update_intervals(params: RegressionParams, model: Robot, state: RegressionState) -> None:
    """Updates what was learnt, with its intervals, and the largest errors of the friction that other parts get."""
    shared, row, learnt, width = state.bounded_shared, _no_row(state), state.learnt, state.learnt_half_width
    head, links = _mass_factors(params, shared)
    learnt.mass = model.platform_mass * head
    row[N_MOTOR + HEAD], row[N_MOTOR + DRIVE] = learnt.mass, learnt.mass * (1.0 - params.by_gain)
    width.mass = _half_width(params, state, 0, row)
    learnt.delay = shared[DELAY]
    if params.by_angle == 1.0:
        row[N_MOTOR + DELAY] = 1.0
        width.delay = _half_width(params, state, 0, row)
    for i in range(6):
        drive = np.exp(-(shared[DRIVE] + state.bounded_per_motor[i, MOTOR_DRIVE]))
        size = drive if params.by_gain == 1.0 else 1.0
        damping, coulomb = _friction_of(params, state.bounded_per_motor[i], shared, i)
        learnt.drive[i], learnt.viscous[i] = drive, size * damping - params.servo_damping
        learnt.coulomb[i] = size * coulomb
        width.drive[i] = _motor_half_width(params, state, i, MOTOR_DRIVE, -drive, 0.0)
        # Friction is estimated as a torque of the model, which the drive multiplies.
        width.viscous[i] = _motor_half_width(params, state, i, MOTOR_DAMPING, size, -size * damping * params.by_gain)
        width.coulomb[i] = _motor_half_width(params, state, i, MOTOR_COULOMB, size, -size * coulomb * params.by_gain)
        state.coulomb_uncertainty[i] = _uncertainty(params, state, i, MOTOR_COULOMB)
        used, unknown = state.friction, state.friction_unknown
        unknown.coulomb[i] = width.coulomb[i] + abs(learnt.coulomb[i] - used.coulomb[i])
        unknown.viscous[i] = width.viscous[i] + abs(learnt.viscous[i] - used.viscous[i])
    for k in range(moment_unknowns(state)):
        change = links * shared[N_SHARED + k]
        state.learnt_center_of_mass.value[k] = (head * model.platform_moment[k] + change) / learnt.mass
        # Moment over mass: the mass acts on what is beyond the model's centre.
        row[N_MOTOR + N_SHARED + k], row[N_MOTOR + HEAD] = links / learnt.mass, -change / learnt.mass
        state.learnt_center_of_mass.half_width[k] = _half_width(params, state, 0, row)
    if joint_unknowns(state) > 0:
        joints, at = state.learnt_joints, len(shared) - N_JOINT
        joints.viscous, joints.viscous_half_width = _joint_interval(params, state, at)
        joints.coulomb, joints.coulomb_half_width = _joint_interval(params, state, at + 1)


@njit
def first_intervals(params: RegressionParams, model: Robot, state: RegressionState) -> None:
    """`update_intervals` of arrays, before the first tick."""
    update_intervals(record(params), record(model), record(state))


@njit
def _no_row(state: RegressionState) -> Vector:
    return np.zeros(N_MOTOR + len(state.shared))


@njit
def _half_width(params: RegressionParams, state: RegressionState, leg: int, row: Vector) -> float:
    """Half the 95 % interval of a linear combination of a motor's unknowns; the row becomes zero."""
    width = HALF_WIDTH * _deviation(params, state, leg, row)
    set_to(row, 0.0)
    return width


@njit
def _motor_half_width(
    params: RegressionParams, state: RegressionState, leg: int, unknown: int, slope: float, by_drive: float
) -> float:
    """Half the 95 % interval of a number of a motor, by its derivatives by an unknown and by the drive."""
    row = _no_row(state)
    row[unknown] = row[N_MOTOR + DRIVE + unknown] = slope
    if unknown != MOTOR_DRIVE:
        row[MOTOR_DRIVE] = row[N_MOTOR + DRIVE] = by_drive
    return _half_width(params, state, leg, row)


@njit
def _joint_interval(params: RegressionParams, state: RegressionState, at: int) -> tuple[float, float]:
    """Friction of ball joints by the shared unknown at a place, and half its 95 % interval."""
    row, shared = _no_row(state), state.bounded_shared
    size = np.exp(-shared[DRIVE] * params.by_gain)
    row[N_MOTOR + at], row[N_MOTOR + DRIVE] = size, -size * shared[at] * params.by_gain
    return size * shared[at], _half_width(params, state, 0, row)


@njit
def _joint_friction(params: RegressionParams, state: RegressionState, at: int) -> float:
    """Friction of ball joints that is compensated, by the shared unknown at a place."""
    known, shared = 1.0, state.applied_shared
    if params.cautious == 1.0:
        row = _no_row(state)
        row[N_MOTOR + at] = 1.0
        known -= (_deviation(params, state, 0, row) / params.shared_sigma[at]) ** 2
    return known * np.exp(-shared[DRIVE] * params.by_gain) * shared[at]


@njit
def _uncertainty(params: RegressionParams, state: RegressionState, leg: int, unknown: int) -> float:
    """Standard deviation of an unknown of a motor, its shared part included, over the initial one."""
    row = _no_row(state)
    row[unknown] = row[N_MOTOR + DRIVE + unknown] = 1.0
    return _deviation(params, state, leg, row) / np.hypot(
        params.shared_sigma[DRIVE + unknown], params.motor_sigma[unknown]
    )


@njit
def _deviation(params: RegressionParams, state: RegressionState, leg: int, row: Vector) -> float:
    """Standard deviation of a linear combination of a motor's unknowns; at most the initial one."""
    first = 0.0
    for k in range(len(row)):
        first += (row[k] * (params.motor_sigma[k] if k < N_MOTOR else params.shared_sigma[k - N_MOTOR])) ** 2
    variance = state.noise_scale**2 * variance_along(state.motor_rows[leg], state.shared_rows, row)
    return np.sqrt(min(variance, first))


@njit
def _mass_factors(params: RegressionParams, shared: Vector) -> tuple[float, float]:
    """Mass of the head, and of cranks and rods, over that of the model."""
    links = np.exp(shared[DRIVE]) if params.by_gain == 0.0 else 1.0
    return links * np.exp(shared[HEAD]), links


@njit
def _friction_of(params: RegressionParams, motor: Vec3, shared: Vector, leg: int) -> tuple[float, float]:
    """Damping [N m s/rad] and Coulomb friction [N m] of a motor, within bounds, as torques of the model."""
    limit = params.limit[leg]
    damping = params.damping[leg] + shared[DAMPING] + motor[MOTOR_DAMPING]
    coulomb = shared[COULOMB] + motor[MOTOR_COULOMB]
    # What an earlier run has learnt, and the model has now, is not cut.
    most_damping = max(MOST_DAMPING * limit, params.damping[leg])
    most_coulomb = max(MOST_COULOMB * limit, params.coulomb[leg])
    return min(max(damping, LEAST_DAMPING * limit), most_damping), min(max(coulomb, 0.0), most_coulomb)
