"""Runs of (37), (38) under fixed weights, which several sections of the report look at."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import run_metrics, second_half, tracking_error
from stewart_drake.scenario import FixedTuner, Scenario
from stewart_drake.training.collect import OMEGAS

PAIRS = tuple(itertools.product(OMEGAS, OMEGAS))
"""omega_Q, omega_R of the nine experiments."""
RATIOS = (0.01, 0.1, 1.0, 10.0, 100.0)
"""Their distinct ratios omega_Q / omega_R: five controllers."""

SCORES = {"pose_mm": "pose_rmse_mm", "torque_rms": "torque_rms_second_half"}
"""What ranks runs, and the torque that it takes -> its line in the table of metrics."""


def score(log: SimulationLog) -> dict[str, float] | None:
    """`SCORES` of a run; None where it ended early, for then there is no second half to speak of."""
    if not log.reached_end:
        return None
    metrics = run_metrics(log)
    return {name: metrics[metric] for name, metric in SCORES.items()}


def refusal(scenario: Scenario) -> str | None:
    """Why a scenario cannot be run, such as a reference beyond the robot's limits; None where it can."""
    from stewart_drake.runs.simulation import check_scenario

    try:
        check_scenario(scenario)
    except ConfigurationError as error:
        return str(error)
    return None


def pair_of(ratio: float) -> tuple[float, float]:
    """The first pair of the nine with this ratio omega_Q / omega_R.

    Raises:
        ValueError: None has it.
    """
    for pair in PAIRS:
        if np.isclose(pair[0] / pair[1], ratio):
            return pair
    raise ValueError(f"ratio {ratio:g}; the nine pairs have {', '.join(f'{r:g}' for r in RATIOS)}")


def paper_scenario(
    base: Scenario, duration: float, gravity: float, feedforward: str, pair: Sequence[float]
) -> Scenario:
    """(37), (38) under one pair of weights, the rest as in `base`."""
    return base.replace(
        {
            "name": f"{feedforward}-{gravity:g}-{pair[0]:g}-{pair[1]:g}",
            "duration": duration,
            "gravity": gravity,
            "reference": {"kind": "sine"},
            "controller.feedforward": feedforward,
            "tuner": FixedTuner(omega_q=pair[0], omega_r=pair[1]).to_dict(),
        }
    )


def growth(log: SimulationLog) -> float | None:
    """RMS tracking error of the second half over that of the first, the larger of roll and Z; None if it ended early.

    The two axes that (37), (38) move; below 1 the error shrinks.
    """
    if not log.reached_end:
        return None
    error, late = tracking_error(log)[:, (0, 5)], second_half(log)
    return float(np.sqrt(np.mean(error[late] ** 2, axis=0) / np.mean(error[~late] ** 2, axis=0)).max())


def outcome(log: SimulationLog) -> str:
    """`completed`, or what happened, with its leg and time."""
    if log.status == "completed":
        return "completed"
    if log.status == "lost":
        return f"lost: {(log.reason or '').replace('_', ' ')}, {log.outcome_time:.3f} s"
    return f"{(log.reason or '').replace('_', ' ')}, leg {log.leg}, {log.end_time:.3f} s"


def largest_integral(log: SimulationLog) -> float | None:
    """Largest |z| at 5 s [rad s, m s]; None where the run ended before."""
    z = run_metrics(log)["integral_at_5s"]
    return None if z is None else float(np.abs(z).max())
