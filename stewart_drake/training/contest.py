"""Contestants in situations: tuners and settings, each in the same runs; every run is kept as it comes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.kept_runs import KeptRuns
from stewart_drake.campaigns.one_run import Task, simulate_unchecked
from stewart_drake.campaigns.plan import identity
from stewart_drake.campaigns.search import minimise
from stewart_drake.campaigns.tables import Row
from stewart_drake.control.objective import CostScales
from stewart_drake.control.settings import disturbance_of, weights_of
from stewart_drake.files.whole import checksum
from stewart_drake.hardware.observer import ObserverOptions
from stewart_drake.logs.cost import run_cost
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.registry import TUNERS
from stewart_drake.scenario import Scenario
from stewart_drake.training.situations import ROBOTS, Changes, kinds_of, situation

MEASURED = ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")
"""Figures of a run that its cost is made of, whatever the scales."""
LEAST_COST = 1e-3
"""Below it a cost counts as this: counts that never change cost nothing, and a ratio to nothing would say so loudly."""
POPULATION = 10
"""Points in a generation of a search."""
DIGITS = 3
"""Of a setting: what is run is what is written down."""

Cell = tuple[str, str]
"""Kind and robot."""


class Case(NamedTuple):
    """A run without a contestant, see `situation`."""

    kind: str
    robot: str
    seed: int


Contestant = Callable[[Case, Scenario], Changes]
"""What a contestant changes in the scenario of a case, which has the default setting."""


def with_setting(setting: Sequence[float] | np.ndarray) -> Contestant:
    """A setting (4,) that stays, in decades above the default, see `control.settings`."""
    decades = np.round(np.asarray(setting, dtype=float), DIGITS)

    def changes(_: Case, scenario: Scenario) -> Changes:
        weights = weights_of(np.array(scenario.tuner.weights), decades).tolist()
        block = dict(zip(("q_pose", "q_rate", "q_integral", "r"), weights, strict=True))
        assert isinstance(scenario.estimator, ObserverOptions)
        level = float(disturbance_of(scenario.estimator.disturbance, decades))
        return {"tuner": {"kind": "block", **block}, "estimator.disturbance": level}

    return changes


def cells_for() -> list[Cell]:
    """All that there are."""
    return [(kind, robot) for robot in ROBOTS for kind in kinds_of(robot)]


def cases_of(cells: Sequence[Cell], seeds: Sequence[int]) -> list[Case]:
    """All seeds of all cells, cell by cell."""
    return [Case(*cell, seed) for cell in cells for seed in seeds]


def log_cost(row: Row, scales: CostScales) -> float:
    """Logarithm of what a run cost."""
    cost = run_cost(row, row["status"], row.get("period", 1.0), scales)
    return float(np.log(max(cost, LEAST_COST)))


def measure_parts(log: SimulationLog) -> Row:
    """What the cost of a run is made of."""
    figures = run_metrics(log)
    return {**{name: figures[name] for name in MEASURED}, "period": log.scenario.controller.period}


class Contest:
    """Runs of contestants, known by what is run: one that is in the folder already is not run again.

    A context manager: within it, the folder is this process's alone.

    Args:
        folder: For the rows.
        engine: See `PlantOptions.engine`.
        where: Where the runs go; None for processes of this machine.
        tell: Called with the number of runs done.
        restart: Throw away what is in the folder.

    Raises:
        ConfigurationError: The folder holds rows of another version, is in use, or cannot be written to.
    """

    def __init__(
        self,
        folder: Path,
        engine: Literal["drake", "reduced"],
        where: Workplace | Executor | None = None,
        tell: Callable[[float], None] | None = None,
        restart: bool = False,
    ) -> None:
        self._engine = engine
        self._runs = KeptRuns(folder, identity({"contest": engine, "measured": MEASURED}), where, tell, restart)

    def __enter__(self) -> Self:
        self._runs.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._runs.__exit__(kind, error, trace)

    def rows(self, runs: Sequence[tuple[Contestant, Case]]) -> list[Row]:
        """A row for each run: how it ended, see `one_run.execute`, and `measure_parts`.

        Raises:
            ConfigurationError, StewartDrakeError, KeyboardInterrupt: See `KeptRuns.rows`.
        """
        return self._runs.rows([self._task(*each) for each in runs], lambda _: simulate_unchecked)

    def log_costs(
        self, contestants: Sequence[Contestant], cases: Sequence[Case], scales: CostScales | None = None
    ) -> np.ndarray:
        """(contestants, cases) logarithms of costs, see `log_cost`."""
        scales = scales or CostScales()
        rows = self.rows([(contestant, case) for contestant in contestants for case in cases])
        return np.reshape([log_cost(row, scales) for row in rows], (len(contestants), len(cases)))

    def _task(self, contestant: Contestant, case: Case) -> Task:
        scenario, base = _situation(case)
        changes = {**contestant(case, scenario), "plant.engine": self._engine, "log_period": None}
        drawn = {"case": list(case), "changes": changes, "network": _network(changes.get("tuner", {}))}
        # Twelve digits are as many as a double holds exactly.
        return Task(int(checksum(drawn)[:12], 16), case.seed, base, changes, drawn, measure_parts)


def cells_of(cases: Sequence[Case]) -> dict[Cell, np.ndarray]:
    """Places (n,) in `cases` of each kind and robot."""
    cells = dict.fromkeys(case[:2] for case in cases)
    return {cell: np.flatnonzero([case[:2] == cell for case in cases]) for cell in cells}


def mean_over_cells(values: np.ndarray, cases: Sequence[Case]) -> np.ndarray:
    """Mean over the cells of the means in them, (...) of values (..., cases): each cell counts alike."""
    return np.mean([values[..., places].mean(axis=-1) for places in cells_of(cases).values()], axis=0)


def best_of(
    contest: Contest,
    contestant_of: Callable[[np.ndarray], Contestant],
    cases: Sequence[Case],
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    generations: int,
    seed: int = 1,
) -> np.ndarray:
    """Numbers of a contestant with the least mean logarithm of its costs, each cell counting alike, by CMA-ES.

    Args:
        contest: Where it runs.
        contestant_of: A contestant from its numbers (n,).
        cases: Its runs, the same for all.
        start: (n,) where the search starts.
        low: (n,) lowest numbers.
        high: (n,) highest numbers.
        generations: Most of them, of `POPULATION` points each.
        seed: Of the search.

    Returns:
        (n,) to `DIGITS` digits.
    """

    def evaluate(points: Sequence[np.ndarray]) -> list[float]:
        contestants = [contestant_of(np.round(point, DIGITS)) for point in points]
        return mean_over_cells(contest.log_costs(contestants, cases), cases).tolist()

    best, _ = minimise(evaluate, start, low, high, generations=generations, population=POPULATION, seed=seed)
    return np.round(best, DIGITS)


@lru_cache(maxsize=4096)
def _situation(case: Case) -> tuple[Scenario, Mapping[str, Any]]:
    made = situation(*case)
    return made, made.to_dict()


def _network(tuner: Mapping[str, Any]) -> str | None:
    """Digest of the network of a tuner, whatever its file is called."""
    section = TUNERS.section_of(tuner)
    text = None if section is None else section.from_dict(tuner).content()
    return None if text is None else checksum(text)
