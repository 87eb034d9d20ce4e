"""Robots by name or file: YAML with the keys of `RobotParameters`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import write_atomically
from stewart_drake.files.yaml_files import find_file, read_mapping, shipped_folder, to_yaml
from stewart_drake.robot.robot_parameters import RobotParameters
from stewart_drake.wording import as_problem

_ABOUT = ("name", "about")
"""Keys that a file has beside those of the robot: texts for people."""


def robot_names() -> list[str]:
    """Robots of the package."""
    return sorted(path.stem for path in shipped_folder("robots").glob("*.yaml"))


def load_robot(name: str | Path) -> RobotParameters:
    """A robot from a YAML file.

    Args:
        name: Path of the file, or a robot of the package such as `reachy_mini`.

    Raises:
        ConfigurationError: Missing, unreadable or malformed file; unknown key; value not allowed.
    """
    return RobotParameters.from_dict(robot_section(name))


def save_robot(robot: RobotParameters, path: str | Path, about: str = "") -> None:
    """Writes a robot as a YAML file that `load_robot` and `robot:` in a scenario read; what is default is left out.

    Args:
        robot: What to write.
        path: The file; its folder must exist.
        about: One line on it.

    Raises:
        ConfigurationError: The folder is missing or not writable.
    """
    usual = RobotParameters().to_dict()
    data = {key: value for key, value in robot.to_dict().items() if value != usual[key]}
    if robot.legs is not None:
        data["legs"] = [{key: each for key, each in leg.items() if each is not None} for leg in data["legs"]]
    write_atomically(Path(path), to_yaml(({"about": about} if about else {}) | data).encode())


def robot_section(name: str | Path) -> dict[str, Any]:
    """Keys and values of a robot's file, unchecked.

    Raises:
        ConfigurationError: Missing, unreadable or malformed file.
    """
    return {key: value for key, value in _read(name).items() if key not in _ABOUT}


def robot_about(name: str | Path) -> str:
    """What a robot's file says of it in a line; empty if nothing.

    Raises:
        ConfigurationError: As `robot_section`.
    """
    return str(_read(name).get("about", ""))


def _read(name: str | Path) -> dict[str, Any]:
    return read_mapping("robot", find_file("robot", name), 100)


class _ByName:
    """In `Annotated`: a text in place of the section is the name or the file of a robot."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_before_validator_function(_section, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        section = handler(schema)
        description = f"Path of a YAML file, or one of {', '.join(robot_names())}."
        return {"anyOf": [section, {"type": "string", "description": description}]}


def _section(given: Any) -> Any:
    if not isinstance(given, (str, Path)):
        return given
    try:
        return robot_section(given)
    except ConfigurationError as error:
        if error.key != "robot file":
            raise
        raise as_problem(ConfigurationError("", str(given), error.allowed)) from None


AnyRobot = Annotated[RobotParameters, _ByName()]
"""A robot in a scenario: its section, a file, or a name."""
