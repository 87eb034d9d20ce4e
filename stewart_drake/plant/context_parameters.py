"""Numbers by name in the Context of a LeafSystem."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractValue
from pydrake.systems.framework import BasicVector, Context

from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.keys import join_or


class WithParameters:
    """What a LeafSystem with records and arrays of float64 as numeric parameters inherits from."""

    def declare_parameters(self: Any, values: Mapping[str, np.ndarray], vector: Any = BasicVector) -> None:
        """Declares what a Context begins with, by name, as one parameter of Drake's; `vector` is of its scalar."""
        self._parameter_kind = np.dtype([(name, value.dtype, value.shape) for name, value in values.items()])
        start = [np.ascontiguousarray(value).view(np.float64).ravel() for value in values.values()]
        self._parameter_index = self.DeclareNumericParameter(vector(np.concatenate([*start, np.empty(0)])))

    def parameter(self: Any, context: Context, name: str) -> np.ndarray:
        """A parameter, a record (1,) or an array, as a view to be read and written; `context` of the Diagram."""
        if name not in (names := self._parameter_kind.names or ()):
            raise ConfigurationError("parameter", name, join_or(names) or "nothing: this system has none")
        with drake_guard("finding a parameter"):
            vector = self.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(self._parameter_index)
            parameter: np.ndarray = np.ndarray((), self._parameter_kind, vector.get_mutable_value())[name]
        return parameter

    def read_parameters(self: Any, context: Any) -> Any:
        """All parameters, a record (), without derivatives; `context` of the system."""
        # A copy: who kept a view would keep Python's name for a Context that may be gone, and pydrake give it to the
        # next Context at that address.
        numbers = context.get_numeric_parameter(self._parameter_index).CopyToVector()
        return np.ndarray(
            (), self._parameter_kind, numbers if numbers.dtype == float else ExtractValue(numbers).ravel()
        )
