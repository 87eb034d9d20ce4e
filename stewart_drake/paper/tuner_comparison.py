"""The tuner against fixed weights: ranking, improvement in per cent, and what it depends on; pure, words included."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stewart_drake.control.network import TunerNetwork
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import second_half
from stewart_drake.paper.nine_experiments_section import PAIRS, RATIOS
from stewart_drake.paper.report import holds

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


@dataclass(frozen=True)
class AnswerFit:
    """What the network's answers depend on, over trajectories (rows) and ratios in force (columns).

    Attributes:
        slope: Of the answer over the ratio in force, both as log10, by least squares: 1 for a perfect estimator, 0 for
            one that sees nothing of the weights.
        mean: log10 of the mean answer.
        by_trajectory: Share of the answers' variance that knowing the trajectory alone accounts for.
        r_squared: 1 - squared error / variance of the ratio in force; negative where a constant would do better.
    """

    slope: float
    mean: float
    by_trajectory: float
    r_squared: float


def fit_answers(in_force: np.ndarray, answers: np.ndarray) -> AnswerFit:
    """Least squares over all trajectories.

    Args:
        in_force: (k,) log10 of the ratios in force.
        answers: (n, k) log10 of the answers' ratio.
    """
    truth = np.broadcast_to(in_force, answers.shape)
    centred = truth - truth.mean()
    spread = float(np.sum((answers - answers.mean()) ** 2))
    between = answers.shape[1] * float(np.sum((answers.mean(axis=1) - answers.mean()) ** 2))
    return AnswerFit(
        slope=float(np.sum(centred * answers) / np.sum(centred**2)),
        mean=float(answers.mean()),
        by_trajectory=between / spread if spread > 0.0 else 0.0,
        r_squared=1.0 - float(np.sum((answers - truth) ** 2) / np.sum(centred**2)),
    )


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


def explanation(
    comparisons: Sequence[Comparison],
    fit: AnswerFit | None,
    score: float | None,
    factors: Sequence[float],
    torque_spread: float,
) -> str:
    """Why the tuner ranks where it does, from the numbers.

    Args:
        comparisons: The trajectories.
        fit: What the network's answers depend on; None where no trajectory was completed by all five.
        score: R^2 of the log ratio on the network's own validation data, where its file says so.
        factors: RMSE of the tuner over that of constant weights of its mean ratio, by trajectory.
        torque_spread: [%] by which torque RMS differs at most between the runs of one trajectory.
    """
    full = [list(c.fixed.values()) for c in comparisons if None not in c.fixed.values()]
    falling = sum(all(a > b for a, b in itertools.pairwise(row) if a and b) for row in full)
    spread = f"The torque RMS of the runs on one trajectory differs by {torque_spread:.1f} % at most"
    nothing = ": holding the robot up and moving it takes what it takes, and R has next to nothing to save"
    parts = [
        f"**What would help.** The error falls at every step from ratio {RATIOS[0]:g} to {RATIOS[-1]:g} on {falling} "
        f"of {len(full)} trajectories that all five complete. {spread}{nothing if torque_spread < 5.0 else ''}."
    ]
    if fit is not None:
        sees = "hardly sees" if fit.slope < 0.2 else "sees in part" if fit.slope < 0.8 else "sees"
        own = "" if score is None else f" (on the motion of its own data its validation R^2 was {score:.2f})"
        parts.append(
            f"**What the network sees.** It was trained to tell which label was in force, and it {sees} that here: "
            f"while it looks on at fixed weights, its answer moves by {fit.slope:z.2f} decades for each decade of the "
            f"ratio in force, where a perfect estimator's moves by 1; R^2 of the log ratio is {fit.r_squared:.2f}"
            f"{own}. The trajectory alone accounts for {100.0 * fit.by_trajectory:.0f} % of the variance of its "
            f"mean answers, which lie around a ratio of {10.0**fit.mean:.2g}, between the extremes of its labels. The "
            "densities (35), (36) divide each signal by its own recent mean, so the size of the error, which is what "
            "the weights change most, is not among the inputs: ten times the error has the same densities."
        )
    parts.append(
        "**What it aims at.** No tracking error enters its training. Even a perfect estimator would answer with the "
        "weights in force and so leave them where they are: the loop of Fig. 6 has no reason to go where the error is "
        "smaller."
    )
    if factors:
        typical = float(np.exp(np.mean(np.log(factors))))
        effect = f"{'costs' if typical > 1.0 else 'gains'} {100.0 * abs(typical - 1.0):.0f} %"
        parts.append(
            "**What switching is worth.** Weights held at the ratio that the network holds on average would have an "
            f"error that can be interpolated between the five. The tuner's is {typical:.2f} times that (geometric mean "
            f"over {len(factors)} trajectories, {min(factors):.2f} to {max(factors):.2f}): changing the weights from "
            f"tick to tick {effect}."
        )
    return "\n\n".join(parts)


def verdict(comparisons: Sequence[Comparison], gains: Mapping[str, Improvement]) -> str:
    """One line from the numbers."""
    first = comparisons[0]
    best = best_fixed_ratio(comparisons)
    start, oracle = gains["ratio 1"].each[0], gains[ORACLE].each[0]
    if first.tuner is None:
        opening = f"on {first.name} the run under the tuner ends early."
    else:
        opening = (
            f"on {first.name} the tuner's pose RMSE is {first.tuner:.3g} mm: {_against(start)} that of 1/1 held fixed, "
            f"{_against(oracle)} that of the best of the nine."
        )
    known = {name: gain.mean for name, gain in gains.items() if gain.mean is not None}
    reached = [name for name, mean in known.items() if mean >= CLAIMED]
    most = max(known, key=known.__getitem__, default=None)
    nearest = ""
    if most is not None:
        typical = gains[most].typical
        by_factor = "" if typical is None else f", or {typical:.0f} % by geometric mean"
        nearest = f" (the most is {known[most]:.0f} %, against {most}{by_factor})"
    named = BEST_FIXED if best is None else f"{BEST_FIXED} (ratio {best:g})"
    better = [name for name in (BEST_FIXED, MEAN_OF_NINE, "ratio 1") if known.get(name, -1.0) > 0.0]
    return (
        f"{holds((len(better) == 3, bool(better)))}: {opening} Over {len(comparisons)} trajectories its error is on "
        f"average {_against(gains[MEAN_OF_NINE].mean)} the mean of the nine and {_against(gains[BEST_FIXED].mean)} "
        f"that of the {named}. {CLAIMED:.0f} % on average is reached against "
        f"{', '.join(reached) if reached else f'no baseline{nearest}'}."
    )


def _against(percent: float | None) -> str:
    """`12 % below` for an improvement of 12 %."""
    if percent is None:
        return "not comparable with"
    return f"{abs(percent):.0f} % {'below' if percent >= 0.0 else 'above'}"
