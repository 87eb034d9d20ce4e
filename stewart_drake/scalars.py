"""Types of scenario values: a number is a number, never a text or a truth value that looks like one."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import Strict

Real = Annotated[float, Strict()]
"""A real number; an integer will do."""
Count = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Vector3 = tuple[Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
"""roll, pitch, yaw, X, Y, Z."""

SECTION: Any = {"extra": "forbid", "allow_inf_nan": False, "use_attribute_docstrings": True}
"""How pydantic reads a plain dataclass as a section of a scenario; its docstrings become the schema's descriptions."""


def is_finite(value: Any) -> bool:
    """Whether a value is a finite number; a truth value or a text that looks like one is none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
