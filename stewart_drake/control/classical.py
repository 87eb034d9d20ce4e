"""Classical controllers: PID on the crank angles, which most such robots have, and computed torque in task space."""

from __future__ import annotations

from typing import Annotated, Any, Literal

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
    limit_and_integrate,
    measured_legs,
    saturation_params,
)
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics_laws import motion_torque, static_torque
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    OK,
    PARALLEL,
    UNREACHABLE,
    crank_rates,
    legs_at,
    twist_of,
)

# --- PID of the cranks -----------------------------------------------------------------------------------------------


class PidOptions(ControllerOptions):
    """PID in joint space, with the same gains for all six motors.

    The default gains give heave at home the stiffness, damping and integral action of the exact-model LQI with weights
    4e5, 30, 4e7, 1 and a weight length of 0.11 m. With the inertia M of heave and J = d(theta)/dZ, an acceleration gain
    k becomes k M / (6 J^2) at each crank. A scenario scales the gains to another robot by its M / sum J^2.
    """

    kind: Literal["pid"] = "pid"
    period: Period = 0.001
    knobs = (("kp", "proportional"), ("ki", "integral"), ("kd", "derivative"))
    kp: Annotated[NotNegative, PROPORTIONAL] = 37.3
    """[N m/rad] proportional gain, on the error of a crank's angle."""
    ki: Annotated[NotNegative, INTEGRAL] = 316.0
    """[N m/(rad s)] integral gain."""
    kd: Annotated[NotNegative, DERIVATIVE] = 0.624
    """[N m s/rad] derivative gain, on the error of a crank's rate."""
    feedforward: Literal["none", "gravity"] = "gravity"
    """Torque added to the feedback. none: nothing. gravity: static torque of all bodies at the measured pose."""
    saturation: Literal["none", "clamp", "back_calculation"] = "clamp"
    """Torque limit and anti-windup. none: commands may exceed the motors' limit. clamp: commands are limited, and the
    integral of a motor at its limit stops growing. back_calculation: commands are limited, and the integral gives back
    the excess within `reset_time`."""
    reset_time: Positive = 0.05
    """[s] time constant of back-calculation."""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        params = new_record(
            _PID,
            self,
            gravity=context.gravity if self.feedforward == "gravity" else 0.0,
            gain=self.ki * np.eye(6),
            **saturation_params(self, context.robot),
        )
        if self.ki == 0.0:
            params["back_share"] = 0.0  # There is no integral torque to reduce.
        return (controller_part(pid_tick, context.robot, params, PID_STATE, LEGS, LEGS),)


PID_STATE = fields(torque=6, health=2, crank_integral=6)
"""torque [N m]. crank_integral: of the errors of the crank angles, for the next tick [rad s]."""
_PID = fields(period=(), gravity=(), kp=(), kd=(), gain=(6, 6), limit=6, clamp=(), back_share=())


@njit
def pid_tick(robot: Any, params: Any, measurement: Any, reference: Any, legs: Any, target_legs: Any, state: Any) -> Any:
    """T = T_gravity - kp e - kd e' - ki z with e = theta(pose) - theta(reference), wrapped to half a turn.

    Crank angles by inverse kinematics, their rates by the Jacobian, of the measurement and of the reference alike. The
    integral changes after it has been used, see `limit_and_integrate`.

    Args:
        robot: `ROBOT` as the controller believes it to be.
        params: Numbers of `PidOptions`. gravity: 0 for no feedforward. gain: ki on the diagonal.
        measurement: (12,) pose and rate now.
        reference: (18,) now.
        legs: `LEGS` of the measurement, overwritten.
        target_legs: `LEGS` of the reference, overwritten.
        state: `PID_STATE` of the tick before; that of this one where the status is OK.

    Returns:
        Status of `base.STATUSES`; leg or -1; margin.
    """
    robot, params, state = record(robot), record(params), record(state)
    legs, target = record(legs), record(target_legs)
    status, leg, margin = measured_legs(robot, measurement, legs)
    if status != OK:
        return status, leg, margin
    bad = legs_at(robot, reference[:6], target)
    if bad >= 0:
        return AT_REFERENCE + UNREACHABLE, bad, target.reach_margin[bad]
    weight, twist, rates, target_rates = np.zeros(6), np.empty(6), np.empty(6), np.empty(6)
    if params.gravity != 0.0 and not static_torque(robot, legs, params.gravity, weight):
        return PARALLEL, -1, margin
    twist_of(measurement[:6], measurement[6:], twist)
    crank_rates(legs, twist, rates)
    twist_of(reference[:6], reference[6:12], twist)
    crank_rates(target, twist, target_rates)
    wanted, error, integral = np.empty(6), np.empty(6), state.crank_integral[:]
    for i in range(6):
        sine = legs.sine[i] * target.cosine[i] - legs.cosine[i] * target.sine[i]
        error[i] = np.arctan2(sine, legs.cosine[i] * target.cosine[i] + legs.sine[i] * target.sine[i])
        integral_torque = params.gain[i, i] * integral[i]
        wanted[i] = weight[i] - (params.kp * error[i] + params.kd * (rates[i] - target_rates[i]) + integral_torque)
    return limit_and_integrate(params, wanted, error, params.gain[:], True, state.torque[:], integral)


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
        return (controller_part(computed_torque_tick, context.robot, params, COMPUTED_TORQUE_STATE, LEGS),)


COMPUTED_TORQUE_STATE = fields(torque=6, integral=6, health=2)
"""torque [N m]. integral: z for the next tick [rad s, m s]."""
_COMPUTED_TORQUE = fields(
    period=(), gravity=(), natural_frequency=(), damping=(), integral_frequency=(), limit=6, clamp=(), back_share=()
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
    # Without back-calculation no gain is asked for.
    return limit_and_integrate(params, wanted, error, np.empty((6, 6)), False, state.torque[:], state.integral[:])
