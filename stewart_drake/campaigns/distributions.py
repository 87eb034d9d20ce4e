"""What a key of a scenario is drawn from: inverse distribution functions, pure."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from stewart_drake.errors import ConfigurationError
from stewart_drake.families import Family
from stewart_drake.logs.metric_table import ValueKind
from stewart_drake.section import Count, Flag, Positive, Real, Section, check_plain

LARGEST = 1e100
"""Bounds beyond this are slips of the pen; differences of them could leave floating point."""
LEAST_PROBABILITY = 1e-9
"""A truncated normal that keeps less of its bell than this is one too."""
_LOWEST = 2.0**-54

Bound = Annotated[Real, Field(ge=-LARGEST, le=LARGEST)]
Whole = Annotated[Count, Field(ge=-(2**53), le=2**53)]


class _Distribution(Section):
    kind: str
    factor: Flag = False
    """The number drawn multiplies the value of the key in the scenario instead of replacing it; all of its components
    where it is a list."""

    column: ClassVar[ValueKind] = "number"

    @abstractmethod
    def at(self, quantile: float) -> Any:
        """The value below which the share `quantile`, 0 to 1, of the distribution lies."""


class _Between(_Distribution):
    kind: str
    low: Bound
    high: Bound

    def rules(self) -> None:
        _check_order(self.low, self.high)


class Uniform(_Between):
    """Uniform from `low` to `high`."""

    kind: Literal["uniform"] = "uniform"

    def at(self, quantile: float) -> float:
        """See `_Distribution.at`."""
        return min(self.low + quantile * (self.high - self.low), self.high)


class LogUniform(_Between):
    """Uniform in the logarithm, from `low` to `high`, both positive."""

    kind: Literal["loguniform"] = "loguniform"
    low: Annotated[Positive, Field(le=LARGEST)]

    def at(self, quantile: float) -> float:
        """See `_Distribution.at`."""
        value = math.exp(math.log(self.low) + quantile * (math.log(self.high) - math.log(self.low)))
        return min(max(value, self.low), self.high)


class Normal(_Distribution):
    """Normal, cut off at `low` and `high` where they are given."""

    kind: Literal["normal"] = "normal"
    mean: Bound
    std: Annotated[Positive, Field(le=LARGEST)]
    low: Bound | None = None
    high: Bound | None = None

    def rules(self) -> None:
        """See `Section.rules`."""
        if self.low is not None and self.high is not None:
            _check_order(self.low, self.high)
        from scipy.special import ndtr

        low, high = self._scores
        # In the upper tail the bell's share below rounds off to 1: then that of its mirror image.
        kept = ndtr(-low) - ndtr(-high) if low > 0.0 else ndtr(high) - ndtr(low)
        if kept < LEAST_PROBABILITY:
            raise ConfigurationError(
                "low", [self.low, self.high], f"bounds that keep at least {LEAST_PROBABILITY:g} of the distribution"
            )

    def at(self, quantile: float) -> float:
        """See `_Distribution.at`."""
        from scipy.stats import truncnorm

        value = self.mean + self.std * float(truncnorm.ppf(max(quantile, _LOWEST), *self._scores))
        value = value if self.low is None else max(value, self.low)
        return value if self.high is None else min(value, self.high)

    @property
    def _scores(self) -> tuple[float, float]:
        """Bounds in standard deviations from the mean."""
        low, high = (None if bound is None else (bound - self.mean) / self.std for bound in (self.low, self.high))
        return -math.inf if low is None else low, math.inf if high is None else high


class Integers(_Between):
    """Whole numbers from `low` to `high`, both included, equally often."""

    kind: Literal["integers"] = "integers"
    low: Whole
    high: Whole

    column: ClassVar[ValueKind] = "whole"

    def at(self, quantile: float) -> int:
        """See `_Distribution.at`."""
        return min(self.low + int(quantile * (self.high - self.low + 1)), self.high)


class Choice(_Distribution):
    """One of `values`, equally often: numbers, texts, truth values, lists, sections."""

    kind: Literal["choice"] = "choice"
    values: Annotated[tuple[Any, ...], Field(min_length=1, max_length=100_000)]

    def rules(self) -> None:
        """See `Section.rules`."""
        check_plain("values", self.values)
        if self.factor and not all(is_number(value) for value in self.values):
            raise ConfigurationError("values", self.values, "numbers, to multiply by")

    def at(self, quantile: float) -> Any:
        """See `_Distribution.at`."""
        return self.values[min(int(quantile * len(self.values)), len(self.values) - 1)]


class Grid(Choice):
    """Each of `values` in turn; several grids of a sweep run through all their combinations, the first key fastest."""

    kind: Literal["grid"] = "grid"  # type: ignore[assignment]


Distribution = Uniform | LogUniform | Normal | Integers | Choice | Grid
DISTRIBUTIONS = Family(
    {
        "uniform": Uniform,
        "loguniform": LogUniform,
        "normal": Normal,
        "integers": Integers,
        "choice": Choice,
        "grid": Grid,
    }
)


def column_of(distribution: Distribution) -> ValueKind:
    """What a column must be to hold the values of a distribution as they are."""
    if not isinstance(distribution, Choice):
        return distribution.column
    values = distribution.values
    if all(isinstance(value, bool) for value in values):
        return "flag"
    if all(isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63 for value in values):
        return "whole"
    if all(is_number(value) for value in values):
        return "number"
    return "text" if all(isinstance(value, str) for value in values) else "json"


def _check_order(low: float, high: float) -> None:
    if not low < high:
        raise ConfigurationError("high", high, f"more than low, {low:g}")


def is_number(value: Any) -> bool:
    """Whether a value is a number, and no truth value."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
