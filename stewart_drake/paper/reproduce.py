"""The paper, claim by claim: what the claims share, a table of them all, and its comparison with the committed one."""

from __future__ import annotations

import csv
import itertools
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.control.network import load_network
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics, second_half, tracking_error
from stewart_drake.planning.pose_box import Region
from stewart_drake.plotting import save_figure
from stewart_drake.scenario import AnnTuner, FixedTuner, Scenario
from stewart_drake.studies.runs import simulate
from stewart_drake.studies.workers import Workers, run_jobs
from stewart_drake.training.collect import OMEGAS

K = TypeVar("K")

MODULES = (
    *("kinematics", "force_map", "state_space", "nine_experiments", "network", "in_the_loop"),
    *("sensitivity", "workspace"),
)
"""Of this package, in the paper's order; each has `reproduce(study) -> Result`."""
SEED = 20_210_601
"""Of every random choice, unless a claim says otherwise."""
PAIRS = tuple(itertools.product(OMEGAS, OMEGAS))
"""omega_Q, omega_R of the nine experiments."""
RATIOS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Their distinct ratios omega_Q / omega_R: five controllers."""
ANNOUNCED = Region("announced", (math.pi / 6.0,) * 3 + (0.3,) * 3, "30 deg and 300 mm, as section III.D announces")
WIDE = Region("wide", (*map(math.radians, (70.0, 70.0, 80.0)), 0.2, 0.2, 0.11), "as far as each coordinate goes alone")


class Claim(NamedTuple):
    """A row of the table: what the paper claims and says, what we find with its unit, and whether the claim holds.

    `holds` is None where the paper says nothing.
    """

    name: str
    paper: str
    ours: float
    unit: str
    holds: bool | None


class Result(NamedTuple):
    """What comes of a module of claims: its numbers, its rows of the table, and its figures, drawn when called."""

    numbers: dict[str, Any]
    claims: list[Claim]
    figures: Mapping[str, Callable[[], Figure]] = {}


@dataclass(eq=False)
class Study:
    """One reproduction under way.

    Attributes:
        quick: Smaller sizes.
        base: Scenario that the claims vary; the default is the paper's loop with gravity compensated.
        folder: Where the network goes that this study trains; None keeps none.
        tuner_file: Its weights; None before, for those of the shipped one.
        workers: Processes for runs; None is one for each core, 0 none.
        progress: Called with the share of the present runs that is done, 0 to 1.
    """

    quick: bool = False
    base: Scenario = field(default_factory=Scenario)
    folder: Path | None = None
    tuner_file: Path | None = None
    workers: int | None = None
    progress: Callable[[float], None] = lambda _: None

    def pick(self, full: Any, quick: Any) -> Any:
        """One of two sizes."""
        return quick if self.quick else full

    def run(self, scenarios: Mapping[K, Scenario], check: bool = True) -> dict[K, SimulationLog]:
        """Logs of the scenarios; equal ones run once. Without `check` a motion is not held against the limits first."""
        different = list(dict.fromkeys(scenarios.values()))
        logs: dict[Scenario, SimulationLog] = {}

        def keep(index: int, log: SimulationLog) -> None:
            logs[different[index]] = log
            self.progress(len(logs) / len(different))

        work = partial(simulate, check=check)
        workers = Workers(0 if len(different) == 1 else self.workers)
        run_jobs(range(len(different)), lambda index: (work, (different[index],)), keep, workers)
        return {key: logs[scenario] for key, scenario in scenarios.items()}

    def under_tuner(self, scenario: Scenario) -> Scenario:
        """`scenario` with the network in the loop, from 1/1 as in section IV, densities as it was trained on."""
        network = load_network(self.tuner_file)
        file = str(self.tuner_file.absolute()) if self.tuner_file else None
        tuner = AnnTuner(density=network.density, window=network.window, weights_file=file)
        return scenario.replace({"tuner": tuner.to_dict()})


def reproduce(
    quick: bool = False, out: Path | None = None, progress: Callable[[float, str], None] = lambda *_: None
) -> dict[str, Result]:
    """All claims by module; with `out` the numbers as numbers.json, the network and the figures go there.

    `progress` is called with the share done, 0 to 1, and the module at hand.
    """
    results: dict[str, Result] = {}
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as scratch:
        study = Study(quick, folder=out or Path(scratch))
        for name in MODULES:
            study.progress = lambda share: progress((len(results) + share) / len(MODULES), name)  # noqa: B023
            study.progress(0.0)
            results[name] = import_module(f"{__package__}.{name}").reproduce(study)
    if out is not None:
        write(out, results)
    return results


def write(out: Path, results: dict[str, Result]) -> None:
    """The numbers of results as numbers.json, and their figures."""
    numbers = {name: result.numbers for name, result in results.items()}
    (out / "numbers.json").write_text(json.dumps(numbers, indent=1, allow_nan=False) + "\n")
    (out / "figures").mkdir(exist_ok=True)
    for result in results.values():
        for name, draw in result.figures.items():
            save_figure(draw(), out / "figures" / f"{name}.png")


def rows(claims: Iterable[Claim]) -> list[tuple[str, str, str, str]]:
    """The table: claim, paper, ours, verdict."""
    verdicts = {True: "holds", False: "fails", None: "-"}
    shown = ((claim, f"{claim.ours:.4g}" if claim.ours % 1 else f"{claim.ours:.0f}") for claim in claims)
    return [(c.name, c.paper, f"{ours} {c.unit}".strip(), verdicts[c.holds]) for c, ours in shown]


def differences(claims: Iterable[Claim], size: str) -> list[str]:
    """Where claims differ from the committed claims.csv, column `size` (quick or full), by more than its `within`."""
    with files(__package__).joinpath("claims.csv").open(encoding="utf-8") as stream:
        table = {row["claim"]: (float(row[size]), float(row["within"])) for row in csv.DictReader(stream)}
    found = {claim.name: claim.ours for claim in claims}
    lines = [f"{name}: only in the committed table" for name in table if name not in found]
    for name, ours in found.items():
        expected, within = table.get(name, (math.nan, 0.0))
        if not abs(ours - expected) <= within:
            lines.append(f"{name}: expected {expected:g} within {within:g}, got {ours:g}")
    return lines


def markdown(header: Iterable[str], lines: Iterable[Iterable[object]]) -> str:
    """A table in Markdown; numbers with four digits, a dash for nothing."""

    def cell(value: object) -> str:
        text = "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
        return text.replace("|", "\\|")

    every = [list(header), ["---"] * len(list(header)), *lines]
    return "\n".join("| " + " | ".join(map(cell, line)) + " |" for line in every)


def pair_of(ratio: float) -> tuple[float, float]:
    """The first pair of the nine with this ratio omega_Q / omega_R."""
    return next(pair for pair in PAIRS if np.isclose(pair[0] / pair[1], ratio))


def paper_scenario(
    base: Scenario, duration: float, gravity: float, feedforward: str, pair: Sequence[float]
) -> Scenario:
    """(37), (38) under one pair of weights, the rest as in `base`."""
    return base.replace(
        {
            "duration": duration,
            "gravity": gravity,
            "reference": {"kind": "sine"},
            "controller.feedforward": feedforward,
            "tuner": FixedTuner(omega_q=pair[0], omega_r=pair[1]).to_dict(),
        }
    )


def score(log: SimulationLog) -> dict[str, float] | None:
    """Pose RMSE [mm] and torque RMS [N m] of the second half; None where a run ended early."""
    if not log.reached_end:
        return None
    metrics = run_metrics(log)
    return {"pose_mm": metrics["pose_rmse_mm"], "torque_rms": metrics["torque_rms_second_half"]}


def growth(log: SimulationLog) -> float | None:
    """RMS error of the second half over that of the first, the larger of roll and Z; None if the run ended early."""
    if not log.reached_end:
        return None
    error, late = tracking_error(log)[:, (0, 5)], second_half(log)
    return float(np.sqrt(np.mean(error[late] ** 2, axis=0) / np.mean(error[~late] ** 2, axis=0)).max())


def outcome(log: SimulationLog) -> str:
    """`completed`, or what happened, with its leg and time."""
    reason = (log.reason or "").replace("_", " ")
    if log.status == "lost":
        return f"lost: {reason}, {log.outcome_time:.3f} s"
    return "completed" if log.status == "completed" else f"{reason}, leg {log.leg}, {log.end_time:.3f} s"


def largest_integral(log: SimulationLog) -> float | None:
    """Largest |z| at 5 s [rad s, m s]; None where the run ended before."""
    z = run_metrics(log)["integral_at_5s"]
    return None if z is None else float(np.abs(z).max())


def quantiles(values: np.ndarray, at: tuple[float, ...] = (0.05, 0.5, 0.95)) -> list[float]:
    """Quantiles of what is finite."""
    return np.quantile(values[np.isfinite(values)], at).tolist()
