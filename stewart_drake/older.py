"""Keys of older scenario files; older names of kinds stand in `registry`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from stewart_drake.errors import OlderFileWarning


def without_compiled(data: dict[str, Any]) -> dict[str, Any]:
    """A scenario without the key `compiled`, which has no effect any more, of its own or of its controller."""
    controller = data.get("controller")
    if isinstance(controller, Mapping) and "compiled" in controller:
        warn_of_compiled()
        data = {**data, "controller": {key: value for key, value in controller.items() if key != "compiled"}}
    if "compiled" in data:
        warn_of_compiled()
        data = {key: value for key, value in data.items() if key != "compiled"}
    return data


def warn_of_compiled() -> None:
    """Says that the key has no effect."""
    message = "the key `compiled` has no effect: everything is compiled; remove it"
    warnings.warn(message, OlderFileWarning, stacklevel=4)
