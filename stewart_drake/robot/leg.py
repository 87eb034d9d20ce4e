"""What one leg of a robot has of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from stewart_drake.base.config import NotNegative, Real, Section, plain, with_message
from stewart_drake.base.errors import ConfigurationError

LEG_COUNT = 6
SMALLEST_SIZE, LARGEST_SIZE = 1e-12, 1e6
"""Sizes, masses and inertias beyond these, in SI units, are slips of the pen; squares of them leave floating point."""
DIRECTION_TOLERANCE = 1e-6
"""How far directions may be from unit length and from perpendicular to each other; what is left is taken away."""
JOINT_SWING = math.radians(65.0)
"""[rad] largest swing of a rod from home that joints allow; assumed, the paper's motion needs 63.1 deg."""
Size = Annotated[Real, Field(ge=SMALLEST_SIZE, le=LARGEST_SIZE)]
Length = Annotated[
    Real, Field(ge=SMALLEST_SIZE, le=30.0), with_message("a length above 0 and at most 30 m; in millimetres?")
]
"""[m]"""
Coordinate = Annotated[Real, Field(ge=-30.0, le=30.0)]
"""[m]"""
Position = tuple[Coordinate, Coordinate, Coordinate]
Signed = Annotated[Real, Field(ge=-LARGEST_SIZE, le=LARGEST_SIZE)]
HalfAngle = Annotated[Real, Field(ge=SMALLEST_SIZE, lt=math.pi / 3.0)]
"""[rad] of a pair of shafts or joints; pairs must not cross."""
Moderate = Annotated[NotNegative, Field(le=LARGEST_SIZE)]
Size3 = tuple[Size, Size, Size]
Signed3 = tuple[Signed, Signed, Signed]


# Python takes True and 1.0 for 1.
Branch = Annotated[Literal[-1, 1], BeforeValidator(lambda given: given if type(given) is int else None)]


class LegParameters(Section, key="robot.legs"):
    """Parameters of one leg that differ from the symmetric robot's; null for no difference."""

    shaft_position: Position | None = None
    """[m] centre of the motor shaft in B."""
    crank_zero_direction: Signed3 | None = None
    """[-] unit vector in B along which the crank points at theta = 0."""
    crank_quarter_direction: Signed3 | None = None
    """[-] unit vector in B along which the crank points at theta = pi/2; null for up. The motor axis is zero x
    quarter."""
    platform_joint: Position | None = None
    """[m] centre of the platform joint in P."""
    crank_length: Length | None = None
    """[m] length of the crank, shaft to tip."""
    rod_length: Length | None = None
    """[m] length of the rod, crank tip to platform joint."""
    effort_limit: Size | None = None
    """[N m] largest torque of the motor."""
    branch: Branch | None = None
    """Sign of the acos in the inverse kinematics: -1 or +1."""
    crank_angle_range: tuple[Signed, Signed] | None = None
    """[rad] lowest and highest theta, within one turn; the plant has stops there. null for none."""

    def rules(self) -> None:
        """Angles rise, directions are unit vectors."""
        low, high = self.crank_angle_range or (-math.pi, math.pi)
        if not low < high <= low + 2.0 * math.pi:
            allowed = "two angles [rad], rising, within one turn"
            allowed += "; degrees?" if max(-low, high) > 2.0 * math.pi else ""
            raise ConfigurationError("crank_angle_range", self.crank_angle_range, allowed)
        for name in ("crank_zero_direction", "crank_quarter_direction"):
            length = math.hypot(*(getattr(self, name) or (1.0,)))
            if abs(length - 1.0) > DIRECTION_TOLERANCE:
                raise ConfigurationError(name, getattr(self, name), f"a vector of length 1, not {length:.4g}")


def _leg(given: Any) -> Any:
    # Null, or a mapping with arrays.
    return {key: plain(value) for key, value in (given or {}).items()} if isinstance(given, Mapping | None) else given


_Leg = Annotated[LegParameters, BeforeValidator(_leg, json_schema_input_type=LegParameters | None)]
SixLegs = tuple[_Leg, _Leg, _Leg, _Leg, _Leg, _Leg]


def crank_equation(span: Any, zero: Any, quarter: Any, crank: Any, rod: Any) -> tuple[Any, Any, Any]:
    """A, B, C (..., 6) [m^2] of A cos(theta) + B sin(theta) = C; what (6) leaves unsaid.

    Of spans (..., 6, 3) [m] from motor shaft to platform joint, the L_i of (2), directions (6, 3) of the cranks at
    theta = 0 and pi/2, and lengths (6,) [m] of cranks and rods. `mechanics.kinematics_laws.legs_at` has it compiled.
    """
    along, up = (2.0 * crank * np.sum(span * direction, axis=-1) for direction in (zero, quarter))
    return along, up, np.sum(span * span, axis=-1) + crank * crank - rod * rod


def crank_angles(along: Any, up: Any, constant: Any, branch: Any) -> Any:
    """Solution theta (..., 6) [rad] of `crank_equation` in closed form; NaN where a rod cannot span."""
    with np.errstate(invalid="ignore"):
        return np.arctan2(up, along) + branch * np.arccos(constant / np.hypot(along, up))
