"""A scenario: all options of one run as typed YAML, checked and frozen."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar

import numpy as np
from pydantic import Field, TypeAdapter

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.code import anchored
from stewart_drake.base.config import (
    Count,
    Positive,
    Reading,
    to_plain,
)
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import user_parts
from stewart_drake.base.registry import MOTORS, OWN_METRICS, PLANTS, SENSORS
from stewart_drake.base.sampling import steps_per
from stewart_drake.base.yaml_files import find_file, parse_changes, read_mapping
from stewart_drake.control.base_reading import LevelReference
from stewart_drake.hardware.disturbances import AnyDisturbance
from stewart_drake.hardware.motors import LinkOptions, MotorOptions, TorqueMotors
from stewart_drake.hardware.moving_base import BaseOptions, base_signal
from stewart_drake.hardware.sensors import IdealSensors, SensorOptions
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.friction import FrictionOptions
from stewart_drake.plant.plant_options import DrakeOptions, PlantOptions
from stewart_drake.references import RecordedReference
from stewart_drake.references.motions import Reference
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.gravity import FixedGravity, GravityKey, Orientation, gravity_text, turned_gravity
from stewart_drake.robot.robot_files import AnyRobot
from stewart_drake.robot.robot_scale import PAPER
from stewart_drake.scenario.control_options import ControlOptions, Model
from stewart_drake.scenario.keys import with_keys
from stewart_drake.scenario.limits import ReferenceLimits, SuccessCriteria

MAX_STEPS = 10**9
"""Largest number of steps of the plant in a run: with more, sample times could not distinguish the steps."""


class Scenario(ControlOptions):
    """Everything that one run depends on; `load_scenario` reads a file.

    Raises:
        ConfigurationError: Names the key, the value and what is allowed.
    """

    nominal_robot: ClassVar[RobotParameters | None] = PAPER
    where_from: ClassVar[str] = "load_scenario reads one from a file"

    duration: Annotated[Positive, Field(le=1e6)] = 10.0
    """[s] simulated time; that of a recorded motion where it is not given. The run ends with the last whole step of the
    plant, at most 1e9 of them."""
    gravity: GravityKey = STANDARD_GRAVITY
    """[m/s^2] gravity in the world, whose axes are those of the base frame B where `base` does not turn it: a number
    along -z, 0 for none, negative where the robot hangs; or three numbers."""
    base: BaseOptions = Field(default_factory=BaseOptions)
    """Where the base is: tilted, hanging, or in motion; and the sensor of its motion."""
    robot: AnyRobot = Field(default_factory=lambda: PAPER)
    """The simulated robot: geometry, masses and limits; a section, a robot's name, or a YAML file with the same
    keys."""
    plant: Annotated[PlantOptions, PLANTS] = Field(default_factory=DrakeOptions)
    """The simulation of the robot: its kind, time step, friction, payload; without `kind`, Drake's plant."""
    motors: Annotated[MotorOptions, MOTORS] = Field(default_factory=TorqueMotors)
    """The motors, with their imperfections; by default they take torques and have none."""
    disturbances: tuple[AnyDisturbance, ...] = ()
    """External wrenches on the platform; they add up."""
    sensors: Annotated[SensorOptions, SENSORS] = Field(default_factory=IdealSensors)
    """The sensors: what they measure, their resolution, noise and faults."""
    command_delay: Annotated[Count, Field(ge=0, le=100)] = 0
    """[ticks] delay from a command to the motors, in control periods; until the first arrives the motors hold the start
    pose."""
    link: LinkOptions = Field(default_factory=LinkOptions)
    """The link that carries commands to the motors, after `command_delay`: what it drops, delays or corrupts."""
    bounds: SuccessCriteria = Field(default_factory=SuccessCriteria)
    """Bounds on the run, such as its largest error; they decide whether it counts as followed."""
    limits: ReferenceLimits = Field(default_factory=ReferenceLimits)
    """Limits on the reference, such as crank speed; checked before the run."""
    metrics: tuple[Annotated[Any, OWN_METRICS], ...] = ()
    """Your own metrics, each a `Metric` by its import path: module:name or path/to/file.py:name."""
    log_period: Positive | None = None
    """[s] time between log rows, a whole multiple of plant.time_step, at most duration; null takes
    controller.period."""

    @classmethod
    def _read(cls, data: object, reading: Reading, key: str | None = None, **details: object) -> Self:
        scenario = super()._read(data, reading, key, **details)
        if isinstance(data, dict) and "duration" not in data and isinstance(scenario.reference, RecordedReference):
            scenario.__dict__["duration"] = scenario.reference.end
            scenario.rules()
        return scenario

    def __repr__(self) -> str:
        """A summary in ten lines; `to_yaml` has every key."""

        def kinds(parts: Iterable[Any]) -> str:
            return ", ".join(str(part.kind) for part in parts) or "none"

        weighted = self.controller.weighted or self.controller.code is not None
        safety = "none" if self.safety is None else f"{len(self.safety.monitor_names) - 1} monitors"
        return (
            f"Scenario {self.name}: {self.duration:g} s, gravity {gravity_text(self.gravity_in_base)} m/s^2\n"
            f"  reference: {kinds([self.reference])}\n"
            f"  controller: {self.controller.kind}, a tick every {self.controller.period:g} s\n"
            f"  tuner: {self.tuner.kind if weighted else 'none'}\n"
            f"  sensors: {self.sensors.kind}; estimator: {self.estimator.kind}\n"
            f"  commands: {self.command_delay} ticks late\n"
            f"  disturbances: {kinds(self.disturbances)}\n"
            f"  safety: {safety}\n"
            f"  plant: {self.plant.kind}, steps of {self.plant.time_step:g} s\n"
            f"  robot: {repr(self.robot).splitlines()[2].strip()}"
        )

    @property
    def default_model(self) -> Model:
        """The simulated machine without faults, friction and payload."""
        readings, motors = self.sensors, self.motors.nominal
        read = readings.reading, readings.reading_noise
        model = Model(self.robot, self.gravity_in_base, None, *read, self.command_delay, motors, readings.delay)
        return model._replace(imu=readings.imu and readings.imu.nominal)

    @property
    def asked(self) -> Reference:
        """The reference as the robot is asked to follow it, turned against a moving base where the controller does."""
        if self.base_compensation != "level" or self.base.motion is None:
            return self.reference
        return LevelReference(self.reference, partial(base_signal, self.base.motion, self.gravity_in_base))

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose (6,) and pose rate (6,) at t = 0, of the reference as asked."""
        pose, rate, _ = self.asked.evaluate(0.0)
        return pose + np.array(self.initial_offset), rate

    @property
    def nominal_gravity(self) -> tuple[FixedGravity, Orientation]:
        """Those of the simulation."""
        return self.gravity, self.base.orientation

    def gravity_at(self, times: np.ndarray) -> FixedGravity | np.ndarray:
        """Gravity in B, or where the base moves what its inertial unit reads (n, 9) at times (n,) [s]."""
        if self.base.motion is None:
            return self.gravity_in_base
        return base_signal(self.base.motion, self.gravity_in_base, times)[:, :9]

    @property
    def gravity_in_base(self) -> FixedGravity:
        """[m/s^2] gravity in B, at its mean position: a number along -z, or a vector."""
        return turned_gravity(self.gravity, self.base.orientation)

    def control(self) -> ControlOptions:
        """The controller's side alone, with `model` in full, for use on a machine."""
        full = self.to_dict() | {"model": to_plain(self.controller_model._asdict())}
        plain = {name: full[name] for name in ControlOptions.__pydantic_fields__}
        return ControlOptions.from_dict(plain, trust_code=all(part.code.trusted for part in user_parts(self)))

    @property
    def effective_log_period(self) -> float:
        """[s] between log rows."""
        return self.controller.period if self.log_period is None else self.log_period

    @property
    def loop_delay(self) -> int:
        """[ticks] total delay of commands and readings, to the nearest tick."""
        return self.command_delay + round(self.sensors.delay / self.controller.period)

    def rules(self) -> None:
        """Periods fit each other, readings the sensors, and the tuner its estimator."""
        super().rules()
        if self.controller_model.reading != self.sensors.reading:
            raise ConfigurationError(
                "model.reading", self.controller_model.reading, f"{self.sensors.reading}, as sensors read"
            )
        if self.model.imu is not None and self.sensors.imu is None:
            raise ConfigurationError("model.imu", "a sensor", "null, because sensors.imu is null")
        model_motors, motors = self.controller_model.motors, self.motors
        # The command of a user's motors is not checked.
        if motors.code is None and model_motors.command_quantity != motors.command_quantity:
            allowed = f"motors that take {motors.command_quantity} [{motors.unit}], as `motors` do"
            raise ConfigurationError("model.motors.kind", model_motors.kind, allowed)
        if not self.plant.base_moves:
            self.base.refuse_motion(f"plant.kind {self.plant.kind}")
        if self.base_compensation != "none" and self.base.sensor is None:
            raise ConfigurationError("base_compensation", self.base_compensation, "none, without base.sensor")
        steps_per("controller.period", self.controller.period, self.plant.time_step)
        steps_per("estimator.period", self.reading_period, self.plant.time_step)
        if self.sensors.imu is not None and self.sensors.imu.period is not None:
            steps_per("sensors.imu.period", self.sensors.imu.period, self.plant.time_step)
        largest = MAX_STEPS * self.plant.time_step
        if self.duration > largest * (1.0 + 1e-9):
            raise ConfigurationError(
                "duration", self.duration, f"at most {largest:g} s, which are 1e9 steps of the plant"
            )
        if self.duration < self.controller.period:
            allowed = f"at least one control period, {self.controller.period:g} s"
            raise ConfigurationError("duration", self.duration, allowed)
        if self.log_period is not None:
            steps_per("log_period", self.log_period, self.plant.time_step)
            if self.log_period > self.duration:
                raise ConfigurationError("log_period", self.log_period, f"at most the duration, {self.duration:g} s")


_Options = TypeVar("_Options", bound=ControlOptions)


def load_scenario(path: str | Path, overrides: Iterable[str] = (), trust_code: bool = False) -> Scenario:
    """Reads a scenario file.

    Args:
        path: YAML file; `weights_file`, `motion_file` and files with code in it are relative to its folder. A bare name
            such as `paper_fig7` is looked up among the scenarios of the package.
        overrides: `key=value` texts, keys dotted, values as YAML, see `Scenario.replace`; files among them are relative
            to the current folder.
        trust_code: Let the code run that is named in it and in `overrides`.

    Raises:
        ConfigurationError: Missing, unreadable or malformed file; unknown key; value not allowed.
    """
    return _load(Scenario, "scenario", path, overrides, trust_code)


def load_controller(path: str | Path, overrides: Iterable[str] = (), trust_code: bool = False) -> ControlOptions:
    """Reads a file of the controller's side alone, see `Scenario.control`; arguments and errors as `load_scenario`."""
    return _load(ControlOptions, "controller", path, overrides, trust_code)


def load_driven(path: str | Path, overrides: Iterable[str] = (), trust_code: bool = False) -> Scenario:
    """A scenario; or a controller's file as one, with the robot and motors of its model.

    Motors that take torques also have the model's friction, which the controller compensates.
    """
    try:
        file = find_file("scenario", path)
    except ConfigurationError as error:
        try:
            file = find_file("controller", path)
        except ConfigurationError:
            raise error from None
    if not set(read_mapping("scenario", file, 100)) <= set(ControlOptions.__pydantic_fields__):
        return load_scenario(file, overrides, trust_code)
    control = load_controller(file, overrides, trust_code)
    robot, motors = to_plain(control.controller_model.robot), to_plain(control.controller_model.motors)
    sensors: Document = {"kind": "encoders" if control.controller_model.reading == "angles" else "ideal"}
    if control.controller_model.imu is not None:
        sensors["imu"] = to_plain(control.controller_model.imu)
    trusted = all(part.code.trusted for part in user_parts(control))
    data = {**control.to_dict(), "robot": robot, "motors": motors, "sensors": sensors}
    friction = control.controller_model.friction
    if friction is not None and not control.controller_model.motors.holds:
        names = FrictionOptions.__pydantic_fields__
        data["plant"] = {"friction": {name: to_plain(getattr(friction, name)) for name in names}}
    return Scenario.from_dict(data, trust_code=trusted)


def _load(kind: type[_Options], what: str, path: str | Path, overrides: Iterable[str], trust_code: bool) -> _Options:
    path = find_file(what, path)
    data = anchored(read_mapping(what, path, 100), path.parent)
    changes = anchored(parse_changes(overrides, "controller.period=0.002"), Path())
    return with_keys(kind, data, changes, trust_code)


def scenario_schema() -> Document:
    """JSON schema of a scenario file, for editors: every section once, under `$defs`."""
    sections: Document = {}

    def moved(node: object) -> Any:
        if isinstance(node, list):
            return [moved(part) for part in node]
        if not isinstance(node, dict):
            return node
        node = {key: moved(part) for key, part in node.items()}
        if "properties" not in node or "title" not in node:
            return node
        name = node["title"]
        while sections.setdefault(name, node) != node:
            name += "_"
        return {"$ref": f"#/$defs/{name}"}

    schema = TypeAdapter(Scenario).json_schema()
    for name, section in schema.pop("$defs", {}).items():
        sections[name] = {key: moved(part) for key, part in section.items()}
    schema = {key: moved(part) for key, part in schema.items()}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "$defs": sections}
