"""The tuner against fixed weights: ranking, improvement in per cent, and what it depends on; pure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stewart_drake.control.network import TunerNetwork
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import second_half
from stewart_drake.paper.experiments import PAIRS, RATIOS

LABELS = {ratio: sum(math.isclose(q / r, ratio) for q, r in PAIRS) for ratio in RATIOS}
"""How many of the nine pairs have each ratio."""

CLAIMED = 45.0
"""[%] improvement on average, of the later paper."""
BEST_FIXED, MEAN_OF_NINE, ORACLE = "best fixed pair", "mean of the nine", "oracle"


@dataclass(frozen=True)
class Comparison:
    """Pose RMSE [mm] of the tuner and of the five fixed controllers on one trajectory.

    Attributes:
        name: Of the trajectory.
        tuner: None where the run ended early.
        fixed: By ratio omega_Q / omega_R; None where the run ended early.
    """

    name: str
    tuner: float | None
    fixed: Mapping[float, float | None]

    @property
    def oracle_ratio(self) -> float | None:
        """Ratio of the pair that is best on this trajectory; None where no fixed pair completes."""
        completed = {ratio: rmse for ratio, rmse in self.fixed.items() if rmse is not None}
        return min(completed, key=completed.__getitem__, default=None)

    @property
    def oracle(self) -> float | None:
        """[mm] what one would reach who knew the best of the nine beforehand."""
        return None if self.oracle_ratio is None else self.fixed[self.oracle_ratio]

    @property
    def mean_of_nine(self) -> float | None:
        """[mm] mean over the nine labels; None where a pair did not complete, for its error has no number."""
        total = 0.0
        for ratio, rmse in self.fixed.items():
            if rmse is None:
                return None
            total += LABELS[ratio] * rmse
        return total / len(PAIRS)


def best_fixed_ratio(comparisons: Sequence[Comparison]) -> float | None:
    """The ratio with the smallest geometric mean of RMSE over all trajectories, among those that complete them all."""
    means: dict[float, float] = {}
    for ratio in RATIOS:
        found = [c.fixed[ratio] for c in comparisons]
        completed = [rmse for rmse in found if rmse is not None]
        if found and len(completed) == len(found):
            means[ratio] = float(np.mean(np.log(completed)))
    return min(means, key=means.__getitem__, default=None)


def baselines(comparisons: Sequence[Comparison]) -> dict[str, list[float | None]]:
    """RMSE [mm] of everything that the tuner is measured against, by name, one for each trajectory."""
    best = best_fixed_ratio(comparisons)
    return {
        **{f"ratio {ratio:g}": [c.fixed[ratio] for c in comparisons] for ratio in RATIOS},
        BEST_FIXED: [None if best is None else c.fixed[best] for c in comparisons],
        MEAN_OF_NINE: [c.mean_of_nine for c in comparisons],
        ORACLE: [c.oracle for c in comparisons],
    }


def improvement(rmse: float | None, baseline: float | None) -> float | None:
    """[%] how much smaller than the baseline's an RMSE is; negative where it is larger, None where one is missing."""
    return None if rmse is None or baseline is None else 100.0 * (1.0 - rmse / baseline)


@dataclass(frozen=True)
class Improvement:
    """The tuner against one baseline.

    Attributes:
        each: [%] for each trajectory, None where a run ended early.
        mean: [%] their mean; one trajectory on which the tuner is many times worse weighs it down.
        typical: [%] 1 - geometric mean of RMSE / baseline: what the usual trajectory sees.
    """

    each: list[float | None]
    mean: float | None
    typical: float | None


def improvements(comparisons: Sequence[Comparison]) -> dict[str, Improvement]:
    """The tuner against each of `baselines`."""
    found = {}
    for name, values in baselines(comparisons).items():
        each = [improvement(c.tuner, value) for c, value in zip(comparisons, values, strict=True)]
        known = np.array([value for value in each if value is not None])
        typical = 100.0 * (1.0 - float(np.exp(np.mean(np.log(1.0 - known / 100.0))))) if len(known) else None
        found[name] = Improvement(each, float(known.mean()) if len(known) else None, typical)
    return found


def log_ratio(weights: np.ndarray) -> np.ndarray:
    """log10 of omega_Q / omega_R; (..., 2) -> (...)."""
    logarithm = np.log10(weights)
    return np.asarray(logarithm[..., 0] - logarithm[..., 1])


def mean_log_ratio(log: SimulationLog) -> float:
    """Mean log10 ratio of the weights in force over the second half."""
    return float(log_ratio(log["weights"][second_half(log)]).mean())


def mean_answer(network: TunerNetwork, log: SimulationLog) -> float:
    """Mean log10 ratio that the network reads off the densities of a run over its second half.

    On a run with fixed weights the network looks on: a perfect estimator would answer with the ratio in force.
    """
    return float(log_ratio(network.weights(log["density"][second_half(log)])).mean())


def fit_answers(in_force: np.ndarray, answers: np.ndarray) -> dict[str, float]:
    """What the network's answers depend on, by least squares over all trajectories.

    Args:
        in_force: (k,) log10 of the ratios in force.
        answers: (n, k) log10 of the answers' ratio, on n trajectories.

    Returns:
        `slope` of the answer over the ratio in force: 1 for a perfect estimator, 0 for one that sees nothing of the
        weights; `mean`, log10 of the mean answer; `by_trajectory`, share of the answers' variance that knowing the
        trajectory alone accounts for; `r_squared`, negative where a constant would do better.
    """
    truth = np.broadcast_to(in_force, answers.shape)
    centred = truth - truth.mean()
    spread = float(np.sum((answers - answers.mean()) ** 2))
    between = answers.shape[1] * float(np.sum((answers.mean(axis=1) - answers.mean()) ** 2))
    return {
        "slope": float(np.sum(centred * answers) / np.sum(centred**2)),
        "mean": float(answers.mean()),
        "by_trajectory": between / spread if spread > 0.0 else 0.0,
        "r_squared": 1.0 - float(np.sum((answers - truth) ** 2) / np.sum(centred**2)),
    }


def constant_at(comparison: Comparison, ratio_log10: float) -> float | None:
    """RMSE [mm] that constant weights of a given ratio would have: log-log interpolation between the five.

    Args:
        comparison: The trajectory.
        ratio_log10: log10 of the ratio, held within the range of the five.

    Returns:
        None where a fixed pair ended early.
    """
    rmse = [comparison.fixed[ratio] for ratio in RATIOS]
    known = [value for value in rmse if value is not None]
    if len(known) < len(rmse):
        return None
    return float(np.exp(np.interp(ratio_log10, np.log10(RATIOS), np.log(known))))


def falling(comparisons: Sequence[Comparison]) -> tuple[int, int]:
    """On how many trajectories the error falls at every step of the ratio, and how many all five complete."""
    full = [list(c.fixed.values()) for c in comparisons if None not in c.fixed.values()]
    return sum(all(a > b for a, b in itertools.pairwise(row) if a and b) for row in full), len(full)


def findings(comparisons: Sequence[Comparison], gains: Mapping[str, Improvement]) -> dict[str, Any]:
    """What the verdict rests on: baselines that the tuner beats, by the claimed average, and by most."""
    known = {name: gain.mean for name, gain in gains.items() if gain.mean is not None}
    return {
        "comparisons": comparisons,
        "gains": gains,
        "claimed": CLAIMED,
        "best": best_fixed_ratio(comparisons),
        "reached": [name for name, mean in known.items() if mean >= CLAIMED],
        "most": max(known, key=known.__getitem__, default=None),
        "better": [name for name in (BEST_FIXED, MEAN_OF_NINE, "ratio 1") if known.get(name, -1.0) > 0.0],
    }
