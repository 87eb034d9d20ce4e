"""What a controller's tick sees, where the robot must not stand for it, and what is raised where its law ends early."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from stewart_drake.errors import NotFiniteError, RiccatiError, RunFailure, SingularPoseError, UnreachablePoseError
from stewart_drake.jit import njit, record
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    NOT_FINITE,
    OK,
    PARALLEL,
    SERIAL,
    UNREACHABLE,
    robot_record,
    usable_legs,
)
from stewart_drake.robot import RobotParameters

AT_REFERENCE = 16
"""Added to a status that concerns the reference's pose, not the measured one."""
POSE, RATE, REFERENCE, TORQUE = range(4)
"""Which signal is NOT_FINITE, in the place of the leg."""
_SIGNALS = ("measured pose", "measured pose rate", "reference", "torque")
_DEAD_CENTRE_SLACK = 0.05
"""[-] reach margin down to which a measured pose counts as a crank at its dead centre: loop gap and sensor error."""


class SingularityLimits(Protocol):
    """How near to a singularity a controller goes, see `OwnControllerOptions`."""

    @property
    def min_transmission(self) -> float:
        """[-] of a crank."""

    @property
    def min_conditioning(self) -> float:
        """[-] of the rods' lines."""


class Measurement(NamedTuple):
    """What the sensor reports: pose (6,) [rad, m] and pose_rate (6,) [rad/s, m/s] of P in B, Euler rates."""

    pose: np.ndarray
    pose_rate: np.ndarray


class Setpoint(NamedTuple):
    """Where the platform should be: pose, pose_rate, pose_acceleration, each (6,)."""

    pose: np.ndarray
    pose_rate: np.ndarray
    pose_acceleration: np.ndarray


@njit
def all_finite(values: Any) -> bool:
    """Whether all numbers of a vector are finite."""
    for value in values:  # noqa: SIM110 - numba knows no generators here
        if not np.isfinite(value):
            return False
    return True


@njit
def measured_legs(robot: Any, min_transmission: float, min_conditioning: float, measurement: Any, legs: Any) -> Any:
    """`usable_legs` at a measurement (12,), refused near singularities, where the force map loses its meaning."""
    if not all_finite(measurement[6:]):
        return NOT_FINITE, RATE, 0.0
    if not all_finite(measurement[:6]):
        return NOT_FINITE, POSE, 0.0
    return usable_legs(robot, min_transmission, min_conditioning, measurement[:6], legs)


@njit
def _check(robots: Any, min_transmission: float, min_conditioning: float, measurement: Any, legs: Any) -> Any:
    return measured_legs(record(robots), min_transmission, min_conditioning, measurement, record(legs))


def checked_legs(robot: RobotParameters, options: SingularityLimits, pose: np.ndarray) -> None:
    """Refuses a pose (6,) [rad, m] at which a controller would not act.

    Raises:
        NotFiniteError: The pose is not finite.
        UnreachablePoseError: The pose cannot be assembled.
        SingularPoseError: A crank near its dead centre, or rods near a parallel singularity.
    """
    at_rest, legs = np.concatenate([pose, np.zeros(6)]), np.empty(1, LEGS)
    ended = _check(robot_record(robot), options.min_transmission, options.min_conditioning, at_rest, legs)
    if ended[0] != OK:
        raise failure(options, ended, at_rest, at_rest)


def failure(
    limits: SingularityLimits, ended: tuple[int, int, float], measurement: np.ndarray, reference: np.ndarray
) -> RunFailure:
    """What a controller's law that ended with a status other than OK means, as the error to raise.

    Args:
        limits: What a margin is held against.
        ended: Status of `kinematics_laws`, at the reference's pose `AT_REFERENCE` more; leg or -1, or which signal is
            NOT_FINITE; margin of the pose, or a torque that is not finite.
        measurement: (12,).
        reference: (18,).
    """
    status, leg, margin = ended
    at_reference = status >= AT_REFERENCE
    status -= AT_REFERENCE * at_reference
    pose = np.array(reference[:6] if at_reference else measurement[:6])
    if status == NOT_FINITE:
        return NotFiniteError(_SIGNALS[leg], (pose, measurement[6:], reference, margin)[leg])
    # Little beyond reach, the crank has been carried across its dead centre: the robot stands there, so it can.
    if status == UNREACHABLE and (at_reference or not margin >= -_DEAD_CENTRE_SLACK):
        return UnreachablePoseError(pose, leg, margin)
    if status in (UNREACHABLE, SERIAL):
        worst = 0.0 if status == UNREACHABLE else margin
        return SingularPoseError("serial", pose, worst, limits.min_transmission, leg)
    if status == PARALLEL:
        return SingularPoseError("parallel", pose, margin, limits.min_conditioning)
    return RiccatiError(f"no gain at pose {pose.tolist()}: M^-1 tau is singular or its gain leaves floating point")
