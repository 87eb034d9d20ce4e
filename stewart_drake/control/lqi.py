"""One tick of the LQI, (19)-(34), by the paper's model or by the exact one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from stewart_drake.control.inputs import (
    AT_REFERENCE,
    REFERENCE,
    TORQUE,
    all_finite,
    failure,
    measured_legs,
)
from stewart_drake.control.lqi_options import Feedforward, LqiOptions, Saturation
from stewart_drake.control.riccati import RiccatiSolver, riccati_gain, solve_drake, split_gain, split_solution
from stewart_drake.control.state_space import (
    AXES,
    INTEGRAL,
    POSITION,
    RATE,
    STATES,
    discretize,
    input_matrix,
    state_matrix,
)
from stewart_drake.errors import RiccatiError, RunFailure
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.dynamics_laws import motion_torque, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    NO_GAIN,
    NOT_FINITE,
    OK,
    PARALLEL,
    UNREACHABLE,
    legs_at,
    robot_record,
)
from stewart_drake.mechanics.linear_algebra import solve
from stewart_drake.part import Part
from stewart_drake.robot import RobotParameters

LQI_STATE = fields(
    torque=6, error=6, integral=6, health=2, gain=(6, 18), feedforward=6, weights=4, held=()
)  # fmt: skip
"""torque [N m]. error: measured pose minus setpoint [rad, m]. integral: z for the next tick [rad s, m s]. gain: K.
feedforward: part of the torque [N m]. weights: q_e, q_v, q_z, r of this tick, zeros before the first. held: ticks in a
row that were bridged."""

LQI_SETUP = fields(
    period=(), gravity=(), length=(), min_transmission=(), min_conditioning=(), integral_limit=6, back_share=(),
    exact_model=(), printed_map=(), feedforward=(), at_reference=(), exact_hold=(), saturation=(), bumpless=(),
    hold_ticks=(),
)  # fmt: skip
"""Numbers of `LqiOptions`; choices are 0 or 1, or count as below. integral_limit: infinite for none. back_share: of
what was cut off that z gives back in a tick."""
NONE, GRAVITY, PLATFORM, FULL = range(4)
"""Kinds of feedforward."""
CLAMP, BACK_CALCULATION = 1, 2
"""Kinds of saturation but none."""


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


def lqi_gain(
    acceleration_map: np.ndarray, options: LqiOptions, weights: np.ndarray, solver: RiccatiSolver | None = None
) -> np.ndarray:
    """K of (31) for M^-1 tau at the present pose, u = -K [e; z] in the paper's state order.

    Args:
        acceleration_map: (6, 6) M^-1 tau.
        options: Period, discretisation, solver and `weight_length`.
        weights: (2,) omega_Q, omega_R of (27), or (4,) q_e, q_v, q_z, r; all > 0.
        solver: Another than the options'.

    Returns:
        (6, 18).

    Raises:
        RiccatiError: No stabilising solution.
    """
    q_e, q_v, q_z, r = (float(w) for w in block_weights(weights))
    if (solver or options.solver) == "split":
        blocks = (q_e, q_v, q_z, r)
        return split_gain(acceleration_map, options.period, blocks, options.discretization, options.length)
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), options.period, options.discretization)
    scale = np.array([options.length**2] * 3 + [1.0] * 3)
    q = np.zeros(STATES)
    q[POSITION], q[RATE], q[INTEGRAL] = q_e * scale, q_v * scale, q_z * scale
    big_r = r * np.eye(AXES)
    return riccati_gain(a, b, big_r, solve_drake(a, b, np.diag(q), big_r))


# --- the law ---------------------------------------------------------------------------------------------------------


@njit
def paper_acceleration_map(robot: Any, legs: Any, printed: bool, out: Any) -> None:
    """M^-1 tau (6, 6) of (10): M the platform's mass and moments alone, tau by statics or tau_2 of (15) as printed."""
    for i in range(6):
        force = legs.transmission[i] / robot.crank_length[i] if printed else 1.0 / legs.lever[i]
        for k in range(3):
            out[k, i] = legs.line[i, k] * force / robot.platform_inertia[k]
            out[3 + k, i] = legs.line[i, 3 + k] * force / robot.platform_mass


@njit
def _model(
    robot: Any, setup: Any, measurement: Any, reference: Any, weights: Any, legs: Any, blocks: Any, own: Any
) -> Any:
    """What a gain is for: fills legs, weights (4,) and M^-1 tau (6, 6); status, leg, margin."""
    if all_finite(measurement[6:]) and not all_finite(reference):
        return NOT_FINITE, REFERENCE, 0.0
    status, leg, margin = measured_legs(robot, setup.min_transmission, setup.min_conditioning, measurement, legs)
    if status != OK:
        return status, leg, margin
    for k in range(4):
        blocks[k] = weights[k] if weights.size == 4 else weights[k // 3]
        if not 0.0 < blocks[k] < np.inf:
            return NO_GAIN, -1, 0.0
    if setup.exact_model == 0.0:
        paper_acceleration_map(robot, legs, setup.printed_map == 1.0, own)
    elif not pose_acceleration_map(robot, legs, measurement[:6], own):
        return PARALLEL, -1, margin
    return OK, -1, margin


@njit
def _weights_change(setup: Any, blocks: Any, state: Any) -> bool:
    """Whether weights differ from those of the tick before in a way that z has to follow."""
    if setup.bumpless == 0.0 or state.weights[0] == 0.0:
        return False
    return bool(np.any(state.weights != blocks))


@njit
def _integral_for(gain: Any, torque: Any) -> bool:
    """Turns a torque (6, 1) into the z for which K_z z is that torque, in place; False where K_z is singular."""
    return solve(gain[:, 12:].copy(), torque) != 0.0


@njit
def _feedback(gain: Any, measurement: Any, reference: Any, integral: Any, motor: int) -> float:
    """A row of K [e; e'; z]."""
    value = 0.0
    for k in range(6):
        value += gain[motor, 2 * k] * (measurement[k] - reference[k])
        value += gain[motor, 2 * k + 1] * (measurement[6 + k] - reference[6 + k])
        value += gain[motor, 12 + k] * integral[k]
    return value


@njit
def _feedforward(robot: Any, setup: Any, measurement: Any, reference: Any, legs: Any, force: Any) -> Any:
    """Torque (6,) beside the feedback; destroys `legs` where it is taken at the reference. Status, leg, margin."""
    force[:] = 0.0
    if setup.feedforward == FULL and setup.at_reference == 1.0:
        bad = legs_at(robot, reference[:6], legs)
        if bad >= 0:
            return AT_REFERENCE + UNREACHABLE, bad, legs.reach[bad]
        if not motion_torque(robot, legs, reference[:12], reference[12:], setup.gravity, force):
            return AT_REFERENCE + PARALLEL, -1, 0.0
        return OK, -1, 0.0
    done = True
    if setup.feedforward == FULL:
        done = motion_torque(robot, legs, measurement, reference[12:], setup.gravity, force)
    elif setup.feedforward != NONE and setup.gravity != 0.0:
        done = static_torque(robot, legs, setup.gravity, force)
    if done and setup.feedforward == PLATFORM:
        # M q''_d of (9) through the force map.
        paper_map, torque = np.empty((6, 6)), np.empty((6, 1))
        paper_acceleration_map(robot, legs, setup.printed_map == 1.0, paper_map)
        torque[:, 0] = reference[12:]
        done = solve(paper_map, torque) != 0.0
        force += torque[:, 0]
    return OK if done else PARALLEL, -1, 0.0


@njit
def _command(
    robot: Any, setup: Any, measurement: Any, reference: Any, legs: Any, blocks: Any, gain: Any, before: Any, state: Any
) -> Any:
    """The rest of a tick, once its gain (6, 18) is known: (34), feedforward, limits, (23).

    `before` is the gain for the weights of the tick before, where `_weights_change`. Changes the state where all is
    well. Status, leg, margin.
    """
    integral, column = state.integral.copy(), np.zeros((6, 1))
    if _weights_change(setup, blocks, state):
        for i in range(6):
            for k in range(6):
                column[i, 0] += before[i, 12 + k] * integral[k]
        if not _integral_for(gain, column):
            return NO_GAIN, -1, 0.0
        integral[:] = column[:, 0]
    force, torque, cut = np.empty(6), np.empty(6), np.zeros((6, 1))
    status, leg, margin = _feedforward(robot, setup, measurement, reference, legs, force)
    if status != OK:
        return status, leg, margin
    saturated = False
    for i in range(6):
        wanted, limit = force[i] - _feedback(gain, measurement, reference, integral, i), robot.effort_limit[i]
        if not np.isfinite(wanted):
            return NOT_FINITE, TORQUE, wanted
        torque[i] = wanted
        if setup.saturation != NONE and abs(wanted) > limit:
            saturated = True
            torque[i] = limit if wanted > 0.0 else -limit
            cut[i, 0] = wanted - torque[i]
    if saturated and setup.saturation == BACK_CALCULATION:
        if not _integral_for(gain, cut):
            return NO_GAIN, -1, 0.0
        integral += setup.back_share * cut[:, 0]
    for k in range(6):
        state.error[k] = measurement[k] - reference[k]
        if not (saturated and setup.saturation == CLAMP):
            integral[k] += setup.period * state.error[k]
        bound = setup.integral_limit[k]
        state.integral[k] = min(max(integral[k], -bound), bound)
    state.torque[:], state.gain[:], state.feedforward[:], state.weights[:] = torque, gain, force, blocks
    state.held = 0.0
    return OK, -1, 0.0


@njit
def _bridged(robot: Any, setup: Any, measurement: Any, reference: Any, state: Any) -> bool:
    """Whether a tick that failed goes on with the last good gain and feedforward, z standing still.

    A measurement or reference that is not finite is bridged by the last torque. Not before a good tick, and not where
    more than `hold_ticks` failed in a row.
    """
    if state.weights[0] == 0.0 or state.held >= setup.hold_ticks:
        return False
    state.held += 1.0
    torque = np.empty(6)
    for i in range(6):
        torque[i] = state.feedforward[i] - _feedback(state.gain, measurement, reference, state.integral, i)
    if all_finite(measurement) and all_finite(torque):
        for k in range(6):
            limit = np.inf if setup.saturation == NONE else robot.effort_limit[k]
            state.torque[k] = min(max(torque[k], -limit), limit)
            state.error[k] = measurement[k] - reference[k]
    return True


@njit
def lqi_tick(
    robots: Any, setups: Any, measurement: Any, reference: Any, weights: Any, leg_records: Any, states: Any
) -> Any:
    """The LQI of one tick: B(t) from the present pose, discretisation, Riccati, (34), feedforward, limits, (23).

    Deviation: u = -K e as in (34), not (30). The integral grows by period * e after it has been used.

    Args:
        robots: `ROBOT` as the controller believes it to be.
        setups: `LQI_SETUP`.
        measurement: (12,) pose and rate now.
        reference: (18,) now.
        weights: (2,) omega_Q, omega_R, or (4,) q_e, q_v, q_z, r.
        leg_records: `LEGS`, overwritten.
        states: `LQI_STATE` of the tick before; that of this one where the status is OK.

    Returns:
        Status; leg or -1, or which signal is NOT_FINITE; margin.
    """
    robot, setup, legs, state = record(robots), record(setups), record(leg_records), record(states)
    blocks, own, gain, before = np.empty(4), np.empty((6, 6)), np.empty((6, 18)), np.empty((6, 18))
    status, leg, margin = _model(robot, setup, measurement, reference, weights, legs, blocks, own)
    if status == OK:
        exact_hold = setup.exact_hold == 1.0
        done = split_solution(own, setup.length, setup.period, blocks, exact_hold, gain)
        if done and _weights_change(setup, blocks, state):
            done = split_solution(own, setup.length, setup.period, state.weights, exact_hold, before)
        if done:
            status, leg, margin = _command(robot, setup, measurement, reference, legs, blocks, gain, before, state)
        else:
            status = NO_GAIN
    if status != OK and _bridged(robot, setup, measurement, reference, state):
        return OK, -1, 0.0
    return status, leg, margin


# --- the same around a gain of Drake's -------------------------------------------------------------------------------


@njit
def _model_tick(
    robots: Any, setups: Any, measurement: Any, reference: Any, weights: Any, legs: Any, blocks: Any, own: Any
) -> Any:
    return _model(record(robots), record(setups), measurement, reference, weights, record(legs), blocks, own)


@njit
def _change_tick(setups: Any, blocks: Any, states: Any) -> bool:
    return _weights_change(record(setups), blocks, record(states))


@njit
def _command_tick(
    robots: Any, setups: Any, measurement: Any, reference: Any, legs: Any, blocks: Any, gain: Any, before: Any,
    states: Any,
) -> Any:  # fmt: skip
    robot, setup, state = record(robots), record(setups), record(states)
    return _command(robot, setup, measurement, reference, record(legs), blocks, gain, before, state)


@njit
def _bridge_tick(robots: Any, setups: Any, measurement: Any, reference: Any, states: Any) -> bool:
    return _bridged(record(robots), record(setups), measurement, reference, record(states))


# --- the part --------------------------------------------------------------------------------------------------------


def lqi_part(
    options: LqiOptions, robot: RobotParameters, gravity: float, weights: int, solver: RiccatiSolver | None = None
) -> Part:
    """The LQI as a part of a loop.

    Args:
        options: See `LqiOptions`.
        robot: Geometry and masses as the controller believes them.
        gravity: [m/s^2] for the feedforward; 0 switches the gravity torque off.
        weights: Size of the port, 2 or 4.
        solver: Another than the options': `split` is one compiled call and needs no Drake.

    Returns:
        Its tick raises where no good tick came before or more than `hold_ticks` failed in a row: NotFiniteError for
        measurement, reference or the torque that comes of them; UnreachablePoseError and SingularPoseError for the
        measured pose, or the reference's where `feedforward_at` is that; RiccatiError for a gain that does not exist.
    """
    robots, setup, legs = robot_record(robot), lqi_setup(options, gravity), np.empty(1, LEGS)

    def error_of(ended: tuple[int, int, float], *inputs: np.ndarray) -> RunFailure:
        if ended[0] == NO_GAIN:
            try:
                block_weights(inputs[2])
            except RiccatiError as error:
                return error
        return failure(options, ended, *inputs[:2])

    def split_tick(measurement: np.ndarray, reference: np.ndarray, weights: np.ndarray, state: np.ndarray) -> None:
        ended = lqi_tick(robots, setup, measurement, reference, weights, legs, state)
        if ended[0] != OK:
            raise error_of(ended, measurement, reference, weights)

    blocks, own = np.empty(4), np.empty((6, 6))

    def drake_tick(measurement: np.ndarray, reference: np.ndarray, weights: np.ndarray, state: np.ndarray) -> None:
        inputs = measurement, reference, weights
        try:
            ended = _model_tick(robots, setup, *inputs, legs, blocks, own)
            if ended[0] == OK:
                gain = before = lqi_gain(own, options, blocks, "drake")
                if _change_tick(setup, blocks, state):
                    before = lqi_gain(own, options, state["weights"][0], "drake")
                ended = _command_tick(robots, setup, *inputs[:2], legs, blocks, gain, before, state)
            if ended[0] != OK:
                raise error_of(ended, *inputs)
        except RunFailure:
            if not _bridge_tick(robots, setup, *inputs[:2], state):
                raise

    return Part(
        "controller",
        {"measurement": 12, "reference": 18, "weights": weights},
        ("torque", "error", "integral"),
        new_record(LQI_STATE),
        split_tick if (solver or options.solver) == "split" else drake_tick,
    )


def lqi_setup(options: LqiOptions, gravity: float) -> np.ndarray:
    """`LQI_SETUP` of options."""
    limits: Sequence[float] = (np.inf, np.inf) if options.integral_limit is None else options.integral_limit
    return new_record(
        LQI_SETUP,
        period=options.period,
        gravity=gravity,
        length=options.length,
        min_transmission=options.min_transmission,
        min_conditioning=options.min_conditioning,
        integral_limit=np.repeat(limits, 3),
        back_share=min(1.0, options.period / options.reset_time),
        exact_model=options.model == "exact",
        printed_map=options.force_map == "printed",
        feedforward=get_args(Feedforward).index(options.feedforward),
        at_reference=options.feedforward_at == "reference",
        exact_hold=options.discretization == "exact",
        saturation=get_args(Saturation).index(options.saturation),
        bumpless=options.bumpless,
        hold_ticks=options.hold_ticks,
    )
