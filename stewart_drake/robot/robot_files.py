"""Robots by name or file: YAML with the keys of `RobotParameters`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field

from stewart_drake.base.atomic_files import Document, write_atomically
from stewart_drake.base.config import as_problem
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.yaml_files import find_file, read_mapping, shipped_folder, to_yaml
from stewart_drake.robot.robot_parameters import RobotParameters

_ABOUT = ("name", "about", "mjcf")  # Further keys of a file: texts, and a model for MuJoCo.


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
    """Writes a robot as a YAML file for `load_robot` and for `robot:` in a scenario, without defaults.

    Args:
        robot: The robot.
        path: The file; its folder must exist.
        about: One line about the robot.

    Raises:
        ConfigurationError: The folder is missing or not writable.
    """
    defaults = RobotParameters().to_dict()
    data = {key: value for key, value in robot.to_dict().items() if value != defaults[key]}
    if robot.legs is not None:
        data["legs"] = [{key: value for key, value in leg.items() if value is not None} for leg in data["legs"]]
    write_atomically(Path(path), to_yaml(({"about": about} if about else {}) | data).encode())


def robot_section(name: str | Path) -> Document:
    """Keys and values of a robot's file, unchecked."""
    return {key: value for key, value in _read(name).items() if key not in _ABOUT}


def robot_about(name: str | Path) -> str:
    """The line about a robot in its file; empty if there is none."""
    return str(_read(name).get("about", ""))


def robot_model(name: str | Path) -> str:
    """The MJCF named in a robot's file, see `plant.model_file`: a path, or a file in a Python package.

    Raises:
        ConfigurationError: The robot does not exist, or its file has no key `mjcf`.
    """
    model = _read(name).get("mjcf")
    if not isinstance(model, str):
        allowed = "a robot whose file names a model with the key `mjcf`, or an MJCF file"
        raise ConfigurationError("plant.model_file", str(name), allowed)
    return model if model.startswith("package:") else str(find_file("robot", name).parent / model)


def _read(name: str | Path) -> Document:
    return read_mapping("robot", find_file("robot", name), 100)


def _section(value: object) -> object:
    """The section of a name or a file."""
    if not isinstance(value, (str, Path)):
        return value
    try:
        return robot_section(value)
    except ConfigurationError as error:
        if error.key != "robot file":
            raise
        raise as_problem(ConfigurationError("", str(value), error.allowed)) from None


_Name = Annotated[str, Field(description=f"Path of a YAML file, or one of {', '.join(robot_names())}.")]
AnyRobot = Annotated[RobotParameters, BeforeValidator(_section, json_schema_input_type=RobotParameters | _Name)]
"""A robot in a scenario: its section, a file, or a name."""
