"""Numbers from a log: its metrics, and what plots and tables make of its rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.files.whole import NOT_FINITE, plain_json
from stewart_drake.logs.metric_table import METRICS, metrics_of
from stewart_drake.logs.rows import RunRows

if TYPE_CHECKING:
    from stewart_drake.logs.log import SimulationLog


def figures_of(rows: RunRows) -> dict[str, Any]:
    """Every metric of a run by name, in values that JSON has; those that are not finite are named in `not_finite`."""
    with np.errstate(all="ignore"):
        return plain_json({metric.name: metric.value(rows) for metric in metrics_of(rows.scenario)})


def run_metrics(log: SimulationLog) -> dict[str, Any]:
    """Figures of a run, ready for JSON. Every key is always there.

    Of a log that `run` made they come from every control tick, and peaks from every step of the plant, whatever rows
    the log has; of another from its rows.

    Returns:
        status, reason, message, outcome_time [s], end_time [s], leg, warnings; safety: first trip of the safety layer,
        see `SimulationLog`; rmse_deg to finite, see `metric_table.METRICS`; not_finite: names of the figures that were
        NaN or infinite, and are None; real_time_factor; git_revision; versions; files: sha256 of each file that the
        scenario names.
    """
    figures = figures_of(RunRows(log.scenario, log.signals)) if log.figures is None else log.figures
    outcome = log.outcome()
    wall, versions, files, _ = (outcome.pop(name) for name in ("wall_time", "versions", "files", "figures"))
    return {
        "scenario": log.scenario.name,
        **outcome,
        **dict.fromkeys(metric.name for metric in METRICS),
        NOT_FINITE: {},
        **figures,
        "real_time_factor": log.end_time / wall if wall > 0.0 else None,
        "git_revision": versions.pop("git_revision", None),
        "versions": versions,
        "files": files,
    }


def tracking_error(log: SimulationLog) -> np.ndarray:
    """Pose minus reference at every row, true pose; (n, 6) [rad, m]."""
    return log["pose"] - log["reference"]


def error_norms(log: SimulationLog) -> tuple[np.ndarray, np.ndarray]:
    """Length of the (roll, pitch, yaw) error (n,) [deg] and of the position error (n,) [mm] at every row, true pose."""
    error = tracking_error(log)
    return np.degrees(np.linalg.norm(error[:, :3], axis=1)), 1e3 * np.linalg.norm(error[:, 3:], axis=1)


def second_half(log: SimulationLog) -> np.ndarray:
    """(n,) mask of the rows in the second half of the planned duration."""
    return log.time >= 0.5 * log.scenario.duration - 1e-9


def integral_at(log: SimulationLog, time: float) -> list[float] | None:
    """Integral states z (6,) [rad s, m s] at the last row at or before `time`; None where the run ended earlier."""
    if not len(log.time) or log.time[-1] < time - 1e-9:
        return None
    row = int(np.searchsorted(log.time, time + 1e-9)) - 1
    return log["integral"][row].tolist()
