"""The search: CMA-ES over the gains of each controller, every run kept as it comes; and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from stewart_drake.campaigns.comparison import ComparisonResult, run_comparison
from stewart_drake.campaigns.comparison_table import Sheet, number
from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.kept_runs import KeptRuns
from stewart_drake.campaigns.one_run import Task, outcome, simulate, simulate_unchecked
from stewart_drake.campaigns.plan import identity_of
from stewart_drake.campaigns.search import minimise
from stewart_drake.campaigns.tables import Row, to_arrow, write_table
from stewart_drake.campaigns.tune_file import SEARCHED, START, TUNED, Setting, Tuning
from stewart_drake.control.objective import CostScales
from stewart_drake.files.whole import checksum, locked_folder, write_atomically
from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.logs.cost import FAILED, mean_cost, run_cost
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metric_table import Column
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.logs.versions import collect_versions

PRODUCTS = ("tuned.yaml", "tune.parquet", "tune.csv", "tune.md", "tune.png")
COLUMNS = (
    Column("controller", "", "its name", "text"),
    Column("evaluation", "", "number of it for this controller; 0 is the start", "whole"),
    Column("cost", "1", "mean of its runs"),
    Column("best", "1", "the least until then"),
    Column("not_completed", "", "how many of its runs were not", "whole"),
    Column("setting", "", "scenario key -> value, as JSON", "json"),
)


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
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
) -> TuneResult:
    """Searches, judges, and writes tuned.yaml, tune.parquet, .csv and .md, and the folder of the verdict.

    Every run is kept as it comes. A second call takes from there what it would run, so that it goes on where the first
    ended: also with more generations, with other controllers of the same file, or with other bounds for one of them.

    Raises:
        ConfigurationError, StewartDrakeError, KeyboardInterrupt: See `plan.run_plan`.
    """
    tell = progress or (lambda _: None)
    with _Evaluations(tuning, folder, where, tell, restart).open() as evaluations:
        rows = [row for name in tuning.ranges for row in _search(tuning, name, evaluations)]
    tuned: dict[str, Setting] = {}
    for name in tuning.ranges:
        tuned[name] = min((row for row in rows if row["controller"] == name), key=lambda row: row["cost"])["setting"]
    verdict = tuning.verdict(tuned)
    searched = tuning.runs - verdict.runs
    # Another search, longer or of other controllers, has another.
    judged_in = folder / f"verdict-{checksum(tuned)[:8]}"
    judged = run_comparison(verdict, judged_in, where, lambda done: tell(searched + done), restart)
    sheet = _sheet(tuning, rows, judged)
    about = {"tune": tuning.options.to_dict(), **tuning.work, "versions": collect_versions()}
    with locked_folder(folder):
        write_table(to_arrow(COLUMNS, rows, "tuning", about), folder, "tune")
        write_atomically(folder / "tune.md", sheet.markdown().encode())
        write_atomically(folder / "tuned.yaml", to_yaml({"name": tuning.name, "controllers": tuned}).encode())
    return TuneResult(rows, tuned, judged, judged_in, sheet)


def write_picture(result: TuneResult, folder: Path) -> str | None:
    """Draws tune.png; a line where it is beyond matplotlib."""
    # matplotlib takes a second to load.
    from stewart_drake.plotting import draw
    from stewart_drake.plotting.tune_plots import plot_search

    with locked_folder(folder):
        return draw(partial(plot_search, result.rows), folder / "tune.png")


def measure_cost(log: SimulationLog, scales: CostScales) -> Row:
    """How a run ended, and its cost."""
    return {**outcome(log), "cost": run_cost(run_metrics(log), log.status, log.scenario.controller.period, scales)}


class _Evaluations:
    """Settings of controllers in, costs out; what has been run before is taken from the folder."""

    def __init__(
        self,
        tuning: Tuning,
        folder: Path,
        where: Workplace | Executor | None,
        tell: Callable[[float], None],
        restart: bool,
    ) -> None:
        comparison = tuning.comparison
        self._tuning = tuning
        identity = identity_of(comparison, collect_versions())
        self._runs = KeptRuns(folder, identity, where, tell, restart, PRODUCTS)
        assert comparison.file.cost is not None
        self._measure = partial(measure_cost, scales=comparison.file.cost)

    @contextmanager
    def open(self) -> Iterator[_Evaluations]:
        with self._runs:
            yield self

    def rows(self, controller: str, first: int, settings: Sequence[Setting]) -> list[Row]:
        """A row of the table for each setting, but for `best`, given the number of the first evaluation."""
        cells = self._tuning.cells(controller)
        tasks = [self._task(cell, k, setting) for k, setting in enumerate(settings, first) for cell in cells]
        # The motions are the same in all evaluations: the first checks them.
        found = self._runs.rows(tasks, lambda task: simulate_unchecked if task.drawn["evaluation"] else simulate)
        made = []
        for k, setting in enumerate(settings):
            runs = found[k * len(cells) : (k + 1) * len(cells)]
            made.append(
                {
                    "controller": controller,
                    "evaluation": first + k,
                    "cost": mean_cost(run.get("cost", FAILED) for run in runs),
                    "not_completed": sum(run["status"] != "completed" for run in runs),
                    "setting": setting,
                }
            )
        return made

    def _task(self, cell: int, number_: int, setting: Setting) -> Task:
        comparison = self._tuning.comparison
        task = comparison.task(cell)
        return replace(
            task,
            index=number_ * comparison.runs + cell,
            changes={**task.changes, **setting},
            drawn={"evaluation": number_, "run": cell, "setting": setting},
            measure=self._measure,
        )


def _search(tuning: Tuning, name: str, evaluations: _Evaluations) -> list[Row]:
    """Evaluations of a controller, one by one, with the least cost until then."""
    ranges, options = tuning.ranges[name], tuning.options
    found: list[Row] = []

    def evaluate(points: Sequence[np.ndarray]) -> list[float]:
        # What is run first is the start as it stands in the file, whatever its digits.
        settings = [ranges.setting(point) for point in points] if found else [ranges.start]
        for row in evaluations.rows(name, len(found), settings):
            found.append({**row, "best": min(row["cost"], found[-1]["best"] if found else row["cost"])})
        return [row["cost"] for row in found[-len(settings) :]]

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
    return found


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
