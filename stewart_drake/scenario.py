"""One run as typed YAML: read, checked to the last key, frozen."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    StrictStr,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_validator,
)

from stewart_drake.control.computed_torque import ComputedTorqueOptions
from stewart_drake.control.control_law import ControlLaw
from stewart_drake.control.density import DensityKind
from stewart_drake.control.joint_pid import PidOptions
from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.control.network import TunerNetwork, default_network_path, load_network
from stewart_drake.control.user_controller import PythonOptions
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.named_files import anchor_files
from stewart_drake.files.yaml_files import find_file, parse_yaml, read_mapping, to_yaml
from stewart_drake.hardware.command_link import LinkOptions
from stewart_drake.hardware.disturbances import Disturbance
from stewart_drake.hardware.estimator import EncoderOptions
from stewart_drake.hardware.motors import MotorOptions
from stewart_drake.hardware.sensor_faults import PoseFault
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.planning.bounds import Bounds
from stewart_drake.planning.limits import Limits
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.references import AnyReference, SineReference
from stewart_drake.robot import LARGEST, RobotParameters
from stewart_drake.safety import SafetyOptions
from stewart_drake.sampling import steps_per
from stewart_drake.section import SECTION, Count, Real, Vector6, explain, keys_of, kind_class, shown

MAX_LOG_ROWS = 10**8
"""Of some 0.8 kilobytes each."""
MAX_STEPS = 10**9
"""Of the plant in a run: beyond it sample times, which are stretched by a hair, would lose their step."""


class _Section(BaseModel):
    model_config = cast(ConfigDict, {**SECTION, "frozen": True})


class _Tuner(_Section):
    density: DensityKind = "magnitude"
    """Kind of density (35), (36); for a network, the one that it was trained on."""
    window: Annotated[Count, Field(ge=1, le=100_000)] = 49
    """Window m of (35), (36) [ticks]; means run over m + 1 samples. A network works with any: a density has no unit of
    time."""

    @model_validator(mode="wrap")
    @classmethod
    def _validate(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        try:
            return handler(data)
        except ValidationError as error:
            raise explain(cls, error, data, "tuner") from None


class _PairTuner(_Tuner):
    omega_q: Annotated[Real, Field(gt=0.0)] = 1.0
    """omega_Q of (27); for a network, its value before the first inference."""
    omega_r: Annotated[Real, Field(gt=0.0)] = 1.0
    """omega_R of (27); for a network, its value before the first inference."""

    @property
    def weights(self) -> tuple[float, ...]:
        """Weights at the start, as the controller takes them."""
        return self.omega_q, self.omega_r


class FixedTuner(_PairTuner):
    """Weights that stay as given; densities are logged all the same."""

    kind: Literal["fixed"] = "fixed"


class BlockTuner(_Tuner):
    """Q = diag(q_pose I, q_rate I, q_integral I), R = r I, held as given; see `controller.weight_length`."""

    kind: Literal["block"] = "block"
    q_pose: Annotated[Real, Field(gt=0.0)]
    """Weight of the pose's error."""
    q_rate: Annotated[Real, Field(gt=0.0)]
    """Weight of its rate."""
    q_integral: Annotated[Real, Field(gt=0.0)]
    """Weight of its integral."""
    r: Annotated[Real, Field(gt=0.0)] = 1.0
    """Weight of the torques."""

    @property
    def weights(self) -> tuple[float, ...]:
        """Weights as the controller takes them."""
        return self.q_pose, self.q_rate, self.q_integral, self.r


class IdealSensors(_Section):
    """Pose and rate of the platform, exact."""

    kind: Literal["ideal"] = "ideal"
    faults: tuple[PoseFault, ...] = ()
    """Times at which the sensor fails."""


class AnnTuner(_PairTuner):
    """Weights from the neural network of Fig. 5."""

    kind: Literal["ann"] = "ann"
    weights_file: StrictStr | None = None
    """Path of a trained network, relative to the scenario file; null takes the one of the package."""


class Scenario(_Section):
    """Everything that one run depends on.

    `Scenario(...)` and `Scenario.from_dict` check the same rules; `load_scenario` reads a file.

    Raises:
        ConfigurationError: Names the key, the value and what is allowed.
    """

    name: Annotated[StrictStr, Field(min_length=1, max_length=100, pattern=r"^\w[\w .+-]*$")] = "scenario"
    """Used for the output folder and titles: letters, digits and, after the first, space and . + - too."""
    duration: Annotated[Real, Field(gt=0.0, le=1e6)] = 10.0
    """[s] simulated time; at most 1e9 steps of the plant. A run ends with the last whole step."""
    gravity: Annotated[Real, Field(ge=0.0, le=LARGEST)] = STANDARD_GRAVITY
    """[m/s^2] along -z of B; 0 for none."""
    robot: RobotParameters = Field(default_factory=RobotParameters)
    """Geometry, masses and limits of the simulated robot."""
    model_robot: RobotParameters | None = None
    """The robot as the controller believes it to be; null for the truth."""
    plant: PlantOptions = Field(default_factory=PlantOptions)
    """The simulated robot."""
    motors: MotorOptions = Field(default_factory=MotorOptions)
    """What its motors make of a torque."""
    disturbances: tuple[Disturbance, ...] = ()
    """Wrenches from outside on the platform; they add up."""
    reference: AnyReference = Field(default_factory=SineReference)
    """The motion to follow."""
    initial_offset: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """[rad, m] start pose minus the reference's; the start velocity is the reference's."""
    controller: Annotated[
        LqiOptions | PidOptions | ComputedTorqueOptions | PythonOptions, Field(discriminator="kind")
    ] = Field(default_factory=LqiOptions)
    """What answers to errors with torques; without `kind`, the LQI."""
    tuner: Annotated[FixedTuner | AnnTuner | BlockTuner, Field(discriminator="kind")] = Field(default_factory=AnnTuner)
    """Where the weights come from; without effect for controllers that take none."""
    sensors: Annotated[IdealSensors | EncoderOptions, Field(discriminator="kind")] = Field(default_factory=IdealSensors)
    """What the controller sees of the robot."""
    command_delay: Annotated[Count, Field(ge=0, le=100)] = 0
    """Control periods from a tick to its torque at the motors; until the first arrives they hold the start pose."""
    link: LinkOptions = Field(default_factory=LinkOptions)
    """The way of the commands: what is dropped, late or spoilt. It comes after the delay."""
    safety: SafetyOptions | None = None
    """What stands between the commands and the motors; null for nothing."""
    bounds: Bounds = Field(default_factory=Bounds)
    """What the run itself must keep to for its motion to count as followed; it decides on the outcome."""
    limits: Limits = Field(default_factory=Limits)
    """What the reference must keep to; checked before the run."""
    log_period: Annotated[Real, Field(gt=0.0)] | None = None
    """[s] between log rows, a whole multiple of plant.time_step, at most duration; null takes controller.period."""

    @model_validator(mode="wrap")
    @classmethod
    def _validate(cls, data: Any, handler: ModelWrapValidatorHandler[Scenario]) -> Scenario:
        try:
            # Numbers near the largest overflow to infinity, which the checks refuse; numpy need not say so as well.
            with np.errstate(all="ignore"):
                scenario = handler(data)
        except ValidationError as error:
            raise explain(cls, error, data) from None
        scenario._check()
        return scenario

    @field_validator(
        "robot",
        "model_robot",
        "plant",
        "motors",
        "reference",
        "controller",
        "link",
        "bounds",
        "limits",
        "safety",
        "sensors",
        mode="before",
    )
    @classmethod
    def _unpack(cls, section: Any, info: ValidationInfo) -> Any:
        if info.field_name == "controller" and isinstance(section, Mapping) and "kind" not in section:
            return {"kind": "lqi", **section}
        # A section made in Python is checked like one from a file; otherwise an array in it would only show at the end.
        if isinstance(section, type) or not dataclasses.is_dataclass(section):
            return section
        return {field.name: getattr(section, field.name) for field in dataclasses.fields(section)}

    @field_validator("robot", "model_robot", mode="wrap")
    @classmethod
    def _validate_robot(cls, data: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        try:
            return handler(data)
        except OverflowError:
            raise ConfigurationError(str(info.field_name), data, "numbers of a robot that can be built") from None
        except ConfigurationError as error:
            key = error.key.replace("robot", str(info.field_name), 1)
            raise ConfigurationError(key, error.value, error.allowed) from None

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Scenario:
        """A scenario from plain values, as YAML gives them.

        Raises:
            ConfigurationError: As for the class.
        """
        if not isinstance(data, Mapping):
            raise ConfigurationError("scenario", data, "a mapping of keys to values")
        return cls.model_validate(dict(data))

    def replace(self, changes: Mapping[str, Any]) -> Scenario:
        """A scenario with some keys changed, checked again.

        Another `kind` of reference, tuner, sensors or controller drops the keys that only the old kind has.

        Args:
            changes: Dotted key -> plain value, such as {"tuner.omega_q": 10.0}.

        Raises:
            ConfigurationError: As for the class.
        """
        data = self.to_dict()
        for key, value in changes.items():
            _assign(data, key, value)
        return Scenario.from_dict(data)

    def to_dict(self) -> dict[str, Any]:
        """Every key with its value, in plain types."""
        return json.loads(self.model_dump_json())

    def to_yaml(self) -> str:
        """The whole scenario, defaults included, as YAML that `load_scenario` reads back."""
        return to_yaml(self.to_dict())

    @property
    def believed_robot(self) -> RobotParameters:
        """The robot that the controller computes with."""
        return self.robot if self.model_robot is None else self.model_robot

    @property
    def lqi(self) -> LqiOptions:
        """`controller`, for what needs the LQI.

        Raises:
            ConfigurationError: It is of another kind.
        """
        if not isinstance(self.controller, LqiOptions):
            raise ConfigurationError("controller.kind", self.controller.kind, "lqi, for this")
        return self.controller

    @property
    def effective_log_period(self) -> float:
        """[s] between log rows."""
        return self.controller.period if self.log_period is None else self.log_period

    def load_tuner_network(self) -> TunerNetwork | None:
        """The network that this scenario names, or None where the weights are fixed.

        Raises:
            ConfigurationError: Missing or corrupt file, trained on another kind of density, or first weights outside of
                the range that it was trained on.
        """
        if not isinstance(self.tuner, AnnTuner):
            return None
        path = default_network_path() if self.tuner.weights_file is None else Path(self.tuner.weights_file)
        network = load_network(path)
        if network.density != self.tuner.density:
            raise ConfigurationError(
                "tuner.density", self.tuner.density, f"{network.density}, as {path} was trained on"
            )
        for index, key in enumerate(("omega_q", "omega_r")):
            value, low, high = getattr(self.tuner, key), network.omega_min[index], network.omega_max[index]
            if not low <= value <= high:
                raise ConfigurationError(f"tuner.{key}", value, f"{low:g} to {high:g}, as {path} was trained on")
        return network

    def control_law(self) -> ControlLaw:
        """The controller of this scenario as a pure function, see `ControlLaw`.

        Raises:
            ConfigurationError: It is no LQI; as `load_tuner_network`.
        """
        return ControlLaw(
            self.believed_robot,
            self.lqi,
            self.gravity,
            self.load_tuner_network(),
            self.tuner.density,
            self.tuner.window,
            self.tuner.weights,
        )

    def start(self) -> tuple[np.ndarray, np.ndarray]:
        """Pose (6,) and pose rate (6,) at t = 0."""
        pose, rate, _ = self.reference.evaluate(0.0)
        return pose + np.array(self.initial_offset), rate

    def _check(self) -> None:
        """Rules between keys."""
        steps = steps_per("controller.period", self.controller.period, self.plant.time_step)
        if self.link.late_steps > steps:
            raise ConfigurationError("link.late_steps", self.link.late_steps, f"at most one control period, {steps}")
        if self.safety is not None:
            self.safety.check_against(self.believed_robot, self.controller.period)
        if self.duration > MAX_STEPS * self.plant.time_step * (1.0 + 1e-9):
            allowed = f"at most {MAX_STEPS * self.plant.time_step:g} s, which are 1e9 steps of the plant"
            raise ConfigurationError("duration", self.duration, allowed)
        if self.log_period is not None:
            steps_per("log_period", self.log_period, self.plant.time_step)
        if self.duration < self.controller.period:
            raise ConfigurationError(
                "duration", self.duration, f"at least one control period, {self.controller.period:g} s"
            )
        if self.log_period is not None and self.log_period > self.duration:
            raise ConfigurationError("log_period", self.log_period, f"at most the duration, {self.duration:g} s")
        if self.duration / self.effective_log_period > MAX_LOG_ROWS * (1.0 + 1e-9):
            steps = math.ceil(self.duration / MAX_LOG_ROWS / self.plant.time_step)
            allowed = f"at least {steps * self.plant.time_step:g} s for a run of {self.duration:g} s"
            raise ConfigurationError("log_period", self.effective_log_period, f"{allowed}: a log has at most 1e8 rows")


def load_scenario(path: str | Path, overrides: Iterable[str] = ()) -> Scenario:
    """Reads a scenario file.

    Args:
        path: YAML file; `weights_file`, `motion_file` and a controller's file in it are relative to its folder, and the
            last lies in it or below. A bare name such as `paper_fig7` is looked up among the scenarios of the package.
        overrides: `key=value` texts, keys dotted, values as YAML; for files among them the current folder is what for
            others is the folder of the YAML file. Another `kind` of reference, tuner, sensors or controller drops the
            keys that only the old kind has.

    Raises:
        ConfigurationError: Missing, unreadable or malformed file; unknown key; value not allowed.
    """
    path = find_file("scenario", path)
    data = read_mapping("scenario", path, 100)
    anchor_files(data, path.parent)
    for text in overrides:
        key, separator, value = text.partition("=")
        if not separator or not key.strip():
            raise ConfigurationError("--set", text, "key=value, such as controller.period=0.002")
        change = {key.strip(): parse_yaml(value, f"--set {shown(key.strip())}")}
        anchor_files(change, Path())
        _assign(data, key.strip(), change[key.strip()])
    return Scenario.from_dict(data)


def scenario_schema() -> dict[str, Any]:
    """JSON schema of a scenario file, for editors."""
    schema = Scenario.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    return schema


def _assign(data: dict[str, Any], key: str, value: Any) -> None:
    *parents, last = key.split(".")
    section: Any = data
    for depth, part in enumerate(parents):
        if section.get(part) is None:
            section[part] = {}
        section = section[part]
        if not isinstance(section, dict):
            name = ".".join(map(shown, parents[: depth + 1]))
            raise ConfigurationError(name, section, f"a section, to set {shown(key)} in it")
    if last == "kind" and parents in (["reference"], ["tuner"], ["sensors"], ["controller"]):
        before = section.get("kind", "lqi" if parents == ["controller"] else None)
        old, new = (kind_class(Scenario, parents[0], kind) for kind in (before, value))
        if old is not None and new is not None:
            # Controllers have keys of one name with other choices.
            same = set(keys_of(new)) - ({"feedforward", "saturation"} if parents == ["controller"] else set())
            for name in set(keys_of(old)) - same:
                section.pop(name, None)
    section[last] = value
