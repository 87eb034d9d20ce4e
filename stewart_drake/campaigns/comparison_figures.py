"""Figures of one run for a comparison; what a worker sends back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from stewart_drake.campaigns.one_run import measure
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import (
    error_norms,
    rms,
    second_half,
    settling_time,
    sine_response,
    torque_change_rms,
    worst_half_rms,
)

TRACE_POINTS = 240
"""Of the error over time that is kept; each the largest error of its share of the run."""


def measure_run(log: SimulationLog, band: float) -> dict[str, Any]:
    """Figures of a run: those of every sweep, and see `table.COLUMNS`.

    Args:
        log: The run.
        band: [mm] of pose error within which it counts as settled.
    """
    rotation, position = error_norms(log)
    length = log.scenario.robot.characteristic_length
    pose = np.hypot(1e3 * length * np.radians(rotation), position)
    late = second_half(log)
    return {
        **measure(log),
        "pose_rmse_mm": rms(pose[late]),
        "worst_half_rmse_deg": worst_half_rms(log.time, rotation, log.scenario.duration),
        "worst_half_rmse_mm": worst_half_rms(log.time, position, log.scenario.duration),
        "settling_s": settling_time(log.time, pose, band) if log.reached_end else None,
        "torque_rms": rms(log["torque_applied"][late]),
        "torque_change_rms": torque_change_rms(log, late),
        "trace": {
            "time": _thinned(log.time, np.max),
            "pose_mm": _thinned(pose, np.max),
        },
    }


def measure_band(log: SimulationLog, frequency: float, axis: int, window: float) -> dict[str, Any]:
    """Amplitude ratio and phase over the end of a run.

    Args:
        log: The run; its reference is a sine of `frequency` on `axis`.
        frequency: [Hz].
        axis: 0..5.
        window: [s] of the end; whole periods.
    """
    empty: dict[str, Any] = dict.fromkeys(("ratio", "phase_deg", "rest"))
    row = {"end_time": log.end_time, "leg": log.leg, **empty}
    if not log.reached_end:
        return row
    rows = log.time > log.time[-1] - window + 1e-9
    reference, pose = log["reference"][rows, axis], log["pose"][rows, axis]
    response, rest = sine_response(log.time[rows], reference, pose, frequency)
    return {**row, "ratio": abs(response), "phase_deg": math.degrees(np.angle(response)), "rest": rest}


def _thinned(values: np.ndarray, of: Any) -> list[float]:
    parts = np.array_split(values, min(TRACE_POINTS, len(values))) if len(values) else []
    return [float(f"{of(part):.4g}") for part in parts]
