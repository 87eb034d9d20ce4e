"""Numbers from a log: its metrics, and what plots and tables make of its rows."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.files.whole import NOT_FINITE, plain_json
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metric_table import METRICS
from stewart_drake.logs.tally import Tally


def tracking_error(log: SimulationLog) -> np.ndarray:
    """Pose minus reference at every row, true pose; (n, 6) [rad, m]."""
    return log["pose"] - log["reference"]


def second_half(log: SimulationLog) -> np.ndarray:
    """(n,) mask of the rows in the second half of the planned duration."""
    return log.time >= 0.5 * log.scenario.duration - 1e-9


def run_metrics(log: SimulationLog) -> dict[str, Any]:
    """Figures of a run, ready for JSON. Every key is always there.

    They come from every control tick, and peaks from every step of the plant, whatever rows the log has; of a log that
    `run` did not make from its rows.

    Returns:
        status, reason, message, outcome_time [s], end_time [s], leg, warnings; safety: first trip of the safety layer,
        see `SimulationLog`; see `tally.Tally.figures` for rmse_deg to finite; not_finite: names of the figures that
        were NaN or infinite, and are None; real_time_factor; git_revision; versions; files: sha256 of each file that
        the scenario names.
    """
    figures = log.figures
    if figures is None:
        tally = Tally(log.scenario)
        tally.add(log.signals)
        figures = plain_json(tally.figures())
    outcome = log.outcome()
    wall, versions, files, _ = (outcome.pop(name) for name in ("wall_time", "versions", "files", "figures"))
    return {
        "scenario": log.scenario.name,
        **outcome,
        **dict.fromkeys(metric.name for metric in METRICS),
        **{name: value for name, value in figures.items() if name not in ("events", NOT_FINITE)},
        NOT_FINITE: figures.get(NOT_FINITE, {}),
        "real_time_factor": log.end_time / wall if wall > 0.0 else None,
        "git_revision": versions.pop("git_revision", None),
        "versions": versions,
        "files": files,
    }


def integral_at(log: SimulationLog, time: float) -> list[float] | None:
    """Integral states z (6,) [rad s, m s] at the last row at or before `time`; None where the run ended earlier."""
    if not len(log.time) or log.time[-1] < time - 1e-9:
        return None
    row = int(np.searchsorted(log.time, time + 1e-9)) - 1
    return log["integral"][row].tolist()


def error_norms(log: SimulationLog) -> tuple[np.ndarray, np.ndarray]:
    """Length of the (roll, pitch, yaw) error (n,) [deg] and of the position error (n,) [mm] at every row, true pose."""
    error = tracking_error(log)
    return np.degrees(np.linalg.norm(error[:, :3], axis=1)), 1e3 * np.linalg.norm(error[:, 3:], axis=1)


def settling_time(time: np.ndarray, size: np.ndarray, band: float, start: float = 0.0) -> float | None:
    """Time from `start` (of the run, or of a step) after which `size` stays within `band` to the end.

    Args:
        time: (n,) [s] ascending.
        size: (n,) of the error, >= 0.
        band: Largest size that counts as settled.
        start: [s].

    Returns:
        [s] 0 where it never leaves the band; None where it ends outside, or there are no rows from `start` on.
    """
    after = time >= start - 1e-9
    time, outside = time[after], ~(size[after] <= band)
    if not len(time) or outside[-1]:
        return None
    last = np.flatnonzero(outside)
    return float(time[last[-1] + 1] - start) if len(last) else 0.0


def sine_response(
    time: np.ndarray, reference: np.ndarray, response: np.ndarray, frequency: float
) -> tuple[complex, float]:
    """Response to a sine: least-squares fit of sine, cosine and constant to both signals at the frequency.

    Args:
        time: (n,) [s], best over whole periods, after the transient.
        reference: (n,) what was asked for.
        response: (n,) what came.
        frequency: [Hz].

    Returns:
        Their ratio as a complex number: amplitude ratio and, as its angle, phase (negative for a lag); and the RMS of
        what the fit leaves of the response, as a part of the RMS of the fitted sine.
    """
    angle = 2.0 * np.pi * frequency * np.asarray(time)
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    solution, *_ = np.linalg.lstsq(basis, np.stack([reference, response], axis=1), rcond=None)
    asked, came = solution[0] + 1j * solution[1]
    rest = response - basis @ solution[:, 1]
    return complex(came / asked), float(np.sqrt(2.0 * np.mean(rest**2)) / abs(came))
