"""Types of scenario values: a number is a number, never a text or a truth value that looks like one."""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np
from pydantic import Field, Strict

Real = Annotated[float, Strict()]
"""A real number; an integer will do."""
Count = Annotated[int, Strict()]

# The same with bounds for editors, by way of the JSON schema; what refuses a value is the section's own check.
Positive = Annotated[float, Strict(), Field(json_schema_extra={"exclusiveMinimum": 0.0})]
NotNegative = Annotated[float, Strict(), Field(json_schema_extra={"minimum": 0.0})]
Fraction = Annotated[float, Strict(), Field(json_schema_extra={"exclusiveMinimum": 0.0, "exclusiveMaximum": 1.0})]
Share = Annotated[float, Strict(), Field(json_schema_extra={"minimum": 0.0, "maximum": 1.0})]
Leg = Annotated[int, Strict(), Field(json_schema_extra={"minimum": 0, "maximum": 5})]
Natural = Annotated[int, Strict(), Field(json_schema_extra={"minimum": 0})]
Flag = Annotated[bool, Strict()]
Vector3 = tuple[Real, Real, Real]
Vector6 = tuple[Real, Real, Real, Real, Real, Real]
"""roll, pitch, yaw, X, Y, Z."""

SECTION: Any = {"extra": "forbid", "allow_inf_nan": False, "use_attribute_docstrings": True}
"""How pydantic reads a plain dataclass as a section of a scenario; its docstrings become the schema's descriptions."""


def plain(value: Any) -> Any:
    """Numpy's numbers as Python's, and lists and arrays of one axis as tuples; anything else as it is."""
    if isinstance(value, (np.floating, np.integer)):
        return value.item()
    if isinstance(value, list) or (isinstance(value, np.ndarray) and value.ndim == 1):
        return tuple(plain(x) for x in value)
    return value


def is_finite(value: Any) -> bool:
    """Whether a value is a finite number; a truth value or a text that looks like one is none."""
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False
