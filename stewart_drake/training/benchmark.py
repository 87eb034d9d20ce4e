"""Settings and tuners in the same situations: their runs, their costs over those of the best fixed setting, and a page.

A candidate changes the scenario of a case; a cell is a kind of situations with a robot, and each counts alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from stewart_drake.config import Real, Section, Text
from stewart_drake.control.features import CostScales
from stewart_drake.control.policy import disturbance_of, weights_of
from stewart_drake.files.whole import PACKAGE, checksum, locked_folder, write_atomically
from stewart_drake.files.yaml_files import read_mapping
from stewart_drake.hardware.observer import ObserverOptions
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_cost, run_metrics
from stewart_drake.registry import TUNERS
from stewart_drake.scenario import Scenario
from stewart_drake.studies.runs import KeptRuns, Row, Task, identity, simulate_unchecked
from stewart_drake.studies.study import markdown, write_table
from stewart_drake.studies.workers import Workers
from stewart_drake.training.situations import HELD_OUT, KINDS, ROBOTS, Case, Changes, kinds_of, situation

SHIPPED = PACKAGE / "weights" / "baselines.yaml"
MEASURED = ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")
"""Figures of a run that its cost is made of, whatever the scales."""
LEAST_COST = 1e-3
"""A smaller cost counts as this: encoders that never change make a cost of nothing, and a ratio to it means nothing."""
DIGITS = 3  # Of a setting: what is run is what is written down
BEST_FIXED = "best fixed"

Engine = Literal["drake", "reduced"]
Numbers = tuple[Real, Real, Real, Real]
Cell = tuple[str, str]
Candidate = Callable[[Case, Scenario], Changes]
GROUPS: Mapping[str, Callable[[Cell], bool]] = {
    "all kinds": lambda _: True,
    "without hold": lambda cell: cell[0] != "hold",
    "kinds never trained on": lambda cell: not KINDS[cell[0]].trained,
    **{f"{robot} alone": lambda cell, robot=robot: cell[1] == robot for robot in ROBOTS},  # type: ignore[misc]
}
COLUMNS = ("candidate", "kind", "robot", "seed", "status", "reason", "cost", "ratio", *MEASURED)
"""Of verdict.csv: cost J and its ratio to that of `BEST_FIXED` in the same situation; figures of the second half."""


class Baselines(Section, key=""):
    """Settings (4,) to beat, in decades above the default: over both robots, by robot, by kind."""

    name: Text = "baselines"
    best: Numbers
    best_of_robot: dict[Text, Numbers]
    best_of_kind: dict[Text, dict[Text, Numbers]]
    """Robot -> kind -> the best for it, also of kinds that nothing is trained on: what knowing the kind is worth."""
    pair: dict[Text, tuple[Real, Real]]
    """Robot -> the best of the paper's nine pairs."""
    schedule: dict[Text, Any]
    costs: dict[Text, dict[Text, dict[Text, Real]]]
    """Robot -> kind -> geometric mean of J over the seeds: default, and the above."""
    evaluations: dict[Text, Real]
    """Points in each search, and seeds of each kind."""

    @classmethod
    def load(cls, path: Path = SHIPPED) -> Baselines:
        return cls.from_dict(read_mapping("settings", path, 200))


def always(changes: Changes) -> Candidate:
    return lambda *_: changes


def with_setting(setting: Sequence[float] | np.ndarray) -> Candidate:
    """A setting (4,) that stays, in decades above the default, see `control.policy`."""
    decades = np.round(np.asarray(setting, dtype=float), DIGITS)

    def changes(_: Case, scenario: Scenario) -> Changes:
        assert isinstance(scenario.estimator, ObserverOptions)
        weights = weights_of(np.array(scenario.tuner.weights), decades).tolist()
        block = dict(zip(("q_pose", "q_rate", "q_integral", "r"), weights, strict=True))
        level = float(disturbance_of(scenario.estimator.disturbance, decades))
        return {"tuner": {"kind": "block", **block}, "estimator.disturbance": level}

    return changes


def with_pair(pair: Sequence[float], setting: Sequence[float] | np.ndarray) -> Candidate:
    """The paper's pair of weights, held fixed, with the observer of a setting (4,)."""
    tuner = {"kind": "fixed", "omega_q": pair[0], "omega_r": pair[1]}
    return lambda case, scenario: {**with_setting(setting)(case, scenario), "tuner": tuner}


def candidates(baselines: Baselines, more: Mapping[str, Changes]) -> dict[str, Candidate]:
    """Those of a verdict by name: fixed ones, those of the paper, an oracle, and more as changes of the scenario."""
    fixed, of_kind = with_setting(baselines.best), baselines.best_of_kind
    return {
        BEST_FIXED: fixed,
        **{name: always(changes) for name, changes in more.items()},
        "best of the nine pairs": lambda case, base: with_pair(baselines.pair[case.robot], baselines.best)(case, base),
        "the paper's tuner": lambda case, base: {**fixed(case, base), "tuner": {"kind": "paper"}},
        "oracle of each kind": lambda case, base: with_setting(of_kind[case.robot][case.kind])(case, base),
    }


def cells_for(robot: str | None = None, trained: bool | None = None) -> list[Cell]:
    return [(kind, each) for each in ROBOTS if robot in (None, each) for kind in kinds_of(each, trained)]


def cases_of(cells: Sequence[Cell], seeds: Sequence[int]) -> list[Case]:
    return [Case(*cell, seed) for cell in cells for seed in seeds]


def cells_of(cases: Sequence[Case]) -> dict[Cell, np.ndarray]:
    cells = dict.fromkeys(case[:2] for case in cases)
    return {cell: np.flatnonzero([case[:2] == cell for case in cases]) for cell in cells}


def mean_over_cells(values: np.ndarray, cases: Sequence[Case]) -> np.ndarray:
    return np.mean([values[..., places].mean(axis=-1) for places in cells_of(cases).values()], axis=0)


def measure_parts(log: SimulationLog) -> Row:
    figures = run_metrics(log)
    return {**{name: figures[name] for name in MEASURED}, "period": log.scenario.controller.period}


def log_cost(row: Row, scales: CostScales) -> float:
    cost = run_cost(row, row["status"], row.get("period", 1.0), scales)
    return float(np.log(max(cost, LEAST_COST)))


class Benchmark(KeptRuns):
    """Runs of candidates, known by what is run; a context manager with the further arguments of `KeptRuns`."""

    def __init__(self, folder: Path, engine: Engine, *more: Any, **options: Any) -> None:
        super().__init__(folder, identity({"benchmark": engine, "measured": MEASURED}), *more, **options)
        self._engine = engine

    def run(self, candidates: Sequence[Candidate], cases: Sequence[Case]) -> list[Row]:
        tasks = [self._task(candidate, case) for candidate in candidates for case in cases]
        keys = [checksum(task.drawn) for task in tasks]
        return self.rows(keys, dict(zip(keys, tasks, strict=True)).__getitem__)

    def log_costs(self, candidates: Sequence[Candidate], cases: Sequence[Case]) -> np.ndarray:
        costs = [log_cost(row, CostScales()) for row in self.run(candidates, cases)]
        return np.reshape(costs, (len(candidates), len(cases)))

    def _task(self, candidate: Candidate, case: Case) -> Task:
        scenario = situation(*case[:3])
        changes = {**candidate(case, scenario), "plant.engine": self._engine, "log_period": None}
        section = TUNERS.section_of(tuner) if (tuner := changes.get("tuner")) else None
        # Of a network the weights count, whatever its file is called.
        network = section and section.from_dict(tuner).content()
        drawn = {"case": list(case), "changes": changes, "network": network and checksum(network)}
        return Task(0, case.seed, scenario.to_dict(), changes, drawn, measure_parts, simulate_unchecked)


class Estimate(NamedTuple):
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


def estimate(logs: Sequence[np.ndarray], kind: Literal["mean", "median"] = "mean") -> Estimate:
    """Of logarithms (n,) by cell: geometric mean over the cells of those in them, or median of all runs.

    The interval is a percentile bootstrap's over the runs in each cell.
    """
    # Half a second of import.
    from scipy.stats import bootstrap

    def statistic(*runs: np.ndarray, axis: int = -1) -> Any:
        if kind == "median":
            return np.median(np.concatenate(runs, axis=axis), axis=axis)
        return np.mean([each.mean(axis=axis) for each in runs], axis=0)

    value = float(statistic(*logs))
    if all(np.ptp(each) == 0.0 for each in logs):
        return Estimate(*np.exp([value] * 3).tolist())
    options: dict[str, Any] = {"n_resamples": 4999, "batch": 500, "method": "percentile", "vectorized": True}
    interval = bootstrap(list(logs), statistic, rng=np.random.default_rng(0), **options).confidence_interval
    return Estimate(*np.exp([value, interval.low, interval.high]).tolist())


class Verdict(NamedTuple):
    """Logarithms of J (candidates, cases), and runs that failed; `BEST_FIXED` is among the names."""

    names: tuple[str, ...]
    cases: tuple[Case, ...]
    logs: np.ndarray
    failed: np.ndarray

    def of(
        self, name: str, within: Callable[[Cell], bool] = GROUPS["all kinds"], over: str = BEST_FIXED
    ) -> list[np.ndarray]:
        """Logarithms of J of a candidate over that of another, an array for each cell that counts."""
        row = self.logs[self.names.index(name)] - self.logs[self.names.index(over)]
        return [row[places] for cell, places in cells_of(self.cases).items() if within(cell)]


def assess(
    entered: Mapping[str, Candidate],
    folder: Path,
    seeds: int,
    engine: Engine = "drake",
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
) -> Verdict:
    import pyarrow as pa

    cases = cases_of(cells_for(), HELD_OUT[:seeds])
    with Benchmark(folder, engine, workers, progress, restart) as benchmark:
        rows = benchmark.run(list(entered.values()), cases)
    shape = (len(entered), len(cases))
    logs = np.reshape([log_cost(row, CostScales()) for row in rows], shape)
    failed = np.reshape([row["status"] != "completed" for row in rows], shape)
    verdict = Verdict(tuple(entered), tuple(cases), logs, failed)
    ratios = logs - logs[verdict.names.index(BEST_FIXED)]
    costs = [{"cost": np.exp(log), "ratio": np.exp(ratio)} for log, ratio in zip(logs.flat, ratios.flat, strict=True)]
    names = [{"candidate": name, **case._asdict()} for name in entered for case in cases]
    table = [{**name, **row, **cost} for name, row, cost in zip(names, rows, costs, strict=True)]
    write_table(pa.table({name: [row.get(name) for row in table] for name in COLUMNS}), folder, "verdict")
    write_atomically(folder / "verdict.md", page(verdict).encode())
    return verdict


def page(verdict: Verdict) -> str:
    """The tables as Markdown; the candidate after `BEST_FIXED` is set against all others."""
    first, *rivals = others = [name for name in verdict.names if name != BEST_FIXED]
    cells = cells_of(verdict.cases)
    groups = {name: within for name, within in GROUPS.items() if any(map(within, cells))}
    whole, by_kind = [], []
    for name, failed in zip(verdict.names, verdict.failed, strict=True):
        means = [float(np.exp(each.mean())) for each in verdict.of(name)]
        worst, (kind, robot) = max(zip(means, cells, strict=True))
        shares = [str(estimate(verdict.of(name, within))) for within in groups.values()]
        median = str(estimate(verdict.of(name), "median"))
        whole.append([name, *shares, median, f"{worst:.2f}, {kind}, {robot}", str(int(failed.sum()))])
    of_others = [verdict.of(name) for name in others]
    for at, ((kind, robot), places) in enumerate(cells.items()):
        base = np.exp(verdict.logs[verdict.names.index(BEST_FIXED), places].mean())
        own = [each[at : at + 1] for each in of_others]
        ratios = [f"{estimate(each)}; {estimate(each, 'median').value:.2f}" for each in own]
        shown = kind if KINDS[kind].trained else f"{kind} (never trained on)"
        by_kind.append([shown, robot, f"{base:.3g}", *ratios])
    duels = [
        [name, *(str(estimate(verdict.of(first, within, over=rival))) for rival in rivals)]
        for name, within in groups.items()
    ]
    lines = [
        f"Ratios of J to that of `{BEST_FIXED}` in the same situation: geometric means over the "
        f"{len(verdict.cases)} runs of each candidate, each kind of each robot counting alike, with intervals of "
        "95 % (bootstrap).",
        "",
        *markdown(["candidate", *groups, "median of runs", "worst kind", "failed"], whole),
        "",
        *([f"J of `{first}` over that of", "", *markdown(["", *rivals], duels), ""] if rivals else []),
        "By kind: J of the best fixed setting (geometric mean), then ratios (geometric mean with interval; median).",
        "",
        *markdown(["kind", "robot", BEST_FIXED, *others], by_kind),
    ]
    return "\n".join(lines) + "\n"


def write_picture(verdict: Verdict, folder: Path) -> str | None:
    # matplotlib takes a second to load.
    from stewart_drake.plotting import draw
    from stewart_drake.plotting.study_plots import plot_costs

    names = [name for name in verdict.names if name != BEST_FIXED]
    ratios = {name: [estimate([each]) for each in verdict.of(name)] for name in names}
    labels = [kind if robot == "paper" else f"{kind}, {robot}" for kind, robot in cells_of(verdict.cases)]
    with locked_folder(folder):
        return draw(partial(plot_costs, labels, ratios, BEST_FIXED), folder / "verdict.png")
