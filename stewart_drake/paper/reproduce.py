"""The paper, claim by claim: common parts, a table of the claims, and its comparison with the committed one."""

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
from typing import NamedTuple, TypeVar

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.analysis.feasibility import Region
from stewart_drake.control.network import load_network
from stewart_drake.control.tuners import FixedTuner, PaperTuner
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.plotting import save_figure
from stewart_drake.robot.gravity import Gravity
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.runs import simulate
from stewart_drake.studies.workers import Workers, run_all
from stewart_drake.training.paper_network import OMEGAS, import_torch

K = TypeVar("K")

MODULES = (
    *("kinematics", "force_map", "state_space", "nine_experiments", "network", "in_the_loop"),
    *("sensitivity", "workspace"),
)
"""Modules with `reproduce(study) -> Result`, in the paper's order."""
SEED = 20_210_601
PAIRS = tuple(itertools.product(OMEGAS, OMEGAS))
RATIOS = (0.01, 0.1, 1.0, 10.0, 100.0)
ANNOUNCED = Region("announced", (math.pi / 6.0,) * 3 + (0.3,) * 3, "30 deg and 300 mm, as section III.D announces")
WIDE = Region("wide", (*map(math.radians, (70.0, 70.0, 80.0)), 0.2, 0.2, 0.11), "as far as single coordinates go")

ROUNDING = 1e-10
"""Numbers below this, except counts, are rounding errors, which depend on the processor; this bound is shown."""


class Claim(NamedTuple):
    """A claim of the paper."""

    name: str
    paper: str  # The paper's value.
    ours: float
    unit: str
    holds: bool | None  # None if the paper gives no value.


class Result(NamedTuple):
    numbers: Mapping[str, object]
    claims: list[Claim]
    figures: Mapping[str, Callable[[], Figure]] = {}


@dataclass(eq=False)
class Reproduction:
    """Settings of a reproduction; `tuner_file` has the weights that it has trained, `workers` is 0 for none."""

    quick: bool = False
    base: Scenario = field(default_factory=Scenario)
    folder: Path | None = None
    tuner_file: Path | None = None
    workers: int | None = None
    progress: Callable[[float], None] = lambda _: None

    def pick(self, full: K, quick: K) -> K:
        return quick if self.quick else full

    def run(self, scenarios: Mapping[K, Scenario], check: bool = True) -> dict[K, SimulationLog]:
        different = list(dict.fromkeys(scenarios.values()))
        arguments = [(scenario,) for scenario in different]
        workers = Workers(0 if len(different) == 1 else self.workers)
        done = run_all(partial(simulate, check=check), arguments, workers, lambda n: self.progress(n / len(different)))
        logs = dict(zip(different, done, strict=True))
        return {key: logs[scenario] for key, scenario in scenarios.items()}

    def under_tuner(self, scenario: Scenario) -> Scenario:
        """`scenario` with the network in the loop, from 1/1 as in section IV, with the densities of its training."""
        network = load_network(self.tuner_file)
        file = str(self.tuner_file.absolute()) if self.tuner_file else None
        tuner = PaperTuner(density=network.density, window=network.window, weights_file=file)
        return scenario.replace({"tuner": tuner.to_dict()})


def reproduce(
    quick: bool = False, out: Path | None = None, progress: Callable[[float, str], None] = lambda *_: None
) -> dict[str, Result]:
    """All claims by module; with `out` numbers.json, the network and the figures go there."""
    results: dict[str, Result] = {}
    import_torch()  # If torch is missing, fails here and not after minutes.
    if out is not None:
        prepare_folder(out)
    with TemporaryDirectory() as scratch:
        study = Reproduction(quick, folder=out or Path(scratch))
        for name in MODULES:
            study.progress = lambda share: progress((len(results) + share) / len(MODULES), name)  # noqa: B023
            study.progress(0.0)
            results[name] = import_module(f"{__package__}.{name}").reproduce(study)
    if out is not None:
        write(out, results)
    return results


def write(out: Path, results: dict[str, Result]) -> None:
    numbers = {name: result.numbers for name, result in results.items()}
    (out / "numbers.json").write_text(json.dumps(numbers, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    (out / "figures").mkdir(exist_ok=True)
    for result in results.values():
        for name, draw in result.figures.items():
            save_figure(draw(), out / "figures" / f"{name}.png")


def rows(claims: Iterable[Claim]) -> list[tuple[str, str, str, str]]:
    verdicts = {True: "holds", False: "fails", None: "-"}
    return [(c.name, c.paper, f"{_shown(c.ours)} {c.unit}".strip(), verdicts[c.holds]) for c in claims]


def _shown(value: float) -> str:
    if isinstance(value, float) and abs(value) < ROUNDING:
        return f"< {ROUNDING:g}"
    return f"{value:.4g}" if value % 1 else f"{value:.0f}"


def differences(claims: Iterable[Claim], size: str) -> list[str]:
    """Claims that differ from the committed claims.csv, column `size` (quick or full), by more than its `within`."""
    with files(__package__).joinpath("claims.csv").open(encoding="utf-8") as stream:
        table = {row["claim"]: (float(row[size]), float(row["within"])) for row in csv.DictReader(stream)}
    values = {claim.name: claim.ours for claim in claims}
    lines = [f"{name}: only in the committed table" for name in table if name not in values]
    for name, ours in values.items():
        expected, within = table.get(name, (math.nan, 0.0))
        if not abs(ours - expected) <= within:
            lines.append(f"{name}: expected {expected:g} within {within:g}, got {ours:g}")
    return lines


def pair_of(ratio: float) -> tuple[float, float]:
    return next(pair for pair in PAIRS if np.isclose(pair[0] / pair[1], ratio))


def paper_scenario(
    base: Scenario, duration: float, gravity: Gravity, feedforward: str, pair: Sequence[float]
) -> Scenario:
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
    if not log.reached_end:
        return None
    metrics = run_metrics(log)
    return {"pose_mm": metrics["pose_rmse_mm"], "torque_rms": metrics["torque_rms_second_half"]}


def growth(log: SimulationLog) -> float | None:
    """RMS error of the second half over that of the first, the larger of roll and Z; None if the run ended early."""
    if not log.reached_end:
        return None
    error, late = log.error[:, (0, 5)], log.second_half
    return float(np.sqrt(np.mean(error[late] ** 2, axis=0) / np.mean(error[~late] ** 2, axis=0)).max())


def outcome(log: SimulationLog) -> str:
    reason = (log.reason or "").replace("_", " ")
    if log.status == "lost":
        return f"lost: {reason}, {log.outcome_time:.3f} s"
    return "completed" if log.status == "completed" else f"{reason}, leg {log.leg}, {log.end_time:.3f} s"


def followed(logs: Iterable[SimulationLog]) -> int:
    """Number of completed runs; a lost run also reaches its end, off its motion."""
    return sum(log.status == "completed" for log in logs)


NEAR_ZERO = 0.1
"""Share of its largest value in the run below which an integral state counts as near zero."""


def integral_share(log: SimulationLog) -> float:
    """|z| at 5 s over its largest in the run, the larger of roll and Z; NaN if the run ended before."""
    z, largest = run_metrics(log)["integral_at_5s"], np.abs(log["integral"]).max(axis=0)
    return math.nan if z is None else float(max(abs(z[axis]) / largest[axis] for axis in (0, 5)))


def largest_integral(log: SimulationLog) -> float | None:
    """Largest |z| at 5 s [rad s, m s]; None if the run ended before."""
    z = run_metrics(log)["integral_at_5s"]
    return None if z is None else float(np.abs(z).max())


def quantiles(values: np.ndarray, at: tuple[float, ...] = (0.05, 0.5, 0.95)) -> list[float]:
    return np.quantile(values[np.isfinite(values)], at).tolist()
