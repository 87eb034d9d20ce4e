"""Commercial motors: servos, which take angles and control them, and motors that take currents."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.config import Natural, NotNegative, Positive, Text, one_for_six
from stewart_drake.base.errors import ConfigurationError, Status
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, TickResult, Vec2, Vec6, Vec12, Vec18, record
from stewart_drake.base.sampling import steps_per
from stewart_drake.hardware.motors import Command, MotorOptions, Torque
from stewart_drake.hardware.presets import PRESETS, Preset, Presets
from stewart_drake.hardware.rounding import rounding_part
from stewart_drake.loop.part import HEALTHY, LoopContext, Part
from stewart_drake.mechanics.dynamics import crank_inertia
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.mechanics.kinematics_laws import (
    OK,
    UNREACHABLE,
    Legs,
    Robot,
    crank_rates,
    legs_at,
    robot_record,
    twist_of,
)
from stewart_drake.robot import RobotParameters

if TYPE_CHECKING:
    from stewart_drake.control.regression_records import Learnt

POSITION_PRESETS, CURRENT_PRESETS = Presets("position"), Presets("current")
MAX_STIFFNESS_NUMBER = 0.5
"""[-] of a servo: stiffness times the square of its period, over a crank's inertia. Its sampled loop is then stable."""
PLAY_WIDTH = 0.25
"""[-] deflection of a servo, over its play, at which 76 % of the play is compensated; a jump would chatter."""


class _CommercialMotors(MotorOptions):
    """Torque limit, no-load speed and presets."""

    by_torque: ClassVar[bool] = False
    presets: ClassVar[Presets]

    torque_limit: Positive | None = None
    """[N m] largest torque at rest, never above the robot's effort limit; null for that."""
    no_load_speed: Positive | None = None
    """[rad/s] speed at which nothing of `torque_limit` is left; it falls in a straight line. null for any speed."""

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, data: object) -> object:
        return cls.presets.with_defaults(data) if isinstance(data, dict) else data

    @property
    def nominal(self) -> MotorOptions:
        return self

    @property
    def gear(self) -> Preset | None:
        return PRESETS.get(getattr(self, "preset", None) or "")

    def limits(self, robot: RobotParameters) -> np.ndarray:
        most = np.inf if self.torque_limit is None else self.torque_limit
        return np.asarray(np.minimum(robot.effort_limits, most))

    @property
    def slope(self) -> float:
        """[s/rad] share of the torque limit that a motor loses per speed."""
        return 0.0 if self.no_load_speed is None else 1.0 / self.no_load_speed

    def available(self, robot: RobotParameters, rates: np.ndarray) -> np.ndarray:
        supply = getattr(self, "supply", 1.0)
        most, speed = supply * self.limits(robot), np.abs(rates)
        by_speed, by_damping = most * (1.0 - self.slope / supply * speed), most - getattr(self, "damping", 0.0) * speed
        return np.minimum(robot.effort_limits, np.minimum(by_speed, by_damping))


class PositionServos(_CommercialMotors):
    """Servos that take angles: T = clip(stiffness (command - angle), limit) - damping rate.

    The torque is clipped before the damping is subtracted, as in a voltage drive: `damping` includes the back-EMF, and
    a servo that turns at limit / damping gives no torque. No torque is above the robot's effort limit. Dry friction
    belongs to the plant, `plant.friction`; a preset sets that too. The defaults are those of a Dynamixel XL330-M288 at
    5 V: Rhoban's `bam` (github.com/Rhoban/bam) identified stiffness 0.6 to 1.7 N m/rad with its maker's gain, and
    damping 0.037 to 0.048 N m s/rad.
    """

    command_quantity: ClassVar[str] = "angle"
    unit: ClassVar[str] = "rad"
    holds: ClassVar[bool] = True
    knobs = (("stiffness", "servo stiffness"),)
    presets: ClassVar[Presets] = POSITION_PRESETS

    kind: Literal["position"] = "position"
    preset: Annotated[Text, POSITION_PRESETS] | None = None
    """A commercial servo, which sets the defaults of the other keys and of the friction of `plant` and `model`; null
    for none."""
    stiffness: Annotated[Positive, Field(ge=1e-6)] = 1.0
    """[N m/rad] torque for an angle's error."""
    ratios: Annotated[tuple[Positive, Positive, Positive, Positive, Positive, Positive], one_for_six(Positive)] = (
        *(1.0,) * 6,
    )
    """[-] stiffness of each motor over `stiffness`."""
    damping: NotNegative = 0.04
    """[N m s/rad] torque that a turning servo loses: back-EMF and the damping of its controller."""
    supply: Positive = 1.0
    """[-] voltage over the nominal one; stiffness, limit and no-load speed are proportional to it."""
    period: Positive = 0.001
    """[s] of the servo's controller, a whole multiple of plant.time_step."""
    resolution_bits: Annotated[Natural, Field(ge=6, le=24)] | None = 12
    """[bit] per turn, to which commands and the servo's readings are rounded; null for none."""
    dead_band: Annotated[NotNegative, Field(le=1.0)] = 0.0
    """[rad] error of the angle below which a servo gives no torque."""
    backlash: Annotated[NotNegative, Field(le=0.5)] = 0.0
    """[rad] play of the gear between the servo's encoder and the crank, which is free in it without a torque."""
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
    def slack(self) -> float:
        """Dead band, half of the play, and half a count of the command and of the servo's reading."""
        return self.dead_band + 0.5 * self.backlash + self.count

    @property
    def gains(self) -> np.ndarray:
        return self.supply * self.stiffness * np.array(self.ratios)

    def command_limits(self, robot: RobotParameters) -> np.ndarray:
        """The stops; without stops, a turn in both directions."""
        return np.clip(robot.crank_angle_ranges, -2.0 * np.pi, 2.0 * np.pi).T

    def with_learnt(self, value: Learnt) -> tuple[Document, np.ndarray, np.ndarray]:
        gains = self.gains * value.drive
        mean, damping = float(gains.mean()), max(0.0, self.damping + min(0.0, float(value.viscous.min())))
        keys = {"stiffness": mean / self.supply, "ratios": (gains / mean).tolist(), "damping": damping}
        keys["delay"] = max(0.0, self.delay + value.delay)
        return self.given() | keys, value.viscous + self.damping - damping, value.coulomb

    def part(self, robot: RobotParameters, time_step: float) -> Part:
        stride = steps_per("motors.period", self.period, time_step)
        limit = MAX_STIFFNESS_NUMBER * robot.crank_axis_inertias.min() / self.period**2
        if (largest := self.gains.max()) > limit:
            by_supply = self.supply * self.stiffness > limit
            key = "stiffness" if self.stiffness > limit else "supply" if by_supply else "ratios"
            most = np.max(getattr(self, key)) * limit / largest
            allowed = f"at most {most:.3g}: no motor above {limit:.3g} N m/rad, with motors.period {self.period:g} s"
            raise ConfigurationError(f"motors.{key}", getattr(self, key), allowed)
        most = np.linalg.eigvalsh(crank_inertia(robot, robot.home_pose))[0] / time_step
        if self.damping > most:
            allowed = f"at most {most:.3g} N m s/rad, with plant.time_step {time_step:g} s"
            raise ConfigurationError("motors.damping", self.damping, allowed)
        params = ServoParams.new(
            self,
            stiffness=self.gains,
            limit=self.supply * self.limits(robot),
            slope=self.slope / self.supply,
            stride=stride,
            play=0.5 * self.backlash,
            effort_limit=robot.effort_limits,
        )
        numbers, first, inputs = {"params": params}, ServoState.new(), {"command": 6, "crank_state": 12}
        return Part("motors", servo_tick, {}, inputs, ("torque",), first, period=time_step, parameters=numbers)

    def inverse_parts(self, context: LoopContext) -> tuple[Part, ...]:
        params = InverseServoParams.new(self, play=0.5 * self.backlash, feedback=float(context.feedback))
        numbers = {"robot": robot_record(context.robot), "gain": self.gains, "params": params}
        first = ServoCommand.new(command=self.initial_command(context), health=HEALTHY)
        inputs = {"torque": 6, "measurement": 12, "reference": 18}
        pose = "measurement" if context.feedback else "reference"
        statuses = {UNREACHABLE: Status("unreachable_pose", pose, of_leg=True)}
        angles = Part("servo_command", servo_command, {}, inputs, ("command",), first, (Legs,), statuses)
        angles = angles._replace(parameters=numbers)
        if context.feedback or self.count == 0.0:
            return (angles,)
        rounding = rounding_part(context, float(self.gains.mean()), self.damping, self.count)
        return angles.named(command="angles"), rounding.connected(command="angles")

    def initial_command(self, context: LoopContext) -> np.ndarray:
        deflection = context.initial_torque / self.gains
        angles = inverse_kinematics(context.robot, context.pose)
        return np.asarray(angles + deflection + 0.5 * self.backlash * np.sign(deflection))


class CurrentMotors(_CommercialMotors):
    """Motors that take currents: T = torque_constant current, within the limits. Wrong numbers go to `model.motors`.

    Friction of the gear belongs to the plant, `plant.friction`; a preset sets that too.
    """

    command_quantity: ClassVar[str] = "current"
    unit: ClassVar[str] = "A"
    presets: ClassVar[Presets] = CURRENT_PRESETS

    kind: Literal["current"] = "current"
    preset: Annotated[Text, CURRENT_PRESETS] | None = None
    """A commercial motor, which sets the defaults of the other keys and of the friction of `plant` and `model`; null
    for none."""
    torque_constant: Positive = 1.0
    """[N m/A] torque for a current."""
    current_limit: Positive | None = None
    """[A] largest current; null for any."""
    resolution: NotNegative = 0.0
    """[A] step to which currents are rounded; 0 for none."""
    delay: Annotated[NotNegative, Field(le=1.0)] = 0.0
    """[s] from a command's arrival to its effect, rounded to steps of the plant."""

    @property
    def dead_time(self) -> float:
        return self.delay

    @property
    def gains(self) -> np.ndarray:
        return np.full(6, self.torque_constant)

    def with_learnt(self, value: Learnt) -> tuple[Document, np.ndarray, np.ndarray]:
        """One constant for all motors; friction keeps its size in currents."""
        ratio = value.drive.mean() / value.drive
        viscous, coulomb = value.viscous * ratio, value.coulomb * ratio
        return self.given() | {"torque_constant": float((self.gains * value.drive).mean())}, viscous, coulomb

    def part(self, robot: RobotParameters, time_step: float) -> Part:
        most = np.inf if self.current_limit is None else self.torque_constant * self.current_limit
        limit = np.minimum(self.limits(robot), most)
        numbers, inputs = {"params": CurrentParams.new(self, limit=limit)}, {"command": 6, "crank_state": 12}
        return Part("motors", current_tick, {}, inputs, ("torque",), Torque.new(), period=time_step, parameters=numbers)

    def inverse_parts(self, context: LoopContext) -> tuple[Part, ...]:
        numbers, first = {"gain": self.gains}, Command.new(command=self.initial_command(context))
        return (Part("motor_current", current_command, {}, {"torque": 6}, ("command",), first, parameters=numbers),)

    def initial_command(self, context: LoopContext) -> np.ndarray:
        return context.initial_torque / self.torque_constant


class ServoParams(Record):
    """`PositionServos` as numbers."""

    stiffness: Vec6  # [N m/rad]
    damping: float  # [N m s/rad]
    dead_band: float  # [rad]
    play: float  # [rad] half of the backlash.
    count: float  # [rad] to which angles are rounded, 0 for none.
    stride: float  # [steps] of the servo's period.
    slope: float  # [s/rad] of the torque limit over the speed.
    limit: Vec6  # [N m] at rest.
    effort_limit: Vec6  # [N m] of the robot.


class ServoState(Record):
    """State of six servos."""

    torque: Vec6  # [N m]
    drive: Vec6  # [N m] torque before the damping, held for a period.
    steps: float  # Done.


class ServoCommand(Record):
    """State of `servo_command`."""

    command: Vec6  # [rad]
    health: Vec2


class InverseServoParams(Record):
    """`PositionServos` in the controller's model."""

    damping: float  # [N m s/rad]
    play: float  # [rad] half of the backlash.
    feedback: float  # 1 where the torque belongs to the measured pose, 0 where it belongs to the reference.


class CurrentParams(Record):
    """`CurrentMotors` as numbers."""

    torque_constant: float  # [N m/A]
    resolution: float  # [A], 0 for none.
    slope: float  # [s/rad] of the torque limit over the speed.
    limit: Vec6  # [N m] at rest.


@njit
def servo_tick(params: ServoParams, command: Vec6, crank_state: Vec12, state: ServoState) -> None:
    """Torques of six servos, see `PositionServos`, in a step of the plant."""
    params, state = record(params), record(state)
    if state.steps % params.stride == 0.0:
        for i in range(6):
            wanted, angle = command[i], crank_state[i]
            if params.count > 0.0:
                wanted = params.count * np.rint(wanted / params.count)
                angle = params.count * np.rint(angle / params.count)
            error = wanted - angle
            error -= 2.0 * np.pi * np.rint(error / (2.0 * np.pi))
            # Without a reading a servo does nothing.
            if abs(error) <= params.dead_band or np.isnan(angle):
                error = 0.0
            error -= min(max(error, -params.play), params.play)
            state.drive[i] = min(max(params.stiffness[i] * error, -params.limit[i]), params.limit[i])
    for i in range(6):
        torque = state.drive[i] - params.damping * crank_state[6 + i]
        torque = within_line(torque, params.limit[i], params.slope, crank_state[6 + i])
        state.torque[i] = min(max(torque, -params.effort_limit[i]), params.effort_limit[i])
    state.steps += 1.0


@njit
def current_tick(params: CurrentParams, command: Vec6, crank_state: Vec12, state: Torque) -> None:
    """Torques of six motors, see `CurrentMotors`, in a step of the plant."""
    params, state = record(params), record(state)
    for i in range(6):
        current = command[i]
        if params.resolution > 0.0:
            current = params.resolution * np.rint(current / params.resolution)
        torque = min(max(params.torque_constant * current, -params.limit[i]), params.limit[i])
        torque = within_line(torque, params.limit[i], params.slope, crank_state[6 + i])
        state.torque[i] = min(max(torque, -params.limit[i]), params.limit[i])


@njit
def within_line(torque: float, limit: float, slope: float, rate: float) -> float:
    """A torque [N m] limited by the torque-speed line: to limit (1 - slope rate) forwards, and so backwards."""
    if slope == 0.0:
        return torque
    return min(max(torque, -limit * (1.0 + slope * rate)), limit * (1.0 - slope * rate))


@njit
def current_command(gain: Vec6, torque: Vec6, state: Command) -> None:
    """Currents [A] at which motors of gains [N m/A] give torques [N m]."""
    state = record(state)
    for i in range(6):
        state.command[i] = torque[i] / gain[i]


@njit
def servo_command(
    robot: Robot,
    gain: Vec6,
    params: InverseServoParams,
    torque: Vec6,
    measurement: Vec12,
    reference: Vec18,
    legs: Legs,
    state: ServoCommand,
) -> TickResult:
    """Angles [rad] at which servos of gains [N m/rad] give torques [N m] at the measurement or the reference."""
    robot, params, legs, state = record(robot), record(params), record(legs), record(state)
    motion = measurement[:12] if params.feedback == 1.0 else reference[:12]
    bad = legs_at(robot, motion[:6], legs)
    if bad >= 0:
        return UNREACHABLE, bad, legs.reach_margin[bad]
    twist, rates = np.empty(6), np.empty(6)
    twist_of(motion[:6], motion[6:], twist)
    crank_rates(legs, twist, rates)
    for i in range(6):
        angle = np.arctan2(legs.sine[i], legs.cosine[i])
        deflection = (torque[i] + params.damping * rates[i]) / gain[i]
        if params.play > 0.0:
            deflection += params.play * np.tanh(deflection / (PLAY_WIDTH * params.play))
        state.command[i] = angle + deflection
    return OK, -1, 0.0
