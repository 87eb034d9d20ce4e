"""Numbers by name in the Context of a LeafSystem."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractValue
from pydrake.systems.framework import BasicVector, Context

from stewart_drake.base.arguments import checked
from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.keys import join_or

_COUNTS = ("ahead", "age", "half")
"""Fields of parts' records that are rows of their memory: compiled laws would write beside it."""


class WithParameters:
    """What a LeafSystem with records and arrays of float64 as numeric parameters inherits from."""

    def declare_parameters(self: Any, values: Mapping[str, np.ndarray], vector: Any = BasicVector) -> Any:
        """Declares what a Context begins with, by name, as one parameter of Drake's; `vector` is of its scalar.

        Returns a record () with all of them, which `read_parameters` fills.
        """
        kind = np.dtype([(name, value.dtype, value.shape) for name, value in values.items()])
        self._parameters_read = np.zeros((), kind)
        self._counts = [
            (name, count, value[count].copy())
            for name, value in values.items()
            for count in _COUNTS
            if count in (value.dtype.names or ())
        ]
        start = [np.ascontiguousarray(value).view(np.float64).ravel() for value in values.values()]
        self._parameter_index = self.DeclareNumericParameter(vector(np.concatenate(start))) if start else None
        self._parameters_flat = np.ndarray(kind.itemsize // 8, np.float64, self._parameters_read)
        return self._parameters_read

    @checked
    def parameter(self: Any, context: Context, name: str) -> np.ndarray:
        """A parameter, a record (1,) or an array, as a view to be read and written; `context` of the Diagram."""
        if name not in (names := self._parameters_read.dtype.names or ()):
            raise ConfigurationError("parameter", name, join_or(names) or "nothing: this system has none")
        with drake_guard("finding a parameter"):
            vector = self.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(self._parameter_index)
            parameter: np.ndarray = np.ndarray((), self._parameters_read.dtype, vector.get_mutable_value())[name]
        return parameter

    def read_parameters(self: Any, context: Any) -> None:
        """Fills the record with what is in a Context of the system; without derivatives."""
        # A view that outlived its Context would keep Python's name for it, and pydrake give that to the next Context
        # at this address.
        if self._parameter_index is not None:
            vector = context.get_numeric_parameter(self._parameter_index)
            is_plain = isinstance(vector, BasicVector)
            self._parameters_flat[:] = vector.value() if is_plain else ExtractValue(vector.CopyToVector()).ravel()
            for name, count, as_built in self._counts:
                if (given := self._parameters_read[name][count]) != as_built:
                    raise ConfigurationError(
                        f"{name}.{count}", given[0], f"{as_built[0]:g}, which its part is built for"
                    )
