"""A sweep: runs of a scenario whose keys are drawn from distributions or grids, and its table."""

from __future__ import annotations

import hashlib
import math
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import Field

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.config import Count, Flag, Positive, Real, Section, Seed, Text, check_plain, shorten
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import Family, given_keys
from stewart_drake.logs.metrics import Column, ValueKind
from stewart_drake.logs.metrics import columns as run_columns
from stewart_drake.logs.outcomes import describe_outcome
from stewart_drake.scenario.keys import split_key, unit_at, value_at
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.experiment import (
    INCIDENTAL,
    Experiment,
    Figures,
    StudyFile,
    StudyName,
    error_prefix,
    load_experiment,
    trial_of,
    with_changes,
)
from stewart_drake.studies.runs import Row, Trial

BEFORE = (
    Column("index", "", "number of the run, from 0", "integer"),
    Column("seed", "", "seed of the run's random values", "integer"),
)


class _Distribution(Section):
    kind: str
    factor: Flag = False
    """Whether the drawn number multiplies the scenario's value (all components of a list) instead of replacing it."""

    @abstractmethod
    def at(self, quantile: float) -> object:
        """The value at a quantile from 0 to below 1."""


class _Between(_Distribution):
    kind: str
    low: Real
    """The lowest value."""
    high: Real
    """The highest value."""

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
    """The lowest value."""

    def at(self, quantile: float) -> float:
        return math.exp(math.log(self.low) + quantile * (math.log(self.high) - math.log(self.low)))


class Normal(_Distribution):
    """Normal distribution, truncated at `low` and `high` if they are given."""

    kind: Literal["normal"] = "normal"
    mean: Real
    """The mean before truncation."""
    std: Positive
    """The standard deviation before truncation."""
    low: Real | None = None
    """The lowest value; null for none."""
    high: Real | None = None
    """The highest value; null for none."""

    def rules(self) -> None:
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise ConfigurationError("high", self.high, f"more than low, {self.low:g}")

    def at(self, quantile: float) -> float:
        from scipy.stats import truncnorm

        low = -math.inf if self.low is None else (self.low - self.mean) / self.std
        high = math.inf if self.high is None else (self.high - self.mean) / self.std
        # Quantile 0 is infinitely far; the next one is 2^-53.
        return self.mean + self.std * float(truncnorm.ppf(max(quantile, 2.0**-54), low, high))


class Integers(_Between):
    """Whole numbers from `low` to `high`, both included, equally likely."""

    kind: Literal["integers"] = "integers"
    low: Count
    """The lowest number."""
    high: Count
    """The highest number."""

    def at(self, quantile: float) -> int:
        return self.low + int(quantile * (self.high - self.low + 1))


class Choice(_Distribution):
    """One of `values`, equally likely: numbers, texts, truth values, lists, sections."""

    kind: Literal["choice"] = "choice"
    values: Annotated[tuple[Any, ...], Field(min_length=1, max_length=100_000)]
    """Numbers, also with a unit, texts, truth values, lists or sections."""

    def rules(self) -> None:
        check_plain("values", self.values)
        if self.factor and any(isinstance(item, bool) or not isinstance(item, (int, float)) for item in self.values):
            raise ConfigurationError("values", self.values, "numbers, to multiply by")

    def at(self, quantile: float) -> object:
        return self.values[int(quantile * len(self.values))]


class Grid(Choice):
    """All `values` in turn; several grids run through all their combinations, the first key fastest."""

    kind: Literal["grid"] = "grid"  # type: ignore[assignment]


Distribution = Uniform | LogUniform | Normal | Integers | Choice | Grid
DISTRIBUTIONS = Family({kind.__pydantic_fields__["kind"].default: kind for kind in get_args(Distribution)})


class SweepFile(StudyFile):
    """Keys of a sweep file."""

    name: StudyName = "sweep"
    runs: Annotated[Count, Field(ge=1, le=1_000_000)] | None = None
    """Number of runs; null takes as many as the grids have combinations. Run i does not depend on this number."""
    seed: Seed = 0
    """Seed of everything random."""
    mismatch: Flag = False
    """Whether the controller's model of robot, servos, gravity, noise, delay and age of readings stays that of the
    scenario while these vary: they become keys of `model`, unless the scenario sets them there."""
    distributions: dict[Text, Annotated[Distribution, DISTRIBUTIONS]]
    """Scenario key -> distribution. A component of a list is `initial_offset[0]`, or `disturbances[0].wrench[3]`."""

    def rules(self) -> None:
        if not self.distributions:
            raise ConfigurationError("distributions", {}, "at least one scenario key with its distribution")


class Draws(Sequence[Trial]):
    """Trials of a sweep; the draws for run i depend only on the file's `seed`, i and the key."""

    def __init__(self, base: Scenario, file: SweepFile, count: int, trust_code: bool) -> None:
        self.base, self.file, self._count, self._given = base, file, count, given_keys(base)
        self._trust_code = trust_code
        data = base.in_full()
        with error_prefix("distributions."):
            self._values: Document = {key: value_at(data, key) for key in file.distributions}
        for key, distribution in file.distributions.items():
            self._check(key, distribution)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: int) -> Trial:  # type: ignore[override]
        return self.trial(range(self._count)[index])

    def trial(self, number: int) -> Trial:
        """Trial `number`, from 0; also beyond the number of runs."""
        drawn = self.draw(number)
        changes = self._changes(drawn)
        factors = {f"{key}.factor": value for key, value in drawn.items() if self.file.distributions[key].factor}
        labels = {"seed": self.run_seed(number), **changes, **factors}
        name = f"{self.file.name} {number}"
        return trial_of(self._given, number, name, changes, labels, trust_code=self._trust_code)

    def run_seed(self, index: int) -> int:
        state = np.random.SeedSequence(self.file.seed, spawn_key=(index,)).generate_state(1, np.uint64)
        return int(state[0] >> np.uint64(1))

    def draw(self, index: int) -> dict[str, object]:
        """Scenario key -> drawn value or factor."""
        seed, rest = self.run_seed(index), index
        values: dict[str, object] = {}
        for key, distribution in self.file.distributions.items():
            if isinstance(distribution, Grid):
                rest, place = divmod(rest, len(distribution.values))
                values[key] = distribution.values[place]
            else:
                # The seed depends on run and key, so that a further key does not change other draws.
                words = np.frombuffer(hashlib.sha256(key.encode()).digest()[:8], np.uint32).tolist()
                rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(words)))
                values[key] = distribution.at(rng.random())
        return values

    def _changes(self, drawn: Mapping[str, object]) -> dict[str, object]:
        factors = self.file.distributions
        return {
            key: (np.array(self._values[key]) * value).tolist() if factors[key].factor else value
            for key, value in drawn.items()
        }

    @property
    def columns(self) -> list[Column]:
        varied: list[Column] = []
        for key, distribution in self.file.distributions.items():
            kind = column_of(distribution)
            if distribution.factor:
                varied.append(Column(f"{key}.factor", "1", f"factor on the scenario's {key}", kind))
                kind = "json" if isinstance(self._values[key], list) else "number"
            text = f"scenario key {key} as run{', as JSON' if kind == 'json' else ''}"
            varied.append(Column(key, "", text, kind))
        return varied

    def _check(self, key: str, distribution: Distribution) -> None:
        """Refuses a distribution if its median does not suit the key; other unsuitable values become rejected rows."""
        current, where = self._values[key], f"distributions.{shorten(key)}"
        if isinstance(current, list) and not distribution.factor and not isinstance(distribution, Choice):
            raise ConfigurationError(where, key, f"a component such as {key}[0], or factor: true, or the kind choice")
        try:
            with_changes(self.base, self._changes({key: distribution.at(0.5)}), self._trust_code)
        except TypeError:
            raise ConfigurationError(where, current, "a key with a number or numbers, to multiply") from None
        except ConfigurationError as error:
            path = ".".join(map(str, split_key(key)))
            if error.key == path or error.key.startswith(f"{path}."):
                raise ConfigurationError(where, error.value, error.allowed) from None


class Sweep(Experiment):
    trials: Draws

    def figures(self, rows: Mapping[str, list[Row]]) -> Figures:
        """Error against the varied keys, or a map if two keys have grids."""
        # Here, because matplotlib takes a second to load.
        from stewart_drake.plotting.study_plots import plot_map, plot_sweep

        given = self.trials.file.distributions
        # A factor has a column with this name; a list cannot be an axis.
        names = {key: f"{key}.factor" if drawn.factor else key for key, drawn in given.items()}
        kinds = {column.name: column.kind for column in self.columns}
        varied = {key: name for key, name in names.items() if kinds[name] != "json"}
        if not varied:
            return {}
        units = {name: "" if given[key].factor else unit_at(self.base, key) for key, name in varied.items()}
        labels = {name: f"{name} [{unit}]" if unit else name for name, unit in units.items()}
        are_grids = len(given) == len(varied) == 2 and all(isinstance(drawn, Grid) for drawn in given.values())
        return {"sweep": partial(plot_map if are_grids else plot_sweep, rows["sweep"], labels)}


def make_sweep(data: Mapping[str, object], folder: Path | None = None, trust_code: bool = False) -> Sweep:
    """Sweep of the plain values of a `SweepFile`; paths relative to `folder`."""
    file, base = SweepFile.read("sweep", data, folder, trust_code)
    if file.mismatch:
        model, given = base.controller_model, base.model
        kept = {"robot": base.to_dict()["robot"], "gravity": model.gravity, "noise": model.noise}
        kept |= {"delay": model.delay, "reading_age": model.reading_age, "motors": model.motors.to_dict()}
        base = base.replace({f"model.{key}": value for key, value in kept.items() if getattr(given, key) is None})
    values = {key: _without_units(base, key, drawn) for key, drawn in file.distributions.items()}
    file = file.replace(distributions=values)
    runs = file.runs
    if runs is None:
        grids = [len(drawn.values) for drawn in file.distributions.values() if isinstance(drawn, Grid)]
        if not grids:
            raise ConfigurationError("runs", None, "a number of runs; optional only where a key has a grid")
        runs = math.prod(grids)
    draws = Draws(base, file, runs, trust_code)
    scenario = {key: value for key, value in base.to_dict().items() if key != "name"}
    distributions = {key: drawn.to_dict() for key, drawn in file.distributions.items()}
    return Sweep(
        kind="sweep",
        name=file.name,
        base=base,
        trials=draws,
        columns=(*BEFORE, *draws.columns, *run_columns(base), *INCIDENTAL),
        # Rows do not depend on the number of runs or a name.
        work={"scenario": scenario, "seed": file.seed, "distributions": distributions},
        variants=(base,),
    )


def _without_units(base: Scenario, key: str, distribution: Distribution) -> Distribution:
    """Replaces texts such as `100 g` by numbers; names and invalid values stay."""
    if not isinstance(distribution, Choice) or not any(isinstance(item, str) for item in distribution.values):
        return distribution
    values = []
    for item in distribution.values:
        values.append(item)
        with suppress(ConfigurationError):
            value = value_at(with_changes(base, {key: item}).in_full(), key)
            values[-1] = value if isinstance(value, (int, float)) else item
    return distribution.replace(values=tuple(values))


def load_sweep(path: str | Path, runs: int | None = None, trust_code: bool = False) -> Sweep:
    more = {} if runs is None else {"runs": runs}
    return load_experiment("sweep", path, lambda data, folder: make_sweep({**data, **more}, folder, trust_code))


def make_simulator(sweep: Experiment, **options: object) -> Callable[[Callable[[], int]], object]:
    """A function `make_simulator(generator)` for Drake's `MonteCarloSimulation`: a simulator of a run of a sweep.

    The run is `sweep.trials.trial(number)`, where `number` is the next number of the generator. The options are those
    of `build_diagram`. The plant must be Drake's.
    """
    from pydrake.systems.analysis import Simulator

    from stewart_drake.systems.diagram import build_diagram

    if not isinstance(draws := sweep.trials, Draws):
        raise ConfigurationError("sweep", f"a {sweep.kind}", "a sweep")
    return lambda generator: Simulator(build_diagram(draws.trial(generator()).scenario(), **options))


def summary(rows: Sequence[Row]) -> list[tuple[str, str]]:
    counts = Counter((row["status"], row["reason"]) for row in rows)
    lines = [("runs", str(len(rows)))]
    for (status, reason), count in sorted(counts.items(), key=lambda item: (item[0][0] != "completed", -item[1])):
        lines.append((describe_outcome(status, reason), str(count)))
    for unit, name in (("deg", "rotation"), ("mm", "position")):
        values = [value for row in rows if (value := row.get(f"rmse_norm_{unit}")) is not None]
        if values:
            shares = "  ".join(f"{value:.4g}" for value in np.percentile(values, [50, 95, 99, 100]))
            lines.append((f"RMSE of {name}, percentiles 50 95 99, largest", f"{shares} {unit}"))
    return lines


def column_of(distribution: Distribution) -> ValueKind:
    """Type of a column that can hold the values of a distribution."""
    values = distribution.values if isinstance(distribution, Choice) else [distribution.at(0.5)]
    types = {type(value) for value in values}
    kinds: dict[ValueKind, set[type]] = {"flag": {bool}, "integer": {int}, "number": {int, float}, "text": {str}}
    return next((kind for kind, fitting in kinds.items() if types <= fitting), "json")
