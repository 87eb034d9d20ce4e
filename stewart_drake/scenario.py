"""One run as typed YAML: read, checked to the last key, frozen."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, TypeAdapter

from stewart_drake.config import (
    NAME,
    NAME_WORDS,
    Count,
    NotNegative,
    Positive,
    Section,
    Text,
    Vector6,
    shown,
    unknown,
    words,
)
from stewart_drake.control.base import ControllerOptions
from stewart_drake.control.lqi import LqiOptions
from stewart_drake.control.tuners import BlockTuner, FixedTuner, PaperTuner, Tuner
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import Family, place_users
from stewart_drake.files.code import ROBOT_KEYS, anchored, trusting_code
from stewart_drake.files.yaml_files import find_file, parse_yaml, read_mapping, to_yaml
from stewart_drake.hardware.disturbances import AnyDisturbance
from stewart_drake.hardware.estimator import DifferenceOptions, EstimatorOptions
from stewart_drake.hardware.motors import FrictionCompensation, LinkOptions, MotorOptions
from stewart_drake.hardware.sensors import IdealSensors, SensorOptions
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.planning.limits import Bounds, Limits
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.references import AnyReference, RecordedReference, SineReference
from stewart_drake.registry import CONTROLLERS, ESTIMATORS, OWN_METRICS, SENSORS, TUNERS
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LARGEST
from stewart_drake.robot.robot_files import AnyRobot, robot_section
from stewart_drake.robot.robot_scale import PAPER, defaults_of
from stewart_drake.safety import SafetyOptions
from stewart_drake.sampling import steps_per

__all__ = ["BlockTuner", "FixedTuner", "IdealSensors", "PaperTuner", "Scenario", "load_scenario", "scenario_schema"]

MAX_STEPS = 10**9
"""Of the plant in a run: beyond it sample times, which are stretched slightly, would lose their step."""


class Scenario(Section):
    """Everything that one run depends on; `load_scenario` reads a file.

    Raises:
        ConfigurationError: Names the key, the value and what is allowed.
    """

    name: Annotated[Text, Field(max_length=100, pattern=NAME), words(f"at most 100 {NAME_WORDS}")] = "scenario"
    """Name of the run, for the output folder and titles; letters, digits and, after the first, space and . + - too."""
    duration: Annotated[Positive, Field(le=1e6)] = 10.0
    """[s] simulated time; that of a recorded motion where it is not given. The run ends with the last whole step of the
    plant, at most 1e9 of them."""
    gravity: Annotated[NotNegative, Field(le=LARGEST)] = STANDARD_GRAVITY
    """[m/s^2] gravity, along -z of the base frame B; 0 for none."""
    robot: AnyRobot = Field(default_factory=lambda: PAPER)
    """The simulated robot: geometry, masses and limits; a section, a robot's name, or a YAML file with the same
    keys."""
    model_robot: AnyRobot | None = None
    """The controller's model of the robot; null for the simulated robot itself."""
    plant: PlantOptions = Field(default_factory=PlantOptions)
    """The simulation of the robot: time step, engine, friction, payload."""
    motors: MotorOptions = Field(default_factory=MotorOptions)
    """Imperfections of the motors; none by default."""
    disturbances: tuple[AnyDisturbance, ...] = ()
    """External wrenches on the platform; they add up."""
    reference: AnyReference = Field(default_factory=SineReference)
    """The motion to follow."""
    initial_offset: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """[rad, m] start pose minus the reference's start pose; the start velocity is the reference's."""
    controller: Annotated[ControllerOptions, CONTROLLERS] = Field(default_factory=LqiOptions)
    """The control law that computes the motor torques; without `kind`, the LQI."""
    tuner: Annotated[Tuner, TUNERS] = Field(default_factory=PaperTuner)
    """Sets the weights of the LQI; ignored by controllers without weights."""
    sensors: Annotated[SensorOptions, SENSORS] = Field(default_factory=IdealSensors)
    """The sensors: what they measure, their resolution, noise and faults."""
    estimator: Annotated[EstimatorOptions, ESTIMATORS] = Field(default_factory=DifferenceOptions)
    """Estimates the platform's pose and rate for the controller from the sensor readings."""
    friction_compensation: FrictionCompensation | None = None
    """The controller's model of motor friction, to compensate it; null for none."""
    command_delay: Annotated[Count, Field(ge=0, le=100)] = 0
    """[ticks] delay from a command to its torque, in control periods; until the first arrives the motors hold the start
    pose."""
    link: LinkOptions = Field(default_factory=LinkOptions)
    """The link that carries commands to the motors, after `command_delay`: what it drops, delays or corrupts."""
    safety: SafetyOptions | None = None
    """The safety layer between controller and motors; null for none."""
    bounds: Bounds = Field(default_factory=Bounds)
    """Bounds on the run, such as its largest error; they decide whether it counts as followed."""
    limits: Limits = Field(default_factory=Limits)
    """Limits on the reference, such as crank speed; checked before the run."""
    metrics: tuple[Annotated[Any, OWN_METRICS], ...] = ()
    """Your own metrics, each a `Metric` by its import path: module:name or path/to/file.py:name."""
    log_period: Positive | None = None
    """[s] time between log rows, a whole multiple of plant.time_step, at most duration; null takes
    controller.period."""

    @classmethod
    def _validated(cls, data: Any, key: str, **details: Any) -> Any:
        if not isinstance(data, dict):
            return super()._validated(data, key, **details)
        data, defaults = _with_robots(data)
        with defaults:
            scenario = super()._validated(data, key, **details)
        if "duration" not in data and isinstance(scenario.reference, RecordedReference):
            vars(scenario)["duration"] = scenario.reference.end
            scenario.rules()
        return scenario

    @classmethod
    def from_dict(cls, data: Any, key: str | None = None, trust_code: bool = False) -> Scenario:
        """A scenario from plain values; with `trust_code`, code that it names may run."""
        with trusting_code(trust_code):
            return super().from_dict(data, key)

    def replace(self, changes: Mapping[str, Any] | None = None, **keys: Any) -> Scenario:
        """The keys that were given with some of them changed, checked again: what was but a default is one anew.

        Another `kind` drops the keys that only the old kind has.

        Args:
            changes: Dotted key -> plain value, such as {"tuner.omega_q": 10.0}. Components of lists, such as
                `robot.legs[2].rod_length`, come last. New code is named within `trusting_code`.
            keys: Likewise, those of the scenario itself.

        Raises:
            ConfigurationError: As for the class.
        """
        return _changed(self.given(), {**(changes or {}), **keys})

    def __repr__(self) -> str:
        """What it is about, in ten lines; `to_yaml` has every key."""

        def kinds(parts: Iterable[Any]) -> str:
            return ", ".join(str(part.kind) for part in parts) or "none"

        weighted = isinstance(self.controller, LqiOptions) or self.controller.code is not None
        safety = "none" if self.safety is None else f"{len(self.safety.monitor_names) - 1} monitors"
        return (
            f"Scenario {self.name}: {self.duration:g} s, gravity {self.gravity:g} m/s^2\n"
            f"  reference: {kinds([self.reference])}\n"
            f"  controller: {self.controller.kind}, a tick every {self.controller.period:g} s\n"
            f"  tuner: {self.tuner.kind if weighted else 'none'}\n"
            f"  sensors: {self.sensors.kind}; estimator: {self.estimator.kind}\n"
            f"  commands: {self.command_delay} ticks late\n"
            f"  disturbances: {kinds(self.disturbances)}\n"
            f"  safety: {safety}\n"
            f"  plant: {self.plant.engine}, steps of {self.plant.time_step:g} s\n"
            f"  robot: {repr(self.robot).splitlines()[2].strip()}"
        )

    def in_full(self) -> dict[str, Any]:
        """`to_dict`, with what each leg of the robots has where `legs` leaves it to the symmetric robot."""
        robots = {name: each for name in ("robot", "model_robot") if (each := getattr(self, name)) is not None}
        filled = {name: {**each.to_dict(), "legs": each.each_leg()} for name, each in robots.items()}
        return {**self.to_dict(), **filled}

    def to_yaml(self) -> str:
        """The whole scenario, defaults included, as YAML that `load_scenario` reads back."""
        return to_yaml(self.to_dict())

    @property
    def believed_robot(self) -> RobotParameters:
        """The robot that the controller computes with."""
        return self.robot if self.model_robot is None else self.model_robot

    @property
    def lqi(self) -> LqiOptions:
        """`controller`, for what needs the LQI; refused where it is of another kind."""
        if not isinstance(self.controller, LqiOptions):
            raise ConfigurationError("controller.kind", self.controller.kind, "lqi, for this")
        return self.controller

    @property
    def effective_log_period(self) -> float:
        """[s] between log rows."""
        return self.controller.period if self.log_period is None else self.log_period

    @property
    def ahead(self) -> int:
        """[ticks] by which the controller sees state and reference ahead of time; 0 without an observer."""
        return self.estimator.ahead(self.command_delay) if self.estimator.expected else 0

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose (6,) and pose rate (6,) at t = 0."""
        pose, rate, _ = self.reference.evaluate(0.0)
        return pose + np.array(self.initial_offset), rate

    def linearize(self, pose: Any = None) -> Any:
        """The plant and the loop near a pose (6,) [rad, m], as matrices; see `stewart_drake.linearize`."""
        from stewart_drake import linearize

        return linearize(self, pose)

    def rules(self) -> None:
        """Periods fit each other, and the tuner its estimator."""
        place_users(self)
        steps_per("controller.period", self.controller.period, self.plant.time_step)
        if self.tuner.listens and not self.estimator.expected:
            allowed = f"observer, for tuner.kind {self.tuner.kind}"
            raise ConfigurationError("estimator.kind", self.estimator.kind, allowed)
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
    path = find_file("scenario", path)
    data = anchored(read_mapping("scenario", path, 100), path.parent)
    changes: dict[str, Any] = {}
    for text in overrides:
        key, separator, value = (part.strip() for part in text.partition("="))
        if not separator or not key:
            raise ConfigurationError("--set", text, "key=value, such as controller.period=0.002")
        changes |= anchored({key: parse_yaml(value, f"--set {shown(key)}")}, Path())
    with trusting_code(trust_code):
        return _changed(data, changes)


def require_scenario(value: object) -> None:
    """Raises a `TypeError` for anything but a Scenario."""
    if not isinstance(value, Scenario):
        raise TypeError(f"a Scenario is needed, not {value!r}; load_scenario reads one from a file")


def scenario_schema() -> dict[str, Any]:
    """JSON schema of a scenario file, for editors: each section once, under `$defs`."""
    sections: dict[str, Any] = {}

    def moved(node: Any) -> Any:
        if isinstance(node, list):
            return [moved(each) for each in node]
        if not isinstance(node, dict):
            return node
        node = {key: moved(each) for key, each in node.items()}
        if "properties" not in node or "title" not in node:
            return node
        name = node["title"]
        while sections.setdefault(name, node) != node:
            name += "_"
        return {"$ref": f"#/$defs/{name}"}

    schema = TypeAdapter(Scenario).json_schema()
    for name, section in schema.pop("$defs", {}).items():
        sections[name] = {key: moved(each) for key, each in section.items()}
    schema = {key: moved(each) for key, each in schema.items()}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "$defs": sections}


_FAMILIES: Mapping[str, Family] = {
    name: each
    for name, field in Scenario.__pydantic_fields__.items()
    for each in field.metadata
    if isinstance(each, Family)
}

# --- defaults that come from the robot ---

_ROBOT: TypeAdapter[RobotParameters | None] = TypeAdapter(AnyRobot | None)


def _with_robots(data: dict[str, Any]) -> tuple[dict[str, Any], AbstractContextManager[None]]:
    """The keys with the robots read, and the defaults of these robots, and of how soon a command acts."""
    try:
        robots = {key: _ROBOT.validate_python(data[key]) for key in ROBOT_KEYS if key in data}
        controller, estimator = (_FAMILIES[name].section(data.get(name, {})) for name in ("controller", "estimator"))
        latency = controller.period * (1 + estimator.ahead(data.get("command_delay", 0)))
    except (ConfigurationError, ValueError, TypeError, OverflowError):
        # The checks will say what is wrong with it.
        return data, nullcontext()
    robot = robots.get("robot") or PAPER
    return {**data, **robots}, defaults_of(robot, robots.get("model_robot") or robot, latency)


# --- keys ---

_KEY = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*|\[(?:0|[1-9]\d{0,5})\])*")


def split_key(key: str) -> tuple[str | int, ...]:
    """Names and indices in a key such as `robot.rod_length` or `initial_offset[0]`; else a `ConfigurationError`."""
    if _KEY.fullmatch(key) is None:
        raise ConfigurationError(shown(key), key, "a key such as robot.rod_length or initial_offset[0]")
    return tuple(int(index) if index else name for name, index in re.findall(r"([A-Za-z_]\w*)|\[(\d+)\]", key))


def value_at(data: Mapping[str, Any], key: str) -> Any:
    """Value of a key in a scenario, given in plain values; a `ConfigurationError` where it has no such key."""
    here: Any = data
    inside = "the scenario"
    for part in split_key(key):
        if isinstance(part, str) and isinstance(here, dict) and part not in here:
            raise ConfigurationError(shown(key), part, unknown(part, list(here)))
        _refuse_part(key, here, part, inside)
        here, inside = here[part], str(part)
    return here


def _refuse_part(key: str, here: Any, part: str | int, inside: str) -> None:
    """Raises a `ConfigurationError` where what a key goes into is no section, or no list that is long enough."""
    if isinstance(part, str) and not isinstance(here, dict):
        hint = "; `mismatch: true` fills it" if inside == "model_robot" and here is None else ""
        raise ConfigurationError(key, here, f"a section with this key, which {inside} is not{hint}")
    if isinstance(part, int) and not (isinstance(here, list) and part < len(here)):
        has = f"components from 0 to {len(here) - 1}" if isinstance(here, list) else "no components"
        raise ConfigurationError(key, here, f"an existing key: {inside} has {has}")


def _changed(data: dict[str, Any], changes: Mapping[str, Any]) -> Scenario:
    """The scenario of given keys and values with some of them changed."""
    components = {key: value for key, value in changes.items() if "[" in key}
    for key, value in changes.items():
        if key not in components:
            _assign(data, key, value, {})
    scenario = Scenario.from_dict(data)
    if not components:
        return scenario
    # Components are those of lists in full, defaults included.
    data, full = scenario.given(), scenario.in_full()
    for key, value in components.items():
        _assign(data, key, value, full)
    return Scenario.from_dict(data)


def _assign(data: dict[str, Any], key: str, value: Any, full: Any) -> None:
    """Sets a key; what is changed inside is a copy, and a list that was not given is filled from `full`."""
    *parents, last = path = split_key(key)
    here: Any = data
    for depth, part in enumerate(parents):
        at = isinstance(full, list) and isinstance(part, int)
        full = full.get(part) if isinstance(full, dict) else full[part] if at else None
        inside = _opened(part if depth == 0 else "", here.get(part) if isinstance(here, dict) else here[part])
        if inside is None:
            inside = [{} if isinstance(each, dict) else each for each in full] if isinstance(full, list) else {}
        _refuse_part(key, inside, path[depth + 1], str(part))
        here[part] = inside
        here = inside
    if last == "kind" and len(parents) == 1 and parents[0] in _FAMILIES:
        family = _FAMILIES[str(parents[0])]
        old, new = family.section_of(here), family.section_of({"kind": value})
        if old is not None and new is not None:
            for name in set(old.__pydantic_fields__) - (set(new.__pydantic_fields__) - new.own_keys):
                here.pop(name, None)
    here[last] = value


def _opened(name: str | int, value: Any) -> Any:
    """A copy of what stands at a key, to change something in it; `name` is that of a key of the scenario itself."""
    if name in ROBOT_KEYS and isinstance(value, str):
        value = robot_section(value)
    elif name in _FAMILIES:
        value = _FAMILIES[str(name)].spelled(value)
    if isinstance(value, Section):
        return value.given()
    return list(value) if isinstance(value, (list, tuple)) else dict(value) if isinstance(value, Mapping) else value
