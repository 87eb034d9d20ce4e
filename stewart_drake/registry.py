"""Every kind of controller, tuner, sensor, reference and disturbance: its section, and the LeafSystem that runs it.

A kind is one line here. Names are texts, imported when a kind is asked for: to read a scenario takes neither Drake nor
what the scenario does not name. `Family.add` takes a kind from outside of the package.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from operator import attrgetter
from typing import Any

from pydantic import GetJsonSchemaHandler, TypeAdapter
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from stewart_drake.errors import ConfigurationError
from stewart_drake.section import Section
from stewart_drake.wording import as_problem, chosen, either

_PACKAGE = __name__.partition(".")[0]


class Family:
    """The kinds of one part of a scenario, told apart by the key `kind`; in `Annotated`, the type of such a part.

    Args:
        lines: Kind -> its section and, where it has one, the LeafSystem or function that builds its part of the
            Diagram: `module:name` in this package, or the thing itself.
        default: Kind where the key is absent; None where it is required.
        without: Kinds that are not taken here.
    """

    def __init__(
        self, lines: dict[str, tuple[Any, ...]], default: str | None = None, without: tuple[str, ...] = ()
    ) -> None:
        self.default = default
        self._lines, self._without = lines, without

    def but(self, *kinds: str) -> Family:
        """The same kinds, without some."""
        return Family(self._lines, self.default, (*self._without, *kinds))

    @property
    def kinds(self) -> list[str]:
        """Names of the kinds."""
        return [kind for kind in self._lines if kind not in self._without]

    def add(self, section: type[Section], system: Any = None) -> None:
        """Adds a kind: its section, whose `kind` has its name as the default, and what runs it."""
        self._lines[section.__pydantic_fields__["kind"].default] = (section, system)

    def section(self, kind: Any) -> type[Section] | None:
        """Class of a kind's section; None for no such kind."""
        known = isinstance(kind, str) and kind in self._lines and kind not in self._without
        return self._get(kind, 0) if known else None

    def system(self, kind: str) -> Any:
        """What builds the part of the Diagram for a kind."""
        return self._get(kind, 1)

    def section_of(self, data: Any) -> type[Section] | None:
        """Class of a section that is written, or made; None where it is not one of these."""
        if isinstance(data, Mapping):
            return self.section(data.get("kind", self.default))
        found = self.section(getattr(data, "kind", None))
        return found if found is not None and isinstance(data, found) else None

    def _get(self, kind: str, column: int) -> Any:
        line = self._lines[kind]
        if isinstance(line[column], str):
            module, _, name = line[column].partition(":")
            found = attrgetter(name)(import_module(f"{_PACKAGE}.{module}"))
            line = self._lines[kind] = (*line[:column], found, *line[column + 1 :])
        return line[column]

    def _validate(self, value: Any) -> Any:
        section = self.section_of(value)
        if isinstance(value, Mapping):
            if section is not None:
                return section.__pydantic_validator__.validate_python(value)
            missing = "kind" not in value
            allowed = f"{either(self.kinds)}; this key is required" if missing else chosen(value["kind"], self.kinds)
            raise as_problem(ConfigurationError("kind", value.get("kind"), allowed))
        if section is not None:
            return value
        if isinstance(value, Section):
            raise as_problem(ConfigurationError("kind", getattr(value, "kind", None), either(self.kinds)))
        raise PydanticCustomError("section", "a section")

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._validate)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        # What `json_schema` makes references of: pydantic knows only those that it made itself.
        return {"kinds": {kind: self.section(kind) for kind in self.kinds}, "default kind": self.default}


def json_schema(root: Any) -> dict[str, Any]:
    """JSON schema of a section, with every kind of its families among the definitions."""
    schema: dict[str, Any] = TypeAdapter(root).json_schema()
    definitions: dict[str, Any] = schema.setdefault("$defs", {})

    def with_references(part: Any) -> Any:
        if isinstance(part, list):
            return [with_references(each) for each in part]
        if not isinstance(part, dict):
            return part
        if "kinds" not in part:
            return {key: with_references(value) for key, value in part.items()}
        rest = {key: value for key, value in part.items() if key not in ("kinds", "default kind")}
        return {**rest, "anyOf": [reference(kind, each, part["default kind"]) for kind, each in part["kinds"].items()]}

    def reference(kind: str, section: Any, default: str | None) -> dict[str, Any]:
        name = section.__name__
        if name not in definitions:
            definitions[name] = {}
            made = TypeAdapter(section).json_schema()
            definitions.update({each: with_references(value) for each, value in made.pop("$defs", {}).items()})
            definitions[name] = with_references(made)
        return {"$ref": f"#/$defs/{name}", **({} if kind == default else {"required": ["kind"]})}

    inner = list(definitions)
    schema = with_references({key: value for key, value in schema.items() if key != "$defs"})
    definitions.update({name: with_references(definitions[name]) for name in inner})
    return {**schema, "$defs": definitions}


REFERENCES = Family(
    {
        "hold": ("references.basic:HoldReference",),
        "sine": ("references.basic:SineReference",),
        "sine_bursts": ("references.basic:SineBurstsReference",),
        "breathing": ("references.surgical:BreathingReference",),
        "heartbeat": ("references.surgical:HeartbeatReference",),
        "tremor": ("references.surgical:TremorReference",),
        "minimum_jerk": ("references.paths:MinimumJerkReference",),
        "spline": ("references.paths:SplineReference",),
        "recorded": ("references.recorded:RecordedReference",),
        "sum": ("references.combined:SumReference",),
        "adjusted": ("references.combined:AdjustedReference",),
    }
)
CONTROLLERS = Family(
    {
        "lqi": ("control.lqi_options:LqiOptions", "systems.lqi_controller:LqiController.build"),
        "pid": ("control.joint_pid:PidOptions", "systems.joint_pid:JointPid.build"),
        "computed_torque": (
            "control.computed_torque:ComputedTorqueOptions",
            "systems.computed_torque:ComputedTorque.build",
        ),
        "python": ("control.user_controller:PythonOptions", "systems.user_controller:load_user_controller"),
    },
    default="lqi",
)
TUNERS = Family(
    {
        "fixed": ("control.tuners:FixedTuner",),
        "ann": ("control.tuners:AnnTuner",),
        "block": ("control.tuners:BlockTuner",),
    }
)
SENSORS = Family(
    {
        "ideal": ("hardware.sensor_faults:IdealSensors", "systems.task_space_sensor:add_ideal_sensor"),
        "encoders": ("hardware.estimator:EncoderOptions", "systems.pose_estimator:add_encoders"),
    }
)
DISTURBANCES = Family(
    {
        "constant": ("hardware.disturbances:ConstantWrench",),
        "step": ("hardware.disturbances:StepWrench",),
        "impulse": ("hardware.disturbances:ImpulseWrench",),
        "sine": ("hardware.disturbances:SineWrench",),
        "noise": ("hardware.disturbances:NoiseWrench",),
    }
)
