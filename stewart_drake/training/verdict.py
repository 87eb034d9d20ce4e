"""Costs of candidates over those of the best fixed setting, with intervals; and the page that says so."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from stewart_drake.control.objective import CostScales
from stewart_drake.files.whole import locked_folder, write_atomically
from stewart_drake.logs.metric_table import Column
from stewart_drake.studies.study import markdown, to_arrow, write_table
from stewart_drake.studies.workers import Workers
from stewart_drake.training.baselines import Baselines
from stewart_drake.training.benchmark import (
    MEASURED,
    Benchmark,
    Candidate,
    Case,
    Cell,
    always,
    cases_of,
    cells_for,
    cells_of,
    log_cost,
    with_pair,
    with_setting,
)
from stewart_drake.training.situations import HELD_OUT, KINDS, ROBOTS, Changes

CONFIDENCE = 0.95
RESAMPLES = 4999
SEEDS = 14
"""Of each kind of each robot: 308 runs of each candidate."""
BEST_FIXED = "best fixed"
COLUMNS = (
    Column("candidate", "", "its name", "text"),
    Column("kind", "", "of situations", "text"),
    Column("robot", "", "its name", "text"),
    Column("seed", "", "of the situation", "whole"),
    Column("status", "", "how the run ended", "text"),
    Column("reason", "", "why, where it was not completed", "text"),
    Column("cost", "1", "J, see `control.objective`"),
    Column("ratio", "1", f"J over that of `{BEST_FIXED}` in the same situation"),
    Column("rmse_norm_deg", "deg", "RMS length of the error in rotation over the second half"),
    Column("rmse_norm_mm", "mm", "likewise in position"),
    Column("torque_change_rms", "N m", "RMS change of a motor's torque from tick to tick over the second half"),
)
GROUPS: Mapping[str, Callable[[Cell], bool]] = {
    "all kinds": lambda _: True,
    "without hold": lambda cell: cell[0] != "hold",
    "kinds never trained on": lambda cell: not KINDS[cell[0]].trained,
    **{f"{robot} alone": lambda cell, robot=robot: cell[1] == robot for robot in ROBOTS},  # type: ignore[misc]
}


class Estimate(NamedTuple):
    """A number with an interval of `CONFIDENCE`."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


def geometric_mean(logs: Sequence[np.ndarray], seed: int = 0) -> Estimate:
    """Geometric mean over cells of the geometric means in them, each cell counting alike; of logarithms (n,) by cell.

    The interval is a percentile bootstrap's over the runs in each cell: the cells are what they are.
    """
    return _estimate(logs, lambda *runs, axis=-1: np.mean([each.mean(axis=axis) for each in runs], axis=0), seed)


def median(logs: Sequence[np.ndarray], seed: int = 0) -> Estimate:
    """Median of all runs of some cells; as `geometric_mean`."""
    return _estimate(logs, lambda *runs, axis=-1: np.median(np.concatenate(runs, axis=axis), axis=axis), seed)


def _estimate(logs: Sequence[np.ndarray], statistic: Callable[..., Any], seed: int) -> Estimate:
    # Half a second of import.
    from scipy.stats import bootstrap

    value = float(statistic(*logs))
    if all(np.ptp(each) == 0.0 for each in logs):
        return Estimate(*np.exp([value] * 3).tolist())
    interval = bootstrap(
        list(logs),
        statistic,
        n_resamples=RESAMPLES,
        batch=500,
        vectorized=True,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return Estimate(*np.exp([value, interval.low, interval.high]).tolist())


@dataclass(frozen=True, eq=False)
class Verdict:
    """Runs of candidates in the same situations.

    Attributes:
        names: Of the candidates, `BEST_FIXED` among them.
        cases: Of the runs.
        logs: (candidates, cases) logarithms of J.
        failed: (candidates, cases) whether a run was not completed.
    """

    names: tuple[str, ...]
    cases: tuple[Case, ...]
    logs: np.ndarray
    failed: np.ndarray

    def ratios(self, over: str = BEST_FIXED) -> np.ndarray:
        """(candidates, cases) logarithms of J over that of one of them."""
        return self.logs - self.logs[self.names.index(over)]

    def of(
        self, name: str, within: Callable[[Cell], bool] = lambda _: True, over: str = BEST_FIXED
    ) -> list[np.ndarray]:
        """Logarithms of ratios of a candidate, an array for each cell that counts."""
        row = self.ratios(over)[self.names.index(name)]
        return [row[places] for cell, places in cells_of(self.cases).items() if within(cell)]

    def worst_cell(self, name: str) -> tuple[Cell, float]:
        """The cell with the largest geometric mean of ratios, and that."""
        means = [float(np.exp(each.mean())) for each in self.of(name)]
        worst = int(np.argmax(means))
        return list(cells_of(self.cases))[worst], means[worst]


def candidates(baselines: Baselines, more: Mapping[str, Changes]) -> dict[str, Candidate]:
    """Those of a verdict by name: fixed ones, those of the paper, an oracle, and more as changes of the scenario."""
    fixed = with_setting(baselines.best)
    return {
        BEST_FIXED: fixed,
        **{name: always(changes) for name, changes in more.items()},
        "best of the nine pairs": lambda case, base: with_pair(baselines.pair[case.robot], baselines.best)(case, base),
        "the paper's tuner": lambda case, base: {**fixed(case, base), "tuner": {"kind": "paper"}},
        "oracle of each kind": lambda case, base: with_setting(baselines.best_of_kind[case.robot][case.kind])(
            case, base
        ),
    }


def judge(
    entered: Mapping[str, Candidate],
    folder: Path,
    seeds: int = SEEDS,
    engine: Literal["drake", "reduced"] = "drake",
    where: Workers | None = None,
    tell: Callable[[float], None] | None = None,
    restart: bool = False,
) -> Verdict:
    """Runs what is missing, on seeds that nothing has seen before, and writes verdict.parquet, .csv and .md.

    `BEST_FIXED` is among the names of the candidates; `seeds` is the number of situations of each kind of each robot.
    """
    cases, scales = cases_of(cells_for(), HELD_OUT[:seeds]), CostScales()
    with Benchmark(folder, engine, where, tell, restart) as benchmark:
        rows = benchmark.run(list(entered.values()), cases)
    shape = (len(entered), len(cases))
    logs = np.reshape([log_cost(row, scales) for row in rows], shape)
    failed = np.reshape([row["status"] != "completed" for row in rows], shape)
    verdict = Verdict(tuple(entered), tuple(cases), logs, failed)
    table = [
        {
            "candidate": name,
            **case._asdict(),
            **{key: row.get(key) for key in ("status", "reason", *MEASURED)},
            "cost": np.exp(log),
            "ratio": np.exp(ratio),
        }
        for (name, case), row, log, ratio in zip(
            [(name, case) for name in entered for case in cases], rows, logs.flat, verdict.ratios().flat, strict=True
        )
    ]
    about = {"seeds": seeds, "engine": engine, "scales": scales.to_dict()}
    write_table(to_arrow(COLUMNS, table, "verdict", about), folder, "verdict")
    write_atomically(folder / "verdict.md", page(verdict).encode())
    return verdict


def page(verdict: Verdict) -> str:
    """The tables as Markdown; the candidate after `BEST_FIXED` is set against all others."""
    first, *rivals = others = [name for name in verdict.names if name != BEST_FIXED]
    groups = {name: within for name, within in GROUPS.items() if any(map(within, cells_of(verdict.cases)))}
    lines = [
        f"Ratios of J to that of `{BEST_FIXED}` in the same situation: geometric means over the "
        f"{len(verdict.cases)} runs of each candidate, each kind of each robot counting alike, with intervals of "
        f"{100 * CONFIDENCE:.0f} % (bootstrap).",
        "",
        *markdown(
            ["candidate", *groups, "median of runs", "worst kind", "failed"],
            [_whole_row(verdict, name, groups.values()) for name in verdict.names],
        ),
        "",
    ]
    if rivals:
        duels = [
            [name, *(str(geometric_mean(verdict.of(first, within, over=rival))) for rival in rivals)]
            for name, within in groups.items()
        ]
        lines += [f"J of `{first}` over that of", "", *markdown(["", *rivals], duels), ""]
    lines += [
        "By kind: J of the best fixed setting (geometric mean), then ratios (geometric mean with interval; median).",
        "",
        *markdown(
            ["kind", "robot", BEST_FIXED, *others],
            [_cell_row(verdict, cell, others) for cell in cells_of(verdict.cases)],
        ),
    ]
    return "\n".join(lines) + "\n"


def _whole_row(verdict: Verdict, name: str, groups: Any) -> list[str]:
    (kind, robot), mean = verdict.worst_cell(name)
    return [
        name,
        *(str(geometric_mean(verdict.of(name, within))) for within in groups),
        str(median(verdict.of(name))),
        f"{mean:.2f}, {kind}, {robot}",
        str(int(verdict.failed[verdict.names.index(name)].sum())),
    ]


def _cell_row(verdict: Verdict, cell: Cell, names: Sequence[str]) -> list[str]:
    kind, robot = cell
    base = np.exp(verdict.logs[verdict.names.index(BEST_FIXED), cells_of(verdict.cases)[cell]].mean())
    own = [verdict.of(name, lambda each: each == cell) for name in names]
    ratios = [f"{geometric_mean(each)}; {median(each).value:.2f}" for each in own]
    return [kind if KINDS[kind].trained else f"{kind} (never trained on)", robot, f"{base:.3g}", *ratios]


def write_picture(verdict: Verdict, folder: Path) -> str | None:
    """Draws verdict.png; a line where it is beyond matplotlib."""
    # matplotlib takes a second to load.
    from stewart_drake.plotting import draw
    from stewart_drake.plotting.tuner_plots import plot_costs

    cells = cells_of(verdict.cases)
    ratios = {
        name: [geometric_mean(verdict.of(name, lambda cell, at=at: cell == at)) for at in cells]  # type: ignore[misc]
        for name in verdict.names
        if name != BEST_FIXED
    }
    labels = [kind if robot == "paper" else f"{kind}, {robot}" for kind, robot in cells]
    with locked_folder(folder):
        return draw(partial(plot_costs, labels, ratios, BEST_FIXED), folder / "verdict.png")
