"""Candidates in situations: settings and tuners, each in the same runs; every run is kept as it comes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from stewart_drake.config import Real, Section, Text
from stewart_drake.control.features import CostScales
from stewart_drake.control.policy import disturbance_of, weights_of
from stewart_drake.files.whole import PACKAGE, checksum
from stewart_drake.files.yaml_files import read_mapping
from stewart_drake.hardware.observer import ObserverOptions
from stewart_drake.logs.cost import run_cost
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.registry import TUNERS
from stewart_drake.scenario import Scenario
from stewart_drake.studies.runs import KeptRuns, Row, Task, identity, simulate_unchecked
from stewart_drake.studies.workers import Workers
from stewart_drake.training.situations import ROBOTS, Changes, kinds_of, situation

SHIPPED = PACKAGE / "weights" / "baselines.yaml"
MEASURED = ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")
"""Figures of a run that its cost is made of, whatever the scales."""
LEAST_COST = 1e-3
"""A smaller cost counts as this: encoders that never change make a cost of nothing, and a ratio to it means nothing."""
DIGITS = 3
"""Of a setting: what is run is what is written down."""

Numbers = tuple[Real, Real, Real, Real]
Cell = tuple[str, str]
"""Kind and robot."""


class Baselines(Section, key=""):
    """What a trained tuner has to beat, found by `make tuner_baselines`: settings (4,) in decades above the default."""

    name: Text = "baselines"
    best: Numbers
    """Over both robots."""
    best_of_robot: dict[Text, Numbers]
    """Robot -> the best over its own kinds."""
    best_of_kind: dict[Text, dict[Text, Numbers]]
    """Robot -> kind -> the best for it, also of kinds that nothing is trained on: what knowing the kind is worth."""
    pair: dict[Text, tuple[Real, Real]]
    """Robot -> the best of the paper's nine pairs."""
    schedule: dict[Text, Any]
    """Keys of `ScheduleTuner`, made over both robots."""
    costs: dict[Text, dict[Text, dict[Text, Real]]]
    """Robot -> kind -> geometric mean of J over the seeds: default, and the above."""
    evaluations: dict[Text, Real]
    """Points in each search, and seeds of each kind."""

    @classmethod
    def load(cls, path: Path = SHIPPED) -> Baselines:
        """Reads the file that the package carries, or another."""
        return cls.from_dict(read_mapping("settings", path, 200))


class Case(NamedTuple):
    """A run without a candidate, see `situation`."""

    kind: str
    robot: str
    seed: int


Candidate = Callable[[Case, Scenario], Changes]
"""What a candidate changes in the scenario of a case, which has the default setting."""


def always(changes: Changes) -> Candidate:
    """A candidate that is the same in all situations."""
    return lambda *_: changes


def with_setting(setting: Sequence[float] | np.ndarray) -> Candidate:
    """A setting (4,) that stays, in decades above the default, see `control.policy`."""
    decades = np.round(np.asarray(setting, dtype=float), DIGITS)

    def changes(_: Case, scenario: Scenario) -> Changes:
        weights = weights_of(np.array(scenario.tuner.weights), decades).tolist()
        block = dict(zip(("q_pose", "q_rate", "q_integral", "r"), weights, strict=True))
        assert isinstance(scenario.estimator, ObserverOptions)
        level = float(disturbance_of(scenario.estimator.disturbance, decades))
        return {"tuner": {"kind": "block", **block}, "estimator.disturbance": level}

    return changes


def with_pair(pair: Sequence[float], setting: Sequence[float] | np.ndarray) -> Candidate:
    """The paper's pair of weights, held fixed, with the observer of a setting (4,)."""
    tuner = {"kind": "fixed", "omega_q": pair[0], "omega_r": pair[1]}
    return lambda case, scenario: {**with_setting(setting)(case, scenario), "tuner": tuner}


def cells_for(robot: str | None = None, trained: bool | None = None) -> list[Cell]:
    """All cells; of one robot, or of kinds that are trained on, see `kinds_of`."""
    return [(kind, each) for each in ROBOTS if robot in (None, each) for kind in kinds_of(each, trained)]


def cases_of(cells: Sequence[Cell], seeds: Sequence[int]) -> list[Case]:
    """All seeds of all cells, cell by cell."""
    return [Case(*cell, seed) for cell in cells for seed in seeds]


def cells_of(cases: Sequence[Case]) -> dict[Cell, np.ndarray]:
    """Places (n,) in `cases` of each kind and robot."""
    cells = dict.fromkeys(case[:2] for case in cases)
    return {cell: np.flatnonzero([case[:2] == cell for case in cases]) for cell in cells}


def mean_over_cells(values: np.ndarray, cases: Sequence[Case]) -> np.ndarray:
    """Mean over the cells of the means in them, (...) of values (..., cases): each cell counts alike."""
    return np.mean([values[..., places].mean(axis=-1) for places in cells_of(cases).values()], axis=0)


def measure_parts(log: SimulationLog) -> Row:
    """What the cost of a run is made of."""
    figures = run_metrics(log)
    return {**{name: figures[name] for name in MEASURED}, "period": log.scenario.controller.period}


def log_cost(row: Row, scales: CostScales) -> float:
    """Logarithm of what a run cost."""
    cost = run_cost(row, row["status"], row.get("period", 1.0), scales)
    return float(np.log(max(cost, LEAST_COST)))


class Benchmark(KeptRuns):
    """Runs of candidates, known by what is run: one that is in the folder already is not run again.

    A context manager, and its arguments, as `KeptRuns`; for `engine` see `PlantOptions`.
    """

    def __init__(
        self,
        folder: Path,
        engine: Literal["drake", "reduced"],
        where: Workers | None = None,
        tell: Callable[[float], None] | None = None,
        restart: bool = False,
    ) -> None:
        super().__init__(folder, identity({"benchmark": engine, "measured": MEASURED}), where, tell, restart)
        self._engine = engine

    def run(self, candidates: Sequence[Candidate], cases: Sequence[Case]) -> list[Row]:
        """A row for each run, candidate by candidate: how it ended, see `runs.execute`, and `measure_parts`."""
        tasks = [self._task(candidate, case) for candidate in candidates for case in cases]
        keys = [checksum(task.drawn) for task in tasks]
        return self.rows(keys, dict(zip(keys, tasks, strict=True)).__getitem__)

    def log_costs(self, candidates: Sequence[Candidate], cases: Sequence[Case]) -> np.ndarray:
        """(candidates, cases) logarithms of costs, see `log_cost`."""
        costs = [log_cost(row, CostScales()) for row in self.run(candidates, cases)]
        return np.reshape(costs, (len(candidates), len(cases)))

    def _task(self, candidate: Candidate, case: Case) -> Task:
        scenario, base = _situation(case)
        changes = {**candidate(case, scenario), "plant.engine": self._engine, "log_period": None}
        drawn = {"case": list(case), "changes": changes, "network": _network(changes.get("tuner", {}))}
        return Task(0, case.seed, base, changes, drawn, measure_parts, simulate_unchecked)


@lru_cache(maxsize=4096)
def _situation(case: Case) -> tuple[Scenario, Mapping[str, Any]]:
    scenario = situation(*case)
    return scenario, scenario.to_dict()


def _network(tuner: Mapping[str, Any]) -> str | None:
    """Digest of the network of a tuner, whatever its file is called."""
    section = TUNERS.section_of(tuner)
    text = None if section is None else section.from_dict(tuner).content()
    return None if text is None else checksum(text)
