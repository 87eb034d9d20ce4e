"""Numeric parameters by name in the Context of a LeafSystem."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pydrake.autodiffutils import ExtractValue
from pydrake.systems.framework import BasicVector, Context

from stewart_drake.base.arguments import checked
from stewart_drake.base.errors import ConfigurationError, drake_guard
from stewart_drake.base.keys import join_or

_COUNTS = ("ahead", "age", "half")
"""Fields that count rows of a part's memory; another number would let a compiled law write outside of it."""


def _counts(kind: np.dtype, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Paths of the fields in `_COUNTS`, in nested records too."""
    for name in kind.names or ():
        if name in _COUNTS:
            yield (*path, name)
        yield from _counts(kind[name].base, (*path, name))


def _field(values: Mapping[str, np.ndarray] | np.ndarray, path: tuple[str, ...]) -> np.ndarray:
    found = values[path[0]]
    for name in path[1:]:
        found = found[name]
    return np.asarray(found)


class WithParameters:
    """Base of a LeafSystem whose numeric parameters are records and arrays of float64."""

    def declare_parameters(self: Any, values: Mapping[str, np.ndarray], vector: Any = BasicVector) -> Any:
        """Declares parameters with their defaults as one numeric parameter of Drake, a `vector` of its scalar type.

        Returns a structured array () with all of them, which `read_parameters` fills.
        """
        kind = np.dtype([(name, value.dtype, value.shape) for name, value in values.items()])
        self._parameters_read = np.zeros((), kind)
        read, first = self._parameters_read, values
        self._counts = [(".".join(path), _field(read, path), _field(first, path).copy()) for path in _counts(kind)]
        start = [np.ascontiguousarray(value).view(np.float64).ravel() for value in values.values()]
        self._parameter_index = self.DeclareNumericParameter(vector(np.concatenate(start))) if start else None
        self._parameters_flat = np.ndarray(kind.itemsize // 8, np.float64, self._parameters_read)
        return self._parameters_read

    @checked
    def parameter(self: Any, context: Context, name: str) -> np.ndarray:
        """A parameter, a record (1,) or an array, as a view to read and write; `context` of the Diagram."""
        if name not in (names := self._parameters_read.dtype.names or ()):
            raise ConfigurationError("parameter", name, join_or(names) or "nothing: this system has none")
        with drake_guard("finding a parameter"):
            vector = self.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(self._parameter_index)
            return np.asarray(np.ndarray((), self._parameters_read.dtype, vector.get_mutable_value())[name])

    def read_parameters(self: Any, context: Any) -> None:
        """Fills the record with the values in a Context of the system; without derivatives."""
        # A copy: pydrake would give the Python object of a view that outlives its Context to the next Context at this
        # address.
        if self._parameter_index is not None:
            vector = context.get_numeric_parameter(self._parameter_index)
            is_plain = isinstance(vector, BasicVector)
            self._parameters_flat[:] = vector.value() if is_plain else ExtractValue(vector.CopyToVector()).ravel()
            for path, value, as_built in self._counts:
                if value != as_built:
                    raise ConfigurationError(path, value[0], f"{as_built[0]:g}, which its part is built for")
