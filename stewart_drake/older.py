"""Keys of older scenario files as this version has them; older names of kinds stand in `registry`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from stewart_drake.errors import ConfigurationError, OlderFileWarning


def compiled_moved(data: dict[str, Any]) -> dict[str, Any]:
    """`controller.compiled` of older files as the scenario's own key."""
    controller = data.get("controller")
    if isinstance(controller, Mapping) and "compiled" in controller:
        warn_of_compiled()
        older = controller["compiled"]
        if data.get("compiled", older) != older:
            allowed = f"{data['compiled']}, as the scenario's own key `compiled` says, or no such key"
            raise ConfigurationError("controller.compiled", older, allowed)
        data = {**data, "compiled": older}
        data["controller"] = {key: value for key, value in controller.items() if key != "compiled"}
    return data


def warn_of_compiled() -> None:
    """Says that the key `controller.compiled` has moved."""
    moved = "controller.compiled is the scenario's own key `compiled` now"
    warnings.warn(moved, OlderFileWarning, stacklevel=4)
