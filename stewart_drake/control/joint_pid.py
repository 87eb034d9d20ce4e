"""Joint-space PID on the crank angles as a pure function, the controller that most such robots have."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Annotated, Literal, NamedTuple

import numpy as np

from stewart_drake.compiled.constants import PID_NUMBERS, filled
from stewart_drake.control.controller_options import OwnControllerOptions
from stewart_drake.control.inputs import Measurement, Setpoint, checked_legs
from stewart_drake.control.lqi_options import Saturation
from stewart_drake.control.parts import ControllerSite, law_part
from stewart_drake.control.robot_gains import DERIVATIVE, INTEGRAL, PROPORTIONAL
from stewart_drake.errors import NotFiniteError
from stewart_drake.mechanics.dynamics import static_torque_of_legs
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import Sampled
from stewart_drake.section import NotNegative, Positive


class PidOptions(OwnControllerOptions):
    """Options of the joint-space PID; the same gains for all six motors.

    The default gains give heave at home the stiffness, damping and integral action that the exact-model LQI has there
    with weights 4e5, 30, 4e7, 1 and a weight length of 0.11 m: for the inertia M of heave and J = d(theta)/dZ, a
    feedback k of acceleration is k M / (6 J^2) at each crank. For another robot than the paper's a scenario scales them
    by its M / sum J^2.
    """

    kind: Literal["pid"] = "pid"
    period: Positive = 0.001
    kp: Annotated[NotNegative, PROPORTIONAL] = 37.3
    """[N m/rad]"""
    ki: Annotated[NotNegative, INTEGRAL] = 316.0
    """[N m/(rad s)]"""
    kd: Annotated[NotNegative, DERIVATIVE] = 0.624
    """[N m s/rad]"""
    feedforward: Literal["none", "gravity"] = "gravity"
    """gravity: adds the static torque of all bodies at the measured pose."""
    torque_limit: Positive | None = None
    """[N m] largest torque of a motor; null takes the robot's `effort_limit`, which nothing exceeds."""
    saturation: Saturation = "clamp"
    """none: the torque asked for may exceed the limit. clamp: it is limited, and the integral of a motor at its limit
    grows no further. back_calculation: it is limited, and the integral gives back what was cut within `reset_time`."""
    reset_time: Positive = 0.05
    """[s] of back_calculation."""

    @property
    def results(self) -> Sequence[int]:
        """See `ControllerOptions`."""
        return (6,)

    @property
    def compiles(self) -> bool:
        """See `ControllerOptions`."""
        return True

    @property
    def back_share(self) -> float:
        """[-] of what was cut off that back_calculation gives back in a tick."""
        return min(1.0, self.period / self.reset_time)

    def limit(self, robot: RobotParameters) -> np.ndarray:
        """(6,) [N m] of the motors' torques."""
        own = np.inf if self.torque_limit is None else self.torque_limit
        limits: np.ndarray = np.minimum(own, robot.effort_limits)
        return limits


class PidMemory(NamedTuple):
    """What a tick says, and what the next one needs of it.

    Attributes:
        torque: (6,) [N m].
        integral: (6,) [rad s] of the crank angles' errors, for the next tick.
    """

    torque: np.ndarray
    integral: np.ndarray


def pid_tick(
    robot: RobotParameters,
    options: PidOptions,
    gravity: float,
    measurement: Measurement,
    setpoint: Setpoint,
    memory: PidMemory,
) -> PidMemory:
    """T = T_gravity - kp e - kd e' - ki z with e = theta(pose) - theta(reference), wrapped to half a turn.

    Crank angles by inverse kinematics, their rates by the Jacobian, of the measurement and of the reference alike. The
    integral grows by period * e after it has been used.

    Args:
        robot: Geometry and masses as the controller believes them.
        options: See `PidOptions`.
        gravity: [m/s^2] for the feedforward.
        measurement: Pose and rate now.
        setpoint: Reference now.
        memory: Of the tick before; zeros at first.

    Raises:
        NotFiniteError, UnreachablePoseError, SingularPoseError: As `inputs.checked_legs`; UnreachablePoseError
            also where the reference is out of reach.
    """
    if not np.isfinite(measurement.pose_rate).all():
        raise NotFiniteError("measured pose rate", measurement.pose_rate)
    legs, wanted_legs = checked_legs(robot, options, measurement.pose), leg_geometry(robot, setpoint.pose)
    error = legs.crank_angles - wanted_legs.crank_angles
    error = np.arctan2(np.sin(error), np.cos(error))
    rate = crank_rates(robot, legs, measurement.pose, measurement.pose_rate)
    rate_error = rate - crank_rates(robot, wanted_legs, setpoint.pose, setpoint.pose_rate)
    integral = memory.integral
    wanted = -(options.kp * error + options.kd * rate_error + options.ki * integral)
    if options.feedforward == "gravity" and gravity != 0.0:
        wanted = wanted + static_torque_of_legs(robot, legs, gravity)
    if not np.isfinite(wanted).all():
        raise NotFiniteError("torque", wanted)
    torque, growth = wanted, options.period * error
    if options.saturation != "none":
        limit = options.limit(robot)
        torque = np.clip(wanted, -limit, limit)
        cut = wanted - torque
        if options.saturation == "clamp":
            growth = np.where(cut == 0.0, growth, 0.0)
        elif options.ki > 0.0:
            growth = growth + options.back_share * cut / options.ki
    return PidMemory(torque, integral + growth)


def pid_part(options: PidOptions, site: ControllerSite) -> Sampled:
    """`pid_tick` as a part of a loop."""
    if not site.compiled:
        return law_part(pid_tick, PidMemory, options, site)
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled import mechanism, tracking

    back = options.saturation == "back_calculation" and options.ki > 0.0
    numbers = filled(
        PID_NUMBERS,
        period=options.period,
        gravity=site.gravity if options.feedforward == "gravity" else 0.0,
        min_transmission=options.min_transmission,
        min_conditioning=options.min_conditioning,
        kp=options.kp,
        ki=options.ki,
        kd=options.kd,
        limit=np.full(6, np.inf) if options.saturation == "none" else options.limit(site.robot),
        given_back=-1.0 if options.saturation == "clamp" else back and options.back_share / options.ki,
    )
    fast = partial(tracking.pid_tick, mechanism.pack(site.robot), numbers)
    return law_part(pid_tick, PidMemory, options, site, fast)
