"""The LQI, (19)-(34), with the paper's model or the exact one: options, the kernel of a tick, the part of a loop."""

from __future__ import annotations

from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Flag, Natural, Period, Positive, PositivePair
from stewart_drake.base.errors import ConfigurationError, RiccatiError, Status
from stewart_drake.base.jit import njit
from stewart_drake.base.records import (
    Mat6,
    Mat6x1,
    Mat6x18,
    Record,
    TickResult,
    Vec4,
    Vec6,
    Vec9,
    Vec12,
    Vec18,
    Vector,
    record,
)
from stewart_drake.control.base import (
    AT_REFERENCE,
    REFERENCE,
    STATUSES,
    ControllerOptions,
    ControllerState,
    Saturation,
    controller_part,
    limit_and_integrate,
    measured_legs,
    saturation_params,
)
from stewart_drake.control.riccati import RiccatiSolver, drake_gain, split_gain, split_solution
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.dynamics import ForceMapKind
from stewart_drake.mechanics.dynamics_laws import motion_torque, pose_acceleration_map, static_torque
from stewart_drake.mechanics.kinematics_laws import Legs, Robot
from stewart_drake.mechanics.linear_algebra import all_finite, any_nonzero, copy_to, set_to, solve
from stewart_drake.robot import Gravity, RobotParameters, base_reading
from stewart_drake.robot.leg import LARGEST_SIZE
from stewart_drake.robot.robot_scale import CHARACTERISTIC_LENGTH

Feedforward = Literal["none", "gravity", "platform", "full"]
NONE, GRAVITY, PLATFORM, FULL = range(4)


class LqiOptions(ControllerOptions):
    """Linear quadratic regulator with integral action (LQI); the defaults are the paper's, with gravity compensated."""

    weighted = True

    kind: Literal["lqi"] = "lqi"
    """The default kind."""
    period: Period = 0.005
    model: Literal["paper", "exact"] = "paper"
    """Model that the regulator is designed for. paper: (9), the platform's mass alone, with moments taken as
    Euler-angle accelerations. exact: inertia of the whole closed chain at the measured pose."""
    force_map: ForceMapKind = "statics"
    """Map from wrench to torques in the paper's model: tau_2 of (15) as the paper prints it, or from statics; the exact
    model has its own."""
    feedforward: Feedforward = "gravity"
    """Torque added to the feedback. none: nothing, as in the paper's (34). gravity: static torque of all bodies at the
    measured pose. platform: that and M q''_d of (9) through the force map at the measured pose. full: inverse dynamics
    of the exact model for the reference's acceleration."""
    feedforward_at: Literal["measured", "reference"] = "measured"
    """Pose and rate at which feedforward `full` is evaluated: the measured ones or the reference's."""
    weight_length: Annotated[Positive | None, Field(le=LARGEST_SIZE), CHARACTERISTIC_LENGTH] = 1.0
    """[m] length that makes rotations comparable with translations in the weight Q; 1 is the paper's. 0.11, the radius
    of the platform's joints, gives both the same weight at the joints. In a scenario null takes the robot's
    `characteristic_length`."""
    solver: RiccatiSolver | None = None
    """Solver of the Riccati equation, which decouples into six of 3 states. drake: Drake's, with `plant.kind: drake`
    alone. split: compiled, without Drake. null: drake with `plant.kind: drake`, split elsewhere."""
    saturation: Literal["none", "clamp", "back_calculation"] = "none"
    """Torque limit and anti-windup. none: commands may exceed the motors' limit. clamp: commands are limited and the
    integral z waits. back_calculation: commands are limited and z is corrected by the excess."""
    reset_time: Positive = 0.05
    """[s] time constant of back-calculation."""
    integral_limit: PositivePair | None = None
    """[rad s, m s] largest |z| of rotations and translations; null for none."""
    bumpless: Flag = False
    """Whether z changes with the weights, so that the integral torque does not jump."""
    hold_ticks: Annotated[Natural, Field(le=1000)] = 0
    """Ticks in a row that the last good gain and torque may bridge before the run ends: near a singularity, without a
    gain, or when a measurement is not finite."""

    @property
    def length(self) -> float:
        """[m] `weight_length`; a ConfigurationError if it is null outside of a scenario."""
        if self.weight_length is None:
            raise ConfigurationError("controller.weight_length", None, "a length, outside of a scenario")
        return self.weight_length

    @property
    def label(self) -> str:
        """Short description, for titles."""
        model = "exact model" if self.model == "exact" else f"force map {self.force_map}"
        return f"{model}, feedforward {self.feedforward}"

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        solver: RiccatiSolver | None = "split" if context.split else None
        return (lqi_part(self, context.robot, context.gravity, len(context.tuner.weights), solver),)


class LqiState(ControllerState):
    """State of the LQI."""

    integral: Vec6  # [rad s, m s] z for the next tick.
    gain: Mat6x18  # K
    feedforward: Vec6  # [N m] part of the torque.
    weights: Vec4  # q_e, q_v, q_z, r of this tick; zeros before the first.
    bridged: float  # Ticks in a row that were bridged.


class LqiParams(Saturation):
    """Parameters of the LQI: numbers of `LqiOptions`."""

    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    length: float  # [m] `weight_length`.
    integral_limit: Vec6  # [rad s, m s] infinite for none.
    exact_model: float  # 1 for the exact model, 0 for the paper's.
    printed_map: float  # 1 for tau_2 of (15) as printed.
    feedforward: float  # NONE, GRAVITY, PLATFORM or FULL.
    at_reference: float  # 1 where feedforward FULL is taken at the reference.
    back_share: float  # Share of the torque beyond the limit that back-calculation takes off z in a tick.
    bumpless: float  # 1 where z follows the weights.
    hold_ticks: float  # Ticks in a row that may be bridged.


class Problem(Record):
    """Riccati problem of a tick, and its solution."""

    weights: Vec4  # q_e, q_v, q_z, r
    map: Mat6  # M^-1 tau
    changed: float  # 1 where z has to follow a change of the weights.
    gain: Mat6x18  # K for these weights.
    before: Mat6x18  # K for the weights of the tick before, if they have changed.


def block_weights(weights: np.ndarray) -> np.ndarray:
    """q_e, q_v, q_z, r from either the paper's pair omega_Q, omega_R, (27), or all four; all positive and finite."""
    weights = np.asarray(weights, dtype=float)
    if weights.shape == (2,):
        weights = weights[[0, 0, 0, 1]]
    if weights.shape != (4,) or not (np.isfinite(weights) & (weights > 0.0)).all():
        raise RiccatiError(f"no gain for weights {weights.tolist()}: two or four are needed, positive and finite")
    return weights


def lqi_gain(acceleration_map: np.ndarray, options: LqiOptions, weights: np.ndarray) -> np.ndarray:
    """K (6, 18) of (31) for M^-1 tau (6, 6), u = -K [e; z] in the paper's state order, or RiccatiError.

    `weights` are two or four, see `block_weights`.
    """
    solve_for = split_gain if options.solver == "split" else drake_gain
    blocks = block_weights(weights).tolist()
    return solve_for(acceleration_map, options.period, blocks, options.length)


# --- the law ---------------------------------------------------------------------------------------------------------


@njit
def lqi_tick(
    robot: Robot,
    params: LqiParams,
    measurement: Vec12,
    reference: Vec18,
    weights: Vector,
    legs: Legs,
    problem: Problem,
    state: LqiState,
) -> TickResult:
    """The LQI of one tick: B(t) from the present pose, discretisation, Riccati, (34), feedforward, limits, (23).

    Deviation: u = -K e as in (34), not (30). The integral changes after it has been used, see `limit_and_integrate`.

    `weights` are omega_Q, omega_R or q_e, q_v, q_z, r; `legs` and `problem` are overwritten. Returns one of
    `base.STATUSES` or NO_WEIGHTS, leg or -1, margin.
    """
    status, leg, margin = pose_problem(robot, params, measurement, reference, weights, legs, problem, state)
    if status == laws.OK and not _solve_split(record(params), record(problem), record(state)):
        status = laws.NO_GAIN
    return command(robot, params, measurement, reference, legs, problem, status, leg, margin, state)


@njit
def _solve_split(params: LqiParams, problem: Problem, state: LqiState) -> bool:
    """Gains of a problem by `split_solution`; False where there is none."""
    length, period = params.length, params.period
    if not split_solution(problem.map[:], length, period, problem.weights[:], problem.gain[:]):
        return False
    return problem.changed == 0.0 or split_solution(problem.map[:], length, period, state.weights[:], problem.before[:])


@njit
def pose_problem(
    robot: Robot,
    params: LqiParams,
    measurement: Vec12,
    reference: Vec18,
    weights: Vector,
    legs: Legs,
    problem: Problem,
    state: LqiState,
) -> TickResult:
    """First half of a tick: legs and the Riccati problem; arguments and result as of `lqi_tick`."""
    robot, params, legs = record(robot), record(params), record(legs)
    problem, state = record(problem), record(state)
    if all_finite(measurement[6:]) and not all_finite(reference):
        return REFERENCE, -1, 0.0
    status, leg, margin = measured_legs(robot, measurement, legs)
    if status != laws.OK:
        return status, leg, margin
    for k in range(4):
        problem.weights[k] = weights[k] if weights.size == 4 else weights[0 if k < 3 else 1]
        if not 0.0 < problem.weights[k] < np.inf:
            return NO_WEIGHTS, -1, 0.0
    problem.changed = 0.0
    if params.bumpless == 1.0 and state.weights[0] != 0.0:
        for k in range(4):
            if state.weights[k] != problem.weights[k]:
                problem.changed = 1.0
    if params.exact_model == 0.0:
        paper_acceleration_map(robot, legs, params.printed_map == 1.0, problem.map[:])
    elif not pose_acceleration_map(robot, legs, measurement[:6], problem.map[:]):
        return laws.PARALLEL, -1, margin
    return laws.OK, -1, margin


@njit
def command(
    robot: Robot,
    params: LqiParams,
    measurement: Vec12,
    reference: Vec18,
    legs: Legs,
    problem: Problem,
    status: int,
    leg: int,
    margin: float,
    state: LqiState,
) -> TickResult:
    """Second half of a tick, after the solution: torque and state, or a bridge if one failed."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    if status == laws.OK:
        status, leg, margin = _command(robot, params, measurement, reference, legs, record(problem), state)
    if status != laws.OK and _bridged(params, measurement, reference, state):
        return laws.OK, -1, 0.0
    return status, leg, margin


@njit
def paper_acceleration_map(robot: Robot, legs: Legs, printed: bool, out: Mat6) -> None:
    """M^-1 tau (6, 6) of (10): M the platform's mass and moments alone, tau by statics or tau_2 of the paper's (15)."""
    for i in range(6):
        force = legs.transmission[i] / robot.crank_length[i] if printed else 1.0 / legs.lever[i]
        for k in range(3):
            out[k, i] = legs.line[i, k] * force / robot.platform_inertia[k]
            out[3 + k, i] = legs.line[i, 3 + k] * force / robot.platform_mass


@njit
def _feedback(gain: Mat6x18, measurement: Vec12, reference: Vec18, integral: Vec6, motor: int) -> float:
    """A row of K [e; e'; z]."""
    value = 0.0
    for k in range(6):
        value += gain[motor, 2 * k] * (measurement[k] - reference[k])
        value += gain[motor, 2 * k + 1] * (measurement[6 + k] - reference[6 + k])
        value += gain[motor, 12 + k] * integral[k]
    return value


@njit
def _feedforward(
    robot: Robot, params: LqiParams, measurement: Vec12, reference: Vec18, legs: Legs, force: Vec6
) -> TickResult:
    """Torque (6,) [N m] added to the feedback; overwrites `legs` if it is taken at the reference."""
    set_to(force, 0.0)
    if params.feedforward == FULL and params.at_reference == 1.0:
        bad = laws.legs_at(robot, reference[:6], legs)
        if bad >= 0:
            return AT_REFERENCE + laws.UNREACHABLE, bad, legs.reach_margin[bad]
        if not motion_torque(robot, legs, reference[:12], reference[12:], params.base[:], force):
            return AT_REFERENCE + laws.PARALLEL, -1, 0.0
        return laws.OK, -1, 0.0
    done = True
    if params.feedforward == FULL:
        done = motion_torque(robot, legs, measurement, reference[12:], params.base[:], force)
    elif params.feedforward != NONE and any_nonzero(params.base[:]):
        done = static_torque(robot, legs, params.base[:], force)
    if done and params.feedforward == PLATFORM:
        # M q''_d of (9) through the force map.
        paper_map, torque = np.empty((6, 6)), np.empty((6, 1))
        paper_acceleration_map(robot, legs, params.printed_map == 1.0, paper_map)
        for k in range(6):
            torque[k, 0] = reference[12 + k]
        done = solve(paper_map, torque) != 0.0
        for k in range(6):
            force[k] += torque[k, 0]
    return laws.OK if done else laws.PARALLEL, -1, 0.0


@njit
def _integral_of_torque(gain: Mat6x18, column: Mat6x1) -> bool:
    """The integral z that gives a torque (6, 1) by the last block of K, in its place; False where there is none."""
    block = np.empty((6, 6))
    for i in range(6):
        copy_to(block[i], gain[i, 12:])
    return solve(block, column) != 0.0


@njit
def _command(
    robot: Robot,
    params: LqiParams,
    measurement: Vec12,
    reference: Vec18,
    legs: Legs,
    problem: Problem,
    state: LqiState,
) -> TickResult:
    """(34), feedforward, limits, (23) with the gain of a solved problem; changes the state only if the status is OK."""
    integral, column = state.integral.copy(), np.zeros((6, 1))
    if problem.changed == 1.0:
        for i in range(6):
            for k in range(6):
                column[i, 0] += problem.before[i, 12 + k] * integral[k]
        if not _integral_of_torque(problem.gain, column):
            return laws.NO_GAIN, -1, 0.0
        copy_to(integral, column[:, 0])
    force, wanted, error, torque = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    status, leg, margin = _feedforward(robot, params, measurement, reference, legs, force)
    if status != laws.OK:
        return status, leg, margin
    for i in range(6):
        wanted[i] = force[i] - _feedback(problem.gain, measurement, reference, integral, i)
        error[i] = measurement[i] - reference[i]
    status, leg, margin = limit_and_integrate(params, wanted, error, False, torque, integral)
    if status != laws.OK:
        return status, leg, margin
    if params.back_share > 0.0:
        cut = np.empty((6, 1))
        for i in range(6):
            cut[i, 0] = wanted[i] - torque[i]
        if any_nonzero(cut[:, 0]):
            if not _integral_of_torque(problem.gain, cut):
                return laws.NO_GAIN, -1, 0.0
            for k in range(6):
                integral[k] += params.back_share * cut[k, 0]
    for k in range(6):
        bound = params.integral_limit[k]
        state.integral[k] = min(max(integral[k], -bound), bound)
    copy_to(state.torque[:], torque)
    copy_to(state.feedforward[:], force)
    copy_to(state.weights[:], problem.weights[:])
    for i in range(6):
        copy_to(state.gain[i], problem.gain[i])
    state.bridged = 0.0
    return laws.OK, -1, 0.0


@njit
def _bridged(params: LqiParams, measurement: Vec12, reference: Vec18, state: LqiState) -> bool:
    """Bridges a failed tick by the last good gain and feedforward; z is held. Returns whether it could.

    A measurement or reference that is not finite is bridged by the last torque. None before a good tick, and none after
    `hold_ticks` failures in a row.
    """
    if state.weights[0] == 0.0 or state.bridged >= params.hold_ticks:
        return False
    state.bridged += 1.0
    torque = np.empty(6)
    for i in range(6):
        torque[i] = state.feedforward[i] - _feedback(state.gain, measurement, reference, state.integral[:], i)
    if all_finite(measurement) and all_finite(torque):
        for k in range(6):
            state.torque[k] = min(max(torque[k], -params.limit[k]), params.limit[k])
    return True


NO_WEIGHTS = 7  # Status of weights that are not positive and finite.
_STATUSES = STATUSES | {
    NO_WEIGHTS: Status("riccati", text="no gain for weights {weights}: two or four are needed, positive and finite")
}


# --- the part --------------------------------------------------------------------------------------------------------


def lqi_part(
    options: LqiOptions, robot: RobotParameters, gravity: Gravity, weights: int, solver: RiccatiSolver | None = None
) -> Part:
    """The LQI as a part of a loop, for the controller's model, gravity [m/s^2], and a port of 2 or 4 weights.

    `solver` overrides the options'; `split` is one compiled call and needs no Drake.
    """
    params = LqiParams.new(
        options,
        base=base_reading(gravity),
        integral_limit=np.inf if options.integral_limit is None else np.repeat(options.integral_limit, 3),
        exact_model=options.model == "exact",
        printed_map=options.force_map == "printed",
        feedforward=get_args(Feedforward).index(options.feedforward),
        at_reference=options.feedforward_at == "reference",
        back_share=min(1.0, options.period / options.reset_time) if options.saturation == "back_calculation" else 0.0,
        **saturation_params(options.saturation, robot),
    )
    part = controller_part(lqi_tick, robot, params, LqiState, Legs, Problem)
    part = part._replace(inputs={**part.inputs, "weights": weights}, statuses=_STATUSES)
    if (solver or options.solver) != "split":
        part = part._replace(kernel=_tick_by_drake, constants={"options": options})
    return part


def _tick_by_drake(
    robot: Robot,
    params: LqiParams,
    options: LqiOptions,
    measurement: Vec12,
    reference: Vec18,
    weights: Vector,
    legs: Legs,
    problem: Problem,
    state: LqiState,
) -> TickResult:
    """`lqi_tick` with the gains of Drake's solver."""
    result = pose_problem(robot, params, measurement, reference, weights, legs, problem, state)
    if result[0] == laws.OK:
        at_pose, length = problem["map"][0], float(params["length"][0])
        try:
            problem["gain"] = drake_gain(at_pose, options.period, problem["weights"][0].tolist(), length)
            if problem["changed"][0]:
                before = state["weights"][0].tolist()
                problem["before"] = drake_gain(at_pose, options.period, before, length)
        except RiccatiError:
            result = (laws.NO_GAIN, -1, 0.0)
    return command(robot, params, measurement, reference, legs, problem, *result, state)
