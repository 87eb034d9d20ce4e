"""A sweep as typed YAML: a scenario, what is fixed in it, what its other keys are drawn from; its table."""

from __future__ import annotations

import hashlib
import math
from abc import abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field

from stewart_drake.config import Count, Flag, Positive, Real, Section, Seed, Text, check_plain, shown
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import Family, refuse_given
from stewart_drake.files.whole import plain_json
from stewart_drake.logs.metrics import Column, ValueKind
from stewart_drake.logs.metrics import columns as run_columns
from stewart_drake.logs.outcomes import told
from stewart_drake.scenario import split_key, value_at
from stewart_drake.studies.runs import Row, Task
from stewart_drake.studies.study import INCIDENTAL, Study, StudyFile, StudyName, Tables, load_study, vary, within

BEFORE = (
    Column("index", "", "number of the run, from 0", "whole"),
    Column("seed", "", "seed of the run's random values", "whole"),
)


class _Distribution(Section):
    kind: str
    factor: Flag = False
    """Whether the drawn number multiplies the scenario's value instead of replacing it; all components of a list."""

    @abstractmethod
    def at(self, quantile: float) -> Any:
        """The value below which the share `quantile`, from 0 to below 1, of the distribution lies."""


class _Between(_Distribution):
    kind: str
    low: Real
    high: Real

    def rules(self) -> None:
        if not self.low < self.high:
            raise ConfigurationError("high", self.high, f"more than low, {self.low:g}")


class Uniform(_Between):
    """Uniform from `low` to `high`."""

    kind: Literal["uniform"] = "uniform"

    def at(self, quantile: float) -> float:
        return self.low + quantile * (self.high - self.low)


class LogUniform(_Between):
    """Uniform in the logarithm, from `low` to `high`, both positive."""

    kind: Literal["loguniform"] = "loguniform"
    low: Positive

    def at(self, quantile: float) -> float:
        return math.exp(math.log(self.low) + quantile * (math.log(self.high) - math.log(self.low)))


class Normal(_Distribution):
    """Normal distribution, truncated at `low` and `high` where they are given."""

    kind: Literal["normal"] = "normal"
    mean: Real
    std: Positive
    low: Real | None = None
    high: Real | None = None

    def rules(self) -> None:
        low, high = self._scores
        if not low < high:
            raise ConfigurationError("high", self.high, f"more than low, {self.low:g}")

    def at(self, quantile: float) -> float:
        from scipy.stats import truncnorm

        # Below 2^-53 there are no quantiles but 0, which is infinitely far.
        return self.mean + self.std * float(truncnorm.ppf(max(quantile, 2.0**-54), *self._scores))

    @property
    def _scores(self) -> tuple[float, float]:
        low = -math.inf if self.low is None else (self.low - self.mean) / self.std
        return low, math.inf if self.high is None else (self.high - self.mean) / self.std


class Integers(_Between):
    """Whole numbers from `low` to `high`, both included, equally likely."""

    kind: Literal["integers"] = "integers"
    low: Count
    high: Count

    def at(self, quantile: float) -> int:
        return self.low + int(quantile * (self.high - self.low + 1))


class Choice(_Distribution):
    """One of `values`, equally likely: numbers, texts, truth values, lists, sections."""

    kind: Literal["choice"] = "choice"
    values: Annotated[tuple[Any, ...], Field(min_length=1, max_length=100_000)]

    def rules(self) -> None:
        check_plain("values", self.values)
        if self.factor and not all(
            isinstance(each, (int, float)) and not isinstance(each, bool) for each in self.values
        ):
            raise ConfigurationError("values", self.values, "numbers, to multiply by")

    def at(self, quantile: float) -> Any:
        return self.values[int(quantile * len(self.values))]


class Grid(Choice):
    """Each of `values` in turn; several grids of a sweep run through all their combinations, the first key fastest."""

    kind: Literal["grid"] = "grid"  # type: ignore[assignment]


Distribution = Uniform | LogUniform | Normal | Integers | Choice | Grid
DISTRIBUTIONS = Family({each.__pydantic_fields__["kind"].default: each for each in get_args(Distribution)})


class SweepFile(StudyFile):
    """Keys of a sweep file."""

    name: StudyName = "sweep"
    runs: Annotated[Count, Field(ge=1, le=1_000_000)] | None = None
    """Number of runs; null takes as many as the grids have combinations. Run i does not depend on this number."""
    seed: Seed = 0
    """Seed of everything random."""
    mismatch: Flag = False
    """Whether the controller keeps the scenario's robot as its model while `robot.*` varies: `model_robot` becomes that
    robot, where the scenario has none of its own."""
    distributions: dict[Text, Annotated[Distribution, DISTRIBUTIONS]]
    """Scenario key -> distribution. A component of a list is `initial_offset[0]`, or `disturbances[0].wrench[3]`."""

    def rules(self) -> None:
        if not self.distributions:
            raise ConfigurationError("distributions", {}, "at least one scenario key with its distribution")


@dataclass(frozen=True, eq=False)
class Sweep(Study):
    """A scenario and its distributions; the draws for run i follow from `seed`, i and the key alone."""

    file: SweepFile
    kind = "sweep"

    def __post_init__(self) -> None:
        refuse_given(self.base)
        for key, distribution in self.file.distributions.items():
            self._check(key, distribution)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: Path | None = None) -> Sweep:
        file, base = SweepFile.read("sweep", data, folder)
        if file.mismatch and base.model_robot is None:
            base = base.replace({"model_robot": base.to_dict()["robot"]})
        runs = file.runs
        if runs is None:
            grids = [len(each.values) for each in file.distributions.values() if isinstance(each, Grid)]
            if not grids:
                raise ConfigurationError("runs", None, "a number of runs; optional only where a key has a grid")
            runs = math.prod(grids)
        return cls(base, file, name=file.name, indices=range(runs))

    def run_seed(self, index: int) -> int:
        state = np.random.SeedSequence(self.file.seed, spawn_key=(index,)).generate_state(1, np.uint64)
        return int(state[0] >> np.uint64(1))

    def draw(self, index: int) -> dict[str, Any]:
        seed, turn = self.run_seed(index), index
        values: dict[str, Any] = {}
        for key, distribution in self.file.distributions.items():
            if isinstance(distribution, Grid):
                turn, place = divmod(turn, len(distribution.values))
                values[key] = distribution.values[place]
            else:
                # Random numbers of one key in one run: another key in the sweep changes nothing about them.
                words = np.frombuffer(hashlib.sha256(key.encode()).digest()[:8], np.uint32).tolist()
                rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(words)))
                values[key] = distribution.at(rng.random())
        return values

    def task(self, index: int) -> Task:
        drawn = self.draw(index)
        return self._task(index, self._changes(drawn), self.run_seed(index), drawn=drawn)

    def _changes(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        factors = self.file.distributions
        return {
            key: (np.array(self._values[key]) * value).tolist() if factors[key].factor else value
            for key, value in drawn.items()
        }

    def tables(self, rows: Sequence[Row]) -> Tables:
        factors = [key for key, distribution in self.file.distributions.items() if distribution.factor]
        varied: list[Column] = []
        for key, distribution in self.file.distributions.items():
            kind = column_of(distribution)
            if key in factors:
                varied.append(Column(f"{key}.factor", "1", f"factor on the scenario's {key}", kind))
                kind = "json" if isinstance(self._values[key], list) else "number"
            text = f"scenario key {key} as run{', as JSON' if kind == 'json' else ''}"
            varied.append(Column(key, "", text, kind))
        wide = []
        for row in rows:
            drawn = {f"{key}.factor": row["values"][key] for key in factors}
            # A factor can take a number out of floating point; its row is one of a run that was rejected.
            wide.append({**plain_json({**self._changes(row["values"]), **drawn}), **row})
        return {"sweep": ((*BEFORE, *varied, *run_columns(self.base), *INCIDENTAL), wide)}

    @property
    def work(self) -> dict[str, Any]:
        """Not how many runs there are, nor a name."""
        scenario = {key: value for key, value in self.base.to_dict().items() if key != "name"}
        distributions = {key: each.to_dict() for key, each in self.file.distributions.items()}
        return {"scenario": scenario, "seed": self.file.seed, "distributions": distributions}

    @cached_property
    def _values(self) -> dict[str, Any]:
        data = self.base.in_full()
        with within("distributions."):
            return {key: value_at(data, key) for key in self.file.distributions}

    def _check(self, key: str, distribution: Distribution) -> None:
        """Refuses a distribution whose middle does not suit the key; other values that do not are rows of the table."""
        current, where = self._values[key], f"distributions.{shown(key)}"
        if isinstance(current, list) and not distribution.factor and not isinstance(distribution, Choice):
            raise ConfigurationError(where, key, f"a component such as {key}[0], or factor: true, or the kind choice")
        try:
            vary(self.base, self._changes({key: distribution.at(0.5)}))
        except TypeError:
            raise ConfigurationError(where, current, "a key with a number or numbers, to multiply") from None
        except ConfigurationError as error:
            path = ".".join(map(str, split_key(key)))
            if error.key == path or error.key.startswith(f"{path}."):
                raise ConfigurationError(where, error.value, error.allowed) from None


def load_sweep(path: str | Path, runs: int | None = None) -> Sweep:
    more = {} if runs is None else {"runs": runs}
    return load_study("sweep", path, lambda data, folder: Sweep.from_dict({**data, **more}, folder))


def summary(rows: Sequence[Row]) -> list[tuple[str, str]]:
    counts = Counter((row["status"], row["reason"]) for row in rows)
    lines = [("runs", str(len(rows)))]
    for (status, reason), count in sorted(counts.items(), key=lambda item: (item[0][0] != "completed", -item[1])):
        lines.append((told(status, reason), str(count)))
    for unit, of in (("deg", "rotation"), ("mm", "position")):
        values = [value for row in rows if (value := row.get(f"rmse_norm_{unit}")) is not None]
        if values:
            shares = "  ".join(f"{value:.4g}" for value in np.percentile(values, [50, 95, 99, 100]))
            lines.append((f"RMSE of {of}, percentiles 50 95 99, largest", f"{shares} {unit}"))
    return lines


def column_of(distribution: Distribution) -> ValueKind:
    """What a column must be to hold the values of a distribution as they are."""
    values = distribution.values if isinstance(distribution, Choice) else [distribution.at(0.5)]
    types = {type(value) for value in values}
    kinds: dict[ValueKind, set[type]] = {"flag": {bool}, "whole": {int}, "number": {int, float}, "text": {str}}
    return next((kind for kind, fitting in kinds.items() if types <= fitting), "json")
