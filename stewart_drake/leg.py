"""One leg of a robot: what it has of its own."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from stewart_drake.errors import ConfigurationError
from stewart_drake.section import SECTION, Count, Positive, Real, Vector3, is_finite, plain

LEGS = 6
SMALLEST, LARGEST = 1e-12, 1e6
"""Sizes, masses and inertias beyond these, in SI units, are slips of the pen; squares of them leave floating point."""
PARALLEL = 1e-6
"""How far directions may be from unit length and from perpendicular to each other; what is left is taken away."""


@dataclass(frozen=True, kw_only=True)
class LegParameters:
    """What one leg has of its own; null is that of the symmetric robot."""

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    shaft_position: Vector3 | None = None
    """[m] centre of the motor shaft in B."""
    crank_zero_direction: Vector3 | None = None
    """[-] unit vector in B along which the crank points at theta = 0."""
    crank_quarter_direction: Vector3 | None = None
    """[-] unit vector in B along which it points at theta = pi/2: up, if null. The motor axis is zero x quarter."""
    platform_joint: Vector3 | None = None
    """[m] joint centre in P."""
    crank_length: Positive | None = None
    """[m] shaft to crank tip."""
    rod_length: Positive | None = None
    """[m] crank tip to platform joint."""
    branch: Count | None = None
    """Sign of the acos in the inverse kinematics: -1 or +1."""
    crank_angle_range: tuple[Real, Real] | None = None
    """[rad] lowest and highest theta, within one turn; the plant has stops there. Null: none."""


Legs = tuple[LegParameters, LegParameters, LegParameters, LegParameters, LegParameters, LegParameters]


def read_legs(given: Any) -> Legs:
    """Six checked legs out of sections, mappings or null.

    Raises:
        ConfigurationError: Not six; or a value that no robot can have.
    """
    if not isinstance(given, tuple) or len(given) != LEGS:
        raise ConfigurationError("robot.legs", given, f"null, or {LEGS} sections")
    return tuple(_leg(f"robot.legs.{leg}", each) for leg, each in enumerate(given))  # type: ignore[return-value]


def _leg(key: str, given: Any) -> LegParameters:
    known = [field.name for field in dataclasses.fields(LegParameters)]
    if isinstance(given, LegParameters):
        given = {name: getattr(given, name) for name in known}
    given = {} if given is None else given
    if not isinstance(given, Mapping) or not set(given) <= set(known):
        raise ConfigurationError(key, given, f"a section with keys such as {', '.join(known)}")
    values = {name: plain(value) for name, value in given.items() if value is not None}
    for name, value in values.items():
        size = {"branch": 1, "crank_length": 1, "rod_length": 1, "crank_angle_range": 2}.get(name, 3)
        if (len(value) if isinstance(value, tuple) else 1) != size:
            raise ConfigurationError(f"{key}.{name}", value, f"{size} numbers" if size > 1 else "a number")
        check_size(f"{key}.{name}", value, signed=not name.endswith("length"))
    if values.get("branch", 1) not in (-1, 1):
        raise ConfigurationError(f"{key}.branch", values["branch"], "-1 or 1")
    low, high = values.get("crank_angle_range", (-math.pi, math.pi))
    if not low < high <= low + 2.0 * math.pi:
        raise ConfigurationError(f"{key}.crank_angle_range", (low, high), "two angles, rising, within one turn")
    return LegParameters(**values)


def check_size(key: str, given: Any, *, signed: bool, zero: bool = False) -> None:
    """Raises a `ConfigurationError` for what is not numbers of a size that a robot can have."""
    low = -LARGEST if signed else 0.0 if zero else SMALLEST
    values = given if isinstance(given, tuple) else (given,)
    if not all(is_finite(value) and low <= value <= LARGEST for value in values):
        kind = f"finite numbers from {low:g} to {LARGEST:g}" if signed or zero else f"positive numbers to {LARGEST:g}"
        raise ConfigurationError(key, given, kind)
