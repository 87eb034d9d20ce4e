"""Benchmark of settings and tuners in the same situations: runs, costs relative to the best fixed setting, and a page.

A candidate changes the scenario of a case. A cell is a kind of situations with a robot; all cells have the same weight.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from stewart_drake.base.atomic_files import PACKAGE, checksum
from stewart_drake.base.config import Real, Section, Text
from stewart_drake.base.markdown import markdown_table
from stewart_drake.base.registry import TUNERS
from stewart_drake.base.yaml_files import read_mapping
from stewart_drake.control.features import CostScales
from stewart_drake.control.policy import NAMES, disturbance_of, weights_of
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import METRICS, OUTCOME, Column, run_cost, run_metrics
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.experiment import Experiment, Figures, RunTrials, grouped, not_completed
from stewart_drake.studies.runs import Row, Trial, simulate_unchecked
from stewart_drake.training.situations import HELD_OUT, KINDS, ROBOTS, Case, Changes, kinds_of, situation

SHIPPED = PACKAGE / "weights" / "baselines.yaml"
MEASURED = ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")
"""Figures of a run that make up its cost at any scales."""
MIN_COST = 1e-3
"""Floor of a cost: encoders that never change give zero cost, and a ratio to it has no meaning."""
LOWEST, HIGHEST = np.array([-0.05, -0.8, -2.2, -2.2]), np.array([0.5, 0.7, 0.1, 1.0])
"""Box of settings (4,) for searches and training. The shipped policy has a smaller one, see
docs/results/tuner.md."""
DIGITS = 3  # Decimal places of a setting, in runs and in files.
BEST_FIXED, ORACLE = "best fixed", "oracle of each kind"
OTHER_FIXED = ("best of each robot", "stiff", "default", "best of the nine pairs")
"""Other fixed settings, for all kinds or for a robot."""
NEVER_WORSE = 1.05
"""[-] bound of the upper end of a policy's J relative to these, in every kind."""

PlantKind = Literal["drake", "closed_form"]
Numbers = tuple[Real, Real, Real, Real]
Cell = tuple[str, str]
Candidate = Callable[[Case, Scenario], Changes]
GROUPS: Mapping[str, Callable[[Cell], bool]] = {
    "all kinds": lambda _: True,
    "without hold": lambda cell: cell[0] != "hold",
    "kinds never trained on": lambda cell: not KINDS[cell[0]].trained,
    **{f"{robot} alone": lambda cell, robot=robot: cell[1] == robot for robot in ROBOTS},  # type: ignore[misc]
}


class Baselines(Section, key=""):
    """Settings (4,) to beat, in decades above the default: over all robots, by robot, by kind."""

    name: Text = "baselines"
    best: Numbers
    stiff: Numbers
    """The best over the kinds in which a stiff loop helps most."""
    best_of_robot: dict[Text, Numbers]
    best_of_kind: dict[Text, dict[Text, Numbers]]
    """Robot -> kind -> the best for it, also for kinds without training: the value of knowing the kind."""
    pair: dict[Text, tuple[Real, Real]]
    """Robot -> the best of the paper's nine pairs."""
    schedule: dict[Text, Any]
    costs: dict[Text, dict[Text, dict[Text, Real]]]
    """Robot -> kind -> geometric mean of J over the seeds, for rows without training."""
    evaluations: dict[Text, Real]
    """Points of the searches, and seeds of the kinds."""

    @classmethod
    def load(cls, path: Path = SHIPPED) -> Baselines:
        return cls.from_dict(read_mapping("settings", path, 200))


def always(changes: Changes) -> Candidate:
    return lambda *_: changes


def with_setting(setting: Sequence[float] | np.ndarray) -> Candidate:
    """A fixed setting (4,), in decades above the default, see `control.policy`."""
    decades = np.round(np.asarray(setting, dtype=float), DIGITS)

    def changes(_: Case, scenario: Scenario) -> Changes:
        weights = weights_of(np.array(scenario.tuner.weights), decades).tolist()
        block = dict(zip(("q_pose", "q_rate", "q_integral", "r"), weights, strict=True))
        level = float(disturbance_of(scenario.estimator.disturbance_density, decades))
        return {"tuner": {"kind": "block", **block}, "estimator.disturbance": level}

    return changes


def with_pair(pair: Sequence[float], setting: Sequence[float] | np.ndarray) -> Candidate:
    """The paper's pair of weights, held fixed, with the observer of a setting (4,)."""
    tuner = {"kind": "fixed", "omega_q": pair[0], "omega_r": pair[1]}
    return lambda case, scenario: {**with_setting(setting)(case, scenario), "tuner": tuner}


def fixed_rows(baselines: Baselines) -> dict[str, Candidate]:
    """Fixed settings by name, which a policy should not exceed in any kind."""
    of_robot, pair = baselines.best_of_robot, baselines.pair
    rows: list[Candidate] = [
        with_setting(baselines.best),
        lambda case, base: with_setting(of_robot[case.robot])(case, base),
        with_setting(baselines.stiff),
        with_setting(np.zeros(len(NAMES))),
        lambda case, base: with_pair(pair[case.robot], baselines.best)(case, base),
    ]
    return dict(zip((BEST_FIXED, *OTHER_FIXED), rows, strict=True))


def oracle(baselines: Baselines) -> Candidate:
    """The best fixed setting for the kind."""
    of_kind = baselines.best_of_kind
    return lambda case, base: with_setting(of_kind[case.robot][case.kind])(case, base)


def candidates(baselines: Baselines, policy: Changes) -> dict[str, Candidate]:
    """Candidates by name: best fixed, the policy, the schedule, other fixed settings, the paper's tuner, an oracle."""
    fixed = fixed_rows(baselines)
    best = fixed.pop(BEST_FIXED)
    return {
        BEST_FIXED: best,
        "policy": always({"tuner": policy}),
        "schedule": always({"tuner": baselines.schedule}),
        **fixed,
        "the paper's tuner": lambda case, base: {**best(case, base), "tuner": {"kind": "paper"}},
        ORACLE: oracle(baselines),
    }


def cells_for(robot: str | None = None, trained: bool | None = None) -> list[Cell]:
    return [(kind, name) for name in ROBOTS if robot in (None, name) for kind in kinds_of(name, trained)]


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
    return float(np.log(max(cost, MIN_COST)))


def candidate_trial(plant: PlantKind, candidate: Candidate, case: Case, name: str = "") -> Trial:
    """A run; its key depends on the case, the changes and the weights of a network, not on file names."""
    scenario = situation(*case[:3])
    changes = {**candidate(case, scenario), "plant.kind": plant, "log_period": None}
    section = TUNERS.resolve(tuner) if (tuner := changes.get("tuner")) else None
    network = section and section.from_dict(tuner).content()
    key = checksum({"case": list(case), "changes": changes, "network": network and checksum(network)})
    labels = {"candidate": name, **case._asdict()}
    return Trial(key, scenario.to_dict(), changes, labels, measure_parts, simulate_unchecked)


def work_of(plant: PlantKind) -> dict[str, object]:
    return {"benchmark": plant, "measured": MEASURED}


class Estimate(NamedTuple):
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


def estimate(logs: Sequence[np.ndarray], kind: Literal["mean", "median"] = "mean") -> Estimate:
    """Geometric mean over cells, or median over all runs, of logarithms (n,) by cell.

    The interval is a percentile bootstrap over the runs within the cells.
    """
    # The import takes half a second.
    from scipy.stats import bootstrap

    def statistic(*runs: np.ndarray, axis: int = -1) -> np.ndarray:
        if kind == "median":
            return np.median(np.concatenate(runs, axis=axis), axis=axis)
        return np.mean([cell.mean(axis=axis) for cell in runs], axis=0)

    value = float(statistic(*logs))
    if all(np.ptp(cell) == 0.0 for cell in logs):
        return Estimate(*np.exp([value] * 3).tolist())
    rng = np.random.default_rng(0)
    result = bootstrap(
        list(logs), statistic, n_resamples=4999, batch=500, method="percentile", vectorized=True, rng=rng
    )
    interval = result.confidence_interval
    return Estimate(*np.exp([value, interval.low, interval.high]).tolist())


COLUMNS = (
    *(Column(name, "", f"{name} of the run", "text") for name in ("candidate", "kind", "robot")),
    Column("seed", "", "seed of the situation", "integer"),
    *OUTCOME[:2],
    Column("cost", "1", "J of the run's second half"),
    Column("error", "1", "J of its errors alone"),
    Column("change", "1", "J of its changes of torque alone"),
    Column("ratio", "1", f"J over that of `{BEST_FIXED}` in the same situation"),
    *(column for metric in METRICS if metric.name in MEASURED for column in metric.columns()),
)


def costs_apart(row: Row) -> dict[str, float]:
    """J of a run, of its errors alone and of its torque changes alone."""
    changes, errors = {"torque_change_rms": 0.0}, {"rmse_norm_deg": 0.0, "rmse_norm_mm": 0.0}
    left_out: dict[str, Row] = {"cost": {}, "error": changes, "change": errors}
    return {name: math.exp(log_cost({**row, **without}, CostScales())) for name, without in left_out.items()}


class Evaluation(Experiment):
    """Candidates in cases: `BEST_FIXED`, and the first other one, which is compared with all others."""

    def rows(self, run: RunTrials) -> list[Row]:
        rows = [{**row, **costs_apart(row)} for row in run(self.trials)]
        fixed = [row["cost"] for row in rows if row["candidate"] == BEST_FIXED]
        return [{**row, "ratio": row["cost"] / base} for row, base in zip(rows, itertools.cycle(fixed), strict=False)]

    def page(self, rows: Mapping[str, list[Row]]) -> str:
        table = rows[self.kind]
        first, *rest = others = [name for (name,) in grouped(table, "candidate") if name != BEST_FIXED]
        fixed = [row for row in table if row["candidate"] == BEST_FIXED]
        cells = grouped(fixed, "kind", "robot")
        groups = {name: within for name, within in GROUPS.items() if any(map(within, cells))}
        whole, by_kind = [], []
        for (name,), group in grouped(table, "candidate").items():
            means = [float(np.exp(cell.mean())) for cell in ratios(table, name)]
            largest, (kind, robot) = max(zip(means, cells, strict=True))
            shares = [estimate(ratios(table, name, within)) for within in groups.values()]
            median = estimate(ratios(table, name), "median")
            whole.append([name, *shares, median, f"{largest:.2f}, {kind}, {robot}", not_completed(group)])
        of_others = [ratios(table, name) for name in others]
        for at, ((kind, robot), group) in enumerate(cells.items()):
            of_cell = [cells_of_other[at : at + 1] for cells_of_other in of_others]
            title = kind if KINDS[kind].trained else f"{kind} (never trained on)"
            shown = [str(estimate(cell)) for cell in of_cell]
            by_kind.append([title, robot, f"{np.exp(np.log([row['cost'] for row in group]).mean()):.3g}", *shown])
        pairwise = [
            [name, *(estimate(ratios(table, first, within, over=other)) for other in rest)]
            for name, within in groups.items()
        ]
        lines = [
            f"Ratios of J to that of `{BEST_FIXED}` in the same situation: geometric means over the "
            f"{len(fixed)} runs of a candidate, with equal weights of all kinds and robots, with intervals of "
            "95 % (bootstrap).",
            markdown_table(["candidate", *groups, "median of runs", "worst kind", "failed"], whole),
            *([f"J of `{first}` over that of", markdown_table(["", *rest], pairwise)] if rest else []),
            "By kind: J of the best fixed setting (geometric mean), then ratios (geometric mean with interval).",
            markdown_table(["kind", "robot", BEST_FIXED, *others], by_kind),
            *_never_worse(table, first, [name for name in OTHER_FIXED if name in others]),
        ]
        return "\n\n".join(lines) + "\n"

    def figures(self, rows: Mapping[str, list[Row]]) -> Figures:
        # Here, because matplotlib takes a second to load.
        from stewart_drake.plotting.study_plots import plot_costs

        table = rows[self.kind]
        names = dict.fromkeys(row["candidate"] for row in table if row["candidate"] != BEST_FIXED)
        shown = {name: [estimate([cell]) for cell in ratios(table, name)] for name in names}
        cells = dict.fromkeys((row["kind"], row["robot"]) for row in table)
        labels = [kind if robot == "paper" else f"{kind}, {robot}" for kind, robot in cells]
        return {self.kind: partial(plot_costs, labels, shown, BEST_FIXED)}


def _never_worse(table: Sequence[Row], first: str, fixed: Sequence[str]) -> list[str]:
    """Tables by kind: errors and torque changes alone, and the first candidate relative to the fixed settings."""
    if not fixed:
        return []
    cells = list(grouped([row for row in table if row["candidate"] == BEST_FIXED], "kind", "robot"))
    apart = [ratios(table, first, key=key) for key in ("error", "change")]
    over = {name: ratios(table, first, over=name) for name in (BEST_FIXED, *fixed)}
    lines, kept = [], 0
    for at, (kind, robot) in enumerate(cells):
        found = {name: estimate(logs[at : at + 1]) for name, logs in over.items()}
        worst = max(found, key=lambda name: found[name].high)
        kept += found[worst].high <= NEVER_WORSE
        shown = [estimate(logs[at : at + 1]) for logs in apart]
        lines.append([kind, robot, *shown, *(found[name] for name in fixed), f"{found[worst].high:.2f}, {worst}"])
    return [
        f"`{first}` by kind: errors and changes of torque apart, over those of `{BEST_FIXED}`; then its J over that of "
        f"what stays, and the highest upper end of these and of `{BEST_FIXED}`. It is at most {NEVER_WORSE:g} in "
        f"{kept} of {len(cells)}.",
        markdown_table(["kind", "robot", "error", "change of torque", *fixed, "highest upper end"], lines),
    ]


def ratios(
    rows: Sequence[Row],
    name: str,
    within: Callable[[Cell], bool] = GROUPS["all kinds"],
    over: str = BEST_FIXED,
    key: str = "cost",
) -> list[np.ndarray]:
    """Log of J, or of a part, of a candidate relative to another, one array per cell."""
    costs = grouped(rows, "candidate", "kind", "robot")
    logs = {names: np.log([row[key] for row in group]) for names, group in costs.items()}
    cells = [cell for candidate, *cell in costs if candidate == name]
    return [logs[name, *cell] - logs[over, *cell] for cell in cells if within((cell[0], cell[1]))]


def evaluation(candidates: Mapping[str, Candidate], seeds: int, plant: PlantKind = "drake") -> Evaluation:
    pairs = itertools.product(candidates.items(), cases_of(cells_for(), HELD_OUT[:seeds]))
    return Evaluation(
        kind="verdict",
        name="tuner verdict",
        base=Scenario(),
        trials=[candidate_trial(plant, candidate, case, name) for (name, candidate), case in pairs],
        columns=COLUMNS,
        work=work_of(plant),
    )
