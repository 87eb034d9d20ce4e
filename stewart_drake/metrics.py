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
        status, reason, message, end_time [s], leg; safety: first trip of the safety layer, see `SimulationLog`;
        rmse_deg [3], rmse_mm [3], peak_deg [3], peak_mm [3]; torque_rms and
        torque_peak [N m] over all motors; saturated_fraction of ticks and motors at the limit; loop_gap_max_m;
        integral_at_5s [6] [rad s, m s] or None; omega_q, omega_r: mean over the run; omega_ratio: geometric
        mean of their ratio; real_time_factor; git_revision; versions; files: sha256
        of each file that the scenario names.
    """
    error = tracking_error(log)[second_half(log)]
    metrics: dict[str, Any] = {
        "scenario": log.scenario.name,
        "status": log.status,
        "reason": log.reason,
        "message": log.message,
        "end_time": log.end_time,
        "leg": log.leg,
        "safety": None if log.safety is None else dict(log.safety),
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
    metrics["files"] = dict(log.files)
    return metrics


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


def rms(values: np.ndarray) -> float | None:
    """Root mean square over everything; None for nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else None


def worst_half_rms(time: np.ndarray, values: np.ndarray, duration: float) -> float | None:
    """The larger RMS of the two halves of `duration`; None where the run did not reach the second.

    Args:
        time: (n,) [s].
        values: (n,).
        duration: [s] planned.
    """
    late = time >= 0.5 * duration - 1e-9
    halves = [rms(values[~late]), rms(values[late])]
    found = [half for half in halves if half is not None]
    return None if halves[1] is None else max(found)


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


def torque_change_rms(log: SimulationLog, rows: np.ndarray | None = None) -> float | None:
    """[N m] RMS change from tick to tick of the torques asked for, within the motors' limit.

    Args:
        log: A run.
        rows: (n,) mask of the rows to look at; None for all.

    Returns:
        None where the log does not have every tick, or fewer than two.
    """
    ratio = log.scenario.controller.period / log.scenario.effective_log_period
    stride = round(ratio)
    if stride < 1 or abs(ratio - stride) > 1e-9 * ratio:
        return None
    limit = log.scenario.robot.effort_limit
    ticks = np.clip(log["torque"], -limit, limit)[::stride]
    mask = np.ones(len(ticks), dtype=bool) if rows is None else rows[::stride]
    return rms(np.diff(ticks[mask], axis=0))


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
