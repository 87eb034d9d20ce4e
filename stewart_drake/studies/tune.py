"""The search for gains: CMA-ES over keys of controllers, with all runs kept, and a test of its result."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stewart_drake.base.atomic_files import Document, checksum, locked_folder, write_atomically
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.markdown import TextTable, number
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.control.features import CostScales
from stewart_drake.logs.metrics import FAILED, Column, mean_cost
from stewart_drake.scenario.keys import value_at
from stewart_drake.studies.comparison import Comparison
from stewart_drake.studies.comparison_file import TuneOptions, check_names
from stewart_drake.studies.experiment import (
    Experiment,
    Figures,
    Result,
    RunTrials,
    error_prefix,
    grouped,
    load_experiment,
    not_completed,
    run_experiment,
    with_changes,
)
from stewart_drake.studies.runs import Row, Trial, measure_cost, simulate_unchecked
from stewart_drake.studies.workers import Workers

DIGITS = 4  # Significant digits of a setting.
START, TUNED, SEARCHED = "start", "tuned", "tuned, as searched"
"""Versions of a controller in the test; the last with `tune.set`."""
_QUICK_GENERATIONS = 2

Setting = dict[str, float]  # Scenario key -> value.

COLUMNS = (
    Column("controller", "", "name of the controller", "text"),
    Column("evaluation", "", "number of the evaluation of this controller; 0 is the start", "integer"),
    Column("cost", "1", "mean cost of its runs"),
    Column("best", "1", "least cost so far"),
    Column("not_completed", "", "number of its runs that were not completed", "integer"),
    Column("setting", "", "scenario key -> value, as JSON", "json"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Tuning(Experiment):
    """The search: `trials` are those of one evaluation, and a row is an evaluation."""

    data: Document  # The comparison in plain values.
    options: TuneOptions
    start: Mapping[str, Setting]  # By controller.
    generations: int
    compare: Callable[[Document], Comparison]  # The comparison with other values of some keys.

    @classmethod
    def from_dict(
        cls,
        data: Document,
        folder: Path | None = None,
        controllers: Sequence[str] = (),
        budget: int | None = None,
        quick: bool = False,
        trust_code: bool = False,
    ) -> Tuning:
        """Search of the plain values of a `CompareFile`; `budget`: evaluations per controller, else `generations`."""

        def compare(changes: Document) -> Comparison:
            changed = {**data, "tuned": None, "bands": None, **changes}
            return Comparison.from_dict(changed, folder, quick, trust_code=trust_code)

        options = compare({}).file.tune
        if options is None:
            raise ConfigurationError("tune", None, "a section with the keys to search, as in the comparison `fair`")
        if data.get("cost") is None:
            raise ConfigurationError("cost", None, "scales of the cost, such as {position: 0.03}")
        check_names("--controller", controllers, options.controllers)
        generations = _QUICK_GENERATIONS if quick else options.generations
        if budget is not None:
            generations = (budget - 1) // options.population
            if generations < 1:
                allowed = f"at least {options.population + 1}: the start and a generation"
                raise ConfigurationError("--budget", budget, allowed)
        with error_prefix("tune: "):
            comparison = compare({"seeds": list(options.seeds), "set": {**(data.get("set") or {}), **options.set}})
        trials = {name: of(comparison.trials, name) for name in controllers or options.controllers}
        return cls(
            kind="tune",
            name=comparison.name,
            base=comparison.base,
            trials=[trial for group in trials.values() for trial in group],
            columns=COLUMNS,
            work=comparison.work,
            variants=comparison.variants,
            data=data,
            options=options,
            start={name: _start(name, group, options.controllers[name]) for name, group in trials.items()},
            generations=generations,
            compare=compare,
        )

    @property
    def evaluations(self) -> int:
        return 1 + self.generations * self.options.population

    @property
    def runs(self) -> int:
        return len(self.trials) * self.evaluations + self.test({}).runs

    def compared(self, rows: Sequence[Row]) -> None:
        """None: the test is compared with another plant, the search is not."""

    def rows(self, run: RunTrials) -> list[Row]:
        return [row for name in self.start for row in self._search(name, run)]

    def _search(self, name: str, run: RunTrials) -> list[Row]:
        start, trials, rows = self.start[name], of(self.trials, name), list[Row]()
        low, high = np.log(list(self.options.controllers[name].values())).T

        def evaluate(points: Sequence[np.ndarray]) -> list[float]:
            # The first setting is that of the file, with all its digits.
            settings = [setting_at(start, point) for point in points] if rows else [start]
            numbered = list(enumerate(settings, len(rows)))
            done = iter(run([self._evaluated(trial, *item) for item in numbered for trial in trials]))
            for evaluation, setting in numbered:
                group = list(itertools.islice(done, len(trials)))
                cost = mean_cost(row.get("cost", FAILED) for row in group)
                best, missed = min([cost, *(row["best"] for row in rows[-1:])]), not_completed(group)
                row = {"controller": name, "evaluation": evaluation, "cost": cost, "best": best}
                rows.append({**row, "not_completed": missed, "setting": setting})
            return [row["cost"] for row in rows[-len(settings) :]]

        size = {"generations": self.generations, "population": self.options.population}
        minimise(evaluate, np.log(list(start.values())), low, high, **size, seed=1)
        return rows

    def _evaluated(self, trial: Trial, evaluation: int, setting: Setting) -> Trial:
        return replace(
            trial,
            key=json.dumps([evaluation, trial.key, setting]),
            changes={**trial.changes, **setting},
            measure=partial(measure_cost, scales=CostScales.from_dict(self.data["cost"])),
            # The first evaluation checks the motions for all.
            function=simulate_unchecked if evaluation else trial.function,
        )

    def figures(self, rows: Mapping[str, list[Row]]) -> Figures:
        # Here, because matplotlib takes a second to load.
        from stewart_drake.plotting.study_plots import plot_search

        return {"tune": partial(plot_search, rows["tune"])}

    def test(self, tuned: Mapping[str, Setting]) -> Comparison:
        """The comparison of the controllers before and after the search, with the runs of the file."""
        controllers: dict[str, object] = {}
        runs = []
        for name, start in self.start.items():
            before = self.data["controllers"][name]
            after = {**before, **tuned.get(name, start)}
            versions = {START: before, TUNED: after}
            if self.options.set:
                versions[SEARCHED] = {**after, **self.options.set}
            named = {f"{name}, {version}": keys for version, keys in versions.items()}
            controllers |= named
            labels = [trial.labels for trial in of(self.trials, name)]
            for reference, condition in grouped(labels, "reference", "condition"):
                runs.append({"controllers": list(named), "references": [reference], "conditions": [condition]})
        return self.compare({"controllers": controllers, "runs": runs, "best_of": {}, "tune": None})


def load_tuning(
    path: str | Path,
    controllers: Sequence[str] = (),
    budget: int | None = None,
    quick: bool = False,
    trust_code: bool = False,
) -> Tuning:
    make = partial(Tuning.from_dict, controllers=controllers, budget=budget, quick=quick, trust_code=trust_code)
    return load_experiment("comparison", path, make)


def of(trials: Sequence[Trial], controller: str) -> list[Trial]:
    return [trial for trial in trials if trial.labels["controller"] == controller]


def _start(name: str, trials: Sequence[Trial], ranges: Mapping[str, tuple[float, float]]) -> Setting:
    if not trials:
        raise ConfigurationError("tune.controllers", name, "controllers that are run")
    scenario = trials[0].scenario()
    data, start = scenario.in_full(), {}
    with error_prefix(f"tune.controllers.{name}: "):
        for key, (low, high) in ranges.items():
            start[key] = value_at(data, key)
            with_changes(scenario, {key: high})
            if not isinstance(start[key], (int, float)) or not low <= start[key] <= high:
                allowed = f"a number from {low:g} to {high:g} in the controller's keys, to start from"
                raise ConfigurationError(key, start[key], allowed)
    return start


class TuneResult(NamedTuple):
    rows: list[Row]
    tuned: dict[str, Setting]
    test: Result
    sheets: list[TextTable]


def run_tuning(
    tuning: Tuning,
    folder: Path,
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
) -> TuneResult:
    report = progress or (lambda _: None)
    rows = run_experiment(tuning, folder, workers, report, restart).rows["tune"]
    searches = {name: group for (name,), group in grouped(rows, "controller").items()}
    tuned = {name: min(group, key=lambda row: row["cost"])["setting"] for name, group in searches.items()}
    comparison = tuning.test(tuned)
    before = tuning.runs - comparison.runs
    # The result of another search has another folder.
    test_folder = folder / f"verdict-{checksum(tuned)[:8]}"
    test = run_experiment(comparison, test_folder, workers, lambda done: report(before + done), restart)
    lines = []
    for name, group in searches.items():
        setting = ", ".join(f"{key.rpartition('.')[2]} {value:g}" for key, value in tuned[name].items())
        lines.append((name, str(len(group)), number(group[0]["cost"]), number(group[-1]["best"]), setting))
    changed = "".join(f", {key} {value}" for key, value in tuning.options.set.items())
    title = f"{tuning.name}: cost in the search{changed}; mean of the runs; below by the verdict, before and after"
    sheet = TextTable(title, ("controller", "evaluations", "start", "best", "setting"), lines)
    sheets = [sheet, *comparison.sheets(test.rows)[:1]]
    with locked_folder(folder):
        write_atomically(folder / "tune.md", "\n".join(sheet.markdown() for sheet in sheets).encode())
        write_atomically(folder / "tuned.yaml", to_yaml({"name": tuning.name, "controllers": tuned}).encode())
    return TuneResult(rows, tuned, test, sheets)


def setting_at(keys: Iterable[str], point: np.ndarray) -> Setting:
    """The setting at a point in logarithms, to `DIGITS` digits."""
    return {key: float(f"{value:.{DIGITS}g}") for key, value in zip(keys, np.exp(point), strict=True)}


def minimise(
    evaluate: Callable[[list[np.ndarray]], Sequence[float]],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    generations: int,
    population: int,
    seed: int,
    spread: float = 0.2,
) -> tuple[np.ndarray, float]:
    """The best point (n,) of a box and its cost, by CMA-ES with the initial standard deviation `spread` (1 is the box).

    N. Hansen, "The CMA evolution strategy: a tutorial", arXiv 1604.00772 (2016). The same arguments give the same
    points, so that a search continues from kept evaluations. The start is evaluated first, alone.
    """
    # Here, because it loads matplotlib.
    import cma

    best, least = start, float(evaluate([start])[0])
    rng = np.random.default_rng(seed)
    options: dict[str, object] = {"bounds": [0.0, 1.0], "popsize": population, "verbose": -10, "verb_log": 0}
    options |= {"randn": lambda *shape: rng.standard_normal(shape), "seed": np.nan}
    # CMA-ES needs two dimensions; a second one has no effect.
    inside = np.resize(np.append((start - low) / (high - low), 0.5), max(2, len(start)))
    strategy = cma.CMAEvolutionStrategy(inside, spread, options)
    for _ in range(generations):
        points = strategy.ask()
        scaled = [low + (high - low) * point[: len(start)] for point in points]
        costs = [float(cost) for cost in evaluate(scaled)]
        strategy.tell(points, costs)
        first = int(np.argmin(costs))
        if costs[first] < least:
            best, least = scaled[first], costs[first]
        if strategy.stop():
            break
    return best, least
