"""The controller's side: its options, and its model of the machine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, TypeAdapter

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.code import ROBOT_KEY
from stewart_drake.base.config import (
    NAME,
    NAME_WORDS,
    Natural,
    NotNegative,
    Reading,
    Section,
    Text,
    Vector6,
    with_message,
)
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import place_users, placed
from stewart_drake.base.registry import ADAPTATIONS, CONTROLLERS, ESTIMATORS, MOTORS, SENSORS, TUNERS
from stewart_drake.base.sampling import on_grid, steps_per
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.control.base import AdaptationOptions, ControllerOptions
from stewart_drake.control.estimator import DifferenceOptions, EstimatorOptions
from stewart_drake.control.friction_compensation import FrictionCompensation
from stewart_drake.control.lqi import LqiOptions
from stewart_drake.control.tuners import PaperTuner, Tuner
from stewart_drake.hardware.imu import ImuOptions
from stewart_drake.hardware.motors import MotorOptions, TorqueMotors
from stewart_drake.hardware.wiring import ServoOptions
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.references import AnyReference, RecordedReference, SineReference
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.gravity import FixedGravity, GravityKey, Orientation, turned_gravity
from stewart_drake.robot.robot_files import AnyRobot
from stewart_drake.robot.robot_scale import PAPER, defaults_of
from stewart_drake.safety import SafetyOptions
from stewart_drake.safety.stream import StreamReference
from stewart_drake.scenario.keys import with_keys
from stewart_drake.scenario.limits import ReferenceLimits, space_of


class ModelOptions(Section, key="model"):
    """The controller's model of the machine. The controller's side has no other knowledge of it."""

    robot: AnyRobot | None = None
    """The robot of the model; null for the simulated one. Keys that are not given are those of `robot`."""
    gravity: GravityKey | None = None
    """[m/s^2] gravity, as in a scenario; null for the simulated one."""
    orientation: Orientation | None = None
    """[rad] roll, pitch, yaw of the base in the world; null for `base.orientation`."""
    friction: FrictionCompensation | None = None
    """Friction of the motors, which is compensated; null for none."""
    reading: Literal["angles", "pose"] | None = None
    """Contents of a reading: the six angles of the cranks, or pose and pose rate of the platform; null for those of
    `sensors`."""
    noise: Annotated[NotNegative, Field(le=1.0)] | None = None
    """[rad] standard deviation of the reading of a crank's angle, with rounding; null for that of `sensors`."""
    delay: Annotated[Natural, Field(le=100)] | None = None
    """[ticks] delay from a command to the motors; null for `command_delay`. An observer gives the controller state and
    reference at the time when its command acts."""
    reading_age: Annotated[NotNegative, Field(le=1.0)] | None = None
    """[s] age of a reading when the controller gets it; null for `sensors.delay`. An observer predicts over it, in
    whole ticks; default gains, tuners and adaptation count it as latency."""
    imu: ImuOptions | None = None
    """The inertial sensor on the platform; null for that of `sensors`. Keys that are not given are those of
    `sensors.imu`. An observer and the safety layer use it."""
    motors: Annotated[MotorOptions, MOTORS] | None = None
    """The motors; null for the simulated ones without their faults."""
    home: Vector6 | None = None
    """[rad] angles of the cranks at which a real machine reads zero; null for zeros. `drive --dry` measures them with
    the robot in its home pose. A crank's angle is its `servo_gain` times what the machine reads, plus this."""
    servos: ServoOptions | None = None
    """Hobby servos on a board, which `export --sketch` writes: how an angle becomes a pulse; null for the preset's."""


class Model(NamedTuple):
    """The controller's model of the machine: `ModelOptions` with all values."""

    robot: RobotParameters
    gravity: FixedGravity  # [m/s^2] in B.
    friction: FrictionCompensation | None
    reading: Literal["angles", "pose"]
    noise: float  # [rad] of a crank's angle.
    delay: int  # [ticks] of the commands.
    motors: MotorOptions
    reading_age: float = 0.0  # [s].
    home: tuple[float, ...] = (0.0,) * 6  # [rad] of the cranks where a machine reads zero.
    servos: ServoOptions | None = None
    imu: ImuOptions | None = None

    @property
    def reading_size(self) -> int:
        """Numbers in a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate."""
        return {"angles": 6, "pose": 12}[self.reading]


class ControlOptions(Section):
    """Options of everything that runs on a robot's computer, for a `Controller`; `load_controller` reads a file.

    Raises:
        ConfigurationError: Names the key, the value and what is allowed.
    """

    moved_keys: ClassVar[Mapping[str, str]] = {"model_robot": "model.robot", "friction_compensation": "model.friction"}
    nominal_robot: ClassVar[RobotParameters | None] = None
    """The simulated robot where no other is given; None where nothing is simulated."""

    name: Annotated[Text, Field(max_length=100, pattern=NAME), with_message(f"at most 100 {NAME_WORDS}")] = "scenario"
    """Name of the run, for the output folder and titles; letters, digits and, after the first, space and . + - too."""
    model: ModelOptions = Field(default_factory=ModelOptions)
    """The controller's model of the machine; by default the simulated machine."""
    reference: AnyReference = Field(default_factory=SineReference)
    """The motion to follow."""
    initial_offset: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """[rad, m] start pose minus the reference's start pose; the start velocity is the reference's."""
    controller: Annotated[ControllerOptions, CONTROLLERS] = Field(default_factory=LqiOptions)
    """The control law that computes the motor torques; without `kind`, the LQI."""
    tuner: Annotated[Tuner, TUNERS] = Field(default_factory=PaperTuner)
    """Sets the weights of the LQI; ignored by controllers without weights."""
    estimator: Annotated[EstimatorOptions, ESTIMATORS] = Field(default_factory=DifferenceOptions)
    """Estimates the platform's pose and rate for the controller from the sensor readings."""
    adaptation: Annotated[AdaptationOptions, ADAPTATIONS] | None = None
    """What is learnt while the robot runs; null for nothing."""
    safety: SafetyOptions | None = None
    """The safety layer between controller and motors; null for none."""
    base_compensation: Literal["none", "torques", "level"] = "none"
    """Use of the reading of `base.sensor`. torques: feedforward, observer and safety layer know the motion of the base.
    level: also the reference, whose angles are then those on a base at rest: the platform stays level on a ship."""

    @classmethod
    def _read(cls, data: object, reading: Reading, key: str | None = None, **details: object) -> Self:
        if isinstance(data, dict):
            data, defaults = _with_robots(data, cls.nominal_robot)
            reading = reading._replace(defaults=defaults)
        return super()._read(data, reading, key, **details)

    @classmethod
    def from_dict(cls, data: object, key: str | None = None, trust_code: bool = False) -> Self:
        """Options from plain values; with `trust_code`, code that they name may run."""
        return cls._read(data, Reading(trust_code), key)

    def replace(self, changes: Mapping[str, object] | None = None, trust_code: bool = False, **keys: object) -> Self:
        """The keys that were given with some of them changed, checked again; defaults are computed again.

        Another kind, `{"plant": "closed_form"}` or `{"plant.kind": "closed_form"}`, keeps the keys that it has too; a
        line of the log names the others, and of plant and motors they are an error. A section replaces a section.

        Args:
            changes: Dotted key -> plain value, such as {"tuner.omega_q": 10.0}. Components of lists, such as
                `robot.legs[2].rod_length`, come last.
            trust_code: Let code run that the changes name; what ran before still may.
            keys: The same for keys at the top.

        Raises:
            ConfigurationError: As for the class.
        """
        return with_keys(type(self), self.given(), {**(changes or {}), **keys}, trust_code)

    def in_full(self) -> Document:
        """`to_dict`, with the legs of the robots in full where `legs` leaves them to the symmetric robot."""
        full = self.to_dict()
        for section, robot in ((full, getattr(self, "robot", None)), (full["model"], self.model.robot)):
            if robot is not None:
                section["robot"]["legs"] = robot.each_leg()
        return full

    def to_yaml(self) -> str:
        """All of it, defaults included, as YAML that is read back as the same."""
        return to_yaml(self.to_dict())

    @property
    def default_model(self) -> Model:
        """The model where `model` is empty; without a simulated machine, of the paper's robot."""
        return Model(PAPER, STANDARD_GRAVITY, None, "angles", 0.0, 0, TorqueMotors())

    @property
    def nominal_gravity(self) -> tuple[FixedGravity, Orientation]:
        """Gravity [m/s^2] in the world and orientation of the base, where `model` has none."""
        return STANDARD_GRAVITY, (0.0, 0.0, 0.0)

    @property
    def controller_model(self) -> Model:
        """`model` with all values."""
        given = {name: getattr(self.model, name) for name in Model._fields}
        gravity, orientation = self.nominal_gravity
        turned = orientation if self.model.orientation is None else self.model.orientation
        given["gravity"] = turned_gravity(gravity if self.model.gravity is None else self.model.gravity, turned)
        model = self.default_model._replace(**{name: value for name, value in given.items() if value is not None})
        if model.friction is None and self.adaptation is not None:
            # Adaptation starts without friction, and needs the part that compensates it.
            model = model._replace(friction=FrictionCompensation())
        return model

    @property
    def lqi(self) -> LqiOptions:
        """`controller`, if it is an LQI; a ConfigurationError for another kind."""
        if not isinstance(self.controller, LqiOptions):
            raise ConfigurationError("controller.kind", self.controller.kind, "lqi, for this")
        return self.controller

    @property
    def reading_period(self) -> float:
        """[s] between two readings."""
        return self.estimator.period or self.controller.period

    @property
    def preview(self) -> float:
        """[s] by which the controller's reference is ahead of time.

        With an observer, which predicts the state as well: the delay of commands. Without feedback, or for a controller
        that looks ahead: also that of the motors, and half of the period for which a command is held. Else 0.
        """
        period = on_grid(self.controller.period)
        if self.controller.looks_ahead or not self.controller.feedback:
            return self.controller_model.delay * period + self.controller_model.motors.dead_time + 0.5 * period
        return self.controller_model.delay * period if self.estimator.disturbance_density else 0.0

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose (6,) and pose rate (6,) at t = 0."""
        pose, rate, _ = self.reference.evaluate(0.0)
        return pose + np.array(self.initial_offset), rate

    def rules(self) -> None:
        """Periods fit each other, the tuner its estimator, and a move the robot."""
        place_users(self)
        if isinstance(self.reference, StreamReference):
            robot, gravity = self.controller_model.robot, self.controller_model.gravity
            usual = 0.005 * robot.characteristic_length / PAPER.characteristic_length
            limits = getattr(self, "limits", None) or ReferenceLimits(clearance=usual)
            # A copy, because other options may have the same reference.
            workspace = None if self.safety is None else self.safety.workspace
            space = partial(space_of, robot, limits, gravity)
            bound = self.reference.bound(robot.home_pose, space, workspace)
            self.__dict__["reference"] = bound
        if self.controller_model.robot.tool is not None:
            for place, motion in placed(self.reference, RecordedReference, "reference"):
                if motion.of_platform:
                    allowed = "a motion of the tool; a move tells of the head: robot.tool null plays it"
                    raise ConfigurationError(f"{place}.motion_file", motion.motion_file, allowed)
        period = self.controller.period
        steps_per("controller.period", period, self.reading_period, "estimator.period")
        steps_per("tuner.period", self.tuner.period or period, period, "controller.period")
        if self.tuner.needs_observer and not self.estimator.disturbance_density:
            allowed = f"observer, for tuner.kind {self.tuner.kind}"
            raise ConfigurationError("estimator.kind", self.estimator.kind, allowed)


_ROBOT: TypeAdapter[RobotParameters | None] = TypeAdapter(AnyRobot | None)


def _with_robots(
    data: Document, nominal: RobotParameters | None
) -> tuple[Document, Callable[[type[Section], Document], Document | None] | None]:
    """The keys with the robots and `model.imu` read, and the defaults of these robots, and of how soon a command acts.

    Without the key `robot` it is `nominal`, or where that is None the one that is believed.
    """
    try:
        robots: Document = {ROBOT_KEY: _ROBOT.validate_python(data[ROBOT_KEY])} if ROBOT_KEY in data else {}
        robot = robots.get(ROBOT_KEY) or nominal or PAPER
        model = data.get("model", {})
        model = model.given() if isinstance(model, Section) else {**model}
        believed = model.get(ROBOT_KEY)
        if isinstance(believed, Mapping):
            believed = {**robot.given(), **believed}
        if believed is not None:
            believed = model[ROBOT_KEY] = _ROBOT.validate_python(believed)
        delay = data.get("command_delay", 0) if model.get("delay") is None else model["delay"]
        real = MOTORS.section(data.get("motors") or {})
        known = MOTORS.section(model["motors"]) if model.get("motors") else real
        age, sensors = model.get("reading_age"), SENSORS.section(data.get("sensors", {}))
        age = sensors.delay if age is None else float(age)
        if isinstance(model.get("imu"), Mapping) and sensors.imu is not None:
            model["imu"] = {**sensors.imu.nominal.given(), **model["imu"]}
        latency = CONTROLLERS.section(data.get("controller", {})).period * (1 + delay) + known.dead_time + age
        friction = dict[str, Document]()
        if gear := real.gear:
            friction["plant"] = {"friction": None, "motor_friction": gear.coulomb, "motor_damping": gear.viscous}
        if gear := known.gear:
            friction["model"] = {"friction": {"coulomb": gear.coulomb, "viscous": gear.viscous, "width": 0.004}}
    except (ConfigurationError, ValueError, TypeError, OverflowError):
        # The checks will say what is wrong with it.
        return data, None
    if "model" in data:
        robots["model"] = model
    believed = believed or robot
    return data | robots, defaults_of(robots.get(ROBOT_KEY) or nominal or believed, believed, latency, friction)
