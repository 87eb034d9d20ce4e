"""What a controller's tick sees, and where the robot must not stand for it; shared by all controllers, pure."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from stewart_drake.errors import NotFiniteError, RunFailure, SingularPoseError, UnreachablePoseError
from stewart_drake.mechanics.kinematics import LegGeometry, leg_geometry, line_conditioning
from stewart_drake.robot import RobotParameters

_DEAD_CENTRE_SLACK = 0.05
"""[-] reach margin down to which a measured pose counts as a crank at its dead centre: loop gap and sensor error."""


class SingularityLimits(Protocol):
    """How near to a singularity a controller goes, see `LqiOptions`."""

    @property
    def min_transmission(self) -> float:
        """[-] As in `LqiOptions`."""

    @property
    def min_conditioning(self) -> float:
        """[-] As in `LqiOptions`."""


class Measurement(NamedTuple):
    """What the sensor reports: pose (6,) [rad, m] and pose_rate (6,) [rad/s, m/s] of P in B, Euler rates."""

    pose: np.ndarray
    pose_rate: np.ndarray


class Setpoint(NamedTuple):
    """Where the platform should be: pose, pose_rate, pose_acceleration, each (6,)."""

    pose: np.ndarray
    pose_rate: np.ndarray
    pose_acceleration: np.ndarray


def checked_legs(robot: RobotParameters, options: SingularityLimits, pose: np.ndarray) -> LegGeometry:
    """Leg vectors at a measured pose, refused near singularities, where the force map loses its meaning.

    Raises:
        NotFiniteError: The pose is not finite.
        UnreachablePoseError: The pose cannot be assembled.
        SingularPoseError: A crank near its dead centre, or rods near a parallel singularity.
    """
    if not np.isfinite(pose).all():
        raise NotFiniteError("measured pose", pose)
    try:
        legs = leg_geometry(robot, pose)
    except UnreachablePoseError as error:
        raise out_of_reach(error, options) from error
    transmission = np.abs(legs.transmission)
    leg = int(transmission.argmin())
    if transmission[leg] < options.min_transmission:
        raise SingularPoseError("serial", pose, float(transmission[leg]), options.min_transmission, leg)
    ratio = float(line_conditioning(robot, legs))
    if ratio < options.min_conditioning:
        raise SingularPoseError("parallel", pose, ratio, options.min_conditioning)
    return legs


def out_of_reach(error: UnreachablePoseError, options: SingularityLimits) -> RunFailure:
    """What a measured pose out of reach means: little beyond it, a crank at its dead centre."""
    if not error.margin >= -_DEAD_CENTRE_SLACK:
        return error
    # The robot stands there, so it can: the crank has been carried across its dead centre, where reach ends.
    return SingularPoseError("serial", error.pose, 0.0, options.min_transmission, error.leg)
