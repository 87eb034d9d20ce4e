"""Units behind numbers in texts: `30 deg`, `300 mm`, `1.5 Hz`; and what was perhaps meant without one."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from stewart_drake.base.errors import ConfigurationError

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
"""What may stand behind a number in a text, as in `30 deg` -> the unit that it is a multiple of, and its size."""
_TEXT = r"^[-+.\d]+ *[A-Za-z°]"
_MEASURE = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z°][\w/^ ]*?)\s*")


def in_unit(value: Any, key: str, units: str, place: tuple[int, int] = (0, 1)) -> Any:
    """A text such as `30 deg` as a number of the field's unit, in lists too; what is no such text stays.

    Of several units, `rad, m`, the first ones are for the first numbers of a list; `place` is the index and the length.
    """
    if isinstance(value, (list, tuple)) and units:
        return tuple(in_unit(each, key, units, (index, len(value))) for index, each in enumerate(value))
    match = _MEASURE.fullmatch(value) if isinstance(value, str) and units else None
    if match is None:
        return value
    several = units.split(", ")
    unit = several[place[0] * len(several) // place[1]]
    base, size = UNITS.get(unit, (unit, 1.0))
    of, factor = UNITS.get(match[2], ("", 0.0))
    if (of, base) == ("Hz", "rad/s"):
        of, factor = base, math.tau * factor
    if of != base or not factor:
        bases = ("rad/s", "Hz") if base == "rad/s" else (base,)
        fitting = [name for name, (each, _) in UNITS.items() if each in bases]
        allowed = f"a number [{unit}]" + (f", or one with {', '.join(fitting)} behind it" if fitting else "")
        raise ConfigurationError(key, value, allowed + _reciprocal(match[1], match[2], base))
    return float(match[1]) * factor / size


def _reciprocal(number: str, name: str, wanted: str) -> str:
    """What a period is as a frequency, and the other way round."""
    unit, size = UNITS.get(name, ("", 1.0))
    if float(number) == 0.0 or (unit, wanted) not in (("s", "Hz"), ("s", "rad/s"), ("Hz", "s")):
        return ""
    inverse = 1.0 / (float(number) * size)
    if unit == "s":
        return f" (a period of {number} {name} is {inverse:g} Hz)"
    return f" ({number} {name} is a period of {inverse:g} s)"


def or_text(schema: Any) -> Any:
    """A JSON schema in which a text with a unit may stand for each number."""
    if isinstance(schema, list):
        return [or_text(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    changed = {key: or_text(each) for key, each in schema.items()}
    return {**changed, "type": ["number", "string"], "pattern": _TEXT} if changed.get("type") == "number" else changed


def smaller_unit(value: Any, unit: str, fits: Callable[[float], bool]) -> str:
    """`; did you mean 5 ms?` for a number that fits in a smaller unit."""
    base, size = UNITS.get(unit, ("", 1.0))
    for name, (of, factor) in UNITS.items():
        smaller = of == base and factor < size and name != "cm" and isinstance(value, (int, float))
        if smaller and fits(value * factor / size):
            return f"; did you mean {value:g} {name}?"
    return ""
