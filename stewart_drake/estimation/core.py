"""Common parts of calibration and identification: parameters, identifiability, estimates, reports, readings."""

from __future__ import annotations

import csv
import io
import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from scipy.linalg import null_space

from stewart_drake.base.errors import ConfigurationError, installed_with
from stewart_drake.base.markdown import markdown_table
from stewart_drake.base.tables import numbers_to_csv, read_numbers, refuse_cells
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.robot import RobotParameters

NORMAL_95 = 1.959964
_ROUNDING = 1e-9  # [-] of the largest singular value below which a direction is rounding.
_SHARE = 0.02  # [-] of its scale by which a parameter must change to be named in an unidentifiable direction.
_UNCERTAIN = 1e-3  # [-] of an unidentifiable direction beyond which a parameter has no interval.
_NAMED = 6  # Parameters in a sentence at most.


class Parameter(NamedTuple):
    """A parameter to estimate; `kind` is its name for `hold`."""

    kind: str
    part: str
    unit: str
    owner: str = ""

    def __str__(self) -> str:
        return " ".join(filter(None, (self.owner, self.kind, self.part)))

    @property
    def display(self) -> tuple[str, float]:
        """Unit in texts, and factor to it from SI."""
        if self.unit == "1":
            return "%", 1e2
        return {"m": ("mm", 1e3), "rad": ("deg", math.degrees(1.0))}.get(self.unit, (self.unit, 1.0))


def check_choices(key: str, given: Collection[str], allowed: Sequence[str]) -> None:
    if unknown := sorted(set(given) - set(allowed)):
        raise ConfigurationError(key, unknown[0], f"some of {', '.join(allowed)}")


def free_directions(
    parameters: Sequence[Parameter],
    kinds: Sequence[str],
    hold: Collection[str],
    known: Collection[str] = (),
    constraints: Sequence[np.ndarray] = (),
) -> np.ndarray:
    """Orthonormal directions (n, k), in scales, along which n parameters may change.

    Parameters of the kinds `hold` and `known` are fixed, and so are the directions (n,) in `constraints`.
    """
    check_choices("hold", hold, kinds)
    if set(kinds) <= set(hold):
        raise ConfigurationError("hold", sorted(hold), f"some of {', '.join(kinds)}, not all")
    identity = np.eye(len(parameters))
    fixed = [parameter.kind in {*hold, *known} for parameter in parameters]
    rows = np.concatenate([identity[fixed], *(row[None] for row in constraints)])
    return null_space(rows) if len(rows) else identity


class Unidentifiable(NamedTuple):
    """A parameter that the data do not determine; it keeps its value."""

    at: int  # Place of the parameter.
    deviation: float  # [-] standard deviation in scales; infinite for undetermined.
    direction: np.ndarray  # (n,) change of all parameters that the data do not show, per unit of this one.


def identifiable(
    slope: np.ndarray, free: np.ndarray, scales: np.ndarray, largest: float, preference: np.ndarray | float = 1.0
) -> tuple[np.ndarray, tuple[Unidentifiable, ...]]:
    """Free directions (n, k) that whitened errors with slopes (m, k) determine, and the parameters to fix for that.

    A direction is determined up to a standard deviation of `largest`. Parameters are fixed one by one, those with a
    large preference first, until only base parameters are left: M. Gautier, "Numerical calculation of the
    base inertial parameters of robots" (J. Robotic Systems 8, 1991).
    """
    # Padded with zeros: else directions would be lost where there are fewer rows.
    root = np.linalg.qr(np.pad(slope, ((0, max(0, slope.shape[1] - len(slope))), (0, 0))), mode="r")
    fixed: list[Unidentifiable] = []
    ways = np.eye(free.shape[1])
    while True:
        _, sigma, directions = np.linalg.svd(root @ ways)
        if len(directions) == 0 or sigma[-1] * largest >= 1.0:
            free = free @ ways
            free[[parameter.at for parameter in fixed]] = 0.0  # exactly
            return free, tuple(fixed)
        direction = free @ (ways @ directions[-1])
        at = int((np.abs(direction) * preference).argmax())
        deviation = np.inf if sigma[-1] <= _ROUNDING * sigma[0] else 1.0 / float(sigma[-1])
        fixed.append(Unidentifiable(at, deviation, direction / direction[at] * scales / scales[at]))
        ways = null_space(free[[parameter.at for parameter in fixed]])


def whitening(covariance: np.ndarray) -> np.ndarray:
    """W (..., n, n) with W'W the inverse of covariances (..., n, n): errors times it have covariance 1."""
    return np.linalg.inv(np.linalg.cholesky(covariance))


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated values of n parameters, and how well they are known.

    Attributes:
        parameters: Names of the values.
        scales: (n,) change of a parameter that counts as 1.
        values: (n,) in SI units.
        directions: (n, k) along which they were estimated.
        covariance: (k, k) along these.
        information: (k, k) along these, of the least squares.
        unidentifiable: Parameters that kept their values because the data do not determine them.
        quantile: Half width of a 95 % interval over the standard deviation.
    """

    parameters: Sequence[Parameter]
    scales: np.ndarray
    values: np.ndarray
    directions: np.ndarray
    covariance: np.ndarray
    information: np.ndarray
    unidentifiable: tuple[Unidentifiable, ...]
    quantile: float = NORMAL_95

    @property
    def half_width(self) -> np.ndarray:
        """(n,) of the 95 % intervals; 0 for what kept its value."""
        variance = np.einsum("ij,jk,ik->i", self.directions, self.covariance, self.directions)
        return self.quantile * np.sqrt(np.maximum(variance, 0.0))

    @property
    def undetermined(self) -> np.ndarray:
        """(n,) bool, parameters that the data do not determine, alone or in a combination."""
        shares = [np.abs(each.direction) * self.scales[each.at] / self.scales for each in self.unidentifiable]
        return np.asarray(np.max(shares, axis=0, initial=0.0) > _UNCERTAIN)

    def identifiable_part(self, change: np.ndarray) -> np.ndarray:
        """The change with the same effect on the data as a change (n,), without unidentifiable parameters."""
        for parameter in self.unidentifiable:
            change = change - change[parameter.at] * parameter.direction
        return change

    def unidentifiable_sentences(self) -> tuple[str, ...]:
        """Sentences on the parameters that the data do not determine: how uncertain, and what changes with them."""
        return tuple(self._sentence(parameter) for parameter in self.unidentifiable)

    def _sentence(self, of: Unidentifiable) -> str:
        parameter, sizes = self.parameters[of.at], np.abs(of.direction) * self.scales[of.at] / self.scales
        unit, factor = parameter.display
        others = [at for at in np.argsort(-sizes, kind="stable") if at != of.at and sizes[at] > _SHARE]
        amounts = [
            f"{self.parameters[at]} by {of.direction[at] * self.parameters[at].display[1] / factor:+.3g} "
            f"{self.parameters[at].display[0]}".strip()
            for at in others[:_NAMED]
        ]
        more = f" and {len(others) - _NAMED} more" if len(others) > _NAMED else ""
        uncertain = f"uncertain by {of.deviation * self.scales[of.at] * factor:.2g} {unit}".strip()
        how = uncertain if np.isfinite(of.deviation) else "undetermined"
        return f"{parameter} ({how}): with each {unit or 'unit'} more of it {', '.join(amounts) or 'nothing'}{more}"


class Result(ABC):
    """Base of results: an estimated robot that is shown, and written as tables, a page and a robot file."""

    columns: ClassVar[tuple[str, ...]]
    """Names of the columns of `rows`."""
    about: ClassVar[str]
    """A paragraph on the table."""
    picture: ClassVar[str]
    """What the report's picture shows."""

    @property
    @abstractmethod
    def title(self) -> str: ...

    @abstractmethod
    def rows(self) -> Sequence[tuple[object, ...]]:
        """A row of `columns` for each parameter, in SI units; the half width is that of the 95 % interval."""

    @abstractmethod
    def summary(self) -> list[tuple[str, str]]:
        """Name and text of each result."""

    @abstractmethod
    def table(self) -> tuple[list[str], list[list[str]]]:
        """Header and rows of texts: the parameters with their 95 % intervals."""

    @abstractmethod
    def robot_file(self) -> str:
        """The robot as YAML, below lines of comments."""

    def __repr__(self) -> str:
        return "\n".join([self.title, *(f"  {name}: {text}" for name, text in self.summary())])

    def to_csv(self) -> str:
        """`rows` as a table."""
        stream = io.StringIO()
        csv.writer(stream, lineterminator="\n").writerows([self.columns, *self.rows()])
        return stream.getvalue()

    def to_pandas(self) -> Any:
        """`rows` as a pandas.DataFrame; a `MissingPackageError` where pandas is not installed."""
        with installed_with("pandas", "rows() gives the same as tuples"):
            import pandas as pd

        return pd.DataFrame(self.rows(), columns=self.columns)

    def to_markdown(self, picture: str) -> str:
        """A page with a picture, a file beside it."""
        header, rows = self.table()
        summary = "\n".join(f"- {name}: {text}" for name, text in self.summary())
        table = markdown_table(header, rows)
        return f"# {self.title}\n\n{summary}\n\n{self.about}\n\n{table}\n\n![{self.picture}]({picture})\n"


def robot_yaml(about: str, comments: Sequence[str], robot: RobotParameters) -> str:
    return "".join(f"# {line}\n" for line in comments) + to_yaml({"about": about, **robot.to_dict()})


class Readings:
    """Base of frozen dataclasses with the columns of a table as arrays, and a `source` for messages."""

    quantities: ClassVar[tuple[tuple[str, str], ...]]
    """Columns of the table with their units."""
    columns: ClassVar[dict[str, slice | int]]
    """Array -> its columns."""
    largest: ClassVar[tuple[int, int]]
    """Bytes and rows of a file."""
    source: str

    @property
    def absent(self) -> np.ndarray:
        """(k,) bool, columns of the table that may be missing, and are."""
        return np.zeros(len(self.quantities), dtype=bool)

    def check(self) -> None:
        """Copies the arrays and makes them read-only; refuses wrong shapes and numbers that are not finite."""
        count = np.shape(getattr(self, next(iter(self.columns))))[:1]
        for name, column in self.columns.items():
            values = np.array(getattr(self, name), dtype=float)
            object.__setattr__(self, name, values)
            width = np.empty(len(self.quantities))[column].shape
            if values.shape != (*count, *width):
                shape = ", ".join(map(str, ("n", *width)))
                raise ConfigurationError(f"{self.source}: {name}", values.shape, f"numbers of shape ({shape})")
            values.flags.writeable = False
        self.refuse(~np.isfinite(self.table) & ~self.absent, "a finite number")

    def refuse(self, wrong: np.ndarray, allowed: str) -> None:
        """Raises a `ConfigurationError` for the first cell of the table that is `wrong`."""
        refuse_cells(self.source, self.quantities, self.table, wrong, allowed)

    @classmethod
    def of_table(cls, table: np.ndarray, source: str, **others: object) -> Self:
        """Readings of a table (n, k) with all columns."""
        arrays = {name: table[:, column] for name, column in cls.columns.items()}
        return cls(**{**arrays, "source": source, **others})

    @classmethod
    def of_file(cls, path: str | Path, source: str, **others: object) -> Self:
        """Readings of a .csv or .parquet file whose columns may have other units and any order."""
        return cls.of_table(read_numbers(path, source, cls.quantities, *cls.largest), source, **others)

    def __len__(self) -> int:
        return len(getattr(self, next(iter(self.columns))))

    @property
    def table(self) -> np.ndarray:
        """(n, k) all columns."""
        return np.column_stack([getattr(self, name) for name in self.columns])

    def to_csv(self) -> str:
        """The columns that are not absent."""
        there = np.flatnonzero(~self.absent)
        return numbers_to_csv([self.quantities[at] for at in there], self.table[:, there])
