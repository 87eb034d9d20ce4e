"""The search for gains: CMA-ES over keys of each controller, every run kept as it comes; and the verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.config import is_finite
from stewart_drake.control.objective import CostScales
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code import trusting_code
from stewart_drake.files.whole import checksum, locked_folder, write_atomically
from stewart_drake.files.yaml_files import find_file, read_mapping, to_yaml
from stewart_drake.logs.cost import FAILED, mean_cost, run_cost
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metric_table import Column
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.logs.versions import collect_versions
from stewart_drake.scenario import value_at
from stewart_drake.studies.comparison import Comparison, TuneOptions
from stewart_drake.studies.comparison_table import ComparisonResult, Sheet, number, run_comparison
from stewart_drake.studies.runs import KeptRuns, Row, Task, outcome, simulate_unchecked
from stewart_drake.studies.study import to_arrow, vary, write_table
from stewart_drake.studies.workers import Workers

PRODUCTS = ("tuned.yaml", "tune.parquet", "tune.csv", "tune.md", "tune.png")
COLUMNS = (
    Column("controller", "", "its name", "text"),
    Column("evaluation", "", "number of it for this controller; 0 is the start", "whole"),
    Column("cost", "1", "mean of its runs"),
    Column("best", "1", "the least until then"),
    Column("not_completed", "", "how many of its runs were not", "whole"),
    Column("setting", "", "scenario key -> value, as JSON", "json"),
)
DIGITS = 4
"""Of a setting: what is run is what is written down."""
START, TUNED, SEARCHED = "start", "tuned", "tuned, as searched"
"""What the verdict compares: before, after, and the latter as the search sees it."""
SPREAD = 0.2
"""Standard deviation of the first generation, as a share of the way from lowest to highest."""
_QUICK_GENERATIONS = 2

Setting = dict[str, float]
"""Scenario key -> value."""


@dataclass(frozen=True)
class Ranges:
    """Keys of a controller with their bounds, and settings of them as points of a unit cube, in logarithms.

    Attributes:
        keys: Scenario key -> lowest and highest value.
        start: The setting to start from.
    """

    keys: Mapping[str, tuple[float, float]]
    start: Setting

    def setting(self, point: Iterable[float]) -> Setting:
        """The setting at a point, to `DIGITS` digits."""
        return {
            key: float(f"{low * (high / low) ** share:.{DIGITS}g}")
            for (key, (low, high)), share in zip(self.keys.items(), point, strict=False)
        }

    def point(self, setting: Setting) -> np.ndarray:
        """Inverse of `setting`, but for the digits."""
        return np.array([math.log(setting[key] / low) / math.log(high / low) for key, (low, high) in self.keys.items()])


@dataclass(frozen=True, eq=False)
class Tuning:
    """A search, ready to be done.

    Attributes:
        comparison: Its cells are the runs of one evaluation of each controller; bands left out.
        options: See `TuneOptions`.
        ranges: Controller -> what is searched of it.
        generations: Of each.
        data: The file in plain values.
        folder: Where it lies.
        quick: Whether runs are short.
    """

    comparison: Comparison
    options: TuneOptions
    ranges: Mapping[str, Ranges]
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
        """A search from plain values, see `CompareFile`; every scenario of it is checked at both ends of each key.

        Args:
            data: Keys and values.
            folder: Paths in `data` are relative to it; None for the current folder.
            controllers: Names of those to search; none for all that `tune` names.
            budget: Evaluations of each, in place of `generations` in the file; rounded down to whole generations.
            quick: Short runs, two generations.
        """
        plain = {**data, "tuned": None, "bands": None}
        options = Comparison.from_dict(plain, folder, quick).file.tune
        if options is None:
            raise ConfigurationError("tune", None, "a section that says what to search, as in the comparison `fair`")
        if data.get("cost") is None:
            raise ConfigurationError("cost", None, "scales of what is to be small, such as {position: 0.03}")
        changed = {"seeds": list(options.seeds), "set": {**(data.get("set") or {}), **options.set}}
        try:
            comparison = Comparison.from_dict({**plain, **changed}, folder, quick)
        except ConfigurationError as error:
            raise error.within("tune: ") from None
        for name in controllers:
            if name not in options.controllers:
                raise ConfigurationError("--controller", name, f"one of {', '.join(options.controllers)}")
        ranges = {
            name: _ranges(comparison, name, keys)
            for name, keys in options.controllers.items()
            if not controllers or name in controllers
        }
        generations = _QUICK_GENERATIONS if quick else options.generations
        if budget is not None:
            generations = (budget - 1) // options.population
            if generations < 1:
                raise ConfigurationError(
                    "--budget", budget, f"at least {options.population + 1}: the start and a generation"
                )
        return cls(comparison, options, ranges, generations, data, folder or Path(), quick)

    @property
    def name(self) -> str:
        """For folders and titles."""
        return self.comparison.name

    @property
    def evaluations(self) -> int:
        """Of each controller, at most: the start, and all generations."""
        return 1 + self.generations * self.options.population

    @property
    def runs(self) -> int:
        """At most, the verdict's included."""
        return sum(len(self.cells(name)) for name in self.ranges) * self.evaluations + self.verdict({}).runs

    def cells(self, controller: str) -> list[int]:
        """Runs of an evaluation of a controller, as places in the cells of `comparison`."""
        return [place for place, cell in enumerate(self.comparison.cells) if cell.controller == controller]

    def verdict(self, tuned: Mapping[str, Setting]) -> Comparison:
        """The comparison's own runs of each controller before and after the search; the start where it found none."""
        controllers: dict[str, Any] = {}
        runs = []
        for name, ranges in self.ranges.items():
            before = self.data["controllers"][name]
            after = {**before, **tuned.get(name, ranges.start)}
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
    path: str | Path,
    controllers: Sequence[str] = (),
    budget: int | None = None,
    quick: bool = False,
    trust_code: bool = False,
) -> Tuning:
    """Reads a comparison file, or a comparison of the package by its name; see `Tuning.from_dict`."""
    path = find_file("comparison", path)
    data = read_mapping("comparison", path, 80)
    with trusting_code(trust_code):
        return Tuning.from_dict(data, path.parent, controllers, budget, quick)


def _ranges(comparison: Comparison, name: str, keys: Mapping[str, tuple[float, float]]) -> Ranges:
    """Bounds and start of a controller's keys."""
    where = f"tune.controllers.{name}"
    cell = next((cell for cell in comparison.cells if cell.controller == name), None)
    if cell is None:
        names = ", ".join(dict.fromkeys(cell.controller for cell in comparison.cells))
        raise ConfigurationError("tune.controllers", name, f"controllers that are run: {names}")
    scenario = vary(comparison.base, cell.changes)
    data, start = scenario.in_full(), {}
    for key, (low, high) in keys.items():
        try:
            start[key] = value_at(data, key)
            for end in (low, high):
                vary(scenario, {key: end})
        except ConfigurationError as error:
            raise error.within(f"{where}: ") from None
        if not is_finite(start[key]) or not low <= start[key] <= high:
            allowed = f"a number from {low:g} to {high:g} in the controller's own keys, to start from"
            raise ConfigurationError(f"{where}: {key}", start[key], allowed)
    return Ranges(keys, start)


@dataclass(frozen=True, eq=False)
class TuneResult:
    """What a search leaves.

    Attributes:
        rows: One an evaluation, see `COLUMNS`.
        tuned: Controller -> the setting that cost least.
        verdict: See `Tuning.verdict`.
        judged_in: The folder of its tables.
        sheet: Costs before and after, as texts.
    """

    rows: list[Row]
    tuned: dict[str, Setting]
    verdict: ComparisonResult
    judged_in: Path
    sheet: Sheet


def run_tuning(
    tuning: Tuning,
    folder: Path,
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
) -> TuneResult:
    """Searches, compares, and writes tuned.yaml, tune.parquet, .csv and .md, and the folder of the verdict.

    Every run is kept as it comes. A second call takes from there what it would run, so that it goes on where the first
    ended: also with more generations, with other controllers of the same file, or with other bounds for one of them.

    Raises:
        ConfigurationError, StewartDrakeError, KeyboardInterrupt: See `run_study`.
    """
    tell = progress or (lambda _: None)
    identity = tuning.comparison.identity(collect_versions())
    with KeptRuns(folder, identity, workers, tell, restart, PRODUCTS) as kept:
        rows = [row for name in tuning.ranges for row in _search(tuning, name, kept)]
    tuned: dict[str, Setting] = {}
    for name in tuning.ranges:
        tuned[name] = min((row for row in rows if row["controller"] == name), key=lambda row: row["cost"])["setting"]
    verdict = tuning.verdict(tuned)
    searched = tuning.runs - verdict.runs
    # Another search, longer or of other controllers, has another.
    judged_in = folder / f"verdict-{checksum(tuned)[:8]}"
    judged = run_comparison(verdict, judged_in, workers, lambda done: tell(searched + done), restart)
    sheet = _sheet(tuning, rows, judged)
    about = {"tune": tuning.options.to_dict(), **tuning.comparison.to_dict(), "versions": collect_versions()}
    with locked_folder(folder):
        write_table(to_arrow(COLUMNS, rows, "tuning", about), folder, "tune")
        write_atomically(folder / "tune.md", sheet.markdown().encode())
        write_atomically(folder / "tuned.yaml", to_yaml({"name": tuning.name, "controllers": tuned}).encode())
    return TuneResult(rows, tuned, judged, judged_in, sheet)


def write_picture(result: TuneResult, folder: Path) -> str | None:
    """Draws tune.png; a line where it is beyond matplotlib."""
    # matplotlib takes a second to load.
    from stewart_drake.plotting import draw
    from stewart_drake.plotting.study_plots import plot_search

    with locked_folder(folder):
        return draw(partial(plot_search, result.rows), folder / "tune.png")


def measure_cost(log: SimulationLog, scales: CostScales) -> Row:
    """How a run ended, and its cost."""
    return {**outcome(log), "cost": run_cost(run_metrics(log), log.status, log.scenario.controller.period, scales)}


def _search(tuning: Tuning, name: str, kept: KeptRuns) -> list[Row]:
    """Evaluations of a controller, one by one, with the least cost until then."""
    comparison, ranges, options = tuning.comparison, tuning.ranges[name], tuning.options
    cells, rows = tuning.cells(name), list[Row]()
    scales = comparison.file.cost
    assert scales is not None

    def task(evaluation: int, cell: int, setting: Setting) -> Task:
        made = comparison.task(cell)
        made = replace(made, changes={**made.changes, **setting}, drawn={"run": cell, "setting": setting})
        # The motions are the same in all evaluations: the first checks them.
        function = simulate_unchecked if evaluation else made.function
        return replace(made, measure=partial(measure_cost, scales=scales), function=function)

    def evaluate(points: Sequence[np.ndarray]) -> list[float]:
        # What is run first is the start as it stands in the file, whatever its digits.
        settings = [ranges.setting(point) for point in points] if rows else [ranges.start]
        tasks = {}
        for evaluation, setting in enumerate(settings, len(rows)):
            for cell in cells:
                made = task(evaluation, cell, setting)
                tasks[checksum([evaluation, made.drawn])] = made
        runs = kept.rows(list(tasks), tasks.__getitem__)
        for k, setting in enumerate(settings):
            own = runs[k * len(cells) : (k + 1) * len(cells)]
            cost = mean_cost(run.get("cost", FAILED) for run in own)
            best = min(cost, rows[-1]["best"]) if rows else cost
            missed = sum(run["status"] != "completed" for run in own)
            found = {"controller": name, "evaluation": len(rows), "cost": cost, "best": best, "not_completed": missed}
            rows.append({**found, "setting": setting})
        return [row["cost"] for row in rows[-len(settings) :]]

    size = len(ranges.keys)
    minimise(
        evaluate,
        ranges.point(ranges.start),
        np.zeros(size),
        np.ones(size),
        generations=tuning.generations,
        population=options.population,
        seed=options.seed,
        spread=options.spread,
    )
    return rows


def minimise(
    evaluate: Callable[[list[np.ndarray]], Sequence[float]],
    start: np.ndarray,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
    *,
    generations: int,
    population: int,
    seed: int,
    spread: float = SPREAD,
    diagonal: bool = False,
) -> tuple[np.ndarray, float]:
    """The least of a function over a box, or all of the space, by CMA-ES: the best point (n,) and its cost.

    N. Hansen, "The CMA evolution strategy: a tutorial", arXiv 1604.00772 (2016). The same arguments give the same
    points, so that a search whose evaluations are kept goes on where it was.

    Args:
        evaluate: Costs of some points (n,). It is asked for the start first, then for a generation at a time.
        start: (n,) within the box.
        low: (n,) lowest values; None, and so `high`, for no bounds.
        high: (n,) highest values.
        generations: Most of them; fewer where the search has converged.
        population: Points in each.
        seed: Of the search.
        spread: Of the first generation, as a share of the box; without one as it stands.
        diagonal: Learn no correlations: for hundreds of numbers and more.
    """
    # It loads matplotlib.
    import cma

    start = np.asarray(start, dtype=float)
    zero = np.zeros_like(start) if low is None else np.asarray(low, dtype=float)
    width = np.ones_like(start) if high is None else np.asarray(high, dtype=float) - zero
    best, least = start, float(evaluate([start])[0])
    rng = np.random.default_rng(seed)
    options: dict[str, Any] = {
        "bounds": [None, None] if low is None else [0.0, 1.0],
        "popsize": population,
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": np.nan,
        "verbose": -10,
        "verb_log": 0,
        "CMA_diagonal": diagonal,
    }
    # It is made for two dimensions and more: a second one without effect.
    inside = np.resize(np.append((start - zero) / width, 0.5), max(2, len(start)))
    strategy = cma.CMAEvolutionStrategy(inside, spread, options)
    for _ in range(generations):
        points = strategy.ask()
        asked = [zero + width * point[: len(start)] for point in points]
        costs = [float(cost) for cost in evaluate(asked)]
        strategy.tell(points, costs)
        first = int(np.argmin(costs))
        if costs[first] < least:
            best, least = asked[first], costs[first]
        if strategy.stop():
            break
    return best, least


def _sheet(tuning: Tuning, rows: Sequence[Row], verdict: ComparisonResult) -> Sheet:
    """Costs before and after, in the search and by the verdict."""

    def judged(name: str, way: str) -> float | None:
        found = [row["cost"] for row in verdict.rows if row["controller"] == f"{name}, {way}"]
        return mean_cost(found) if found else None

    def shown(setting: Mapping[str, float]) -> str:
        return ", ".join(f"{key.rpartition('.')[2]} {value:g}" for key, value in setting.items())

    lines = []
    for name in tuning.ranges:
        own = [row for row in rows if row["controller"] == name]
        best = min(own, key=lambda row: row["cost"])
        costs = [own[0]["cost"], best["cost"], *(judged(name, way) for way in (START, TUNED, SEARCHED))]
        lines.append((name, str(len(own)), *map(number, costs), shown(best["setting"])))
    header = (
        "controller",
        "evaluations",
        "start",
        "best",
        *(f"verdict: {way}" for way in (START, TUNED, SEARCHED)),
        "setting",
    )
    changed = ", ".join(f"{key} {value}" for key, value in tuning.options.set.items())
    with_ = f" with {changed}" if changed else ""
    title = (
        f"{tuning.name}: cost, mean of the runs; the search's{with_}, noise seeds "
        f"{', '.join(map(str, tuning.options.seeds))}; the verdict's as the comparison has them"
    )
    return Sheet(title, header, tuple(lines), (0, 1, 2, 3, 4, 5, 6))
