"""Pose and rate of the platform from the motor encoders alone: forward kinematics and backward differences."""

from __future__ import annotations

import contextlib
import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base import errors
from stewart_drake.base.config import InOtherKinds, Natural, Period, Positive, PositivePair, Section
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, TickResult, Vec2, Vec6, Vec12, record
from stewart_drake.loop.part import HEALTHY, LoopContext, Part
from stewart_drake.loop.user_parts import UserParts
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry
from stewart_drake.mechanics.kinematics_laws import NO_CONVERGENCE, NOT_FINITE, OK, PARALLEL, SERIAL, Legs, Robot
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, solve
from stewart_drake.robot.robot_scale import LENGTH

TOLERANCE = 1e-12  # [m] rod-length error at which Newton's method stops.
ITERATIONS = 12  # Newton steps at most; a warm start needs two.
SAME_BRANCH = 1.0 - 1e-6
"""Cosine between a crank and that of the inverse kinematics at the pose found; below it, it is on the other branch."""
TOO_FAST, OTHER_MODE = 10, 11  # Statuses beside those of `kinematics_laws`.


class EstimatorOptions(Section, key="estimator"):
    """Base of the options of estimators."""

    exact: ClassVar[bool] = False
    """Whether it passes the reading of a sensor of pose and rate on unchanged."""
    imu = InOtherKinds(False)
    """Whether it uses the inertial sensor of the model."""
    kind: str
    period: Period | None = None
    """[s] between two readings; controller.period is a whole multiple. Null for the same."""

    @property
    def disturbance_density(self) -> float:
        """[rad/s^2 per sqrt(s)] that an observer expects unless a tuner says otherwise; 0 for none."""
        return 0.0

    def parts(self, context: LoopContext) -> tuple[Part, ...]:  # noqa: ARG002
        """The parts from the signal `reading` to `measurement`; none if the reading is the measurement."""
        return ()


class DifferenceOptions(EstimatorOptions):
    """Pose from the readings, rate from the difference of two; a sensor of pose and rate is passed on unchanged."""

    exact: ClassVar[bool] = True
    kind: Literal["difference"] = "difference"
    rate_cutoff: Positive | None = None
    """[Hz] corner frequency of the first-order low pass on crank rates, which are differences over one tick; null for
    none."""
    max_speed: Positive = 60.0
    """[rad/s] largest plausible crank speed; a reading that has moved faster is rejected."""
    max_step: Annotated[PositivePair, LENGTH] = (0.2, 0.05)
    """[rad, m] largest plausible step from the last pose, at first from the start; a pose beyond it is rejected as
    another assembly mode."""
    hold_ticks: Annotated[Natural, Field(le=1000)] = 10
    """Rejected readings in a row that the last good pose may replace before the run ends."""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        if context.reading == 12:
            return ()
        return (difference_part(self, context),)


class UserEstimator(UserParts, EstimatorOptions, key="estimator"):  # type: ignore[misc]
    """Your own estimator: `parts(context)` returns parts from `reading` to the signal `measurement` (12,)."""

    gives = "measurement"


class DifferenceParams(Record):
    """Parameters of `difference_tick`: numbers of `DifferenceOptions`."""

    period: float  # [s]
    smoothing: float  # Share of a new difference in the filtered crank rate.
    max_speed: float  # [rad/s]
    max_turn: float  # [rad]
    max_shift: float  # [m]
    hold_ticks: float  # Ticks in a row.


class DifferenceState(Record):
    """State of `difference_tick`."""

    measurement: Vec12  # [rad, m and 1/s] pose and its rate.
    health: Vec2  # See `loop.part.HEALTHY`.
    angles: Vec6  # [rad] last accepted reading.
    crank_rate: Vec6  # [rad/s] filtered.
    missed: float  # Rejected readings in a row.
    assembly_sign: float  # Sign of the determinant of the rods' lines.
    started: float  # 1 once a reading has been accepted.
    candidate: Vec6  # [rad, m] pose found in the last tick, which may have been rejected.


STATUSES = {
    NOT_FINITE: errors.Status("encoder", "reading", text="encoder readings {at}: not finite"),
    TOO_FAST: errors.Status(
        "encoder", "reading", text="encoder readings {at}: changed faster than {params[max_speed][0]:g} rad/s"
    ),
    NO_CONVERGENCE: errors.Status("forward_kinematics"),
    SERIAL: errors.Status("crank_dead_centre", "state.candidate", of_leg=True),
    PARALLEL: errors.Status("parallel_singularity", "state.candidate"),
    OTHER_MODE: errors.Status("assembly_mode", "state.candidate", last="state.measurement"),
}
"""How `pose_of_angles` may end."""


@njit
def pose_of_angles(
    robot: Robot, params: DifferenceParams, angles: Vec6, legs: Legs, state: DifferenceState
) -> TickResult:
    """Forward kinematics from the last pose, and the pose's rate from the difference of the angles (6,).

    The rate lags by half a period; the first repeats the crank rates of the state. A pose is accepted if no angle has
    jumped, Newton's method converges near the last pose, the cranks are on the robot's branch of the inverse
    kinematics, and the determinant of the rods' lines has the same sign: it changes at the parallel singularities
    between assembly modes.

    Returns status, leg or -1, margin; with NO_CONVERGENCE the steps taken and the error [m]. If not OK only
    `candidate` changes.
    """
    pose, last = state.candidate[:], state.measurement
    started, elapsed = state.started > 0.0, params.period * (1.0 + state.missed)
    copy_to(pose, last[:6])
    if not all_finite(angles):
        return NOT_FINITE, -1, 0.0
    for i in range(6):
        if started and abs(angles[i] - state.angles[i]) > params.max_speed * elapsed:
            return TOO_FAST, -1, 0.0
    error, steps = laws.forward_kinematics(robot, angles, pose, TOLERANCE, ITERATIONS)
    if not error <= TOLERANCE:
        return NO_CONVERGENCE, steps, error
    bad = laws.legs_at(robot, pose, legs)
    if bad >= 0:
        # A crank slightly beyond its dead centre.
        return SERIAL, bad, legs.reach_margin[bad]
    for i in range(6):
        if legs.cosine[i] * np.cos(angles[i]) + legs.sine[i] * np.sin(angles[i]) < SAME_BRANCH:
            return SERIAL, i, -abs(legs.transmission[i])
    twist, rate = np.empty((6, 1)), state.crank_rate.copy()
    for i in range(6):
        if started:
            rate[i] += params.smoothing * ((angles[i] - state.angles[i]) / elapsed - rate[i])
        twist[i, 0] = legs.lever[i] * rate[i]
    sign = solve(legs.line[:], twist)
    near = True
    for k in range(6):
        near = near and abs(pose[k] - last[k]) <= (params.max_turn if k < 3 else params.max_shift)
    if not near or (started and sign != 0.0 and sign != state.assembly_sign):
        return OTHER_MODE, -1, 0.0
    if sign == 0.0:
        return PARALLEL, -1, 0.0
    copy_to(state.measurement[:6], pose)
    laws.rate_of(pose, twist[:, 0], state.measurement[6:])
    copy_to(state.angles[:], angles)
    copy_to(state.crank_rate[:], rate)
    state.missed, state.assembly_sign, state.started = 0.0, sign, 1.0
    return OK, -1, 0.0


@njit
def difference_tick(
    robot: Robot, params: DifferenceParams, angles: Vec6, legs: Legs, state: DifferenceState
) -> TickResult:
    """One tick: `pose_of_angles`; up to `hold_ticks` failures in a row repeat the last state."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    result = pose_of_angles(robot, params, angles, legs, state)
    if result[0] != OK and state.started > 0.0 and state.missed < params.hold_ticks:
        state.missed += 1.0
        return OK, -1, 0.0
    return result


def difference_params(options: DifferenceOptions, period: float) -> DifferenceParams:
    """Parameters for a period [s]."""
    cutoff = options.rate_cutoff
    return DifferenceParams.new(
        options,
        period=period,
        smoothing=1.0 if cutoff is None else 1.0 - math.exp(-2.0 * math.pi * cutoff * period),
        max_turn=options.max_step[0],
        max_shift=options.max_step[1],
    )


def difference_part(options: DifferenceOptions, context: LoopContext) -> Part:
    """`reading` (6,) [rad] of encoders -> `measurement` (12,), pose [rad, m] and its rate; see `difference_tick`.

    The pose at the start selects the assembly mode; it may be rough.
    """
    robot, initial = context.robot, DifferenceState.new(health=HEALTHY)
    initial["measurement"][0, :6] = context.pose
    # Where the robot cannot be at that pose, the first tick fails, with a log.
    with contextlib.suppress(errors.UnreachablePoseError), np.errstate(all="ignore"):
        rates = crank_rates(robot, leg_geometry(robot, context.pose), context.pose, context.pose_rate)
        initial["crank_rate"] = rates if np.isfinite(rates).all() else 0.0
    numbers = {"robot": laws.robot_record(robot), "params": difference_params(options, context.period)}
    part = Part("estimator", difference_tick, {}, {"reading": 6}, ("measurement",), initial, (Legs,), STATUSES)
    return part._replace(parameters=numbers)
