"""Computed torque in task space: inverse dynamics of the exact model around a linear loop."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np

from stewart_drake.config import NotNegative, Positive
from stewart_drake.control.base import (
    FREQUENCY,
    TORQUE,
    OwnControllerOptions,
    controller_part,
    failure,
    measured_legs,
)
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.mechanics.dynamics_laws import motion_torque
from stewart_drake.mechanics.kinematics_laws import LEGS, NOT_FINITE, OK, PARALLEL, robot_record
from stewart_drake.part import Part
from stewart_drake.robot import RobotParameters


class ComputedTorqueOptions(OwnControllerOptions):
    """Options of the computed-torque controller; all six coordinates of the pose behave alike.

    The default feedback is what the exact-model LQI has on heave at home with weights 4e5, 30, 4e7, 1 and a weight
    length of 0.11 m.
    """

    kind: Literal["computed_torque"] = "computed_torque"
    period: Positive = 0.001
    natural_frequency: Annotated[Positive, FREQUENCY] = 93.8
    """[rad/s] omega of e'' + 2 damping omega e' + omega^2 (e + integral_frequency z) = 0."""
    damping: Positive = 0.785
    """[-]"""
    integral_frequency: Annotated[NotNegative, FREQUENCY] = 8.47
    """[rad/s] 0 leaves a PD loop, which errors of the model keep away from the reference."""
    saturation: Literal["none", "clamp"] = "clamp"
    """none: the torque asked for may exceed what the motors have. clamp: it is limited, and z stands still
    meanwhile."""

    def parts(self, setup: Any) -> tuple[Part, ...]:
        """The controller in a loop, see `part.Setup`."""
        return (computed_torque_part(self, setup.robot, setup.gravity),)


COMPUTED_TORQUE_STATE = fields(torque=6, error=6, integral=6, health=2)
"""torque [N m]. error: measured pose minus setpoint [rad, m]. integral: z for the next tick [rad s, m s]."""
_SETUP = fields(
    period=(), gravity=(), min_transmission=(), min_conditioning=(), natural_frequency=(), damping=(),
    integral_frequency=(), limit=6,
)  # fmt: skip


@njit
def computed_torque_tick(
    robots: Any, setups: Any, measurement: Any, reference: Any, leg_records: Any, states: Any
) -> Any:
    """Inverse dynamics at the measured pose and rate for q''_d - 2 damping omega e' - omega^2 (e + omega_i z).

    The integral grows by period * e after it has been used.

    Arguments and result are as of `joint_pid.pid_tick`, of the numbers of `ComputedTorqueOptions`.
    """
    robot, setup, legs, state = record(robots), record(setups), record(leg_records), record(states)
    status, leg, margin = measured_legs(robot, setup.min_transmission, setup.min_conditioning, measurement, legs)
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


def computed_torque_part(options: ComputedTorqueOptions, robot: RobotParameters, gravity: float) -> Part:
    """Computed torque as a part of a loop, for a robot as believed, in a gravity [m/s^2]; raises as `failure`."""
    robots, legs = robot_record(robot), np.empty(1, LEGS)
    limit = robot.effort_limits if options.saturation == "clamp" else np.inf
    setup = new_record(_SETUP, options, gravity=gravity, limit=limit)

    def tick(measurement: np.ndarray, reference: np.ndarray, state: np.ndarray) -> None:
        ended = computed_torque_tick(robots, setup, measurement, reference, legs, state)
        if ended[0] != OK:
            raise failure(options.near_singularity, ended, measurement, reference)

    return controller_part(tick, new_record(COMPUTED_TORQUE_STATE))
