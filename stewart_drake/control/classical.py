"""Classical controllers: PID on the crank angles, which most such robots have, and computed torque in task space."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from stewart_drake.base.config import NotNegative, Period, Positive
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.control.base import (
    AT_REFERENCE,
    DERIVATIVE,
    FREQUENCY,
    INTEGRAL,
    PROPORTIONAL,
    ControllerOptions,
    controller_part,
    heave_inertia,
    limit_and_integrate,
    measured_legs,
    saturation_params,
)
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics_laws import motion_torque, static_torque, task_inertia
from stewart_drake.mechanics.kinematics_laws import (
    OK,
    PARALLEL,
    UNREACHABLE,
    Legs,
    crank_jacobian,
    crank_rates,
    legs_at,
    robot_record,
    twist_of,
)
from stewart_drake.mechanics.linear_algebra import solve

# --- PID of the cranks -----------------------------------------------------------------------------------------------


class PidOptions(ControllerOptions):
    """PID in joint space, with the same gains for all six motors or through the robot's inertia.

    The default gains give heave at home the stiffness, damping and integral action of the exact-model LQI with weights
    4e5, 30, 4e7, 1 and a weight length of 0.11 m. With the inertia M of heave and J = d(theta)/dZ, an acceleration gain
    k becomes k M / (6 J^2) at each crank. A scenario scales the gains to another robot by its M / sum J^2.

    For a slow bus: inertia robot, feedforward motion, derivative difference and sticking. Nothing but the reading
    itself is then fed back, neither a model's rate nor its disturbance: at 100 Hz with a tick of delay what a wrong
    model says comes too late to be mended.
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
    """What makes torques of errors. diagonal: the gains alone. robot: the inertia that the cranks feel at the reference
    too, so that all motions answer as heave at home does."""
    feedforward: Literal["none", "gravity", "motion"] = "gravity"
    """Torque added to the feedback. none: nothing. gravity: static torque of all bodies at the measured pose. motion:
    inverse dynamics of the reference at the time when the command acts; the feedback is that of now."""
    derivative: Literal["rate", "difference"] = "rate"
    """Rate of a crank's error. rate: from the measured rate of the pose. difference: of the error from tick to tick."""
    sticking: NotNegative = 0.0
    """[N m/rad] torque for the way that the reference goes on while a crank sticks, such as 4; 0 for none. It grows
    until the crank breaks away, the less so, the better its friction is known by what learns."""
    dead_band: NotNegative = 0.0
    """[counts] of the encoders, such as 2.5. A crank that is to rest and is less far off is right; its integral
    stays."""

    @property
    def looks_ahead(self) -> bool:
        """Whether its `reference` is that of when its command acts."""
        return self.feedforward == "motion"

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        robot, by_robot = context.robot, self.inertia == "robot"
        scale = 1.0 / heave_inertia(robot) if by_robot else 1.0
        params = new_record(
            _PID,
            self,
            **{name: scale * getattr(self, name) for name in ("kp", "ki", "kd")},
            gravity=context.gravity,
            feedforward=("none", "gravity", "motion").index(self.feedforward),
            by_robot=by_robot,
            by_difference=self.derivative == "difference",
            count=max(context.noise * np.sqrt(12.0), 1e-4),
            fade=np.exp(-self.period / FADES),
            **saturation_params(self, robot),
        )
        numbers = {"robot": robot_record(robot), "doubt": np.ones(6), "params": params}
        part = controller_part(pid_tick, robot, params, PID_STATE, Legs, Legs)
        return (part._replace(inputs={**part.inputs, "reference_now": 18}, parameters=numbers),)


GRAVITY, MOTION = 1.0, 2.0
MOVED, PASSED = 1.5, 3.0
"""[counts] of the encoders beyond which a crank has moved; that the reference must have passed it."""
SLOW = 1e-4  # [rad/s] a crank that is to turn more slowly is to rest.
FADES = 0.3  # [s] time constant with which a torque against sticking fades once the crank has broken away.
PID_STATE = fields(
    torque=6, health=2, crank_integral=6, error=6, against=6, anchor=6, passed=6, turning=6, wanted=6, ticks=()
)
"""torque [N m]. crank_integral, error: of the crank angles [rad s, rad]. against: torque that grows while a crank
sticks [N m]. anchor: angle of a crank when it last moved, passed: of the reference then, turning: the sign of its rate,
wanted: its angle at the tick before [rad]. ticks: done."""
_PID = fields(
    period=(), gravity=(), kp=(), ki=(), kd=(), feedforward=(), by_robot=(), by_difference=(), sticking=(),
    dead_band=(), count=(), fade=(), limit=6, clamp=(),
)  # fmt: skip
"""count: [rad] of an encoder. fade: share of a torque against sticking that a tick leaves."""


@njit
def pid_tick(
    robot: Any, doubt: Any, params: Any, measurement: Any, reference: Any, reference_now: Any, legs: Any,
    target_legs: Any, state: Any,
) -> Any:  # fmt: skip
    """T = T_feedforward - M (kp e + kd e' + ki z) with e = theta(pose) - theta(reference), wrapped to half a turn.

    M is 1, or the inertia (J M^-1 J')^-1 that the cranks feel, over that of heave at home. Crank angles by inverse
    kinematics, their rates by the Jacobian, of the measurement and of the reference alike. The integral changes after
    it has been used, see `limit_and_integrate`.

    Args:
        robot: robot as the controller believes it to be.
        doubt: (6,) how unknown the Coulomb friction of each motor is, 1 at first.
        params: Numbers of `PidOptions`, gains over the inertia of heave where they pass that of the robot.
        measurement: (12,) pose and rate now.
        reference: (18,) of the feedforward.
        reference_now: (18,) of the feedback.
        legs: `Legs` of the measurement, overwritten.
        target_legs: `Legs` of the reference, overwritten.
        state: `PID_STATE` of the tick before; that of this one where the status is OK.

    Returns:
        Status of `base.STATUSES`; leg or -1; margin.
    """
    robot, params, state = record(robot), record(params), record(state)
    legs, target = record(legs), record(target_legs)
    status, leg, margin = measured_legs(robot, measurement, legs)
    if status != OK:
        return status, leg, margin
    wanted, twist, rates, target_rates = np.zeros(6), np.empty(6), np.empty(6), np.empty(6)
    if params.feedforward == GRAVITY and not static_torque(robot, legs, params.gravity, wanted):
        return PARALLEL, -1, margin
    if params.feedforward == MOTION:
        bad = legs_at(robot, reference[:6], target)
        if bad >= 0:
            return AT_REFERENCE + UNREACHABLE, bad, target.reach_margin[bad]
        if not motion_torque(robot, target, reference[:12], reference[12:], params.gravity, wanted):
            return AT_REFERENCE + PARALLEL, -1, 0.0
    bad = legs_at(robot, reference_now[:6], target)
    if bad >= 0:
        return AT_REFERENCE + UNREACHABLE, bad, target.reach_margin[bad]
    twist_of(measurement[:6], measurement[6:], twist)
    crank_rates(legs, twist, rates)
    twist_of(reference_now[:6], reference_now[6:12], twist)
    crank_rates(target, twist, target_rates)
    feedback, counted, integral = np.empty((6, 1)), np.empty(6), state.crank_integral[:]
    for i in range(6):
        sine = legs.sine[i] * target.cosine[i] - legs.cosine[i] * target.sine[i]
        error = np.arctan2(sine, legs.cosine[i] * target.cosine[i] + legs.sine[i] * target.sine[i])
        change = rates[i] - target_rates[i]
        if params.by_difference == 1.0:
            change = (error - state.error[i]) / params.period if state.ticks > 0.0 else 0.0
        state.error[i] = error
        feedback[i, 0] = params.kp * error + params.kd * change + params.ki * integral[i]
        rests = abs(target_rates[i]) < SLOW and abs(error) < params.dead_band * params.count
        counted[i] = 0.0 if rests else error
        if params.sticking > 0.0:
            angle = np.arctan2(legs.sine[i], legs.cosine[i])
            _stick(params, doubt[i], i, angle, angle - error, target_rates[i], state)
    if params.by_robot == 1.0 and not _through_inertia(robot, target, feedback):
        return AT_REFERENCE + PARALLEL, -1, 0.0
    for i in range(6):
        wanted[i] += state.against[i] * state.turning[i] - feedback[i, 0]
    state.ticks += 1.0
    return limit_and_integrate(params, wanted, counted, True, state.torque[:], integral)


@njit
def _through_inertia(robot: Any, legs: Any, column: Any) -> bool:
    """(J M^-1 J')^-1 times a column (6, 1), in its place: J'^-1 M J^-1; False where there is none."""
    jacobian, inertia = np.empty((6, 6)), np.empty((6, 6))
    crank_jacobian(legs, jacobian)
    task_inertia(robot, legs, inertia)
    transposed = np.ascontiguousarray(jacobian.T)
    if solve(jacobian, column) == 0.0:
        return False
    torque = inertia @ column
    if solve(transposed, torque) == 0.0:
        return False
    for i in range(6):
        column[i, 0] = torque[i, 0]
    return True


@njit
def _stick(params: Any, doubt: float, leg: int, angle: float, wanted: float, rate: float, state: Any) -> None:
    """Whether a crank sticks while its reference goes on, and the torque against that."""
    turning = 0.0 if abs(rate) < SLOW else np.sign(rate)
    way = wanted - state.wanted[leg] if state.ticks > 0.0 else 0.0
    state.wanted[leg] = wanted
    moved = abs(angle - state.anchor[leg]) > MOVED * params.count
    if moved or turning != state.turning[leg] or state.ticks == 0.0:
        state.anchor[leg], state.passed[leg] = angle, wanted
    if turning != state.turning[leg]:
        state.against[leg] = 0.0
    state.turning[leg] = turning
    if (wanted - state.passed[leg]) * turning > PASSED * params.count:
        state.against[leg] += doubt * params.sticking * abs(way)
    else:
        state.against[leg] *= params.fade


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
        params = new_record(_COMPUTED_TORQUE, self, gravity=context.gravity, **saturation_params(self, context.robot))
        return (controller_part(computed_torque_tick, context.robot, params, COMPUTED_TORQUE_STATE, Legs),)


COMPUTED_TORQUE_STATE = fields(torque=6, integral=6, health=2)
"""torque [N m]. integral: z for the next tick [rad s, m s]."""
_COMPUTED_TORQUE = fields(
    period=(), gravity=(), natural_frequency=(), damping=(), integral_frequency=(), limit=6, clamp=()
)


@njit
def computed_torque_tick(robot: Any, params: Any, measurement: Any, reference: Any, legs: Any, state: Any) -> Any:
    """Inverse dynamics at the measured pose and rate for q''_d - 2 damping omega e' - omega^2 (e + omega_i z).

    The integral changes after it has been used, see `limit_and_integrate`.

    Arguments and result are as of `pid_tick`, of the numbers of `ComputedTorqueOptions`.
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
    if not motion_torque(robot, legs, measurement, acceleration, params.gravity, wanted):
        return PARALLEL, -1, 0.0
    return limit_and_integrate(params, wanted, error, False, state.torque[:], state.integral[:])
