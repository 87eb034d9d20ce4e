"""Classical controllers: PID on the crank angles, which most such robots have, and computed torque in task space."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np

from stewart_drake.config import NotNegative, Period, Positive
from stewart_drake.control.base import (
    AT_REFERENCE,
    DERIVATIVE,
    FREQUENCY,
    INTEGRAL,
    PROPORTIONAL,
    TORQUE,
    ControllerOptions,
    controller_part,
    measured_legs,
)
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.dynamics_laws import motion_torque, static_torque
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    NOT_FINITE,
    OK,
    PARALLEL,
    UNREACHABLE,
    crank_rates,
    legs_at,
    twist_of,
)
from stewart_drake.part import Part, Setup

# --- PID of the cranks -----------------------------------------------------------------------------------------------


class PidOptions(ControllerOptions):
    """PID in joint space, with the same gains for all six motors.

    The default gains give heave at home the stiffness, damping and integral action of the exact-model LQI with weights
    4e5, 30, 4e7, 1 and a weight length of 0.11 m. With the inertia M of heave and J = d(theta)/dZ, an acceleration gain
    k becomes k M / (6 J^2) at each crank. A scenario scales the gains to another robot by its M / sum J^2.
    """

    kind: Literal["pid"] = "pid"
    period: Period = 0.001
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

    def parts(self, setup: Setup) -> tuple[Part, ...]:
        gives_back = self.saturation == "back_calculation" and self.ki > 0.0
        numbers = new_record(
            _PID,
            self,
            gravity=setup.gravity if self.feedforward == "gravity" else 0.0,
            limit=np.inf if self.saturation == "none" else setup.robot.effort_limits,
            clamp=self.saturation == "clamp",
            given_back=min(1.0, self.period / self.reset_time) / self.ki if gives_back else 0.0,
        )
        return (controller_part(pid_tick, setup.robot, numbers, PID_STATE, LEGS, LEGS),)


PID_STATE = fields(torque=6, error=6, integral=6, health=2, crank_integral=6)
"""torque [N m]. error: measured pose minus setpoint [rad, m]. integral: zeros; the PID has its own, of the errors of
the crank angles [rad s], for the next tick."""
_PID = fields(period=(), gravity=(), kp=(), ki=(), kd=(), limit=6, clamp=(), given_back=())


@njit
def pid_tick(
    robots: Any, setups: Any, measurement: Any, reference: Any, leg_records: Any, target_records: Any, states: Any
) -> Any:
    """T = T_gravity - kp e - kd e' - ki z with e = theta(pose) - theta(reference), wrapped to half a turn.

    Crank angles by inverse kinematics, their rates by the Jacobian, of the measurement and of the reference alike. The
    integral grows by period * e after it has been used.

    Args:
        robots: `ROBOT` as the controller believes it to be.
        setups: Numbers of `PidOptions`. gravity: 0 for no feedforward. limit: infinite for none. clamp: whether the
            integral of a motor at its limit stands still. given_back: by what it is led back for a torque that was cut.
        measurement: (12,) pose and rate now.
        reference: (18,) now.
        leg_records: `LEGS` of the measurement, overwritten.
        target_records: `LEGS` of the reference, overwritten.
        states: `PID_STATE` of the tick before; that of this one where the status is OK.

    Returns:
        Status; leg or -1, or which signal is NOT_FINITE; margin.
    """
    robot, setup, state = record(robots), record(setups), record(states)
    legs, target = record(leg_records), record(target_records)
    status, leg, margin = measured_legs(robot, measurement, legs)
    if status != OK:
        return status, leg, margin
    bad = legs_at(robot, reference[:6], target)
    if bad >= 0:
        return AT_REFERENCE + UNREACHABLE, bad, target.reach[bad]
    weight, twist, rates, target_rates = np.zeros(6), np.empty(6), np.empty(6), np.empty(6)
    if setup.gravity != 0.0 and not static_torque(robot, legs, setup.gravity, weight):
        return PARALLEL, -1, margin
    twist_of(measurement[:6], measurement[6:], twist)
    crank_rates(legs, twist, rates)
    twist_of(reference[:6], reference[6:12], twist)
    crank_rates(target, twist, target_rates)
    for i in range(6):
        sine = legs.sine[i] * target.cosine[i] - legs.cosine[i] * target.sine[i]
        error = np.arctan2(sine, legs.cosine[i] * target.cosine[i] + legs.sine[i] * target.sine[i])
        feedback = setup.kp * error + setup.kd * (rates[i] - target_rates[i]) + setup.ki * state.crank_integral[i]
        wanted, limit = weight[i] - feedback, setup.limit[i]
        if not np.isfinite(wanted):
            return NOT_FINITE, TORQUE, wanted
        state.torque[i] = min(max(wanted, -limit), limit)
        cut = wanted - state.torque[i]
        if setup.clamp == 0.0 or cut == 0.0:
            state.crank_integral[i] += setup.period * error + setup.given_back * cut
        state.error[i] = measurement[i] - reference[i]
    return OK, -1, 0.0


# --- computed torque -------------------------------------------------------------------------------------------------


class ComputedTorqueOptions(ControllerOptions):
    """Computed torque, with the same error dynamics in all six coordinates of the pose.

    The default feedback is that of the exact-model LQI for heave at home, with weights 4e5, 30, 4e7, 1 and a weight
    length of 0.11 m.
    """

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

    def parts(self, setup: Setup) -> tuple[Part, ...]:
        limit = setup.robot.effort_limits if self.saturation == "clamp" else np.inf
        numbers = new_record(_COMPUTED_TORQUE, self, gravity=setup.gravity, limit=limit)
        return (controller_part(computed_torque_tick, setup.robot, numbers, COMPUTED_TORQUE_STATE, LEGS),)


COMPUTED_TORQUE_STATE = fields(torque=6, error=6, integral=6, health=2)
"""torque [N m]. error: measured pose minus setpoint [rad, m]. integral: z for the next tick [rad s, m s]."""
_COMPUTED_TORQUE = fields(period=(), gravity=(), natural_frequency=(), damping=(), integral_frequency=(), limit=6)


@njit
def computed_torque_tick(
    robots: Any, setups: Any, measurement: Any, reference: Any, leg_records: Any, states: Any
) -> Any:
    """Inverse dynamics at the measured pose and rate for q''_d - 2 damping omega e' - omega^2 (e + omega_i z).

    The integral grows by period * e after it has been used.

    Arguments and result are as of `pid_tick`, of the numbers of `ComputedTorqueOptions`.
    """
    robot, setup, legs, state = record(robots), record(setups), record(leg_records), record(states)
    status, leg, margin = measured_legs(robot, measurement, legs)
    if status != OK:
        return status, leg, margin
    omega, acceleration = setup.natural_frequency, np.empty(6)
    for k in range(6):
        state.error[k] = measurement[k] - reference[k]
        stiff = omega * omega * (state.error[k] + setup.integral_frequency * state.integral[k])
        damped = 2.0 * setup.damping * omega * (measurement[6 + k] - reference[6 + k])
        acceleration[k] = reference[12 + k] - damped - stiff
    if not motion_torque(robot, legs, measurement, acceleration, setup.gravity, state.torque):
        return PARALLEL, -1, 0.0
    cut = False
    for i in range(6):
        wanted, limit = state.torque[i], setup.limit[i]
        if not np.isfinite(wanted):
            return NOT_FINITE, TORQUE, wanted
        if abs(wanted) > limit:
            cut = True
            state.torque[i] = limit if wanted > 0.0 else -limit
    if not cut:
        for k in range(6):
            state.integral[k] += setup.period * state.error[k]
    return OK, -1, 0.0
