"""Base of controllers: options, inputs, torque limit with anti-windup, checks of a pose, statuses of a tick."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import lru_cache
from typing import ClassVar, NamedTuple

import numpy as np

from stewart_drake.base.code import CodePath
from stewart_drake.base.config import Period, Section
from stewart_drake.base.errors import Status, failure
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, TickResult, Vec2, Vec6, Vec12, Vec18, record
from stewart_drake.loop.part import Kernel, LoopContext, Part
from stewart_drake.loop.user_parts import UserParts
from stewart_drake.mechanics.dynamics import pose_acceleration_map, task_inertia
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.mechanics.kinematics_laws import (
    NO_GAIN,
    OK,
    PARALLEL,
    QUICK,
    SERIAL,
    UNREACHABLE,
    Legs,
    Robot,
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
    """Base of the options of controllers."""

    kind_keys = frozenset({"feedforward", "saturation"})
    weighted: ClassVar[bool] = False
    """Whether it takes the weights of the tuner."""
    feedback: ClassVar[bool] = True
    """Whether it uses the measurement."""

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
        """Whether its `reference` is the one of the time when its command acts, and `reference_now` that of now."""
        return False

    @property
    def asks_for_more(self) -> bool:
        """Whether its torque may exceed the motors' limit."""
        return getattr(self, "saturation", "") == "none"

    @property
    def code(self) -> CodePath | None:
        """The user's code that it runs; None for a kind of the package."""
        return None

    @abstractmethod
    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        """The part of a loop from measurement and reference to `torque`, and `integral` if it has one."""


_WITH_MODEL = "estimator", "observer", "controller", "friction_compensation", "servo_command", "rounding", "safety"
"""Parts that compute with the controller's model of the robot."""


class AdaptationOptions(Section, ABC, key="adaptation"):
    """Base of the options of adaptive laws, which learn while the robot runs.

    From the next tick on an output replaces the parameters of other parts that `writes` lists for it. It has the
    numbers of the parameter, in the same order, and begins with those of the model.
    """

    writes: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "robot": tuple(f"{part}.robot" for part in _WITH_MODEL),
        "friction": ("observer.friction", "friction_compensation.friction", "safety.friction"),
        "friction_unknown": ("safety.friction_unknown",),
        "coulomb_uncertainty": ("controller.coulomb_uncertainty",),
        "gain": ("servo_command.gain", "motor_current.gain", "safety.gain"),
        "command_lead": ("reference_lead.command_lead",),
        "joints": ("friction_compensation.joints",),
    }
    """Output -> the parameters that it replaces, as `part.parameter`; parts that a loop does not have are ignored."""

    is_kept: ClassVar[bool] = False
    """Whether the learnt numbers can be saved as `model`."""
    kind: str
    """Kind of law."""

    @property
    def forgets(self) -> str:
        """Key with which it begins without friction nevertheless; empty for none."""
        return ""

    @abstractmethod
    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        """The parts of the law; inputs may be `measurement` (12,), `reference` (18,) and all signals of the loop."""


class UserAdaptation(UserParts, AdaptationOptions, key="adaptation"):  # type: ignore[misc]
    """Your own adaptive law: `parts(context)` returns its parts of the loop, see `AdaptationOptions`.

    The class may have `writes`, as these options have.
    """

    @property
    def writes(self) -> Mapping[str, tuple[str, ...]]:  # type: ignore[override]
        """`writes` of the class, or of `AdaptationOptions` if the class has none."""
        writes: Mapping[str, tuple[str, ...]] = getattr(self.load(), "writes", AdaptationOptions.writes)
        return writes


# --- default gains, scaled from the paper's robot ---------------------------------------------------------------------


@lru_cache(maxsize=64)
def _input_gain(robot: RobotParameters) -> float:
    """[m/s^2 per N m] geometric mean of the singular values of M^-1 tau at home, angles times characteristic length."""
    volume = abs(float(np.linalg.det(pose_acceleration_map(robot, robot.home_pose))))
    return float((volume * robot.characteristic_length**3) ** (1.0 / 6.0))


@lru_cache(maxsize=64)
def heave_inertia(robot: RobotParameters) -> float:
    """[kg m^2] inertia of heave at home, at one crank: M / sum J^2 with J = d(theta)/dZ."""
    heave = task_inertia(robot, robot.home_pose)[5, 5]
    return float(heave / np.sum(twist_jacobian(robot, robot.home_pose)[:, 5] ** 2))


POSE_WEIGHT, RATE_WEIGHT, INTEGRAL_WEIGHT = (times(_input_gain, -2.0, slower) for slower in (4.0, 2.0, 6.0))
"""Weights of errors against torques, for the same poles; the natural frequency is the fourth root of the first."""
PROPORTIONAL, INTEGRAL, DERIVATIVE = (times(heave_inertia, 1.0, slower) for slower in (2.0, 3.0, 1.0))
"""Gains on a crank's error, for the same natural frequency of heave."""
FREQUENCY = times(lambda _: 1.0, slower=1.0)
"""The same for every robot."""


# --- a tick ----------------------------------------------------------------------------------------------------------

AT_REFERENCE = 16
"""Added to a status that concerns the reference's pose, not the measured one."""
POSE, RATE, REFERENCE, TORQUE = range(8, 12)
"""Statuses of a signal that is not finite."""
_DEAD_CENTRE_SLACK = 0.05
"""[-] reach margin down to which a measured pose counts as a dead centre: allowance for loop gap and sensor error."""


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
"""Statuses of a controller's tick; those at the reference's pose are offset by `AT_REFERENCE`."""


class Measurement(NamedTuple):
    """Reading of the sensor: pose (6,) [rad, m] and pose_rate (6,) [rad/s, m/s] of P in B, Euler rates."""

    pose: np.ndarray
    pose_rate: np.ndarray


class Setpoint(NamedTuple):
    """Target of the platform: pose (6,) [rad, m], pose_rate and pose_acceleration (6,)."""

    pose: np.ndarray
    pose_rate: np.ndarray
    pose_acceleration: np.ndarray


@njit
def measured_legs(robot: Robot, measurement: Vec12, legs: Legs) -> TickResult:
    """`legs_at` the pose of a measurement, and whether a controller may act there: OK, POSE, RATE, UNREACHABLE, ..."""
    if not all_finite(measurement[6:]):
        return RATE, -1, 0.0
    if not all_finite(measurement[:6]):
        return POSE, -1, 0.0
    bad = legs_at(robot, measurement[:6], legs)
    if bad >= 0:
        # Slightly out of reach: the crank has been pushed across its dead centre.
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
def _check(robot: Robot, measurement: Vec12, legs: Legs) -> TickResult:
    return measured_legs(record(robot), measurement, record(legs))


def check_start(robot: RobotParameters, pose: np.ndarray) -> None:
    """Raises the RunFailure of a controller's tick at a pose (6,) [rad, m], if any."""
    at_rest = np.concatenate([pose, np.zeros(6)])
    result = _check(robot_record(robot), at_rest, Legs.empty())
    if result[0] != OK:
        raise failure(STATUSES[result[0]], result[1], result[2], {"measurement": at_rest})


class ControllerState(Record):
    """State of a controller without memory; base of others."""

    torque: Vec6  # [N m]
    health: Vec2  # See `loop.part.HEALTHY`.


def controller_part(
    kernel: Kernel, robot: RobotParameters, params: Record, state: type[Record], *scratch: type[Record]
) -> Part:
    """Part of a loop for a controller, with the outputs torque and, if its state has one, integral.

    The kernel takes the robot, its parameters, measurement (12,), reference (18,), the scratch and the state, and
    returns one of `STATUSES`, leg and margin.
    """
    outputs = tuple(name for name in ("torque", "integral") if name in state.fields)
    numbers, inputs = {"robot": robot_record(robot), "params": params}, {"measurement": 12, "reference": 18}
    return Part("controller", kernel, {}, inputs, outputs, state.new(), scratch, STATUSES, parameters=numbers)


# --- tracking error, torque limit and anti-windup ---------------------------------------------------------------------


class TrackingError(Record):
    """State of the tracking error."""

    error: Vec6  # [rad, m] measured pose minus that of the reference.


@njit
def tracking_error_tick(measurement: Vec12, reference: Vec18, state: TrackingError) -> None:
    """Measured pose minus that of the reference; unchanged where one is not finite."""
    state = record(state)
    if all_finite(measurement[:6]) and all_finite(reference[:6]):
        for k in range(6):
            state.error[k] = measurement[k] - reference[k]


LEARNT_SIGNALS = ("learnt", "learnt_half_width", "learnt_center_of_mass", "learnt_joints")
"""Signals of what an adaptive law has learnt, with half the widths of the confidence intervals."""
_INPUTS = {"measurement": 12, "reference": 18}
TRACKING_ERROR = Part("tracking_error", tracking_error_tick, {}, _INPUTS, ("error",), TrackingError.new())
"""Tracking error of a loop, for densities, tuners and the log."""


class Saturation(Record):
    """Parameters of the torque limit with anti-windup."""

    period: float  # [s]
    limit: Vec6  # [N m] largest torque; infinite for none.
    clamp: float  # 1 where the integral waits while a motor is at its limit.


def saturation_params(saturation: str, robot: RobotParameters) -> dict[str, object]:
    """Fields `limit` and `clamp` of a controller's parameters, by its key `saturation`."""
    return {"limit": np.inf if saturation == "none" else robot.effort_limits, "clamp": saturation == "clamp"}


@njit
def limit_and_integrate(
    params: Saturation, wanted: Vec6, error: Vec6, by_motor: bool, torque: Vec6, integral: Vec6
) -> TickResult:
    """Limits torques [N m] to those of the motors, and integrates the error; with `clamp` not while a motor saturates.

    With `by_motor` element i of the integral waits for motor i only, else all wait for any motor. Returns OK, or TORQUE
    with the torque that is not finite.
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
