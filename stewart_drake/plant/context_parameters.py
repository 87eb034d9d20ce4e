"""Numbers by name in the Context of a LeafSystem."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.keys import join_or


class ContextParameters:
    """Records and arrays of float64 as one numeric parameter of Drake's; with AutoDiff their derivatives are none.

    Args:
        system: Under construction.
        values: What a Context begins with, by name.
        vector: `BasicVector` of the system's scalar.
    """

    def __init__(self, system: Any, values: Mapping[str, np.ndarray], vector: Any = BasicVector) -> None:
        self._kind = np.dtype([(name, value.dtype, value.shape) for name, value in values.items()])
        start = [np.ascontiguousarray(value).view(np.float64).ravel() for value in values.values()]
        self._index = system.DeclareNumericParameter(vector(np.concatenate(start))) if start else None

    def read(self, context: Any) -> np.ndarray | None:
        """All of them, a record (), in the Context of the system; not to be written to."""
        if self._index is None:
            return None
        vector = context.get_numeric_parameter(self._index)
        is_plain = isinstance(vector, BasicVector)
        numbers = vector.get_mutable_value() if is_plain else ExtractValue(vector.CopyToVector()).ravel()
        return np.ndarray((), self._kind, numbers)

    def view(self, system: LeafSystem, context: Context, name: str) -> np.ndarray:
        """One of them, to be read and written; `context` of the Diagram."""
        if name not in (names := self._kind.names or ()):
            raise ConfigurationError("parameter", name, join_or(names) or "no name; this system has no parameters")
        with drake_guard("finding a parameter"):
            mine = system.GetMyMutableContextFromRoot(context)
            numbers = mine.get_mutable_numeric_parameter(self._index).get_mutable_value()
        parameter: np.ndarray = np.ndarray((), self._kind, numbers)[name]
        return parameter
