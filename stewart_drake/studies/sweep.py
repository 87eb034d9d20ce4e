"""A sweep as typed YAML: a scenario, what is fixed in it, what its other keys are drawn from; its table."""

from __future__ import annotations

import hashlib
import math
from abc import abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
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
from stewart_drake.scenario import Scenario, split_key, value_at
from stewart_drake.studies.runs import Row, Task
from stewart_drake.studies.study import INCIDENTAL, Study, StudyFile, StudyName, Tables, load_study, vary, within

MAX_RUNS = 1_000_000
BEFORE = (
    Column("index", "", "number of the run, from 0", "whole"),
    Column("seed", "", "of the run; its draws follow from it", "whole"),
)
"""Columns before those of the varied keys."""


class _Distribution(Section):
    kind: str
    factor: Flag = False
    """The number drawn multiplies the value of the key in the scenario instead of replacing it; all of its components
    where it is a list."""

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
    """Normal, cut off at `low` and `high` where they are given."""

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
        """Bounds in standard deviations from the mean."""
        low = -math.inf if self.low is None else (self.low - self.mean) / self.std
        return low, math.inf if self.high is None else (self.high - self.mean) / self.std


class Integers(_Between):
    """Whole numbers from `low` to `high`, both included, equally often."""

    kind: Literal["integers"] = "integers"
    low: Count
    high: Count

    def at(self, quantile: float) -> int:
        return self.low + int(quantile * (self.high - self.low + 1))


class Choice(_Distribution):
    """One of `values`, equally often: numbers, texts, truth values, lists, sections."""

    kind: Literal["choice"] = "choice"
    values: Annotated[tuple[Any, ...], Field(min_length=1, max_length=100_000)]

    def rules(self) -> None:
        check_plain("values", self.values)
        if self.factor and not all(map(_is_number, self.values)):
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
    runs: Annotated[Count, Field(ge=1, le=MAX_RUNS)] | None = None
    """Number of runs; null takes as many as the grids have combinations. Run i stays the same when this changes."""
    seed: Seed = 0
    """Everything random follows from it."""
    sampler: Literal["random", "sobol"] = "random"
    """random: every key of every run drawn by itself. sobol: a scrambled Sobol sequence over all keys that are not
    grids, in their order; covers the space more evenly, and another key changes every run."""
    mismatch: Flag = False
    """The controller keeps believing in the robot of the scenario while `robot.*` varies: `model_robot` becomes that
    robot, where the scenario has none of its own."""
    distributions: dict[Text, Annotated[Distribution, DISTRIBUTIONS]]
    """Scenario key -> distribution. A component of a list is `initial_offset[0]`, or `disturbances[0].wrench[3]`."""

    def rules(self) -> None:
        if not self.distributions:
            raise ConfigurationError("distributions", {}, "at least one scenario key with its distribution")


@dataclass(frozen=True, eq=False)
class Sweep(Study):
    """A scenario and what its keys are drawn from.

    The draws for run i depend on `seed`, i and the key alone: not on how many runs there are, nor on other keys (with
    the sampler `sobol`: not on how many runs there are).
    """

    file: SweepFile
    kind = "sweep"

    def __post_init__(self) -> None:
        refuse_given(self.base)
        for key, current in self._bases.items():
            self._check(key, current)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], folder: Path | None = None) -> Sweep:
        """A sweep from plain values, see `SweepFile`; paths are relative to `folder`, None for the current one."""
        file, base = SweepFile.read("sweep", data, folder)
        if file.mismatch and base.model_robot is None:
            base = base.replace({"model_robot": base.to_dict()["robot"]})
        runs = file.runs
        if runs is None:
            grids = [each for each in file.distributions.values() if isinstance(each, Grid)]
            if not grids:
                raise ConfigurationError("runs", None, "a number of runs; it may be left out where a key has a grid")
            runs = math.prod(len(grid.values) for grid in grids)
            if runs > MAX_RUNS:
                raise ConfigurationError("distributions", f"{runs} combinations", f"grids of at most {MAX_RUNS}")
        return cls(base, file, name=file.name, indices=range(runs))

    def run_seed(self, index: int) -> int:
        """Seed of run `index`, below 2^63."""
        state = np.random.SeedSequence(self.file.seed, spawn_key=(index,)).generate_state(1, np.uint64)
        return int(state[0] >> np.uint64(1))

    def draw(self, index: int) -> dict[str, Any]:
        """Values of the varied keys in run `index`; for a factor, the factor."""
        seed, turn = self.run_seed(index), index
        values: dict[str, Any] = {}
        for key, distribution in self.file.distributions.items():
            if isinstance(distribution, Grid):
                turn, place = divmod(turn, len(distribution.values))
                values[key] = distribution.values[place]
            elif self.file.sampler == "sobol":
                values[key] = distribution.at(float(self._points[index, self._random.index(key)]))
            else:
                values[key] = distribution.at(_generator(seed, key).random())
        return values

    def task(self, index: int) -> Task:
        drawn = self.draw(index)
        return self._task(index, self._changes(drawn), self.run_seed(index), drawn=drawn)

    def _changes(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Scenario key -> value for what `draw` gave: factors multiplied out."""
        return {key: _times(self._bases[key], value) if key in self._factors else value for key, value in drawn.items()}

    @property
    def variants(self) -> list[Scenario]:
        found = [self.base]
        for key, distribution in self.file.distributions.items():
            if isinstance(distribution, Choice) and not distribution.factor:
                for value in (each for each in distribution.values if isinstance(each, (str, dict, list))):
                    with suppress(ConfigurationError):  # a row says so
                        found.append(self.vary({key: value}))
        return found

    def tables(self, rows: Sequence[Row]) -> Tables:
        """Of each varied key the value as run; of a factor, `KEY.factor`, the number drawn too."""
        varied: list[Column] = []
        for key, distribution in self.file.distributions.items():
            kind = column_of(distribution)
            if key in self._factors:
                varied.append(Column(f"{key}.factor", "1", f"what the scenario's {key} is multiplied by", kind))
                kind = "json" if isinstance(self._bases[key], list) else "number"
            text = f"scenario key {key} as run{', as JSON' if kind == 'json' else ''}"
            varied.append(Column(key, "", text, kind))
        wide = []
        for row in rows:
            factors = {f"{key}.factor": row["values"][key] for key in self._factors}
            # A factor can take a number out of floating point; its row is one of a run that was rejected.
            wide.append({**plain_json({**self._changes(row["values"]), **factors}), **row})
        return {"sweep": ((*BEFORE, *varied, *run_columns(self.base), *INCIDENTAL), wide)}

    @property
    def work(self) -> dict[str, Any]:
        """Not how many runs there are, nor a name."""
        scenario = {key: value for key, value in self.base.to_dict().items() if key != "name"}
        distributions = {key: each.to_dict() for key, each in self.file.distributions.items()}
        return {
            "scenario": scenario,
            "seed": self.file.seed,
            "sampler": self.file.sampler,
            "distributions": distributions,
        }

    @cached_property
    def _random(self) -> list[str]:
        return [key for key, distribution in self.file.distributions.items() if not isinstance(distribution, Grid)]

    @cached_property
    def _factors(self) -> list[str]:
        return [key for key, distribution in self.file.distributions.items() if distribution.factor]

    @cached_property
    def _bases(self) -> dict[str, Any]:
        """Values of the varied keys before the draws."""
        data = self.base.in_full()
        with within("distributions."):
            return {key: value_at(data, key) for key in self.file.distributions}

    @cached_property
    def _points(self) -> np.ndarray:
        """(runs, keys that are not grids) of the Sobol sequence."""
        from scipy.stats import qmc

        engine = qmc.Sobol(len(self._random), scramble=True, seed=np.random.default_rng(self.file.seed))
        # A power of two at a time, or scipy warns; the first rows are the same for any.
        return engine.random_base2(math.ceil(math.log2(self.runs)))[: self.runs]

    def _check(self, key: str, current: Any) -> None:
        """Refuses a distribution that cannot suit `key`, whose value in the scenario is `current`."""
        distribution, where = self.file.distributions[key], f"distributions.{shown(key)}"
        if distribution.factor:
            if not _numbers(current):
                raise ConfigurationError(where, current, "a key that holds a number or numbers, to multiply")
        elif isinstance(distribution, Choice):
            for value in distribution.values:
                self._check_value(key, current, value)
        elif isinstance(current, list):
            raise ConfigurationError(where, key, f"a component such as {key}[0], or factor: true, or the kind choice")
        elif current is not None and not _is_number(current):
            raise ConfigurationError(where, current, "a key that holds a number; kinds for others are choice and grid")
        elif isinstance(current, int) and column_of(distribution) != "whole":
            raise ConfigurationError(where, distribution.kind, "whole numbers, by the kinds integers, choice or grid")

    def _check_value(self, key: str, current: Any, value: Any) -> None:
        # A number out of range is a row of the table; a value of the wrong type is a slip of the pen.
        if _is_number(current) and type(current) is type(value):
            return
        try:
            vary(self.base, {key: value})
        except ConfigurationError as error:
            path = ".".join(map(str, split_key(key)))
            if error.key == path or error.key.startswith(f"{path}."):
                raise ConfigurationError(f"distributions.{shown(key)}", error.value, error.allowed) from None


def load_sweep(path: str | Path, runs: int | None = None, trust_code: bool = False) -> Sweep:
    """Reads a sweep file, or a sweep of the package by its name; `runs` in place of the number in it."""
    more = {} if runs is None else {"runs": runs}
    return load_study("sweep", path, lambda data, folder: Sweep.from_dict({**data, **more}, folder), trust_code)


def summary(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Counts by status and reason, percentiles of the errors: what and how much, as texts."""
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


def _generator(seed: int, key: str) -> np.random.Generator:
    """Random numbers of one key in one run: another key in the sweep changes nothing about them."""
    words = np.frombuffer(hashlib.sha256(key.encode()).digest()[:8], np.uint32)
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(int(word) for word in words)))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _numbers(value: Any) -> bool:
    return bool(value) and all(map(_numbers, value)) if isinstance(value, list) else _is_number(value)


def _times(value: Any, factor: float) -> Any:
    return [_times(item, factor) for item in value] if isinstance(value, list) else value * factor
