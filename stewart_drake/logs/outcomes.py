"""How a run ended, told by what happened in it and not by the clock; pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from stewart_drake.errors import RunFailure, SafetyStop
from stewart_drake.logs.rows import RunRows

Status = Literal["completed", "stopped", "lost", "failed", "interrupted", "unknown"]
"""completed: the controller was in charge to the end, and the motion was followed. stopped: the safety layer held the
robot at the end. lost: the controller was in charge, but the motion was not followed, see `Bounds`. failed: the run
broke midway. interrupted: the user ended it. unknown: of a log from a file that does not say."""

MUCH_SATURATION = 0.01
"""Share of torques at the limit above which there is a warning."""
POORLY_FOLLOWED = 0.5
"""Error over motion above which a run that was completed has a warning."""
LARGE_GAP = 0.1
"""Share of the position's RMSE above which the loop gap is a warning: errors are then known no better than that."""


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        status: See `Status`.
        reason: Stable name of what happened; None for completed.
        message: One line on it, or None; where a user's code raised, its traceback follows.
        time: [s] when it was decided; None for completed.
        leg: Leg 0..5 to which it belongs, or None.
    """

    status: Status
    reason: str | None = None
    message: str | None = None
    time: float | None = None
    leg: int | None = None


def told(status: str, reason: str | None, time: float | None = None) -> str:
    """How a run ended in a few words, such as `failed, crank_dead_centre at t = 0.650 s`."""
    words = status if reason in (None, status) else f"{status}, {reason}"
    return words if time is None else f"{words} at t = {time:.3f} s"


def judge(
    rows: RunRows, trip: Mapping[str, Any] | None, end_time: float, ended_by: RunFailure | KeyboardInterrupt | None
) -> Outcome:
    """How a run ended.

    Args:
        rows: Of every step of the plant.
        trip: First trip of the safety layer, see `safety.first_trip`, or None.
        end_time: [s] simulated time reached.
        ended_by: What ended the run before its time, or None.
    """
    if isinstance(ended_by, KeyboardInterrupt):
        return Outcome("interrupted", "interrupted", "stopped by the user", end_time)
    held = isinstance(ended_by, SafetyStop) and trip is not None and trip["last"] != "end"
    if ended_by is not None and not held:
        when = end_time if ended_by.time is None else ended_by.time
        text = "\n".join(filter(None, (str(ended_by), ended_by.traceback)))
        return Outcome("failed", ended_by.reason, text, when, ended_by.leg)
    by = None if trip is None else trip["stopped"] or rows.interventions()[1]
    if trip is not None and by is not None:
        text = str(ended_by) if held else f"{by['monitor']}: {trip['last'].replace('_', ' ')} when the time was up"
        return Outcome("stopped", by["monitor"], text, by["time"], by["leg"])
    bounds, left = rows.scenario.bounds, rows.left()
    if left:
        name = min(left, key=lambda name: float(left[name]["time"]))
        event = left[name]
        scale, unit = (math.degrees(1.0), "deg") if name == "rotation" else (1e3, "mm")
        bound, worst = (f"{scale * value:.4g} {unit}" for value in (getattr(bounds, name), event["worst"]))
        what = "the loops opened by more than" if name == "loop_gap" else f"the error in {name} went beyond"
        text = f"{what} {bound} at t = {event['time']:.3f} s; the largest was {worst}"
        return Outcome("lost", f"{name}_bound", text, event["time"], event["leg"])
    ratio = rows.motion_ratio
    if bounds.motion_ratio is not None and ratio is not None and not ratio >= bounds.motion_ratio:
        text = f"the platform moved by {ratio:.1%} of its reference's motion; bound {bounds.motion_ratio:.0%}"
        return Outcome("lost", "not_followed", text, end_time)
    ratio = rows.error_ratio
    if bounds.error_ratio is not None and ratio is not None and not ratio <= bounds.error_ratio:
        return Outcome("lost", "not_followed", f"{_error_over_motion(rows)}; bound {bounds.error_ratio:.3g}", end_time)
    return Outcome("completed")


def _error_over_motion(rows: RunRows) -> str:
    assert rows.worst_window is not None
    ratio, begin, end = rows.worst_window
    return f"from {begin:.4g} to {end:.4g} s the RMS error was {ratio:.3g} times the motion"


def find_warnings(status: Status, rows: RunRows, trip: Mapping[str, Any] | None) -> tuple[dict[str, Any], ...]:
    """What a reader of a run should know beside its outcome.

    Returns:
        name, time [s], number and text of each. safety_intervention: the safety layer took over and gave back, so many
        times. saturation: share of torques at the limit. loop_gap: largest gap over the RMSE of the position.
        poorly_followed: error over motion of a run that was completed all the same.
    """
    found: list[dict[str, Any]] = []

    def warn(name: str, time: float, number: float, text: str) -> None:
        found.append({"name": name, "time": float(time), "number": number, "text": text})

    if trip is not None and trip["last"] == "none":
        warn("safety_intervention", trip["time"], rows.interventions()[0], f"{trip['monitor']}, {trip['worst']}")
    if not rows.steps:
        return tuple(found)
    share = int(rows.at_limit.sum()) / (6 * rows.ticks)
    if share > MUCH_SATURATION:
        when = rows.time[int(rows.at_limit.any(axis=1).argmax())]
        warn("saturation", when, share, f"{share:.1%} of the torques are at their limit")
    gap, rmse = rows.largest["loop_gap"], rows.late_rms_norms[1] if rows.late_ticks else math.nan
    if gap > LARGE_GAP * rmse:
        ratio = float(gap / rmse) if rmse > 0.0 else math.inf
        when = rows.time[int(rows.sizes["loop_gap"].argmax())]
        warn("loop_gap", when, ratio, f"a gap of {gap:.2g} m is {ratio:.1%} of the RMSE of the position")
    error = rows.error_ratio
    if status == "completed" and error is not None and not error <= POORLY_FOLLOWED and rows.worst_window:
        warn("poorly_followed", rows.worst_window[1], error, _error_over_motion(rows))
    return tuple(found)
