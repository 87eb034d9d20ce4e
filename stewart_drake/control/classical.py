"""Classical controllers: PID of the crank angles, which most such robots have, and computed torque in task space."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np

from stewart_drake.base.config import NotNegative, Period, Positive
from stewart_drake.base.jit import njit
from stewart_drake.base.records import TickResult, Vec6, Vec9, Vec12, Vec18, record
from stewart_drake.control.base import (
    AT_REFERENCE,
    DERIVATIVE,
    FREQUENCY,
    INTEGRAL,
    PROPORTIONAL,
    ControllerOptions,
    ControllerState,
    Saturation,
    controller_part,
    heave_inertia,
    limit_and_integrate,
    measured_legs,
    saturation_params,
)
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics_laws import motion_torque, multiply_by_crank_inertia, static_torque
from stewart_drake.mechanics.kinematics_laws import (
    OK,
    PARALLEL,
    UNREACHABLE,
    Legs,
    Robot,
    crank_rates,
    legs_at,
    robot_record,
    twist_of,
)
from stewart_drake.robot.gravity import base_reading

# --- PID of the cranks -----------------------------------------------------------------------------------------------


class PidOptions(ControllerOptions):
    """PID in joint space, with the same gains for all six motors or through the robot's inertia.

    The default gains give heave at home the stiffness, damping and integral action of the exact-model LQI with weights
    4e5, 30, 4e7, 1 and a weight length of 0.11 m. With the inertia M of heave and J = d(theta)/dZ, an acceleration gain
    k becomes k M / (6 J^2) at a crank. A scenario scales the gains to another robot by its M / sum J^2.

    For a slow bus: inertia robot, feedforward motion, derivative difference and sticking. Only the reading is then fed
    back, not the rate or the disturbance of a model: at 100 Hz with a tick of delay, errors of the model are corrected
    too late.
    """

    saturation: ClassVar[str] = "clamp"

    kind: Literal["pid"] = "pid"
    period: Period = 0.001
    knobs = (("kp", "proportional"), ("ki", "integral"), ("kd", "derivative"))
    kp: Annotated[NotNegative, PROPORTIONAL] = 37.3
    """[N m/rad] proportional gain, on the error of a crank's angle."""
    ki: Annotated[NotNegative, INTEGRAL] = 316.0
    """[N m/(rad s)] integral gain; the integral of a motor at its limit stops growing."""
    kd: Annotated[NotNegative, DERIVATIVE] = 0.624
    """[N m s/rad] derivative gain, on the error of a crank's rate."""
    inertia: Literal["diagonal", "robot"] = "diagonal"
    """Matrix from errors to torques. diagonal: gains alone. robot: gains times the inertia at the cranks, at the
    reference, so that all motions respond as heave at home does."""
    feedforward: Literal["none", "gravity", "motion"] = "gravity"
    """Torque added to the feedback. none: nothing. gravity: static torque of all bodies at the measured pose. motion:
    inverse dynamics of the reference at the time when the command acts; the feedback uses the reference of now."""
    derivative: Literal["rate", "difference"] = "rate"
    """Rate of a crank's error. rate: from the measured rate of the pose. difference: difference of the error."""
    sticking: NotNegative = 0.0
    """[N m/rad] torque over the travel of the reference while a crank sticks, such as 4; 0 for none. It grows until the
    crank breaks away, more slowly where an adaptive law knows the friction better."""
    dead_band: NotNegative = 0.0
    """[counts] of the encoders, such as 2.5. The integral of a crank stays while its reference rests and its error is
    smaller."""

    @property
    def looks_ahead(self) -> bool:
        """Whether its `reference` is the one of the time when its command acts."""
        return self.feedforward == "motion"

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        robot, by_robot = context.robot, self.inertia == "robot"
        scale = 1.0 / heave_inertia(robot) if by_robot else 1.0
        params = PidParams.new(
            self,
            **{name: scale * getattr(self, name) for name in ("kp", "ki", "kd")},
            base=base_reading(context.gravity),
            feedforward=("none", "gravity", "motion").index(self.feedforward),
            by_robot=by_robot,
            by_difference=self.derivative == "difference",
            count=max(context.noise * np.sqrt(12.0), 1e-4),
            fade=np.exp(-self.period / FADE_TIME),
            **saturation_params(self.saturation, robot),
        )
        numbers = {"robot": robot_record(robot), "coulomb_uncertainty": np.ones(6), "params": params}
        part = controller_part(pid_tick, robot, params, PidState, Legs, Legs)
        return (part._replace(inputs={**part.inputs, "reference_now": 18}, parameters=numbers),)


GRAVITY, MOTION = 1.0, 2.0
MOVED, PASSED = 1.5, 3.0
"""[counts] of the encoders. A crank has moved beyond the first; it sticks if the reference then travels the second."""
SLOW = 1e-4  # [rad/s] a reference that turns a crank more slowly is at rest.
FADE_TIME = 0.3  # [s] time constant with which the torque against sticking fades after the crank has broken away.


class PidState(ControllerState):
    """State of the PID."""

    crank_integral: Vec6  # [rad s] integral of the errors, for the next tick.
    error: Vec6  # [rad] crank angles minus those of the reference.
    stick_torque: Vec6  # [N m] torque that grows while a crank sticks.
    last_moved: Vec6  # [rad] angle of a crank when it last moved.
    reference_at_move: Vec6  # [rad] angle of the reference at that time.
    direction: Vec6  # Sign of the reference's crank rate; 0 at rest.
    reference_angle: Vec6  # [rad] angle of the reference.
    ticks: float  # Ticks done.


class PidParams(Saturation):
    """Parameters of the PID: numbers of `PidOptions`, gains over the inertia of heave with `inertia: robot`."""

    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    kp: float  # [N m/rad], [1/s^2] with `inertia: robot`; ki and kd likewise.
    ki: float  # [N m/(rad s)]
    kd: float  # [N m s/rad]
    feedforward: float  # 0 for none, GRAVITY or MOTION.
    by_robot: float  # 1 for `inertia: robot`.
    by_difference: float  # 1 for `derivative: difference`.
    sticking: float  # [N m/rad]
    dead_band: float  # [counts]
    count: float  # [rad] of an encoder.
    fade: float  # Factor by which the torque against sticking fades in a tick.


@njit
def pid_tick(
    robot: Robot,
    coulomb_uncertainty: Vec6,
    params: PidParams,
    measurement: Vec12,
    reference: Vec18,
    reference_now: Vec18,
    legs: Legs,
    target_legs: Legs,
    state: PidState,
) -> TickResult:
    """T = T_feedforward - M (kp e + kd e' + ki z) with e = theta(pose) - theta(reference), wrapped to half a turn.

    M is 1, or the inertia (J M^-1 J')^-1 at the cranks over that of heave at home. Crank angles of measurement and
    reference are by inverse kinematics, their rates by the Jacobian. The integral changes after it has been used, see
    `limit_and_integrate`.

    `reference` is for the feedforward, `reference_now` for the feedback; `coulomb_uncertainty` is 1 at the start. Both
    `legs` are overwritten. Returns one of `base.STATUSES`, leg or -1, margin.
    """
    robot, params, state = record(robot), record(params), record(state)
    legs, target = record(legs), record(target_legs)
    status, leg, margin = measured_legs(robot, measurement, legs)
    if status != OK:
        return status, leg, margin
    wanted, twist, rates, target_rates = np.zeros(6), np.empty(6), np.empty(6), np.empty(6)
    if params.feedforward == GRAVITY and not static_torque(robot, legs, params.base[:], wanted):
        return PARALLEL, -1, margin
    if params.feedforward == MOTION:
        bad = legs_at(robot, reference[:6], target)
        if bad >= 0:
            return AT_REFERENCE + UNREACHABLE, bad, target.reach_margin[bad]
        if not motion_torque(robot, target, reference[:12], reference[12:], params.base[:], wanted):
            return AT_REFERENCE + PARALLEL, -1, 0.0
    bad = legs_at(robot, reference_now[:6], target)
    if bad >= 0:
        return AT_REFERENCE + UNREACHABLE, bad, target.reach_margin[bad]
    twist_of(measurement[:6], measurement[6:], twist)
    crank_rates(legs, twist, rates)
    twist_of(reference_now[:6], reference_now[6:12], twist)
    crank_rates(target, twist, target_rates)
    feedback, integral_error, integral = np.empty((6, 1)), np.empty(6), state.crank_integral[:]
    for i in range(6):
        sine = legs.sine[i] * target.cosine[i] - legs.cosine[i] * target.sine[i]
        error = np.arctan2(sine, legs.cosine[i] * target.cosine[i] + legs.sine[i] * target.sine[i])
        change = rates[i] - target_rates[i]
        if params.by_difference == 1.0:
            change = (error - state.error[i]) / params.period if state.ticks > 0.0 else 0.0
        state.error[i] = error
        feedback[i, 0] = params.kp * error + params.kd * change + params.ki * integral[i]
        rests = abs(target_rates[i]) < SLOW and abs(error) < params.dead_band * params.count
        integral_error[i] = 0.0 if rests else error
        if params.sticking > 0.0:
            angle = np.arctan2(legs.sine[i], legs.cosine[i])
            _update_stick_torque(params, coulomb_uncertainty[i], i, angle, angle - error, target_rates[i], state)
    if params.by_robot == 1.0 and not multiply_by_crank_inertia(robot, target, feedback):
        return AT_REFERENCE + PARALLEL, -1, 0.0
    for i in range(6):
        wanted[i] += state.stick_torque[i] * state.direction[i] - feedback[i, 0]
    state.ticks += 1.0
    return limit_and_integrate(params, wanted, integral_error, True, state.torque[:], integral)


@njit
def _update_stick_torque(
    params: PidParams, coulomb_uncertainty: float, leg: int, angle: float, target: float, rate: float, state: PidState
) -> None:
    """Grows the torque against sticking while a crank stays and its reference travels; fades it otherwise.

    Angles of the crank and of the reference [rad], rate of the reference [rad/s].
    """
    direction = 0.0 if abs(rate) < SLOW else np.sign(rate)
    travel = target - state.reference_angle[leg] if state.ticks > 0.0 else 0.0
    state.reference_angle[leg] = target
    moved = abs(angle - state.last_moved[leg]) > MOVED * params.count
    if moved or direction != state.direction[leg] or state.ticks == 0.0:
        state.last_moved[leg], state.reference_at_move[leg] = angle, target
    if direction != state.direction[leg]:
        state.stick_torque[leg] = 0.0
    state.direction[leg] = direction
    if (target - state.reference_at_move[leg]) * direction > PASSED * params.count:
        state.stick_torque[leg] += coulomb_uncertainty * params.sticking * abs(travel)
    else:
        state.stick_torque[leg] *= params.fade


# --- computed torque -------------------------------------------------------------------------------------------------


class ComputedTorqueOptions(ControllerOptions):
    """Computed torque, with the same error dynamics in all six coordinates of the pose.

    The default feedback is that of the exact-model LQI for heave at home, with weights 4e5, 30, 4e7, 1 and a weight
    length of 0.11 m.
    """

    knobs = (("natural_frequency", "natural frequency"), ("damping", "damping"), ("integral_frequency", "integral"))
    kind: Literal["computed_torque"] = "computed_torque"
    period: Period = 0.001
    natural_frequency: Annotated[Positive, FREQUENCY] = 93.8
    """[rad/s] natural frequency omega of e'' + 2 damping omega e' + omega^2 (e + integral_frequency z) = 0."""
    damping: Positive = 0.785
    """[-] damping ratio of the error dynamics."""
    integral_frequency: Annotated[NotNegative, FREQUENCY] = 8.47
    """[rad/s] integral action, see `natural_frequency`; 0 is a PD loop, which keeps a steady error where the model is
    wrong."""
    saturation: Literal["none", "clamp"] = "clamp"
    """Torque limit and anti-windup. none: commands may exceed the motors' limit. clamp: commands are limited and the
    integral z waits."""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        params = ComputedTorqueParams.new(
            self, base=base_reading(context.gravity), **saturation_params(self.saturation, context.robot)
        )
        return (controller_part(computed_torque_tick, context.robot, params, ComputedTorqueState, Legs),)


class ComputedTorqueState(ControllerState):
    """State of computed torque."""

    integral: Vec6  # [rad s, m s] z for the next tick.


class ComputedTorqueParams(Saturation):
    """Parameters of computed torque: numbers of `ComputedTorqueOptions`."""

    base: Vec9  # What the base's inertial unit reads, see `base_reading`.
    natural_frequency: float  # [rad/s]
    damping: float
    integral_frequency: float  # [rad/s]


@njit
def computed_torque_tick(
    robot: Robot,
    params: ComputedTorqueParams,
    measurement: Vec12,
    reference: Vec18,
    legs: Legs,
    state: ComputedTorqueState,
) -> TickResult:
    """Inverse dynamics at the measured pose and rate for q''_d - 2 damping omega e' - omega^2 (e + omega_i z).

    The integral changes after it has been used, see `limit_and_integrate`. Result as of `pid_tick`.
    """
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    status, leg, margin = measured_legs(robot, measurement, legs)
    if status != OK:
        return status, leg, margin
    omega, acceleration, error, wanted = params.natural_frequency, np.empty(6), np.empty(6), np.empty(6)
    for k in range(6):
        error[k] = measurement[k] - reference[k]
        stiff = omega * omega * (error[k] + params.integral_frequency * state.integral[k])
        damped = 2.0 * params.damping * omega * (measurement[6 + k] - reference[6 + k])
        acceleration[k] = reference[12 + k] - damped - stiff
    if not motion_torque(robot, legs, measurement, acceleration, params.base[:], wanted):
        return PARALLEL, -1, 0.0
    return limit_and_integrate(params, wanted, error, False, state.torque[:], state.integral[:])
