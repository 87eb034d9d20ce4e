"""Adaptation by regression: a robot learns its motors and its head from commands and crank angles while it moves.

The law is in `adaptation_laws`; this file has its options, its part of the loop, and what was learnt as a model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.atomic_files import Document, checksum
from stewart_drake.base.config import Flag, Positive, Real
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.control.adaptation_laws import regression_tick
from stewart_drake.control.ball_joints import BallJoints, joints_record
from stewart_drake.control.base import LEARNT_SIGNALS, AdaptationOptions
from stewart_drake.control.learnt_parameters import first_intervals
from stewart_drake.control.regression_records import (
    HALF,
    LATE,
    MIDDLE,
    ROWS,
    Learnt,
    LearntCenter,
    LearntJoints,
    RegressionParams,
    RegressionState,
    Sample,
    state_type,
)
from stewart_drake.control.square_root_filter import COULOMB, MOTOR_COULOMB, N_JOINT, N_MOMENT, N_MOTOR
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.friction import Friction
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.mechanics.kinematics_laws import Legs, robot_record
from stewart_drake.robot import RobotParameters, base_reading

if TYPE_CHECKING:
    from stewart_drake.scenario.control_options import Model

# Initial standard deviations of the unknowns.
SIZE_HEAD = 0.25  # [-] logarithm of the head's mass.
SIZE_DRIVE, SIZE_TORQUE = 0.35, 0.03  # [-] logarithm of the drive, common to all motors; of motors that take torques.
SIZE_MOTOR_DRIVE = 0.06  # [-] difference of a motor from that.
SIZE_DAMPING, SIZE_SERVO_DAMPING = 0.25, 0.03  # [s/rad] damping over the torque limit; of servos.
SIZE_COULOMB = 0.1  # [-] Coulomb friction over the torque limit.
MOTOR_SHARE = 0.2  # Deviation of damping or friction between the motors, over the common one.
SIZE_DELAY = 0.012  # [s] delay of a servo.
SIZE_CENTER = 0.15  # [-] shift of the head's centre of mass over the robot's characteristic length.
SIZE_PUSH = 0.1  # [-] sideways push over the head's weight.
PUSH_KEPT = 2.0  # [s] of motion after which information on a push has decayed to 37 %.
CORRELATION_TIME = 0.6
"""[s] for which errors of the model are correlated: the samples within it count as one."""
FINEST = 0.008
"""[s] smallest standard deviation of the kernel; a finer one amplifies noise of the readings in the acceleration."""
BLEND, BLEND_TORQUE = 0.5, 0.1
"""[s] time constants of the low pass from the estimate to the applied numbers: for servos, and for motors that take
torques or currents."""
WIDTH = 2.2
"""[blocks] standard deviation of the kernel, as near as whole ticks allow."""
LIMIT_TIME = 2.0
"""[s] of motion in which the limit for outliers widens by a factor of e, if all rows are rejected."""
REPORT_PERIOD = 0.016
"""[s] between two updates of the intervals, and between two steps of forgetting. They take longer than a sample."""
_LEARNT_OF_MOTORS = ("stiffness", "ratios", "torque_constant", "damping", "delay")
_HEAD = ("platform_mass", "platform_moment", "platform_tensor", "platform_inertia")


class RegressionOptions(AdaptationOptions):
    """Regression of commands on the measured motion: head, stiffness or torque constants, damping, dry friction.

    It starts from `model`. Samples do not count while the robot rests, is hit or is at its limits; a crank that sticks
    for a moment counts less. A lasting push sideways is estimated too, except with servos; any other push changes the
    estimate once it lasts for seconds. With motors that take torques, masses and inertias are relative to the commanded
    torque.
    """

    moved_keys: ClassVar[Mapping[str, str]] = {"reading_age": "model.reading_age"}
    is_kept: ClassVar[bool] = True
    kind: Literal["regression"] = "regression"
    forgetting: Annotated[Real, Field(ge=1.0, le=1e5)] = 8.0
    """[s] of motion after which a sample counts 37 %; for a lasting push 2 s. At least 1, because samples within 0.6 s
    count as one."""
    smoothing: Positive | None = None
    """[s] standard deviation of the kernel; null for 1.5 periods, or more where the noise of the readings needs it."""
    drive: Positive | None = None
    """[-] how far stiffness or torque constants may be off, as a standard deviation; null for 0.35, and for motors that
    take torques 0.03."""
    slowest: Positive = 0.03
    """[rad/s] of a crank below which it counts as resting, and its samples are left out."""
    noise: Annotated[Real, Field(ge=1e-4, le=1.0)] = 0.003
    """[-] standard deviation of a sample, over the motors' torque limit. At least 0.0001, because no model and no motor
    is more accurate; at 1 nothing can be learnt."""
    cautious: Flag = False
    """Whether friction is compensated only as far as it is known: too much compensation makes a slow loop unstable."""
    center_of_mass: Flag = True
    """Whether the head's centre of mass is learnt too: a load off its centre moves it."""
    ball_joints: Flag = False
    """Whether friction of the rods' ball joints is learnt too: one viscous and one dry number for all of them."""
    frozen: Flag = False
    """Whether nothing is learnt: the numbers stay those of `model`, and all of its friction is compensated."""

    @property
    def forgets(self) -> str:
        return "cautious" if self.cautious and not self.frozen else ""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        return (regression_part(self, context),)


def last_learnt(log: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The last rows of the signals of what was learnt; empty where a log has none."""
    return {name: log[name][-1] for name in LEARNT_SIGNALS if name in log and len(log[name])}


def has_learnt(log: Mapping[str, np.ndarray]) -> bool:
    """Whether a number that was learnt, or its interval, has changed since the start."""
    return any(not np.array_equal(log[name][0], last) for name, last in last_learnt(log).items())


def rows_of(known: Mapping[str, np.ndarray]) -> list[tuple[str, str]]:
    """Lines of text about what was learnt, see `last_learnt`, with 95 % intervals: the lowest and highest motor's."""
    value, width = Learnt.of(known["learnt"]), Learnt.of(known["learnt_half_width"])
    lines = [("learnt: head", f"{value.mass:.4g} ± {width.mass:.2g} kg")]
    if "learnt_center_of_mass" in known:
        center = LearntCenter.of(known["learnt_center_of_mass"])
        shown = " ".join(f"{1e3 * x:.3g}" for x in center.value)
        lines.append(("learnt: its centre of mass, x y z", f"{shown} ± {1e3 * center.half_width.max():.2g} mm"))
    if width.delay > 0.0:
        lines.append(
            ("learnt: delay, beyond that of the model", f"{1e3 * value.delay:.3g} ± {1e3 * width.delay:.2g} ms")
        )
    for words, unit, of, wide in (
        ("torque over that of the model", "", value.drive, width.drive),
        ("viscous friction", " N m s/rad", value.viscous, width.viscous),
        ("Coulomb friction", " N m", value.coulomb, width.coulomb),
    ):
        lines.append((f"learnt: {words}", f"{of.min():.4g} to {of.max():.4g} ± {wide.max():.2g}{unit}"))
    if "learnt_joints" in known:
        joints = LearntJoints.of(known["learnt_joints"])
        viscous = f"{joints.viscous:.4g} ± {joints.viscous_half_width:.2g} N m s/rad"
        lines.append(("learnt: viscous friction of ball joints", viscous))
        dry = f"{joints.coulomb:.4g} ± {joints.coulomb_half_width:.2g} N m"
        lines.append(("learnt: dry friction of ball joints", dry))
    return lines


def model_of(known: Mapping[str, np.ndarray], before: Any) -> Document:
    """Robot, motors and friction as keys of `model`: those of the model before, with what was learnt."""
    robot, motors, friction = before.robot, before.motors, before.friction
    value = Learnt.of(known["learnt"])
    of_motors, viscous, coulomb = motors.with_learnt(value)
    keys, weaker = ({"motors": of_motors}, 1.0) if of_motors else ({}, 1.0 / float(value.drive.mean()))
    excess = np.subtract(friction.break_away or friction.coulomb, friction.coulomb)
    levels = {"coulomb": coulomb.tolist(), "viscous": np.maximum(viscous, 0.0).tolist()}
    levels["break_away"] = (coulomb + excess).tolist() if excess.any() else None
    keys["friction"] = {**friction.to_dict(), **levels}
    if "learnt_joints" in known:
        joints = LearntJoints.of(known["learnt_joints"])
        levels = {"viscous": float(joints.viscous), "coulomb": float(joints.coulomb)}
        keys["friction"]["joints"] = {**(friction.joints or BallJoints()).to_dict(), **levels}
    head = robot.scaled_masses(value.mass / robot.platform_mass, weaker)
    if "learnt_center_of_mass" in known:
        # A robot's keys are in P.
        center = robot.tool_rotation @ LearntCenter.of(known["learnt_center_of_mass"]).value
        head["platform_center_of_mass"] = (center + robot.tool_position).tolist()
    return keys | {"robot": {**robot.given(), **head}}


def machine_text(model: Model) -> str:
    """What is not learnt of a robot and its motors: its links, its kind of motors and a digest of it all."""
    robot, motors = model.robot, model.motors
    learnt = {*robot.scaled_masses(1.0), "platform_center_of_mass", *_LEARNT_OF_MOTORS}
    fixed = [{key: value for key, value in part.to_dict().items() if key not in learnt} for part in (robot, motors)]
    return f"{robot.links_text}, {motors.kind} motors, {checksum(fixed)}"


def kernel_weights(width: float) -> np.ndarray:
    """Weights (3, n) of a Gaussian of a standard deviation [blocks], its first two derivatives: exact for parabolas."""
    at = np.arange(-HALF, HALF + 1.0)
    bell = np.exp(-0.5 * (at / width) ** 2)
    bell /= bell.sum()
    square = bell @ at**2
    bent = bell * (at**2 - square)
    return np.stack([bell, at * bell / square, 2.0 * bent / (bent @ at**2)])


def late_weights(width: float, late: float) -> np.ndarray:
    """Weights (3, n) of commands that act `late` [blocks] after the reading of their block, and of derivatives."""
    at = np.arange(ROWS) - MIDDLE + late
    bell = np.where(np.abs(at) <= HALF + 0.5, np.exp(-0.5 * (at / width) ** 2), 0.0)
    bell /= bell.sum()
    # The cut at the window's end must not delay it.
    bell *= 1.0 - at * (bell @ at) / (bell @ at**2)
    bell /= bell.sum()
    return np.stack([bell, at * bell / width**2, (at**2 - width**2) * bell / width**4])


def room_of(robot: RobotParameters) -> float:
    """[m] largest change of the coordinates of the head's centre of mass that leaves a tenth of its least inertia.

    The inertia about the origin stays that of the model; that about the centre of mass is the rest.
    """
    mass, inertia = robot.platform_mass, robot.platform_inertia_about_origin
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)

    def least(room: float) -> float:
        at = robot.platform_center + room * corners
        about = np.sum(at * at, axis=1)[:, None, None] * np.eye(3) - at[:, :, None] * at[:, None, :]
        return float(np.linalg.eigvalsh(inertia - mass * about).min())

    below, above, bound = 0.0, robot.characteristic_length, 0.1 * least(0.0)
    for _ in range(30):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if least(middle) > bound else (below, middle)
    return below


def regression_part(
    options: RegressionOptions, context: LoopContext, correlation_time: float = CORRELATION_TIME
) -> Part:
    """`reading` (6,) or (12,), `command` (6,) -> parameters of other parts, and what was learnt.

    Samples within the correlation time [s] count as one.
    """
    motors, friction = context.motors, context.friction.record()
    joints = context.friction.joints or BallJoints()
    ball_joints = joints_record(joints if options.ball_joints else context.friction.joints)
    robot = robot_record(context.robot)
    rest = robot.copy()
    for name in _HEAD:
        rest[name] = 0.0
    params = _params(options, context, correlation_time)
    first = _first_state(options, context, params)
    if options.ball_joints:
        first["joints"] = ball_joints
        first["shared"][0, -N_JOINT:] = joints.viscous, joints.coulomb
        if options.forgets:
            first["joints"]["viscous"] = first["joints"]["coulomb"] = 0.0
    for words in ("bounded", "applied"):
        first[f"{words}_per_motor"], first[f"{words}_shared"] = first["per_motor"], first["shared"]
    first_intervals(params, robot, first)
    if options.frozen:
        # The model stays as it is.
        first["friction_unknown"] = Friction.new()
    constants = {"robot": robot, "rest": rest, "joints": ball_joints, "friction": friction, "params": params}
    outputs = ["friction", "robot", "learnt", "learnt_half_width", "friction_unknown", "coulomb_uncertainty"]
    outputs += [] if motors.by_torque else ["gain"]
    outputs += ["command_lead"] if motors.holds else []
    outputs += ["learnt_center_of_mass"] if options.center_of_mass else []
    outputs += ["joints", "learnt_joints"] if options.ball_joints else []
    inputs = {"reading": context.reading, "command": 6}
    return Part("adaptation", regression_tick, constants, inputs, tuple(outputs), first, (Legs, Sample))


def _params(options: RegressionOptions, context: LoopContext, correlation_time: float) -> RegressionParams:
    """Parameters of the law."""
    motors, robot = context.motors, context.robot
    stride, smoothing = _kernel_size(options, context)
    block = stride * context.period
    report_period = max(1, int(REPORT_PERIOD / block))
    width, late = smoothing / block, (context.latency - 0.5 * context.period) / block
    if not 1.0 <= width <= HALF / 2.0:
        raise ConfigurationError("adaptation.smoothing", smoothing, f"at least {context.period:g} s, a period")
    if late > LATE - 0.5:
        most, commands = (LATE - 0.5) * block, context.latency - context.reading_age - 0.5 * context.period
        allowed = f"at most {most:g} s together with the {commands:g} s by which commands are late"
        raise ConfigurationError("model.reading_age", context.reading_age, allowed)
    motor_sigma, shared_sigma = _initial_sigmas(options, context)
    friction, per = context.friction.record(), np.array([1.0, block, block**2])[:, None]
    servo_damping = getattr(motors, "damping", 0.0)
    return RegressionParams.sized(shared=len(shared_sigma)).new(
        base=base_reading(context.gravity),
        stride=stride,
        kernel=kernel_weights(width) / per,
        late=late_weights(width, late) / per,
        gain=motors.gains,
        limit=np.asarray(motors.available(robot, np.zeros(6)), dtype=float),
        by_gain=not motors.by_torque,
        by_angle=motors.holds,
        damping=friction["viscous"][0] + servo_damping,
        coulomb=friction["coulomb"][0],
        servo_damping=servo_damping,
        noise=options.noise,
        correlated=max(1.0, correlation_time / block),
        slowest=options.slowest,
        width=context.friction.width,
        report_period=report_period,
        keep=np.exp(-report_period * block / options.forgetting),
        keep_push=np.exp(-report_period * block / min(PUSH_KEPT, options.forgetting)),
        widening=block / LIMIT_TIME,
        blend=min(1.0, block / (BLEND if motors.holds else BLEND_TORQUE)),
        first=3 * HALF + 1 + np.ceil(late),
        motor_sigma=motor_sigma,
        shared_sigma=shared_sigma,
        most_moment=robot.platform_mass * room_of(robot),
        cautious=options.cautious,
        frozen=options.frozen,
    )


def _kernel_size(options: RegressionOptions, context: LoopContext) -> tuple[int, float]:
    """Ticks of a block, and standard deviation of the kernel [s]."""
    smoothing = options.smoothing
    if smoothing is None:
        # With this one noise of the readings changes a rate by the width of friction's reversal.
        coarse = context.noise**2 * context.period / (4.0 * np.sqrt(np.pi) * context.friction.width**2)
        smoothing = max(FINEST, 1.5 * context.period, float(np.cbrt(coarse)))
    stride = max(1, round(smoothing / (WIDTH * context.period)))
    if smoothing > HALF / 2.0 * stride * context.period:
        stride += 1
    return stride, smoothing


def _initial_sigmas(options: RegressionOptions, context: LoopContext) -> tuple[list[float], list[float]]:
    """Initial standard deviations of the unknowns of a motor, and of the shared ones."""
    motors, robot = context.motors, context.robot
    size = np.asarray(motors.available(robot, np.zeros(6)), dtype=float).mean()
    # Friction of ball joints is nearly damping of the motors: with both unknown, either may be farther off.
    damping = SIZE_SERVO_DAMPING if motors.holds and not options.ball_joints else SIZE_DAMPING
    drive = options.drive or (SIZE_TORQUE if motors.by_torque else SIZE_DRIVE)
    push = SIZE_PUSH * STANDARD_GRAVITY * robot.platform_mass
    shared = [SIZE_HEAD, drive, damping * size, SIZE_COULOMB * size, SIZE_DELAY]
    shared += [push, push, push * robot.characteristic_length]
    if options.center_of_mass:
        shared += [SIZE_CENTER * robot.characteristic_length * robot.platform_mass] * N_MOMENT
    if options.ball_joints:
        shared += [SIZE_DAMPING * size, SIZE_COULOMB * size]
    return [SIZE_MOTOR_DRIVE, *(MOTOR_SHARE * size * np.array([damping, SIZE_COULOMB]))], shared


def _first_state(options: RegressionOptions, context: LoopContext, params: RegressionParams) -> RegressionState:
    """State before the first tick, but for ball joints."""
    shared, friction = params["shared_sigma"].size, context.friction.record()
    first = state_type(shared, N_JOINT if options.ball_joints else 0).new(
        friction=friction,
        gain=context.motors.gains,
        robot=robot_record(context.robot),
        pose=context.pose,
        angles=inverse_kinematics(context.robot, context.pose),
        commands=context.motors.initial_command(context),
        good=1.0,
        coulomb_uncertainty=1.0,
        noise_scale=1.0,
    )
    if options.forgets:
        for level in ("coulomb", "break_away", "viscous"):
            first["friction"][level] = 0.0
    coulomb = friction["coulomb"][0]
    first["shared"][0, COULOMB] = coulomb.mean()
    first["per_motor"][0, :, MOTOR_COULOMB] = coulomb - coulomb.mean()
    for k in range(N_MOTOR):
        first["motor_rows"][0, :, k, k] = 1.0 / params["motor_sigma"][0, k]
    for k in range(shared):
        first["shared_rows"][0, k, k] = 1.0 / params["shared_sigma"][0, k]
    return first
