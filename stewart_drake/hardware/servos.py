"""Motors as they are sold: servos that take angles and close a loop of their own, and motors that take currents."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from stewart_drake.base.config import Natural, NotNegative, Positive, Text, one_for_six
from stewart_drake.base.errors import ConfigurationError, Status
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.base.sampling import steps_per
from stewart_drake.hardware.motors import MotorOptions
from stewart_drake.hardware.presets import PRESETS, Presets
from stewart_drake.hardware.rounding import rounding_part
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.dynamics import crank_inertia
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.mechanics.kinematics_laws import LEGS, OK, UNREACHABLE, crank_rates, legs_at, robot_record, twist_of
from stewart_drake.robot import RobotParameters

POSITION_PRESETS, CURRENT_PRESETS = Presets("position"), Presets("current")
STIFFEST = 0.5
"""[-] largest stiffness times the square of its period, over a crank's inertia: a held torque then still settles."""


PLAY_WIDTH = 0.25
"""[-] of the play by which a servo is wound up where 76 % of the play is taken out: a jump would chatter."""


class _SoldMotors(MotorOptions):
    """What is common to motors as they are sold."""

    by_torque: ClassVar[bool] = False
    presets: ClassVar[Presets]

    torque_limit: Positive | None = None
    """[N m] largest torque at rest, never above the robot's effort limit; null for that."""
    no_load_speed: Positive | None = None
    """[rad/s] speed at which nothing of `torque_limit` is left; it falls in a straight line. null for any speed."""

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, data: Any) -> Any:
        return cls.presets.with_defaults(data) if isinstance(data, dict) else data

    @property
    def nominal(self) -> MotorOptions:
        return self

    @property
    def gear(self) -> Any:
        return PRESETS.get(getattr(self, "preset", None) or "")

    def limits(self, robot: RobotParameters) -> np.ndarray:
        """(6,) [N m] largest torques at rest."""
        most = np.inf if self.torque_limit is None else self.torque_limit
        limits: np.ndarray = np.minimum(robot.effort_limits, most)
        return limits

    @property
    def slope(self) -> float:
        """[s/rad] share of the limit that a motor loses for its speed."""
        return 0.0 if self.no_load_speed is None else 1.0 / self.no_load_speed

    def available(self, robot: RobotParameters, rates: np.ndarray) -> np.ndarray:
        supply = getattr(self, "supply", 1.0)
        most, speed = supply * self.limits(robot), np.abs(rates)
        # What is left of a limit at a speed, and what the damping takes of it.
        left = np.minimum(most * (1.0 - self.slope / supply * speed), most - getattr(self, "damping", 0.0) * speed)
        return np.minimum(robot.effort_limits, left)


class PositionServos(_SoldMotors):
    """Servos that take angles: T = clip(stiffness (command - angle), limit) - damping rate.

    The clip comes before the damping, as in a voltage drive: `damping` has the back-EMF, and a servo that turns at
    limit / damping gives no torque. No torque is above the robot's effort limit. What a servo has of dry friction is
    the plant's, `plant.friction`; a preset sets that too. Default numbers are those of a Dynamixel XL330-M288 at 5 V:
    Rhoban's `bam` (github.com/Rhoban/bam) identified stiffness 0.6 to 1.7 N m/rad with its maker's gain, and damping
    0.037 to 0.048 N m s/rad.
    """

    takes: ClassVar[str] = "angle"
    unit: ClassVar[str] = "rad"
    holds: ClassVar[bool] = True
    knobs = (("stiffness", "servo stiffness"),)
    presets: ClassVar[Presets] = POSITION_PRESETS

    kind: Literal["position"] = "position"
    preset: Annotated[Text, POSITION_PRESETS] | None = None
    """A servo that one can buy: what it says are the defaults of the other keys, and of the friction of `plant` and
    `model`; null for none."""
    stiffness: Annotated[Positive, Field(ge=1e-6)] = 1.0
    """[N m/rad] torque for an angle's error."""
    ratios: Annotated[tuple[Positive, Positive, Positive, Positive, Positive, Positive], one_for_six(Positive)] = (
        *(1.0,) * 6,
    )
    """[-] stiffness of each motor over `stiffness`."""
    damping: NotNegative = 0.04
    """[N m s/rad] torque that a turning servo loses: back-EMF, and what its loop adds."""
    supply: Positive = 1.0
    """[-] voltage over the nominal one; stiffness, limit and no-load speed are proportional to it."""
    period: Positive = 0.001
    """[s] of the servo's own loop, a whole multiple of plant.time_step."""
    resolution_bits: Annotated[Natural, Field(ge=6, le=24)] | None = 12
    """[bit] of a turn, to which commands and the servo's own readings are rounded; null for none."""
    dead_band: Annotated[NotNegative, Field(le=1.0)] = 0.0
    """[rad] error of the angle below which a servo gives no torque."""
    backlash: Annotated[NotNegative, Field(le=0.5)] = 0.0
    """[rad] play of the gear between what the servo reads and the crank: without a torque the crank is free in it."""
    delay: Annotated[NotNegative, Field(le=1.0)] = 0.0
    """[s] from a command's arrival to its effect, rounded to steps of the plant."""

    @property
    def dead_time(self) -> float:
        return self.delay

    @property
    def count(self) -> float:
        """[rad] to which angles are rounded, 0 for none."""
        return 0.0 if self.resolution_bits is None else 2.0 * math.pi / 2**self.resolution_bits

    @property
    def gains(self) -> np.ndarray:
        return self.supply * self.stiffness * np.array(self.ratios)

    def command_limits(self, robot: RobotParameters) -> np.ndarray:
        """The stops; a turn both ways without."""
        return np.clip(robot.crank_angle_ranges, -2.0 * np.pi, 2.0 * np.pi).T

    def with_learnt(self, value: Any) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
        gains = self.gains * value.drive
        mean, damping = float(gains.mean()), max(0.0, self.damping + min(0.0, float(value.viscous.min())))
        keys = {"stiffness": mean / self.supply, "ratios": (gains / mean).tolist(), "damping": damping}
        keys["delay"] = max(0.0, self.delay + value.delay)
        return self.given() | keys, value.viscous + self.damping - damping, value.coulomb

    def part(self, robot: RobotParameters, time_step: float) -> Part:
        stride = steps_per("motors.period", self.period, time_step)
        stiffest = STIFFEST * robot.crank_axis_inertias.min() / self.period**2
        if (largest := self.gains.max()) > stiffest:
            by_supply = self.supply * self.stiffness > stiffest
            key = "stiffness" if self.stiffness > stiffest else "supply" if by_supply else "ratios"
            most = np.max(getattr(self, key)) * stiffest / largest
            allowed = f"at most {most:.3g}: no motor above {stiffest:.3g} N m/rad, with motors.period {self.period:g} s"
            raise ConfigurationError(f"motors.{key}", getattr(self, key), allowed)
        most = np.linalg.eigvalsh(crank_inertia(robot, robot.home_pose))[0] / time_step
        if self.damping > most:
            allowed = f"at most {most:.3g} N m s/rad, with plant.time_step {time_step:g} s"
            raise ConfigurationError("motors.damping", self.damping, allowed)
        params = new_record(
            _PARAMS, self, stiffness=self.gains, limit=self.supply * self.limits(robot),
            slope=self.slope / self.supply, count=self.count, stride=stride, play=0.5 * self.backlash,
            most=robot.effort_limits,
        )  # fmt: skip
        numbers, first, inputs = {"params": params}, new_record(_STATE), {"command": 6, "crank_state": 12}
        return Part("motors", servo_tick, {}, inputs, ("torque",), first, period=time_step, parameters=numbers)

    def inverse_parts(self, context: LoopContext) -> tuple[Part, ...]:
        params = new_record(_BELIEVED, self, play=0.5 * self.backlash, feedback=float(context.feedback))
        numbers = {"robot": robot_record(context.robot), "gain": self.gains, "params": params}
        first = new_record(fields(command=6), command=self.initial_command(context))
        inputs = {"torque": 6, "measurement": 12, "reference": 18}
        aim = "measurement" if context.feedback else "reference"
        statuses = {UNREACHABLE: Status("unreachable_pose", aim, of_leg=True)}
        angles = Part("servo_command", servo_command, {}, inputs, ("command",), first, (LEGS,), statuses)
        angles = angles._replace(parameters=numbers)
        if context.feedback or self.count == 0.0:
            return (angles,)
        rounding = rounding_part(context, float(self.gains.mean()), self.damping, self.count)
        return angles.named(command="angles"), rounding.connected(command="angles")

    def initial_command(self, context: LoopContext) -> np.ndarray:
        angles: np.ndarray = inverse_kinematics(context.robot, context.pose)
        twist = context.initial_torque / self.gains
        return angles + twist + 0.5 * self.backlash * np.sign(twist)


class CurrentMotors(_SoldMotors):
    """Motors that take currents: T = torque_constant current, within the limits. Wrong numbers stand in `model.motors`.

    What a gear has of friction is the plant's, `plant.friction`; a preset sets that too.
    """

    takes: ClassVar[str] = "current"
    unit: ClassVar[str] = "A"
    presets: ClassVar[Presets] = CURRENT_PRESETS

    kind: Literal["current"] = "current"
    preset: Annotated[Text, CURRENT_PRESETS] | None = None
    """A motor that one can buy: what it says are the defaults of the other keys, and of the friction of `plant` and
    `model`; null for none."""
    torque_constant: Positive = 1.0
    """[N m/A] torque for a current."""
    current_limit: Positive | None = None
    """[A] largest current; null for any."""
    resolution: NotNegative = 0.0
    """[A] to whole steps of which currents are rounded; 0 for none."""
    delay: Annotated[NotNegative, Field(le=1.0)] = 0.0
    """[s] from a command's arrival to its effect, rounded to steps of the plant."""

    @property
    def dead_time(self) -> float:
        return self.delay

    @property
    def gains(self) -> np.ndarray:
        return np.full(6, self.torque_constant)

    def with_learnt(self, value: Any) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
        """One constant for all: what a motor rubs, in currents, is kept."""
        viscous, coulomb = (each * value.drive.mean() / value.drive for each in (value.viscous, value.coulomb))
        return self.given() | {"torque_constant": float((self.gains * value.drive).mean())}, viscous, coulomb

    def part(self, robot: RobotParameters, time_step: float) -> Part:
        most = np.inf if self.current_limit is None else self.torque_constant * self.current_limit
        limit = np.minimum(self.limits(robot), most)
        params = new_record(_CURRENT, self, limit=limit, slope=self.slope)
        numbers, first, inputs = {"params": params}, new_record(fields(torque=6)), {"command": 6, "crank_state": 12}
        return Part("motors", current_tick, {}, inputs, ("torque",), first, period=time_step, parameters=numbers)

    def inverse_parts(self, context: LoopContext) -> tuple[Part, ...]:
        numbers = {"gain": self.gains}
        first = new_record(fields(command=6), command=self.initial_command(context))
        return (Part("motor_current", current_command, {}, {"torque": 6}, ("command",), first, parameters=numbers),)

    def initial_command(self, context: LoopContext) -> np.ndarray:
        return context.initial_torque / self.torque_constant


_PARAMS = fields(stiffness=6, damping=(), dead_band=(), play=(), count=(), stride=(), slope=(), limit=6, most=6)
"""`PositionServos` as numbers. play: half of the backlash [rad]. count: [rad] to which angles are rounded, 0 for none.
stride: [steps] of its period. slope: of the limit over the speed [s/rad]. most: the robot's effort limits [N m]."""
_BELIEVED = fields(damping=(), play=(), feedback=())
"""feedback: whether the torque is one for the measured pose, rather than for the reference's."""
_CURRENT = fields(torque_constant=(), resolution=(), slope=(), limit=6)
_STATE = fields(torque=6, drive=6, steps=())
"""torque [N m]. drive: before the damping, held for a period [N m]. steps: done."""


@njit
def servo_tick(params: Any, command: Any, crank_state: Any, state: Any) -> None:
    """Torques (6,) [N m] of six servos, see `PositionServos`, in a step of the plant."""
    params, state = record(params), record(state)
    if state.steps % params.stride == 0.0:
        for i in range(6):
            wanted, angle = command[i], crank_state[i]
            if params.count > 0.0:
                wanted = params.count * np.rint(wanted / params.count)
                angle = params.count * np.rint(angle / params.count)
            error = wanted - angle
            error -= 2.0 * np.pi * np.rint(error / (2.0 * np.pi))
            if abs(error) <= params.dead_band:
                error = 0.0
            error -= min(max(error, -params.play), params.play)
            state.drive[i] = min(max(params.stiffness[i] * error, -params.limit[i]), params.limit[i])
    for i in range(6):
        torque = state.drive[i] - params.damping * crank_state[6 + i]
        torque = within_line(torque, params.limit[i], params.slope, crank_state[6 + i])
        state.torque[i] = min(max(torque, -params.most[i]), params.most[i])
    state.steps += 1.0


@njit
def current_tick(params: Any, command: Any, crank_state: Any, state: Any) -> None:
    """Torques (6,) [N m] of six motors, see `CurrentMotors`, in a step of the plant."""
    params, state = record(params), record(state)
    for i in range(6):
        current = command[i]
        if params.resolution > 0.0:
            current = params.resolution * np.rint(current / params.resolution)
        torque = min(max(params.torque_constant * current, -params.limit[i]), params.limit[i])
        torque = within_line(torque, params.limit[i], params.slope, crank_state[6 + i])
        state.torque[i] = min(max(torque, -params.limit[i]), params.limit[i])


@njit
def within_line(torque: Any, limit: Any, slope: Any, rate: Any) -> Any:
    """A torque [N m] within what a motor gives at a rate [rad/s]: limit (1 - slope rate) forwards, and backwards."""
    if slope == 0.0:
        return torque
    return min(max(torque, -limit * (1.0 + slope * rate)), limit * (1.0 - slope * rate))


@njit
def current_command(gain: Any, torque: Any, state: Any) -> None:
    """Currents (6,) [A] at which motors of gains (6,) [N m/A] give torques (6,) [N m]."""
    state = record(state)
    for i in range(6):
        state.command[i] = torque[i] / gain[i]


@njit
def servo_command(
    robot: Any, gain: Any, params: Any, torque: Any, measurement: Any, reference: Any, legs: Any, state: Any
) -> Any:
    """Angles (6,) [rad] at which servos give torques (6,) [N m] at the measurement (12,) or the reference (18,)."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    aim = measurement[:12] if params.feedback == 1.0 else reference[:12]
    bad = legs_at(robot, aim[:6], legs)
    if bad >= 0:
        return UNREACHABLE, bad, legs.reach_margin[bad]
    twist, rates = np.empty(6), np.empty(6)
    twist_of(aim[:6], aim[6:], twist)
    crank_rates(legs, twist, rates)
    for i in range(6):
        angle = np.arctan2(legs.sine[i], legs.cosine[i])
        wound = (torque[i] + params.damping * rates[i]) / gain[i]
        if params.play > 0.0:
            wound += params.play * np.tanh(wound / (PLAY_WIDTH * params.play))
        state.command[i] = angle + wound
    return OK, -1, 0.0
