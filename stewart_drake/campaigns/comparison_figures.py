"""Figures of one run for a comparison; what a worker sends back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stewart_drake.campaigns.one_run import measure, outcome
from stewart_drake.campaigns.tables import Row
from stewart_drake.control.objective import CostScales
from stewart_drake.logs.cost import run_cost
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import error_norms

TRACE_POINTS = 240
"""Of the error over time that is kept; each the largest error of its share of the run."""


def measure_run(log: SimulationLog, band: float, scales: CostScales | None = None) -> Row:
    """Figures of a run: those of every sweep, and see `comparison_table.table_columns`.

    Args:
        log: The run.
        band: [mm] of pose error within which it counts as settled.
        scales: Of its cost; None for none.
    """
    rotation, position = error_norms(log)
    pose = np.hypot(1e3 * log.scenario.robot.characteristic_length * np.radians(rotation), position)
    figures = measure(log)
    if scales is not None:
        figures["cost"] = run_cost(figures, log.status, log.scenario.controller.period, scales)
    return {
        **figures,
        "settling_s": settling_time(log.time, pose, band) if log.reached_end else None,
        "trace": {"time": _thinned(log.time, np.max), "pose_mm": _thinned(pose, np.max)},
    }


def measure_band(log: SimulationLog, frequency: float, axis: int, window: float) -> Row:
    """Amplitude ratio and phase over the end of a run.

    Args:
        log: The run; its reference is a sine of `frequency` on `axis`.
        frequency: [Hz].
        axis: 0..5.
        window: [s] of the end; whole periods.
    """
    row = outcome(log) | dict.fromkeys(("ratio", "phase_deg", "rest"))
    if not log.reached_end:
        return row
    rows = log.time > log.time[-1] - window + 1e-9
    reference, pose = log["reference"][rows, axis], log["pose"][rows, axis]
    response, rest = sine_response(log.time[rows], reference, pose, frequency)
    return {**row, "ratio": abs(response), "phase_deg": math.degrees(np.angle(response)), "rest": rest}


def settling_time(time: np.ndarray, size: np.ndarray, band: float, start: float = 0.0) -> float | None:
    """Time from `start` (of the run, or of a step) after which `size` stays within `band` to the end.

    0 where it never leaves the band; None where it ends outside, or there are no rows from `start` on.
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


def _thinned(values: np.ndarray, of: Any) -> list[float]:
    parts = np.array_split(values, min(TRACE_POINTS, len(values))) if len(values) else []
    return [float(f"{of(part):.4g}") for part in parts]
