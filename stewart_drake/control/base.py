"""What all controllers share: options, what a tick sees, near which poses none acts, and why a tick fails."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.config import Period, Section
from stewart_drake.errors import NotFiniteError, RiccatiError, RunFailure, SingularPoseError, UnreachablePoseError
from stewart_drake.jit import new_record, njit, record
from stewart_drake.mechanics.dynamics import pose_acceleration_map, task_inertia
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    NOT_FINITE,
    OK,
    PARALLEL,
    QUICK,
    SERIAL,
    UNREACHABLE,
    conditioning,
    legs_at,
    robot_record,
)
from stewart_drake.mechanics.linear_algebra import all_finite
from stewart_drake.part import Part, Setup
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import times

# --- options ---------------------------------------------------------------------------------------------------------


class ControllerOptions(Section, ABC, key="controller"):
    """Base of the options of controllers; wiring, checks, logs and plots ask these, not which kind it is."""

    own_keys = frozenset({"feedforward", "saturation"})
    kind: str
    """Kind of controller."""
    period: Period
    """[s] control period, a whole multiple of plant.time_step."""

    @property
    def label(self) -> str:
        """In a few words, for titles."""
        return f"controller {self.kind}"

    @property
    def asks_for_more(self) -> bool:
        """Whether its torque may exceed the limit, which then says that it has been cut."""
        return getattr(self, "saturation", "") == "none"

    @property
    def code(self) -> Any:
        """What of a user's code it runs, a `CodePath`; None for what comes with the package."""
        return None

    @abstractmethod
    def parts(self, setup: Setup) -> tuple[Part, ...]:
        """The controller in a loop, one part: from measurement and reference to torque, error and integral."""


# --- gains in the size that a robot needs to answer as the paper's does -----------------------------------------------


@lru_cache(maxsize=64)
def _input_gain(robot: RobotParameters) -> float:
    """[m/s^2 per N m] geometric mean of the singular values of M^-1 tau at home, angles times characteristic length."""
    volume = abs(float(np.linalg.det(pose_acceleration_map(robot, robot.home_pose))))
    return float((volume * robot.characteristic_length**3) ** (1.0 / 6.0))


@lru_cache(maxsize=64)
def _crank_inertia(robot: RobotParameters) -> float:
    """[kg m^2] what heave at home moves, as felt at each crank: M / sum J^2 with J = d(theta)/dZ."""
    heave = task_inertia(robot, robot.home_pose)[5, 5]
    return float(heave / np.sum(twist_jacobian(robot, robot.home_pose)[:, 5] ** 2))


POSE_WEIGHT, RATE_WEIGHT, INTEGRAL_WEIGHT = (times(_input_gain, -2.0, slower) for slower in (4.0, 2.0, 6.0))
"""Of errors against torques, for poles at the same place; a natural frequency is the fourth root of the first."""
PROPORTIONAL, INTEGRAL, DERIVATIVE = (times(_crank_inertia, 1.0, slower) for slower in (2.0, 3.0, 1.0))
"""Of a crank's error, for the same natural frequency of heave."""
FREQUENCY = times(lambda _: 1.0, slower=1.0)
"""The same for every robot."""


# --- a tick ----------------------------------------------------------------------------------------------------------

LEAST_TRANSMISSION, LEAST_CONDITIONING = 0.02, 0.005
"""[-] |e_l . e_N| below which a crank counts as at its dead centre, and sigma_min / sigma_max of the rods' lines below
which a pose counts as a parallel singularity: there the force map loses its meaning, and no controller acts."""
AT_REFERENCE = 16
"""Added to a status that concerns the reference's pose, not the measured one."""
POSE, RATE, REFERENCE, TORQUE = range(4)
"""Which signal is NOT_FINITE, in the place of the leg."""
OUTPUTS = ("torque", "error", "integral")
_SIGNALS = ("measured pose", "measured pose rate", "reference", "torque")
_DEAD_CENTRE_SLACK = 0.05
"""[-] reach margin down to which a measured pose counts as a crank at its dead centre: loop gap and sensor error."""


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
def measured_legs(robot: Any, measurement: Any, legs: Any) -> Any:
    """`legs_at` the pose of a measurement (12,), and whether a controller may act there.

    Returns:
        OK, NOT_FINITE, UNREACHABLE, SERIAL or PARALLEL; the leg or -1, of NOT_FINITE which signal; the margin.
    """
    if not all_finite(measurement[6:]):
        return NOT_FINITE, RATE, 0.0
    if not all_finite(measurement[:6]):
        return NOT_FINITE, POSE, 0.0
    bad = legs_at(robot, measurement[:6], legs)
    if bad >= 0:
        return UNREACHABLE, bad, legs.reach[bad]
    worst, leg = np.inf, 0
    for i in range(6):
        if not abs(legs.transmission[i]) >= worst:
            worst, leg = abs(legs.transmission[i]), i
    if worst < LEAST_TRANSMISSION:
        return SERIAL, leg, worst
    ratio = conditioning(robot, legs, QUICK)
    return OK if ratio >= LEAST_CONDITIONING else PARALLEL, -1, ratio


@njit
def _check(robots: Any, measurement: Any, leg_records: Any) -> Any:
    return measured_legs(record(robots), measurement, record(leg_records))


def check_start(robot: RobotParameters, pose: np.ndarray) -> None:
    """Raises the RunFailure with which a controller's tick at a pose (6,) [rad, m] would end, if any."""
    at_rest = np.concatenate([pose, np.zeros(6)])
    ended = _check(robot_record(robot), at_rest, np.empty(1, LEGS))
    if ended[0] != OK:
        raise failure(ended, at_rest, at_rest)


def failure(ended: tuple[int, int, float], measurement: np.ndarray, reference: np.ndarray) -> RunFailure:
    """The error that says why a controller's law ended with a status other than OK.

    Args:
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
        return SingularPoseError("serial", pose, max(margin, 0.0), LEAST_TRANSMISSION, leg)
    if status == PARALLEL:
        return SingularPoseError("parallel", pose, margin, LEAST_CONDITIONING)
    return RiccatiError(f"no gain at pose {pose.tolist()}: M^-1 tau is singular, or its gain overflows")


def controller_part(
    kernel: Callable[..., Any], robot: RobotParameters, params: np.ndarray, state: np.dtype, *scratch: np.dtype
) -> Part:
    """A controller's part of a loop, with the outputs torque, error and integral.

    The kernel takes the `ROBOT` record, its parameters, measurement (12,), reference (18,), the scratch and the state;
    it returns status, leg and margin, see `failure`.
    """
    constants, inputs = {"robot": robot_record(robot), "params": params}, {"measurement": 12, "reference": 18}
    return Part("controller", kernel, constants, inputs, OUTPUTS, new_record(state), scratch, controller_error)


def controller_error(result: Any, arguments: Mapping[str, Any]) -> RunFailure:
    """`failure` of a controller's part."""
    return failure(result, arguments["measurement"], arguments["reference"])
