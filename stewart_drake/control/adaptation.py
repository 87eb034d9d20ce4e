"""Learns the motors and the head that a robot has while it moves, from commands and readings of the cranks alone.

The law is in `adaptation_laws`; here are its options, the part that it is in a loop, and what it has learnt as a model.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.base.atomic_files import checksum
from stewart_drake.base.config import Flag, Positive, Real
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import new_record
from stewart_drake.control import adaptation_laws as law
from stewart_drake.control.adaptation_laws import HALF, LATE, MIDDLE, ROWS
from stewart_drake.control.arrow_factor import JOINT, OWN, PLACE
from stewart_drake.control.ball_joints import BallJoints, joints_record
from stewart_drake.control.base import LEARNT_SIGNALS, AdaptationOptions
from stewart_drake.control.learnt_laws import ROBOT_SIZE, show_first
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.friction import FRICTION
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, robot_record
from stewart_drake.robot import RobotParameters

SIZE_HEAD, SIZE_DRIVE, SIZE_TORQUE, SIZE_OWN_DRIVE = 0.25, 0.35, 0.03, 0.06
"""[-] standard deviations of logarithms, before anything is learnt; torque: of motors that take one; own: how far apart
motors of a robot are."""
SIZE_DAMPING, SIZE_SERVO_DAMPING, SIZE_COULOMB, SHARE_OWN, SIZE_DELAY = 0.25, 0.03, 0.1, 0.2, 0.012
"""Likewise, [s/rad] and [-] of the torque limit; how far apart motors are, of that; [s] of a servo's delay."""
SIZE_PLACE = 0.15
"""[-] likewise, of the head's centre of mass, of the robot's characteristic length."""
SIZE_PUSH, PUSH_KEPT = 0.1, 2.0
"""[-] likewise, of a push sideways, of the head's weight; [s] of motion after which that counts 37 %."""
ALIKE = 0.6
"""[s] for which samples err alike, by what the model does not have: together they count as one."""
FINEST = 0.008
"""[s] smallest standard deviation of the kernel: finer, noise of the readings makes much of the acceleration."""
BLEND, BLEND_TORQUE = 0.5, 0.1
"""[s] in which numbers go over into new ones, and where a motor's torque depends on them at once."""
WIDTH = 2.2
"""[blocks] of the kernel's standard deviation, as near as whole ticks allow; the fewer, the later a sample."""
ADAPTS = 2.0
"""[s] of motion in which the limit for refused samples widens by a factor of e, if all are refused."""
SELDOM = 0.016
"""[s] from one forgetting to the next, and of what is shown: both together cost more than a sample."""
_LEARNT_OF_MOTORS = ("stiffness", "ratios", "torque_constant", "damping", "delay")
_LINKS = ("rod_mass", "rod_inertia", "crank_mass", "crank_inertia")
_HEAD = ("platform_mass", "platform_moment", "platform_tensor", "platform_inertia")


class RegressionOptions(AdaptationOptions):
    """Regression of commands on the motion that was read: head, stiffness or torque constants, damping, dry friction.

    It begins with what `model` believes. What a robot that rests, is hit or is at its limits says does not count, what
    a crank that sticks for a moment says counts less, and a push sideways that lasts is told apart, but for servos. Any
    other push counts once it lasts for seconds. For motors that take torques, head, rods and cranks are those in units
    of the torque that is commanded.
    """

    moved_keys: ClassVar[Mapping[str, str]] = {"reading_age": "model.reading_age"}
    is_kept: ClassVar[bool] = True
    kind: Literal["regression"] = "regression"
    forgetting: Annotated[Real, Field(ge=1.0, le=1e5)] = 8.0
    """[s] of motion after which a sample counts 37 %; for a push that lasts 2 s. At least 1: samples within 0.6 s count
    as one, and one alone tells nothing."""
    smoothing: Positive | None = None
    """[s] standard deviation of the kernel; null for 1.5 periods, or more where the noise of the readings needs it."""
    drive: Positive | None = None
    """[-] how far stiffness or torque constants may be off, as a standard deviation; null for 0.35, and for motors that
    take torques 0.03."""
    slowest: Positive = 0.03
    """[rad/s] of a crank below which it counts as resting, and its samples are left out."""
    noise: Annotated[Real, Field(ge=1e-4, le=1.0)] = 0.003
    """[-] standard deviation of a sample, of the motors' torque limit; the least that is assumed. No model and no motor
    is right to less than 0.0001 of it, and at 1 no sample tells anything."""
    cautious: Flag = False
    """Whether friction is compensated only as far as it is known by now: too much of it would lose a slow loop."""
    center_of_mass: Flag = True
    """Whether the head's centre of mass is learnt too: a load beside its middle moves it."""
    ball_joints: Flag = False
    """Whether friction of the rods' ball joints is learnt too: one viscous and one dry number for all of them."""
    frozen: Flag = False
    """Whether nothing is learnt: the numbers stay as they are in `model`, all friction of which is compensated."""

    @property
    def forgets(self) -> str:
        return "cautious" if self.cautious and not self.frozen else ""

    def parts(self, context: LoopContext) -> tuple[Part, ...]:
        return (regression_part(self, context),)


class Learnt(NamedTuple):
    """What was learnt, or half the widths of its intervals, as a row (20,) of the signal of that name has it."""

    mass: float  # [kg] of the head.
    delay: float  # [s] by which a servo is later than was believed.
    drive: np.ndarray  # (6,) [-] torque of a motor for its command, over what was believed.
    viscous: np.ndarray  # (6,) [N m s/rad].
    coulomb: np.ndarray  # (6,) [N m].

    @classmethod
    def of(cls, row: np.ndarray) -> Learnt:
        return cls(float(row[0]), float(row[1]), row[2:8], row[8:14], row[14:20])


def last_learnt(log: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The last row of each signal that tells what was learnt; empty where a log has none."""
    return {name: log[name][-1] for name in LEARNT_SIGNALS if name in log and len(log[name])}


def has_learnt(log: Mapping[str, np.ndarray]) -> bool:
    """Whether anything that was learnt is another than at first, a number or how well it is known."""
    return any(not np.array_equal(log[name][0], last) for name, last in last_learnt(log).items())


def rows_of(known: Mapping[str, np.ndarray]) -> list[tuple[str, str]]:
    """What was learnt, see `last_learnt`, with 95 % intervals, in lines to be read: the lowest and highest motor's."""
    value, width = Learnt.of(known["learnt"]), Learnt.of(known["learnt_half_width"])
    lines = [("learnt: head", f"{value.mass:.4g} ± {width.mass:.2g} kg")]
    if (place := known.get("learnt_center_of_mass")) is not None:
        shown = " ".join(f"{1e3 * x:.3g}" for x in place[:PLACE])
        lines.append(("learnt: its centre of mass, x y z", f"{shown} ± {1e3 * place[PLACE:].max():.2g} mm"))
    if width.delay > 0.0:
        lines.append(("learnt: delay, more than believed", f"{1e3 * value.delay:.3g} ± {1e3 * width.delay:.2g} ms"))
    units = {"drive": ("torque over what was believed", "1"), "viscous": ("viscous friction", "N m s/rad")}
    for name, (words, unit) in (units | {"coulomb": ("Coulomb friction", "N m")}).items():
        of, wide = getattr(value, name), getattr(width, name)
        shown = f"{of.min():.4g} to {of.max():.4g} ± {wide.max():.2g}"
        lines.append((f"learnt: {words}", shown if unit == "1" else f"{shown} {unit}"))
    if (joints := known.get("learnt_joints")) is not None:
        for n, (words, unit) in enumerate((("viscous", "N m s/rad"), ("dry", "N m"))):
            lines.append(
                (f"learnt: {words} friction of ball joints", f"{joints[n]:.4g} ± {joints[JOINT + n]:.2g} {unit}")
            )
    return lines


def model_of(known: Mapping[str, np.ndarray], belief: Any) -> dict[str, Any]:
    """Robot, motors and friction as keys of `model`: those of `belief`, with what was learnt, see `last_learnt`."""
    robot, motors, friction = belief.robot, belief.motors, belief.friction
    value = Learnt.of(known["learnt"])
    of_motors, viscous, coulomb = motors.with_learnt(value)
    keys, weaker = ({"motors": of_motors}, 1.0) if of_motors else ({}, 1.0 / float(value.drive.mean()))
    more = np.subtract(friction.break_away or friction.coulomb, friction.coulomb)
    rubs = {"coulomb": coulomb.tolist(), "viscous": np.maximum(viscous, 0.0).tolist()}
    keys["friction"] = {**friction.to_dict(), **rubs, "break_away": (coulomb + more).tolist()}
    if not more.any():
        keys["friction"]["break_away"] = None
    if (joints := known.get("learnt_joints")) is not None:
        rub = {"viscous": float(joints[0]), "coulomb": float(joints[1])}
        keys["friction"]["joints"] = {**(friction.joints or BallJoints()).to_dict(), **rub}
    head = robot.heavier(value.mass / robot.platform_mass, weaker)
    if (place := known.get("learnt_center_of_mass")) is not None:
        # A robot's keys are in P.
        head["platform_center_of_mass"] = (robot.tool_rotation @ place[:PLACE] + robot.tool_position).tolist()
    return keys | {"robot": {**robot.given(), **head}}


def machine_text(belief: Any) -> str:
    """What of a believed robot and its motors is not learnt: its links, its kind of motors and a digest of it all."""
    robot, motors = belief.robot, belief.motors
    learnt = {*robot.heavier(1.0), "platform_center_of_mass", *_LEARNT_OF_MOTORS}
    fixed = [{key: value for key, value in each.to_dict().items() if key not in learnt} for each in (robot, motors)]
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
    """Weights (3, n) of commands that act `late` [blocks] after the reading of their own block, and of derivatives."""
    at = np.arange(ROWS) - MIDDLE + late
    bell = np.where(np.abs(at) <= HALF + 0.5, np.exp(-0.5 * (at / width) ** 2), 0.0)
    bell /= bell.sum()
    # What the window cuts off must not make it later.
    bell *= 1.0 - at * (bell @ at) / (bell @ at**2)
    bell /= bell.sum()
    return np.stack([bell, at * bell / width**2, (at**2 - width**2) * bell / width**4])


def room_of(robot: RobotParameters) -> float:
    """[m] by which each coordinate of the head's centre of mass may be another, with a tenth of its least inertia left.

    The inertia about the origin stays as it is believed; that about the centre of mass is the rest.
    """
    mass, inertia = robot.platform_mass, robot.platform_inertia_about_origin
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * PLACE), axis=-1).reshape(-1, PLACE)

    def least(room: float) -> float:
        at = robot.platform_center + room * corners
        about = np.sum(at * at, axis=1)[:, None, None] * np.eye(PLACE) - at[:, :, None] * at[:, None, :]
        return float(np.linalg.eigvalsh(inertia - mass * about).min())

    below, above, bound = 0.0, robot.characteristic_length, 0.1 * least(0.0)
    for _ in range(30):
        middle = 0.5 * (below + above)
        below, above = (middle, above) if least(middle) > bound else (below, middle)
    return below


def regression_part(options: RegressionOptions, context: LoopContext, alike: float = ALIKE) -> Part:
    """`reading` (6,) or (12,), `command` (6,) -> numbers that stand in for constants of other parts.

    Samples within `alike` [s] count as one.
    """
    motors, robot, believed = context.motors, context.robot, context.friction
    smoothing = options.smoothing
    if smoothing is None:
        # At which noise of the readings leaves a rate that is known to the width of friction's reversal.
        coarse = context.noise**2 * context.period / (4.0 * np.sqrt(np.pi) * believed.width**2)
        smoothing = max(FINEST, 1.5 * context.period, float(np.cbrt(coarse)))
    stride = max(1, round(smoothing / (WIDTH * context.period)))
    if smoothing > HALF / 2.0 * stride * context.period:
        stride += 1
    block = stride * context.period
    seldom = max(1, int(SELDOM / block))
    width, late = smoothing / block, (context.latency - 0.5 * context.period) / block
    if not 1.0 <= width <= HALF / 2.0:
        raise ConfigurationError("adaptation.smoothing", smoothing, f"at least {context.period:g} s, a period")
    if late > LATE - 0.5:
        most, commands = (LATE - 0.5) * block, context.latency - context.reading_age - 0.5 * context.period
        allowed = f"at most {most:g} s together with the {commands:g} s by which commands are late"
        raise ConfigurationError("model.reading_age", context.reading_age, allowed)
    limit = np.asarray(motors.available(robot, np.zeros(6)), dtype=float)
    friction = believed.record()
    coulomb = friction["coulomb"][0]
    servo_damping = getattr(motors, "damping", 0.0)
    weights = kernel_weights(width)
    per = np.array([1.0, block, block**2])[:, None]
    by_gain, by_angle = not motors.by_torque, motors.holds
    # What ball joints rub is nearly damping of the motors: with both unknown, each may be farther off.
    damping = SIZE_SERVO_DAMPING if by_angle and not options.ball_joints else SIZE_DAMPING
    drive = options.drive or (SIZE_DRIVE if by_gain else SIZE_TORQUE)
    joints = believed.joints or BallJoints()
    size, joint = limit.mean(), JOINT if options.ball_joints else 0
    common = [SIZE_HEAD, drive, damping * size, SIZE_COULOMB * size, SIZE_DELAY]
    push = SIZE_PUSH * STANDARD_GRAVITY * robot.platform_mass
    common += [push, push, push * robot.characteristic_length]
    beside = SIZE_PLACE * robot.characteristic_length
    common += [beside * robot.platform_mass] * PLACE if options.center_of_mass else []
    common += [SIZE_DAMPING * size, SIZE_COULOMB * size] if options.ball_joints else []
    params = new_record(
        law.params_of(len(common)), gravity=context.gravity, stride=stride, kernel=weights / per,
        late=late_weights(width, late) / per, gain=motors.gains, limit=limit, by_gain=by_gain, by_angle=by_angle,
        damping=friction["viscous"][0] + servo_damping, coulomb=coulomb, servo_damping=servo_damping,
        noise=options.noise, alike=max(1.0, alike / block), slowest=options.slowest,
        width=believed.width, seldom=seldom,
        keep=np.exp(-seldom * block / options.forgetting),
        keep_push=np.exp(-seldom * block / min(PUSH_KEPT, options.forgetting)),
        adapt=block / ADAPTS, blend=min(1.0, block / (BLEND if by_angle else BLEND_TORQUE)),
        first=3 * HALF + 1 + np.ceil(late),
        most_moment=robot.platform_mass * room_of(robot), cautious=options.cautious, frozen=options.frozen,
        own=[SIZE_OWN_DRIVE, *(SHARE_OWN * size * np.array([damping, SIZE_COULOMB]))], common=common,
    )  # fmt: skip
    whole = robot_record(robot)
    rest, bodies = whole.copy(), np.zeros((ROBOT_SIZE, 3))
    bodies[:, 0] = whole.view(np.float64)
    for column, names in ((1, _LINKS), (2, _HEAD)):
        for name in names:
            at = int(Robot.layout.fields[name][1]) // 8  # type: ignore[index]
            place = slice(at, at + whole[name].size)
            bodies[place, column], bodies[place, 0] = bodies[place, 0], 0.0
    for name in _HEAD:
        rest[name] = 0.0
    # The head as believed, then heads that have a unit first moment alone.
    heads = np.repeat(rest, 1 + PLACE)
    heads[0] = whole[0]
    heads["platform_moment"][1:] = np.eye(PLACE)
    angles = inverse_kinematics(robot, context.pose)
    first = new_record(
        law.state_of(len(common), joint), friction=friction, gain=motors.gains,
        robot=whole.view(np.float64), pose=context.pose, angles=angles, commands=motors.initial_command(context),
        good=1.0, doubt=1.0, noise_scale=1.0,
    )  # fmt: skip
    cautious = options.cautious and not options.frozen
    if cautious:
        for level in ("coulomb", "break_away", "viscous"):
            first["friction"][level] = 0.0
    first["common"][0, 3], first["own"][0, :, 2] = coulomb.mean(), coulomb - coulomb.mean()
    for k in range(OWN):
        first["information"][0, :, k, k] = 1.0 / params["own"][0, k]
    for k in range(len(common)):
        first["shared"][0, k, k] = 1.0 / params["common"][0, k]
    hanging = joints_record(joints if options.ball_joints else believed.joints)
    if options.ball_joints:
        rubs = np.array([joints.viscous, joints.coulomb])
        first["joints"] = hanging.view(np.float64)
        first["common"][0, -JOINT:] = rubs
        if cautious:
            first["joints"][0, :JOINT] = 0.0
    for words in ("held", "used"):
        first[f"{words}_own"], first[f"{words}_common"] = first["own"], first["common"]
    constants = {
        "robot": whole, "rest": rest, "heads": heads, "joints": hanging, "bodies": bodies,
        "friction": friction, "params": params,
    }  # fmt: skip
    show_first(params, bodies, first)
    if options.frozen:
        # It stays believed, for good.
        first["friction_unknown"] = np.zeros(1, FRICTION)
    outputs = ["friction", "robot", "learnt", "learnt_half_width", "friction_unknown", "doubt"]
    outputs += ["gain"] if by_gain else []
    outputs += ["lead"] if by_angle else []
    outputs += ["learnt_center_of_mass"] if options.center_of_mass else []
    outputs += ["joints", "learnt_joints"] if options.ball_joints else []
    inputs = {"reading": context.reading, "command": 6}
    return Part("adaptation", law.regression_tick, constants, inputs, tuple(outputs), first, (Legs,))
