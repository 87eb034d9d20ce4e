"""A filter that follows a stream of target poses within all limits, with bounded speed and acceleration, compiled.

In every tick it accelerates towards the target only if it could then still brake to rest on a straight line within the
limits; else it brakes. So whatever the target does, there is always a way to rest that was checked before.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec1, Vec2, Vec6, Vec18, record
from stewart_drake.mechanics.linear_algebra import all_finite, copy_to, largest_size
from stewart_drake.mechanics.reach_laws import (
    SPACING,
    Probe,
    Space,
    canonical,
    corrected,
    difference,
    least_margin,
    moved,
    project,
    size_of,
    slopes_at,
)

ROWS = 8
"""Rows that the filter keeps, for the reference between the time of its commands and now."""
_LOOK_AHEAD = 0.1  # Distance to the point that is aimed at, from where the platform can rest; over the robot's length.
_SHARES = 8  # Accelerations that are tried, each half as far from braking as the one before.
_TURNS = 4  # Corrections of a target: the angle of a rotation is only nearly in proportion to roll, pitch and yaw.
_LARGEST = 1e3  # [rad, m] larger targets are dropped.


class StreamParams(Record):
    """Numbers of a filter."""

    space: Space
    period: float  # [s]
    ahead: float  # [s] by which its targets are ahead of time.
    reserve: float  # Least relative margin of all limits.
    speed: Vec2  # [rad/s, m/s] largest speed: size of the rates of roll, pitch and yaw, and of the velocity.
    acceleration: Vec2  # [rad/s^2, m/s^2]
    home: Vec6  # [rad, m]
    workspace: Vec2  # [rad, m] largest distance of targets from home: angle of the rotation, and distance of P.


class StreamState(Record):
    """State of a filter."""

    rows: Annotated[np.ndarray, (8, 18)]  # Pose, rate and acceleration, constant in a period; the newest first.
    time: float  # [s] of the newest row.
    target: Vec6  # [rad, m] the last valid one.
    reference: Vec18  # Now.
    reference_ahead: Vec18  # When a command acts.


@njit
def row_after(row: Vec18, time: float, out: Vec18) -> None:
    """Pose, rate and acceleration after a time [s] of constant acceleration."""
    for k in range(6):
        rate, acceleration = row[6 + k], row[12 + k]
        out[k] = row[k] + rate * time + 0.5 * acceleration * time * time
        out[6 + k], out[12 + k] = rate + acceleration * time, acceleration


@njit
def _part_size(vector: Vec6, part: int) -> float:
    """Size of the turning part, 0, or of the shifting part, 1."""
    k = 3 * part
    return np.sqrt(vector[k] * vector[k] + vector[k + 1] * vector[k + 1] + vector[k + 2] * vector[k + 2])


@njit
def braking_ticks(params: StreamParams, rate: Vec6) -> float:
    """Ticks to rest, on a straight line."""
    slower = 0.0
    for part in range(2):
        slower = max(slower, _part_size(rate, part) / (params.acceleration[part] * params.period))
    return np.ceil(slower * (1.0 - 1e-9))


@njit
def _is_safe(params: StreamParams, row: Vec18, probe: Probe) -> bool:
    """Whether a pose in motion is within the limits for a period, and may brake to rest after it."""
    space, period, reserve = params.space, params.period, params.reserve
    pose, rate, braking, way = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    if not least_margin(space, row[:6], row[6:12], row[12:], probe)[0] >= reserve:
        return False
    later = np.empty(18)
    row_after(row, period, later)
    if not least_margin(space, later[:6], later[6:12], row[12:], probe)[0] >= reserve:
        return False
    ticks = braking_ticks(params, later[6:12])
    for k in range(6):
        braking[k] = -later[6 + k] / (ticks * period) if ticks > 0.0 else 0.0
        way[k] = 0.5 * later[6 + k] * ticks * period * (space.weight if k < 3 else 1.0)
    # In steps of equal length.
    count = int(np.ceil(2.0 * size_of(way) / (SPACING * space.robot.length)))
    for n in range(count + 1):
        left = np.sqrt(1.0 - n / count) if count > 0 else 0.0
        for k in range(6):
            rate[k] = left * later[6 + k]
            pose[k] = later[k] + 0.5 * later[6 + k] * ticks * period * (1.0 - left * left)
        if not least_margin(space, pose, rate, braking, probe)[0] >= reserve:
            return False
    return True


@njit
def _near_home(params: StreamParams, pose: Vec6) -> None:
    """Moves a pose (6,) towards home, into the workspace."""
    way, share = np.empty(6), np.empty(2)
    for _ in range(_TURNS):
        difference(1.0, params.home[:], pose, way)
        for part in range(2):
            size, most = _part_size(way, part), params.workspace[part]
            share[part] = most / size if size > most else 1.0
        if share[0] == 1.0 and share[1] == 1.0:
            return
        for k in range(6):
            pose[k] = params.home[k] + (share[0] if k < 3 else share[1]) * (pose[k] - params.home[k])


@njit
def _aim(params: StreamParams, target: Vec6, rest: Vec6, probe: Probe, out: Vec6) -> None:
    """A pose near one of rest (6,), within the limits, on the way to a target or along the limits."""
    space, step, still = params.space, np.empty(6), np.zeros(6)
    canonical(target, rest, out)
    _near_home(params, out)
    goal = out.copy()
    reserve = 1.5 * params.reserve
    distance, radius = difference(space.weight, rest, goal, step), _LOOK_AHEAD * space.robot.length
    if distance == 0.0:
        return
    for k in range(6):
        step[k] *= min(1.0, radius / distance)
    asked = size_of(step)
    slopes_at(space, rest, probe)
    project(probe, probe.margins_here[:], reserve, step)
    gap = size_of(step)
    for _ in range(_SHARES):
        moved(space.weight, rest, step, 1.0, out)
        if corrected(space, reserve, out, probe):
            is_free = distance <= radius and gap > asked * (1.0 - 1e-9)
            # Nothing is in the way: to the target itself, where the linear step has come to it.
            if is_free and least_margin(space, goal, still, still, probe)[0] >= params.reserve:
                copy_to(out, goal)
            return
        for k in range(6):
            step[k] *= 0.25
    copy_to(out, rest)


@njit
def next_row(params: StreamParams, target: Vec6, before: Vec18, probe: Probe, out: Vec18) -> None:
    """The row a period after another one: its acceleration brings the platform towards a target."""
    period, rest, goal, way = params.period, np.empty(6), np.empty(6), np.empty(6)
    asked, braking = np.empty(6), np.empty(6)
    row_after(before, period, out)
    ticks = braking_ticks(params, out[6:12])
    for k in range(6):
        braking[k] = -out[6 + k] / (ticks * period) if ticks > 0.0 else 0.0
        rest[k] = out[k] + 0.5 * out[6 + k] * ticks * period
    _aim(params, target, rest, probe, goal)
    for k in range(6):
        way[k] = goal[k] - out[k] - 0.5 * period * out[6 + k]
    # The largest speed on the way from which braking ends at the goal.
    per_way = 1.0 / period
    for part in range(2):
        size, most = _part_size(way, part), params.acceleration[part]
        if size > 0.0:
            speed = most * (np.sqrt(period * period + 2.0 * size / most) - period)
            per_way = min(per_way, min(speed, params.speed[part]) / size)
    for k in range(6):
        asked[k] = (per_way * way[k] - out[6 + k]) / period
    # Less of all at once, so that it does not leave the way.
    share = 1.0
    for part in range(2):
        share = min(share, params.acceleration[part] / max(_part_size(asked, part), 1e-300))
    for k in range(6):
        asked[k] *= share
    for _ in range(_SHARES):
        copy_to(out[12:], asked)
        if _is_safe(params, out, probe):
            return
        for k in range(6):
            asked[k] = 0.5 * (asked[k] + braking[k])
    copy_to(out[12:], braking)


@njit
def stream_tick(params: StreamParams, target: Vec6, time: Vec1, probe: Probe, state: StreamState) -> None:
    """Advances a filter to a time [s], with the newest target; what is no pose is dropped."""
    params, probe, state = record(params), record(probe), record(state)
    if all_finite(target) and largest_size(target) < _LARGEST:
        copy_to(state.target[:], target)
    late = time[0] + params.ahead
    for _ in range(int(max(0.0, np.floor((late - state.time) / params.period + 1e-9)))):
        for n in range(ROWS - 1, 0, -1):
            copy_to(state.rows[n], state.rows[n - 1])
        next_row(params, state.target[:], state.rows[1], probe, state.rows[0])
        state.time += params.period
    row_after(state.rows[0], late - state.time, state.reference_ahead[:])
    late_rows = int(max(0.0, min(ROWS - 1.0, np.ceil((state.time - time[0]) / params.period - 1e-9))))
    row_after(state.rows[late_rows], max(0.0, time[0] - state.time + late_rows * params.period), state.reference[:])


@njit
def stream_rows(params: StreamParams, targets: Vec6, probe: Probe, rows: Vec18) -> None:
    """Fills rows (n, 18) after the first, of targets (n, 6) at the times of the rows."""
    params, probe = record(params), record(probe)
    held = targets[0].copy()
    for n in range(1, len(rows)):
        if all_finite(targets[n]) and largest_size(targets[n]) < _LARGEST:
            copy_to(held, targets[n])
        next_row(params, held, rows[n - 1], probe, rows[n])
