"""Numbers with units as texts, such as `30 deg` or `1.5 Hz`, and hints for wrong units."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

UNITS: Mapping[str, tuple[str, float]] = {
    **{"rad": ("rad", 1.0), "deg": ("rad", math.radians(1.0)), "°": ("rad", math.radians(1.0)), "mrad": ("rad", 1e-3)},
    **{"m": ("m", 1.0), "cm": ("m", 1e-2), "mm": ("m", 1e-3), "um": ("m", 1e-6)},
    **{"s": ("s", 1.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "min": ("s", 60.0)},
    **{"rad/s": ("rad/s", 1.0), "deg/s": ("rad/s", math.radians(1.0)), "rpm": ("rad/s", math.tau / 60.0)},
    **{"A": ("A", 1.0), "mA": ("A", 1e-3)},
    **{"Hz": ("Hz", 1.0), "kHz": ("Hz", 1e3), "N": ("N", 1.0), "kg": ("kg", 1.0), "g": ("kg", 1e-3)},
    **{"N m": ("N m", 1.0), "Nm": ("N m", 1.0), "mN m": ("N m", 1e-3), "mNm": ("N m", 1e-3)},
    **{"m/s": ("m/s", 1.0), "mm/s": ("m/s", 1e-3), "m/s^2": ("m/s^2", 1.0), "mm/s^2": ("m/s^2", 1e-3)},
    **{"rad/s^2": ("rad/s^2", 1.0), "deg/s^2": ("rad/s^2", math.radians(1.0))},
    **{"kg m^2": ("kg m^2", 1.0), "g mm^2": ("kg m^2", 1e-9)},
}
"""Unit in a text -> its SI unit, and its size in that unit."""
_TEXT = r"^[-+.\d]+ *[A-Za-z°]"
_MEASURE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z°][\w/^ ]*?)\s*")


def in_unit(value: object, units: str, index: int = 0, length: int = 1) -> Any:
    """Converts a text such as `30 deg`, also in lists, to a number in the unit of a field; other values stay.

    Several units, `rad, m`, are for equal parts of a list, where `index` is a place.
    """
    if isinstance(value, (list, tuple)) and units:
        return tuple(in_unit(item, units, place, len(value)) for place, item in enumerate(value))
    several = units.split(", ")
    found = _measured(value, several[index * len(several) // length])
    return value if found is None or found.number is None else found.number


def wrong_unit(value: object, unit: str) -> str:
    """Allowed values for a text with a wrong unit, such as `3 mm` for seconds; empty for other values."""
    found = _measured(value, unit)
    if found is None or found.number is not None:
        return ""
    base, _ = UNITS.get(unit, (unit, 1.0))
    bases = ("rad/s", "Hz") if base == "rad/s" else (base,)
    fitting = [name for name, (of, _) in UNITS.items() if of in bases]
    allowed = f"a number [{unit}]" + (f", or one with {', '.join(fitting)} behind it" if fitting else "")
    return allowed + _reciprocal(found.written, found.unit, base)


class _Measured(NamedTuple):
    """A text such as `30 deg`."""

    written: str
    unit: str
    number: float | None  # In the unit of a field; None if the units do not fit.


def _measured(value: object, unit: str) -> _Measured | None:
    match = _MEASURE.fullmatch(value) if isinstance(value, str) and unit else None
    if match is None:
        return None
    base, size = UNITS.get(unit, (unit, 1.0))
    of, factor = UNITS.get(match[2], ("", 0.0))
    if (of, base) == ("Hz", "rad/s"):
        of, factor = base, math.tau * factor
    return _Measured(match[1], match[2], float(match[1]) * factor / size if of == base else None)


def _reciprocal(number: str, name: str, wanted: str) -> str:
    """Hint with a period as a frequency, or a frequency as a period."""
    unit, size = UNITS.get(name, ("", 1.0))
    if float(number) == 0.0 or (unit, wanted) not in (("s", "Hz"), ("s", "rad/s"), ("Hz", "s")):
        return ""
    inverse = 1.0 / (float(number) * size)
    if unit == "s":
        return f" (a period of {number} {name} is {inverse:g} Hz)"
    return f" ({number} {name} is a period of {inverse:g} s)"


def or_text(schema: object) -> object:
    """A JSON schema in which every number may also be a text with a unit."""
    if isinstance(schema, list):
        return [or_text(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    changed = {key: or_text(item) for key, item in schema.items()}
    return {**changed, "type": ["number", "string"], "pattern": _TEXT} if changed.get("type") == "number" else changed


def smaller_unit(value: object, unit: str, fits: Callable[[float], bool]) -> str:
    """`; did you mean 5 ms?` for a number that fits in a smaller unit."""
    base, size = UNITS.get(unit, ("", 1.0))
    for name, (of, factor) in UNITS.items():
        smaller = of == base and factor < size and name != "cm"
        if smaller and isinstance(value, (int, float)) and fits(value * factor / size):
            return f"; did you mean {value:g} {name}?"
    return ""
