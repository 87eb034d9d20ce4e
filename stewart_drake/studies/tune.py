"""The search for gains: CMA-ES over keys of each controller, every run kept as it comes; and the verdict."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.control.features import CostScales
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code import trusting_code
from stewart_drake.files.whole import checksum, locked_folder, write_atomically
from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.logs.metrics import FAILED, Column, mean_cost
from stewart_drake.logs.versions import collect_versions
from stewart_drake.scenario import value_at
from stewart_drake.studies.comparison import Comparison
from stewart_drake.studies.comparison_file import TuneOptions
from stewart_drake.studies.runs import KeptRuns, Row, Task, measure_cost, simulate_unchecked
from stewart_drake.studies.study import (
    Sheet,
    StudyResult,
    load_study,
    number,
    run_study,
    to_arrow,
    vary,
    within,
    write_table,
)
from stewart_drake.studies.workers import Workers

COLUMNS = (
    Column("controller", "", "name of the controller", "text"),
    Column("evaluation", "", "number of the evaluation of this controller; 0 is the start", "whole"),
    Column("cost", "1", "mean cost of its runs"),
    Column("best", "1", "least cost so far"),
    Column("not_completed", "", "number of its runs that were not completed", "whole"),
    Column("setting", "", "scenario key -> value, as JSON", "json"),
)
DIGITS = 4
START, TUNED, SEARCHED = "start", "tuned", "tuned, as searched"
"""What the verdict compares: before, after, and the latter as the search sees it."""
_QUICK_GENERATIONS = 2

Setting = dict[str, float]


@dataclass(frozen=True, eq=False)
class Tuning:
    comparison: Comparison
    options: TuneOptions
    start: Mapping[str, Setting]
    generations: int
    data: Mapping[str, Any]
    folder: Path
    quick: bool

    @classmethod
    def from_dict(
        cls,
        data: Mapping[str, Any],
        folder: Path | None = None,
        controllers: Sequence[str] = (),
        budget: int | None = None,
        quick: bool = False,
    ) -> Tuning:
        """From plain values, see `CompareFile`; `budget` evaluations of each stand in place of `generations`."""
        plain = {**data, "tuned": None, "bands": None}
        options = Comparison.from_dict(plain, folder, quick).file.tune
        if options is None:
            raise ConfigurationError("tune", None, "a section with the keys to search, as in the comparison `fair`")
        if data.get("cost") is None:
            raise ConfigurationError("cost", None, "scales of the cost, such as {position: 0.03}")
        changed = {"seeds": list(options.seeds), "set": {**(data.get("set") or {}), **options.set}}
        with within("tune: "):
            comparison = Comparison.from_dict({**plain, **changed}, folder, quick)
        for name in controllers:
            if name not in options.controllers:
                raise ConfigurationError("--controller", name, f"one of {', '.join(options.controllers)}")
        searched = controllers or options.controllers
        start = {name: _start(comparison, name, options.controllers[name]) for name in searched}
        generations = _QUICK_GENERATIONS if quick else options.generations
        if budget is not None:
            generations = (budget - 1) // options.population
            if generations < 1:
                allowed = f"at least {options.population + 1}: the start and a generation"
                raise ConfigurationError("--budget", budget, allowed)
        return cls(comparison, options, start, generations, data, folder or Path(), quick)

    @property
    def name(self) -> str:
        return self.comparison.name

    @property
    def evaluations(self) -> int:
        return 1 + self.generations * self.options.population

    @property
    def runs(self) -> int:
        return sum(len(self.cells(name)) for name in self.start) * self.evaluations + self.verdict({}).runs

    def cells(self, controller: str) -> list[int]:
        return [place for place, cell in enumerate(self.comparison.cells) if cell.controller == controller]

    def verdict(self, tuned: Mapping[str, Setting]) -> Comparison:
        """The comparison's own runs of each controller before and after the search; the start where it found none."""
        controllers: dict[str, Any] = {}
        runs = []
        for name, start in self.start.items():
            before = self.data["controllers"][name]
            after = {**before, **tuned.get(name, start)}
            ways = {START: before, TUNED: after}
            if self.options.set:
                ways[SEARCHED] = {**after, **self.options.set}
            named = {f"{name}, {way}": keys for way, keys in ways.items()}
            controllers |= named
            cells = [self.comparison.cells[place] for place in self.cells(name)]
            for reference, condition in dict.fromkeys((cell.reference, cell.condition) for cell in cells):
                runs.append({"controllers": list(named), "references": [reference], "conditions": [condition]})
        changed = {"controllers": controllers, "runs": runs, "best_of": {}, "tune": None, "tuned": None, "bands": None}
        with trusting_code(self.comparison.trust_code):
            return Comparison.from_dict({**self.data, **changed}, self.folder, self.quick)


def load_tuning(
    path: str | Path, controllers: Sequence[str] = (), budget: int | None = None, quick: bool = False
) -> Tuning:
    make = partial(Tuning.from_dict, controllers=controllers, budget=budget, quick=quick)
    return load_study("comparison", path, make)


def _start(comparison: Comparison, name: str, keys: Mapping[str, tuple[float, float]]) -> Setting:
    cell = next((cell for cell in comparison.cells if cell.controller == name), None)
    if cell is None:
        names = ", ".join(dict.fromkeys(cell.controller for cell in comparison.cells))
        raise ConfigurationError("tune.controllers", name, f"controllers that are run: {names}")
    scenario = vary(comparison.base, cell.changes)
    data, start = scenario.in_full(), {}
    with within(f"tune.controllers.{name}: "):
        for key, (low, high) in keys.items():
            start[key] = value_at(data, key)
            vary(scenario, {key: high})
            if not isinstance(start[key], (int, float)) or not low <= start[key] <= high:
                allowed = f"a number from {low:g} to {high:g} in the controller's own keys, to start from"
                raise ConfigurationError(key, start[key], allowed)
    return start


class TuneResult(NamedTuple):
    rows: list[Row]
    tuned: dict[str, Setting]
    verdict: StudyResult
    sheets: list[Sheet]


def run_tuning(
    tuning: Tuning,
    folder: Path,
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
) -> TuneResult:
    report = progress or (lambda _: None)
    with KeptRuns(folder, tuning.comparison.identity(), workers, report, restart) as kept:
        rows = [row for name in tuning.start for row in _search(tuning, name, kept)]
    searches = {name: [row for row in rows if row["controller"] == name] for name in tuning.start}
    tuned = {name: min(own, key=lambda row: row["cost"])["setting"] for name, own in searches.items()}
    verdict = tuning.verdict(tuned)
    searched = tuning.runs - verdict.runs
    # Another search, longer or of other controllers, has another.
    verdict_folder = folder / f"verdict-{checksum(tuned)[:8]}"
    assessed = run_study(verdict, verdict_folder, workers, lambda done: report(searched + done), restart)
    lines = []
    for name, own in searches.items():
        setting = ", ".join(f"{key.rpartition('.')[2]} {value:g}" for key, value in tuned[name].items())
        lines.append((name, str(len(own)), number(own[0]["cost"]), number(own[-1]["best"]), setting))
    changed = "".join(f", {key} {value}" for key, value in tuning.options.set.items())
    title = f"{tuning.name}: cost in the search{changed}; mean of the runs; below by the verdict, before and after"
    sheets = [
        Sheet(title, ("controller", "evaluations", "start", "best", "setting"), lines),
        *verdict.sheets(assessed.rows)[:1],
    ]
    about = {"tune": tuning.options.to_dict(), **tuning.comparison.work, "versions": collect_versions()}
    with locked_folder(folder):
        write_table(to_arrow(COLUMNS, rows, "tuning", about), folder, "tune")
        write_atomically(folder / "tune.md", "\n".join(sheet.markdown() for sheet in sheets).encode())
        write_atomically(folder / "tuned.yaml", to_yaml({"name": tuning.name, "controllers": tuned}).encode())
    return TuneResult(rows, tuned, assessed, sheets)


def write_picture(result: TuneResult, folder: Path) -> None:
    # matplotlib takes a second to load.
    from stewart_drake.plotting import save_figure
    from stewart_drake.plotting.study_plots import plot_search

    with locked_folder(folder):
        save_figure(plot_search(result.rows), folder / "tune.png")


def setting_at(keys: Iterable[str], point: np.ndarray) -> Setting:
    """The setting at a point in logarithms, to `DIGITS` digits."""
    return {key: float(f"{value:.{DIGITS}g}") for key, value in zip(keys, np.exp(point), strict=True)}


def _search(tuning: Tuning, name: str, kept: KeptRuns) -> list[Row]:
    comparison, start, options = tuning.comparison, tuning.start[name], tuning.options
    low, high = (np.log([ends[place] for ends in options.controllers[name].values()]) for place in (0, 1))
    cells, rows = tuning.cells(name), list[Row]()
    measure = partial(measure_cost, scales=comparison.file.cost or CostScales())

    def task(evaluation: int, cell: int, setting: Setting) -> Task:
        made = comparison.task(cell)
        # The motions are the same in all evaluations: the first checks them.
        function = simulate_unchecked if evaluation else made.function
        return replace(made, changes={**made.changes, **setting}, measure=measure, function=function)

    def evaluate(points: Sequence[np.ndarray]) -> list[float]:
        # What is run first is the start as it stands in the file, whatever its digits.
        settings = [setting_at(start, point) for point in points] if rows else [start]
        numbered = list(enumerate(settings, len(rows)))
        keys = [json.dumps([evaluation, cell, setting]) for evaluation, setting in numbered for cell in cells]
        runs = iter(kept.rows(keys, lambda key: task(*json.loads(key))))
        for evaluation, setting in numbered:
            own = list(itertools.islice(runs, len(cells)))
            cost = mean_cost(run.get("cost", FAILED) for run in own)
            missed = sum(run["status"] != "completed" for run in own)
            found = {"controller": name, "evaluation": evaluation, "cost": cost, "not_completed": missed}
            best = min([cost, *(row["best"] for row in rows[-1:])])
            rows.append({**found, "best": best, "setting": setting})
        return [row["cost"] for row in rows[-len(settings) :]]

    minimise(
        evaluate,
        np.log(list(start.values())),
        low,
        high,
        generations=tuning.generations,
        population=options.population,
        seed=1,
    )
    return rows


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
    """The best point (n,) of a box and its cost, by CMA-ES with `spread`, a share of the box, at first.

    N. Hansen, "The CMA evolution strategy: a tutorial", arXiv 1604.00772 (2016). The same arguments give the same
    points: a search whose evaluations are kept goes on where it was. The first asked for is the start, alone.
    """
    # It loads matplotlib.
    import cma

    best, least = start, float(evaluate([start])[0])
    rng = np.random.default_rng(seed)
    options: dict[str, Any] = {"bounds": [0.0, 1.0], "popsize": population, "verbose": -10, "verb_log": 0}
    options |= {"randn": lambda *shape: rng.standard_normal(shape), "seed": np.nan}
    # It is made for two dimensions and more: a second one without effect.
    inside = np.resize(np.append((start - low) / (high - low), 0.5), max(2, len(start)))
    strategy = cma.CMAEvolutionStrategy(inside, spread, options)
    for _ in range(generations):
        points = strategy.ask()
        asked = [low + (high - low) * point[: len(start)] for point in points]
        costs = [float(cost) for cost in evaluate(asked)]
        strategy.tell(points, costs)
        first = int(np.argmin(costs))
        if costs[first] < least:
            best, least = asked[first], costs[first]
        if strategy.stop():
            break
    return best, least
