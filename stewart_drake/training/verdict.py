"""Costs of candidates over those of the best fixed setting, with intervals; and the page that says so."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from stewart_drake.control.features import CostScales
from stewart_drake.files.whole import locked_folder, write_atomically
from stewart_drake.studies.study import markdown, write_table
from stewart_drake.studies.workers import Workers
from stewart_drake.training.benchmark import (
    MEASURED,
    Baselines,
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

CONFIDENCE, RESAMPLES = 0.95, 4999
SEEDS = 14
"""Of each kind of each robot: 308 runs of each candidate."""
BEST_FIXED = "best fixed"
COLUMNS = ("candidate", "kind", "robot", "seed", "status", "reason", "cost", "ratio", *MEASURED)
"""Of verdict.csv: cost J and its ratio to that of `BEST_FIXED` in the same situation; figures of the second half."""
Within = Callable[[Cell], bool]
GROUPS: Mapping[str, Within] = {
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

    value, rng = float(statistic(*logs)), np.random.default_rng(seed)
    if all(np.ptp(each) == 0.0 for each in logs):
        return Estimate(*np.exp([value] * 3).tolist())
    options = {"n_resamples": RESAMPLES, "batch": 500, "confidence_level": CONFIDENCE, "method": "percentile"}
    interval = bootstrap(list(logs), statistic, vectorized=True, rng=rng, **options).confidence_interval
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

    def of(self, name: str, within: Within = GROUPS["all kinds"], over: str = BEST_FIXED) -> list[np.ndarray]:
        """Logarithms of J of a candidate over that of another, an array for each cell that counts."""
        row = self.logs[self.names.index(name)] - self.logs[self.names.index(over)]
        return [row[places] for cell, places in cells_of(self.cases).items() if within(cell)]


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


def assess(
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
    import pyarrow as pa

    cases, scales = cases_of(cells_for(), HELD_OUT[:seeds]), CostScales()
    with Benchmark(folder, engine, where, tell, restart) as benchmark:
        rows = benchmark.run(list(entered.values()), cases)
    shape = (len(entered), len(cases))
    logs = np.reshape([log_cost(row, scales) for row in rows], shape)
    failed = np.reshape([row["status"] != "completed" for row in rows], shape)
    verdict = Verdict(tuple(entered), tuple(cases), logs, failed)
    ratios = logs - logs[verdict.names.index(BEST_FIXED)]
    pairs = [(name, case) for name in entered for case in cases]
    table = [
        {"candidate": name, **case._asdict(), **row, "cost": np.exp(log), "ratio": np.exp(ratio)}
        for (name, case), row, log, ratio in zip(pairs, rows, logs.flat, ratios.flat, strict=True)
    ]
    columns = {name: [row.get(name) for row in table] for name in COLUMNS}
    write_table(pa.table(columns), folder, "verdict")
    write_atomically(folder / "verdict.md", page(verdict).encode())
    return verdict


def page(verdict: Verdict) -> str:
    """The tables as Markdown; the candidate after `BEST_FIXED` is set against all others."""
    first, *rivals = others = [name for name in verdict.names if name != BEST_FIXED]
    cells = cells_of(verdict.cases)
    groups = {name: within for name, within in GROUPS.items() if any(map(within, cells))}
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
        *markdown(["kind", "robot", BEST_FIXED, *others], [_cell_row(verdict, cell, others) for cell in cells]),
    ]
    return "\n".join(lines) + "\n"


def _whole_row(verdict: Verdict, name: str, groups: Any) -> list[str]:
    means = [float(np.exp(each.mean())) for each in verdict.of(name)]
    worst = int(np.argmax(means))
    kind, robot = list(cells_of(verdict.cases))[worst]
    return [
        name,
        *(str(geometric_mean(verdict.of(name, within))) for within in groups),
        str(median(verdict.of(name))),
        f"{means[worst]:.2f}, {kind}, {robot}",
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

    others, cells = [name for name in verdict.names if name != BEST_FIXED], cells_of(verdict.cases)
    ratios = {name: [geometric_mean([each]) for each in verdict.of(name)] for name in others}
    labels = [kind if robot == "paper" else f"{kind}, {robot}" for kind, robot in cells]
    with locked_folder(folder):
        return draw(partial(plot_costs, labels, ratios, BEST_FIXED), folder / "verdict.png")
