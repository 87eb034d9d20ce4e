"""Numbers from a log."""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.joint_pid import PidOptions
from stewart_drake.log import SimulationLog

INTEGRAL_TIME = 5.0
"""[s] when the paper looks at the integral states."""


def tracking_error(log: SimulationLog) -> np.ndarray:
    """Pose minus reference at every row, true pose; (n, 6) [rad, m]."""
    return log["pose"] - log["reference"]


def second_half(log: SimulationLog) -> np.ndarray:
    """(n,) mask of the rows in the second half of the planned duration."""
    return log.time >= 0.5 * log.scenario.duration - 1e-9


def run_metrics(log: SimulationLog) -> dict[str, Any]:
    """Figures of a run, ready for JSON.

    RMSE and peak are taken over the second half of the planned duration and are None where the run did not get there;
    torques are those within the motors' limits, over the whole run. Every key is always there.

    Returns:
        status, reason, message, end_time [s], leg; rmse_deg [3], rmse_mm [3], peak_deg [3], peak_mm [3]; torque_rms and
        torque_peak [N m] over all motors; saturated_fraction of ticks and motors at the limit; loop_gap_max_m;
        integral_at_5s [6] [rad s, m s] or None; omega_q, omega_r: mean over the run; omega_ratio: geometric
        mean of their ratio; real_time_factor; git_revision; versions.
    """
    error = tracking_error(log)[second_half(log)]
    metrics: dict[str, Any] = {
        "scenario": log.scenario.name,
        "status": log.status,
        "reason": log.reason,
        "message": log.message,
        "end_time": log.end_time,
        "leg": log.leg,
        "rmse_deg": None,
        "rmse_mm": None,
        "peak_deg": None,
        "peak_mm": None,
        "torque_rms": None,
        "torque_peak": None,
        "saturated_fraction": None,
        "loop_gap_max_m": None,
        "omega_q": None,
        "omega_r": None,
        "omega_ratio": None,
    }
    if len(error):
        rms, peak = np.sqrt(np.mean(error**2, axis=0)), np.abs(error).max(axis=0)
        metrics["rmse_deg"], metrics["rmse_mm"] = np.degrees(rms[:3]).tolist(), (1e3 * rms[3:]).tolist()
        metrics["peak_deg"], metrics["peak_mm"] = np.degrees(peak[:3]).tolist(), (1e3 * peak[3:]).tolist()
    if len(log.time):
        applied = log["torque_applied"]
        metrics["torque_rms"] = float(np.sqrt(np.mean(applied**2)))
        metrics["torque_peak"] = float(np.abs(applied).max())
        size, controller = np.abs(log["torque"]), log.scenario.controller
        limit = (
            controller.limit(log.scenario.robot)
            if isinstance(controller, PidOptions)
            else log.scenario.robot.effort_limit
        )
        # A controller that limits the torque itself asks for the limit and no more.
        at_limit = size > limit if getattr(controller, "saturation", "") == "none" else size >= limit
        metrics["saturated_fraction"] = float(np.mean(at_limit))
        metrics["loop_gap_max_m"] = float(log["loop_gap"].max())
    if len(log.time) and "weights" in log.signals:
        metrics["omega_q"], metrics["omega_r"] = log["weights"].mean(axis=0).tolist()
        metrics["omega_ratio"] = float(np.exp(np.mean(np.log(log["weights"][:, 0] / log["weights"][:, 1]))))
    metrics["integral_at_5s"] = integral_at(log, INTEGRAL_TIME)
    metrics["real_time_factor"] = log.end_time / log.wall_time if log.wall_time > 0.0 else None
    versions = dict(log.versions)
    metrics["git_revision"] = versions.pop("git_revision", None)
    metrics["versions"] = versions
    return metrics


def integral_at(log: SimulationLog, time: float) -> list[float] | None:
    """Integral states z (6,) [rad s, m s] at the last row at or before `time`; None where the run ended earlier."""
    if not len(log.time) or log.time[-1] < time - 1e-9:
        return None
    row = int(np.searchsorted(log.time, time + 1e-9)) - 1
    return log["integral"][row].tolist()
