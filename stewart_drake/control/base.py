"""What all controllers share: options, inputs, the torque limit with anti-windup, where none acts, why a tick fails."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple

import numpy as np

from stewart_drake.base.config import Period, Section
from stewart_drake.base.errors import Status, failure
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.loop.user_parts import UserParts
from stewart_drake.mechanics.dynamics import pose_acceleration_map, task_inertia
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.mechanics.kinematics_laws import (
    LEGS,
    NO_GAIN,
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
from stewart_drake.mechanics.singularities import CONTROLLED
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.robot_scale import times

# --- options ---------------------------------------------------------------------------------------------------------


class ControllerOptions(Section, ABC, key="controller"):
    """Base of the options of controllers; wiring, checks, logs and plots ask these, not which kind it is."""

    kind_keys = frozenset({"feedforward", "saturation"})
    weighted: ClassVar[bool] = False
    """Whether it takes the weights of the tuner."""
    feedback: ClassVar[bool] = True
    """Whether it uses what is measured."""

    kind: str
    """Kind of controller."""
    period: Period
    """[s] control period, a whole multiple of plant.time_step."""

    @property
    def label(self) -> str:
        """In a few words, for titles."""
        return f"controller {self.kind}"

    @property
    def looks_ahead(self) -> bool:
        """Whether its `reference` is that of when its command acts, and `reference_now` that of now."""
        return False

    @property
    def asks_for_more(self) -> bool:
        """Whether its torque may exceed the limit, which then says that it has been cut."""
        return getattr(self, "saturation", "") == "none"

    @property
    def code(self) -> Any:
        """What of a user's code it runs, a `CodePath`; None for what comes with the package."""
        return None

    @abstractmethod
    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        """The controller in a loop, one part: measurement and reference to `torque`, and `integral` if it has one."""


_WITH_MODEL = "estimator", "observer", "controller", "friction_compensation", "servo_command", "rounding", "safety"
"""Parts that compute with the controller's model of the robot."""


class AdaptationOptions(Section, ABC, key="adaptation"):
    """Base of the options of laws that learn while the robot runs.

    An output of such a law takes the place of parameters of other parts, from the next tick on; which ones is in
    `writes`. Its numbers are those of the parameter, in that order; the law's state begins with what is believed.
    """

    writes: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "robot": tuple(f"{part}.robot" for part in _WITH_MODEL),
        "friction": ("observer.friction", "friction_compensation.friction", "safety.friction"),
        "friction_unknown": ("safety.friction_unknown",),
        "doubt": ("controller.doubt",),
        "gain": ("servo_command.gain", "motor_current.gain"),
        "lead": ("lead.lead",),
        "joints": ("friction_compensation.joints",),
    }
    """Output -> the parameters that it writes, as `part.parameter`. Parts that a loop does not have are passed over."""

    is_kept: ClassVar[bool] = False
    """Whether what it has learnt can be kept as `model`."""
    kind: str
    """Kind of law."""

    @property
    def forgets(self) -> str:
        """Key by which it begins without friction all the same; empty for none."""
        return ""

    @abstractmethod
    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        """The law in a loop; inputs may be `measurement` (12,), `reference` (18,) and all signals of the loop."""


class UserAdaptation(UserParts, AdaptationOptions, key="adaptation"):  # type: ignore[misc]
    """Your own adaptive law: `parts(context)` returns its parts of the loop, as of `AdaptationOptions`.

    The class may have `writes`, as these options have.
    """

    @property
    def writes(self) -> Mapping[str, tuple[str, ...]]:  # type: ignore[override]
        """That of the class, or what all laws may write."""
        writes: Mapping[str, tuple[str, ...]] = getattr(self.load(), "writes", AdaptationOptions.writes)
        return writes


# --- gains in the size that a robot needs to answer as the paper's does -----------------------------------------------


@lru_cache(maxsize=64)
def _input_gain(robot: RobotParameters) -> float:
    """[m/s^2 per N m] geometric mean of the singular values of M^-1 tau at home, angles times characteristic length."""
    volume = abs(float(np.linalg.det(pose_acceleration_map(robot, robot.home_pose))))
    return float((volume * robot.characteristic_length**3) ** (1.0 / 6.0))


@lru_cache(maxsize=64)
def heave_inertia(robot: RobotParameters) -> float:
    """[kg m^2] what heave at home moves, as felt at each crank: M / sum J^2 with J = d(theta)/dZ."""
    heave = task_inertia(robot, robot.home_pose)[5, 5]
    return float(heave / np.sum(twist_jacobian(robot, robot.home_pose)[:, 5] ** 2))


POSE_WEIGHT, RATE_WEIGHT, INTEGRAL_WEIGHT = (times(_input_gain, -2.0, slower) for slower in (4.0, 2.0, 6.0))
"""Of errors against torques, for poles at the same place; a natural frequency is the fourth root of the first."""
PROPORTIONAL, INTEGRAL, DERIVATIVE = (times(heave_inertia, 1.0, slower) for slower in (2.0, 3.0, 1.0))
"""Of a crank's error, for the same natural frequency of heave."""
FREQUENCY = times(lambda _: 1.0, slower=1.0)
"""The same for every robot."""


# --- a tick ----------------------------------------------------------------------------------------------------------

AT_REFERENCE = 16
"""Added to a status that concerns the reference's pose, not the measured one."""
POSE, RATE, REFERENCE, TORQUE = range(8, 12)
"""Statuses of a signal that is not finite."""
_DEAD_CENTRE_SLACK = 0.05
"""[-] reach margin down to which a measured pose counts as a crank at its dead centre: loop gap and sensor error."""


_AT_POSE = {
    UNREACHABLE: Status("unreachable_pose", "measurement", of_leg=True),
    SERIAL: Status("crank_dead_centre", "measurement", of_leg=True, limit=CONTROLLED.transmission),
    PARALLEL: Status("parallel_singularity", "measurement", limit=CONTROLLED.conditioning),
    NO_GAIN: Status("riccati", "measurement", text="no gain at pose {at}: M^-1 tau is singular, or its gain overflows"),
    POSE: Status("not_finite", "measurement", text="measured pose"),
    RATE: Status("not_finite", "measurement", text="measured pose rate", numbers=slice(6, 12)),
    REFERENCE: Status("not_finite", "reference", text="reference", numbers=slice(18)),
    TORQUE: Status("not_finite", text="torque"),
}
STATUSES = _AT_POSE | {AT_REFERENCE + k: _AT_POSE[k]._replace(signal="reference") for k in (UNREACHABLE, PARALLEL)}
"""How a controller's tick may end; what is wrong at the reference's pose is `AT_REFERENCE` more."""


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
        OK, POSE, RATE, UNREACHABLE, SERIAL or PARALLEL; the leg or -1; the margin.
    """
    if not all_finite(measurement[6:]):
        return RATE, -1, 0.0
    if not all_finite(measurement[:6]):
        return POSE, -1, 0.0
    bad = legs_at(robot, measurement[:6], legs)
    if bad >= 0:
        # Little beyond reach, the crank has been carried across its dead centre: the robot stands there, so it can.
        margin = legs.reach_margin[bad]
        if margin >= -_DEAD_CENTRE_SLACK:
            return SERIAL, bad, 0.0
        return UNREACHABLE, bad, margin
    worst, leg = np.inf, 0
    for i in range(6):
        if not abs(legs.transmission[i]) >= worst:
            worst, leg = abs(legs.transmission[i]), i
    if worst < CONTROLLED.transmission:
        return SERIAL, leg, worst
    ratio = conditioning(robot, legs, QUICK, CONTROLLED.conditioning)
    return OK if ratio >= CONTROLLED.conditioning else PARALLEL, -1, ratio


@njit
def _check(robot: Any, measurement: Any, legs: Any) -> Any:
    return measured_legs(record(robot), measurement, record(legs))


def check_start(robot: RobotParameters, pose: np.ndarray) -> None:
    """Raises the RunFailure with which a controller's tick at a pose (6,) [rad, m] would end, if any."""
    at_rest = np.concatenate([pose, np.zeros(6)])
    result = _check(robot_record(robot), at_rest, np.empty(1, LEGS))
    if result[0] != OK:
        raise failure(STATUSES[result[0]], result[1], result[2], {"measurement": at_rest})


def controller_part(
    kernel: Callable[..., Any], robot: RobotParameters, params: np.ndarray, state: np.dtype, *scratch: np.dtype
) -> Part:
    """A controller's part of a loop, with the outputs torque and, where its state has one, integral.

    The kernel takes the `ROBOT` record, its parameters, measurement (12,), reference (18,), the scratch and the state;
    it returns one of `STATUSES`, leg and margin.
    """
    outputs = tuple(name for name in ("torque", "integral") if name in (state.names or ()))
    numbers, inputs = {"robot": robot_record(robot), "params": params}, {"measurement": 12, "reference": 18}
    return Part("controller", kernel, {}, inputs, outputs, new_record(state), scratch, STATUSES, parameters=numbers)


# --- tracking error, torque limit and anti-windup ---------------------------------------------------------------------


@njit
def tracking_error_tick(measurement: Any, reference: Any, state: Any) -> None:
    """Measured pose minus that of the reference, (6,) [rad, m]; the last one stays where one is not finite."""
    state = record(state)
    if all_finite(measurement[:6]) and all_finite(reference[:6]):
        for k in range(6):
            state.error[k] = measurement[k] - reference[k]


LEARNT_SIGNALS = ("learnt", "learnt_half_width", "learnt_center_of_mass", "learnt_joints")
"""What an adaptive law tells of what it has learnt, each with half the widths of its intervals."""
TRACKING_ERROR = Part(
    "tracking_error",
    tracking_error_tick,
    {},
    {"measurement": 12, "reference": 18},
    ("error",),
    new_record(fields(error=6)),
)
"""The tracking error of a loop, for densities, tuners and the log."""


def saturation_params(options: Any, robot: RobotParameters) -> dict[str, Any]:
    """Fields `limit` and `clamp` of a controller's parameters, by its `saturation`."""
    limit = np.inf if options.saturation == "none" else robot.effort_limits
    return {"limit": limit, "clamp": options.saturation == "clamp"}


@njit
def limit_and_integrate(params: Any, wanted: Any, error: Any, by_motor: bool, torque: Any, integral: Any) -> Any:
    """Cuts torques to the limits of the motors, and integrates the error; with `clamp` not while a motor is there.

    Args:
        params: Record with `period` [s] and the fields of `saturation_params`.
        wanted: (6,) [N m].
        error: (6,) what is integrated.
        by_motor: Whether each element of the integral belongs to one motor, and waits for that one alone.
        torque: (6,) [N m] out.
        integral: (6,) changed in place.

    Returns:
        OK or TORQUE; -1; the torque that is not finite.
    """
    saturated = False
    for i in range(6):
        if not np.isfinite(wanted[i]):
            return TORQUE, -1, wanted[i]
        torque[i] = min(max(wanted[i], -params.limit[i]), params.limit[i])
        saturated = saturated or torque[i] != wanted[i]
    for k in range(6):
        if not (params.clamp == 1.0 and (torque[k] != wanted[k] if by_motor else saturated)):
            integral[k] += params.period * error[k]
    return OK, -1, 0.0
