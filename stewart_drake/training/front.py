"""From quiet to stiff: error against change of torque, a tuner by its taste and settings that stay."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.tables import Row, markdown
from stewart_drake.control.objective import CostScales
from stewart_drake.training.baselines import HIGH, LOW, always
from stewart_drake.training.contest import (
    Contest,
    cases_of,
    cells_for,
    log_cost,
    mean_over_cells,
    with_setting,
)
from stewart_drake.training.situations import HELD_OUT, Changes

TASTES = (-1.0, -0.5, 0.0, 0.5, 1.0)
SETTINGS = 64
"""Fixed ones, of a Sobol sequence in the box of the searches; beside them those that are given."""
SEEDS = 3
LEAST = 1e-6
"""[mm], [N m] smaller ones count as this."""


class Front(NamedTuple):
    """What comes of it; means are geometric, over kinds that count alike.

    Attributes:
        settings: (n, 4) of settings that stay.
        cloud: (n, 2) their error [mm] RMS, and change of torque in a millisecond [N m] RMS.
        tuner: (k, 2) likewise, by taste.
        cloud_costs: (n, k) logarithms of J at each taste.
        tuner_costs: (k,) likewise, of the tuner with that taste.
    """

    settings: np.ndarray
    cloud: np.ndarray
    tuner: np.ndarray
    cloud_costs: np.ndarray
    tuner_costs: np.ndarray

    @property
    def best(self) -> np.ndarray:
        """(k,) place of the setting that costs least of all that stay, by taste."""
        return np.argmin(self.cloud_costs, axis=0)


def find_front(
    tuner_at: Callable[[float], Changes],
    folder: Path,
    given: Sequence[Sequence[float]] = (),
    settings: int = SETTINGS,
    seeds: int = SEEDS,
    robot: str = "paper",
    where: Workplace | Executor | None = None,
    tell: Callable[[float], None] | None = None,
) -> Front:
    """Runs what is missing, on the reduced engine and on seeds that nothing has seen.

    Args:
        tuner_at: Changes of a scenario for the tuner at a taste.
        folder: For the rows.
        given: Settings (4,) that are looked at too.
        settings: How many others.
        seeds: Of each kind.
        robot: Its name: of several, errors could not be told in millimetres together.
        where: Where the runs go; None for processes of this machine.
        tell: Called with the number of runs done.

    Raises:
        ConfigurationError, StewartDrakeError, KeyboardInterrupt: See `Contest`.
    """
    from scipy.stats import qmc

    drawn = LOW + (HIGH - LOW) * qmc.Sobol(len(LOW), seed=0).random(settings)
    points = np.concatenate([np.reshape(given, (-1, len(LOW))), drawn])
    cases = cases_of([cell for cell in cells_for() if cell[1] == robot], HELD_OUT[:seeds])
    entered = [*map(with_setting, points), *(always(tuner_at(taste)) for taste in TASTES)]
    with Contest(folder, "reduced", where, tell) as contest:
        rows = contest.rows([(each, case) for each in entered for case in cases])

    def means(value: Callable[[Row], float]) -> np.ndarray:
        return mean_over_cells(np.reshape([value(row) for row in rows], (len(entered), -1)), cases)

    shown = np.exp(np.stack([means(_log_error), means(_log_change)], axis=-1))
    scales = [CostScales().at(taste) for taste in TASTES]
    costs = np.stack([means(partial(log_cost, scales=each)) for each in scales], axis=-1)
    count = len(points)
    return Front(points, shown[:count], shown[count:], costs[:count], np.diag(costs[count:]))


def _log_error(row: Row) -> float:
    return float(np.log(max(row["rmse_norm_mm"], LEAST)))


def _log_change(row: Row) -> float:
    return float(np.log(max(row["torque_change_rms"] * 1e-3 / row["period"], LEAST)))


def table(front: Front) -> list[str]:
    """Lines of a table, a row a taste, as Markdown."""
    rows = []
    for number, (taste, best) in enumerate(zip(TASTES, front.best, strict=True)):
        (error, change), (fixed_error, fixed_change) = front.tuner[number], front.cloud[best]
        ratio = np.exp(front.tuner_costs[number] - front.cloud_costs[best, number])
        numbers = (f"{error:.4f}", f"{change:.4f}", f"{fixed_error:.4f}", f"{fixed_change:.4f}", f"{ratio:.2f}")
        rows.append([f"{taste:g}", *numbers])
    header = ("kappa", "error [mm]", "torque [N m]", "best fixed: error", "torque", "J over its")
    return markdown(header, rows)
