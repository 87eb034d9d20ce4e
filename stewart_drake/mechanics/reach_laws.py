"""The nearest pose within all limits: sequential quadratic programming over the exact margins, compiled.

The search starts at a pose within the limits, and every step is checked along its way, so that what it returns can be
reached from the start without leaving the limits.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Record, Vec6, Vector, record
from stewart_drake.mechanics.kinematics_laws import Legs, Robot, dot, rate_of, roll_pitch_yaw, rotation
from stewart_drake.mechanics.linear_algebra import copy_to, set_to
from stewart_drake.mechanics.pose_margins import MARGINS, Measures, PoseLimits, margins_of, measure_motion

RESERVE = 1e-7
"""Least relative margin of a result, more than the rounding of another computation of it."""
_FAR = 10.0  # Relative margins beyond it count as equal.
_SPACING = 0.05  # Distance between checked poses, over the robot's length.
_CLEAR = 0.05  # Conditioning this far above its limit is only estimated, from below.
_DIFFERENCE = 1e-6  # Step of the margins' derivatives, over the robot's length.
_RADIUS, _SMALLEST = 0.25, 1e-5  # Largest and smallest step of the search, over the robot's length.
_STEPS, _CORRECTIONS, _SWEEPS = 16, 3, 40
_IMPROVEMENT = 1e-4  # Relative one at which the search ends.


class Probe(Record):
    """Margins at a pose, and their slopes."""

    margins: Annotated[np.ndarray, (104,)]  # Relative: lengths over the robot's, torques and speeds over their limits.
    slopes: Annotated[np.ndarray, (104, 6)]  # [1/m] by the metric's coordinates.
    pressure: Annotated[np.ndarray, (104,)]  # Multipliers of the margins.
    place: Annotated[np.ndarray, (104,)]  # Numbers of the margins that may matter in a step.
    square: Annotated[np.ndarray, (104,)]  # Squared slopes of these.


@njit
def least_margin(
    robot: Robot,
    limits: PoseLimits,
    pose: Vec6,
    rate: Vec6,
    acceleration: Vec6,
    legs: Legs,
    measures: Measures,
    out: Vector,
) -> tuple[float, int]:
    """Fills relative margins (104,) of a pose in motion; the least and its number, minus infinity out of reach."""
    enough = limits.conditioning + _CLEAR
    least, place = -np.inf, 0
    spans = measure_motion(robot, limits.gravity, limits.thickness, pose, rate, acceleration, enough, legs, measures)
    if not spans:
        for i in range(6):
            out[i] = measures.reach_margin[i]
            if not out[i] >= out[place]:
                place = i
        return least, place
    margins_of(limits, pose, measures, out)
    least = np.inf
    for j in range(MARGINS):
        if 26 <= j < 86:
            out[j] /= robot.length
        elif 92 <= j < 98:
            out[j] = out[j] / limits.crank_speed if limits.crank_speed < np.inf else _FAR
        elif j >= 98:
            out[j] = out[j] / limits.torque[j - 98] if limits.torque[j - 98] < np.inf else _FAR
        if out[j] > _FAR:
            out[j] = _FAR
        if not out[j] >= least:
            least, place = out[j], j
    return least, place


@njit
def at_rest(
    robot: Robot, limits: PoseLimits, pose: Vec6, legs: Legs, measures: Measures, probe: Probe
) -> tuple[float, int]:
    """The least relative margin of a pose at rest and its number; minus infinity out of reach."""
    still, margins = np.zeros(6), record(probe).margins[:]
    return least_margin(record(robot), record(limits), pose, still, still, record(legs), record(measures), margins)


@njit
def difference(weight: float, pose: Vec6, target: Vec6, out: Vec6) -> float:
    """Twist from a pose to a target in the metric [m]: the rotation vector in B times `weight` [m/rad], then the shift.

    Returns its size.
    """
    here, there, turn = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    rotation(pose[:3], here)
    rotation(target[:3], there)
    for i in range(3):
        for k in range(3):
            turn[i, k] = dot(there[i], here[k])
    x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    sine, cosine = np.sqrt(x * x + y * y + z * z), turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0
    angle = np.arctan2(sine, cosine)
    if sine > 1e-7:
        factor = angle / sine
        out[0], out[1], out[2] = factor * x, factor * y, factor * z
    elif cosine > 0.0:
        out[0], out[1], out[2] = 0.5 * x, 0.5 * y, 0.5 * z
    else:
        # Half a turn: the largest column of the sum of the matrix and the identity is along its axis.
        best = 0
        for k in range(1, 3):
            if turn[k, k] > turn[best, best]:
                best = k
        for k in range(3):
            out[k] = turn[k, best] + (1.0 if k == best else 0.0)
        size = np.sqrt(dot(out, out))
        for k in range(3):
            out[k] *= angle / size
    square = 0.0
    for k in range(6):
        out[k] = weight * out[k] if k < 3 else target[k] - pose[k]
        square += out[k] * out[k]
    return np.sqrt(square)


@njit
def moved(weight: float, pose: Vec6, step: Vec6, share: float, out: Vec6) -> None:
    """The pose (6,) after a share of a small step in the metric."""
    twist, rate = np.empty(6), np.empty(6)
    for k in range(6):
        twist[k] = step[k] / weight if k < 3 else step[k]
    rate_of(pose, twist, rate)
    for k in range(6):
        out[k] = pose[k] + share * rate[k]


@njit
def slopes_at(
    robot: Robot, limits: PoseLimits, weight: float, pose: Vec6, legs: Legs, measures: Measures, probe: Probe
) -> None:
    """Fills the slopes of the margins at a pose at rest, whose margins are in the probe."""
    unit, still, near, margins = np.zeros(6), np.zeros(6), np.empty(6), np.empty(MARGINS)
    for k in range(6):
        step = _DIFFERENCE * robot.length
        unit[k] = 1.0
        for _ in range(2):
            moved(weight, pose, unit, step, near)
            if least_margin(robot, limits, near, still, still, legs, measures, margins)[0] > -np.inf:
                break
            step = -step
        for j in range(MARGINS):
            slope = (margins[j] - probe.margins[j]) / step
            probe.slopes[j, k] = slope if np.isfinite(slope) else 0.0
        unit[k] = 0.0


@njit
def project(probe: Probe, margins: Vector, reserve: float, step: Vec6) -> None:
    """Changes a step as little as possible so that all margins, linear in it, are at least a reserve.

    Hildreth's method: coordinate ascent on the multipliers.
    """
    size, count = np.sqrt(dot(step[:3], step[:3]) + dot(step[3:], step[3:])), 0
    for j in range(MARGINS):
        square = dot(probe.slopes[j, :3], probe.slopes[j, :3]) + dot(probe.slopes[j, 3:], probe.slopes[j, 3:])
        probe.pressure[j] = 0.0
        # The step never becomes more than twice as long, but where margins are broken.
        if square > 0.0 and margins[j] - reserve < 2.0 * np.sqrt(square) * size:
            probe.square[j], probe.place[count], count = square, j, count + 1
    for _ in range(_SWEEPS):
        most = 0.0
        for n in range(count):
            j = int(probe.place[n])
            row, value = probe.slopes[j], margins[j] - reserve
            for k in range(6):
                value += row[k] * step[k]
            change = max(-probe.pressure[j], -value / probe.square[j])
            if change != 0.0:
                probe.pressure[j] += change
                for k in range(6):
                    step[k] += change * row[k]
                most = max(most, abs(change) * np.sqrt(probe.square[j]))
        if most <= 1e-4 * size:
            break


@njit
def along(
    robot: Robot,
    limits: PoseLimits,
    weight: float,
    start: Vec6,
    end: Vec6,
    legs: Legs,
    measures: Measures,
    margins: Vector,
    out: Vec6,
) -> bool:
    """The last checked pose within the limits on the straight line between poses; whether that is its end."""
    still, gap, pose = np.zeros(6), np.empty(6), np.empty(6)
    copy_to(out, start)
    square = 0.0
    for k in range(6):
        gap[k] = end[k] - start[k]
        square += (gap[k] * weight) ** 2 if k < 3 else gap[k] ** 2
    count = int(np.ceil(np.sqrt(square) / (_SPACING * robot.length)))
    for n in range(1, count + 1):
        for k in range(6):
            pose[k] = end[k] if n == count else start[k] + gap[k] * n / count
        if not least_margin(robot, limits, pose, still, still, legs, measures, margins)[0] >= RESERVE:
            return False
        copy_to(out, pose)
    return True


@njit
def canonical(target: Vec6, near: Vec6, out: Vec6) -> None:
    """The same pose with pitch within a quarter of a turn, and roll and yaw within half a turn of those of `near`."""
    copy_to(out, target)
    turn = np.empty((3, 3))
    if not abs(target[1]) <= 0.5 * np.pi:
        rotation(target[:3], turn)
        roll_pitch_yaw(turn, out[:3])
    for k in range(0, 3, 2):
        out[k] -= 2.0 * np.pi * np.round((out[k] - near[k]) / (2.0 * np.pi))


@njit
def nearest(
    robot: Robot,
    limits: PoseLimits,
    weight: float,
    start: Vec6,
    target: Vec6,
    legs: Legs,
    measures: Measures,
    probe: Probe,
    out: Vec6,
) -> bool:
    """The nearest pose to a target that the search finds from a start within the limits; whether it is the target.

    The distance is sqrt(shift^2 + (weight turn)^2), with the angle of the turn between both orientations.
    """
    robot, limits = record(robot), record(limits)
    legs, measures, probe = record(legs), record(measures), record(probe)
    goal, step, tried, far = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    still, margins, last = np.zeros(6), np.empty(MARGINS), np.empty(6)
    canonical(target, start, goal)
    if along(robot, limits, weight, start, goal, legs, measures, margins, out):
        return True
    radius, distance = _RADIUS * robot.length, difference(weight, out, goal, far)
    is_new, before, curvature, share = True, np.zeros(6), 1.0, 1.0
    for _ in range(_STEPS):
        if is_new:
            least_margin(robot, limits, out, still, still, legs, measures, probe.margins[:])
            slopes_at(robot, limits, weight, out, legs, measures, probe)
        copy_to(step, far)
        project(probe, probe.margins[:], RESERVE, step)
        # The curvature of the limits, from how the step has changed along the last one.
        product = square = size = 0.0
        for k in range(6):
            product += step[k] * before[k]
            square += before[k] * before[k]
            size += step[k] * step[k]
        if is_new and square > 0.0:
            curvature = max(1.0, (1.0 - product / square) / share)
        share = min(1.0 / curvature, radius / max(np.sqrt(size), 1e-300))
        for k in range(6):
            before[k] = step[k]
            step[k] *= share
        moved(weight, out, step, 1.0, tried)
        is_new = _corrected(robot, limits, weight, tried, legs, measures, probe, margins)
        remaining = difference(weight, tried, goal, step)
        is_new = is_new and remaining < distance
        is_new = is_new and along(robot, limits, weight, out, tried, legs, measures, margins, last)
        if not is_new:
            radius *= 0.25
            if radius < _SMALLEST * robot.length:
                break
            continue
        improvement = distance - remaining
        copy_to(out, tried)
        distance = difference(weight, out, goal, far)
        canonical(target, out, goal)
        if along(robot, limits, weight, out, goal, legs, measures, margins, tried):
            copy_to(out, goal)
            return True
        if improvement < _IMPROVEMENT * distance:
            break
    return False


@njit
def _corrected(
    robot: Robot,
    limits: PoseLimits,
    weight: float,
    pose: Vec6,
    legs: Legs,
    measures: Measures,
    probe: Probe,
    margins: Vector,
) -> bool:
    """Moves a pose near the limits inside, by the slopes of the probe; whether that succeeds."""
    still, step, near = np.zeros(6), np.empty(6), np.empty(6)
    for n in range(_CORRECTIONS + 1):
        least, _ = least_margin(robot, limits, pose, still, still, legs, measures, margins)
        if least >= RESERVE:
            return True
        if n == _CORRECTIONS or not least > -np.inf:
            return False
        set_to(step, 0.0)
        project(probe, margins, 2.0 * RESERVE, step)
        moved(weight, pose, step, 1.0, near)
        copy_to(pose, near)
    return False
