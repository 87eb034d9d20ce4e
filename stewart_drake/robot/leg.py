"""Parameters of one leg, and the crank equation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from stewart_drake.base.config import NotNegative, Real, Section, plain, with_message
from stewart_drake.base.errors import ConfigurationError

LEG_COUNT = 6
SMALLEST_SIZE, LARGEST_SIZE = 1e-12, 1e6
"""Limits of sizes, masses and inertias in SI units: beyond them are typing errors, and squares that overflow."""
DIRECTION_TOLERANCE = 1e-6
"""By which directions may differ from unit vectors, and from perpendicular ones; the rest is corrected."""
MOST = 30.0
"""[m] largest length and coordinate."""
JOINT_SWING = math.radians(65.0)
"""[rad] largest swing of a rod from home that joints allow; assumed, the paper's motion needs 63.1 deg."""
Size = Annotated[Real, Field(ge=SMALLEST_SIZE, le=LARGEST_SIZE)]
Length = Annotated[
    Real, Field(ge=SMALLEST_SIZE, le=MOST), with_message("a length above 0 and at most 30 m; in millimetres?")
]
"""[m]"""
Height = Annotated[
    Real, Field(ge=-MOST, le=MOST), with_message("a height within 30 m, negative below the base; in millimetres?")
]
"""[m]"""
Coordinate = Annotated[Real, Field(ge=-MOST, le=MOST)]
"""[m]"""
Position = tuple[Coordinate, Coordinate, Coordinate]
Signed = Annotated[Real, Field(ge=-LARGEST_SIZE, le=LARGEST_SIZE)]
Gain = Annotated[
    Real, Field(ge=0.5, le=2.0), with_message("a number from 0.5 to 2; 1 for a servo that turns as commanded")
]
HalfAngle = Annotated[Real, Field(ge=SMALLEST_SIZE, lt=math.pi / 3.0)]
"""[rad] of a pair of shafts or joints; pairs must not cross."""
Moderate = Annotated[NotNegative, Field(le=LARGEST_SIZE)]
Size3 = tuple[Size, Size, Size]
Signed3 = tuple[Signed, Signed, Signed]


# In Python True == 1.0 == 1.
Branch = Annotated[Literal[-1, 1], BeforeValidator(lambda value: value if type(value) is int else None)]


class LegParameters(Section, key="robot.legs"):
    """Parameters of one leg that differ from the symmetric robot's; null for no difference."""

    shaft_position: Position | None = None
    """[m] centre of the motor shaft in B."""
    crank_zero_direction: Signed3 | None = None
    """[-] unit vector in B along which the crank points at theta = 0."""
    crank_quarter_direction: Signed3 | None = None
    """[-] unit vector in B along which the crank points at theta = pi/2; null for up. The motor axis is the cross
    product of both directions."""
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
    servo_gain: Gain | None = None
    """[-] angle by which the crank turns over the angle that its motor is commanded and reads; null for 1. `calibrate`
    estimates it; commands and readings of a machine are corrected by that of `model.robot`."""
    servo_middle: Signed | None = None
    """[rad] reading of the servo, the angle of packets, in the middle of its travel, as it is mounted; null for that at
    home. `calibrate` writes the guess's: the board turns as before, and cranks start at the true home."""

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


def _leg(value: object) -> object:
    # Null, or a mapping with arrays.
    return {key: plain(item) for key, item in (value or {}).items()} if isinstance(value, Mapping | None) else value


_Leg = Annotated[LegParameters, BeforeValidator(_leg, json_schema_input_type=LegParameters | None)]
SixLegs = tuple[_Leg, _Leg, _Leg, _Leg, _Leg, _Leg]


def crank_equation(
    span: np.ndarray, zero: np.ndarray, quarter: np.ndarray, crank: np.ndarray, rod: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients A, B, C (..., 6) [m^2] of A cos(theta) + B sin(theta) = C, which (6) does not give.

    Args:
        span: (..., 6, 3) [m] from motor shaft to platform joint, L_i of (2).
        zero: (6, 3) directions of the cranks at theta = 0.
        quarter: (6, 3) at theta = pi/2.
        crank: (6,) [m] lengths.
        rod: (6,) [m] lengths.
    """
    along, up = (2.0 * crank * np.sum(span * direction, axis=-1) for direction in (zero, quarter))
    return along, up, np.sum(span * span, axis=-1) + crank * crank - rod * rod


def crank_angles(along: np.ndarray, up: np.ndarray, constant: np.ndarray, branch: float | np.ndarray) -> np.ndarray:
    """Solution theta (..., 6) [rad] of `crank_equation` in closed form; NaN where a rod cannot span."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.arctan2(up, along) + branch * np.arccos(constant / np.hypot(along, up)))
