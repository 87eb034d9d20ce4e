"""Computed torque in task space as a pure function: inverse dynamics of the exact model around a linear loop."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal, NamedTuple

import numpy as np

from stewart_drake.compiled.constants import COMPUTED_TORQUE_NUMBERS, filled
from stewart_drake.control.controller_options import OwnControllerOptions
from stewart_drake.control.inputs import Measurement, Setpoint, checked_legs
from stewart_drake.control.parts import ControllerSite, law_part
from stewart_drake.control.robot_gains import FREQUENCY
from stewart_drake.errors import NotFiniteError
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import Sampled
from stewart_drake.section import NotNegative, Positive


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

    @property
    def compiles(self) -> bool:
        """See `ControllerOptions`."""
        return True


class ComputedTorqueMemory(NamedTuple):
    """What a tick says, and what the next one needs of it.

    Attributes:
        torque: (6,) [N m].
        error: (6,) [rad, m] measured pose minus setpoint.
        integral: (6,) [rad s, m s] z for the next tick.
    """

    torque: np.ndarray
    error: np.ndarray
    integral: np.ndarray


def computed_torque_tick(
    robot: RobotParameters,
    options: ComputedTorqueOptions,
    gravity: float,
    measurement: Measurement,
    setpoint: Setpoint,
    memory: ComputedTorqueMemory,
) -> ComputedTorqueMemory:
    """Inverse dynamics at the measured pose and rate for q''_d - 2 damping omega e' - omega^2 (e + omega_i z).

    The integral grows by period * e after it has been used.

    Args:
        robot: Geometry and masses as the controller believes them.
        options: See `ComputedTorqueOptions`.
        gravity: [m/s^2].
        measurement: Pose and rate now.
        setpoint: Reference now.
        memory: Of the tick before; zeros at first.

    Raises:
        NotFiniteError, UnreachablePoseError, SingularPoseError: As `inputs.checked_legs`.
    """
    if not np.isfinite(measurement.pose_rate).all():
        raise NotFiniteError("measured pose rate", measurement.pose_rate)
    checked_legs(robot, options, measurement.pose)
    error, rate_error = measurement.pose - setpoint.pose, measurement.pose_rate - setpoint.pose_rate
    omega = options.natural_frequency
    acceleration = (
        setpoint.pose_acceleration
        - 2.0 * options.damping * omega * rate_error
        - omega**2 * (error + options.integral_frequency * memory.integral)
    )
    wanted = inverse_dynamics(robot, measurement.pose, measurement.pose_rate, acceleration, gravity)
    if not np.isfinite(wanted).all():
        raise NotFiniteError("torque", wanted)
    torque, growth = wanted, options.period * error
    if options.saturation == "clamp":
        torque = np.clip(wanted, -robot.effort_limits, robot.effort_limits)
        if np.any(torque != wanted):
            growth = np.zeros(6)
    return ComputedTorqueMemory(torque, error, memory.integral + growth)


def computed_torque_part(options: ComputedTorqueOptions, site: ControllerSite) -> Sampled:
    """`computed_torque_tick` as a part of a loop."""
    if not site.compiled:
        return law_part(computed_torque_tick, ComputedTorqueMemory, options, site)
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled import mechanism, tracking

    numbers = filled(
        COMPUTED_TORQUE_NUMBERS,
        period=options.period,
        gravity=site.gravity,
        min_transmission=options.min_transmission,
        min_conditioning=options.min_conditioning,
        frequency=options.natural_frequency,
        damping=options.damping,
        integral_frequency=options.integral_frequency,
        limit=site.robot.effort_limits if options.saturation == "clamp" else np.full(6, np.inf),
    )
    fast = partial(tracking.computed_torque_tick, mechanism.pack(site.robot), numbers)
    return law_part(computed_torque_tick, ComputedTorqueMemory, options, site, fast)
