"""The nearest pose within all limits: sequential quadratic programming over the exact margins, compiled.

The search starts at a pose within the limits, and checks the way of every step, so that what it returns can be reached
from the start without leaving the limits.
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
FAR = 10.0
"""Relative margins beyond it count as equal."""
SPACING = 0.05
"""Distance between checked poses, over the robot's length."""
_CLEAR = 0.05  # Conditioning this far above its limit is only estimated, from below.
_DIFFERENCE = 1e-6  # Step of the margins' derivatives, over the robot's length.
_RADIUS, _SMALLEST = 0.25, 1e-5  # Largest and smallest step of the search, over the robot's length.
_STEPS, _CORRECTIONS, _SWEEPS = 12, 3, 40
_IMPROVEMENT = 1e-4  # Relative one at which the search ends.


class Space(Record):
    """A robot with its limits, and the metric of its poses."""

    robot: Robot
    limits: PoseLimits
    weight: float  # [m/rad] of turns against shifts.


class Probe(Record):
    """Margins at a pose, and their slopes."""

    legs: Legs
    measures: Measures
    margins: Annotated[np.ndarray, (104,)]  # Relative: lengths over the robot's, torques and speeds over their limits.
    margins_here: Annotated[np.ndarray, (104,)]  # Margins where the slopes are taken.
    slopes: Annotated[np.ndarray, (104, 6)]  # [1/m] by the metric's coordinates.
    pressure: Annotated[np.ndarray, (104,)]  # Multipliers of the margins.
    place: Annotated[np.ndarray, (104,)]  # Numbers of the margins that may matter in a step.
    square: Annotated[np.ndarray, (104,)]  # Squared slopes of these.


@njit
def at_rest(space: Space, pose: Vec6, probe: Probe) -> tuple[float, int]:
    """`least_margin` at rest, of structured arrays."""
    still = np.zeros(6)
    return least_margin(record(space), pose, still, still, record(probe))


@njit
def least_margin(space: Space, pose: Vec6, rate: Vec6, acceleration: Vec6, probe: Probe) -> tuple[float, int]:
    """Fills the relative margins of a pose in motion; the least and its number, minus infinity out of reach."""
    limits, measures, out = space.limits, probe.measures, probe.margins[:]
    enough, place, least = limits.conditioning + _CLEAR, 0, np.inf
    base, thickness = limits.base_reading[:], limits.thickness
    if not measure_motion(space.robot, base, thickness, pose, rate, acceleration, enough, probe.legs, measures):
        for i in range(6):
            out[i] = measures.reach_margin[i] - (1.0 - limits.reach)
            if not out[i] >= out[place]:
                place = i
        return -np.inf, place
    margins_of(limits, pose, measures, out)
    for j in range(MARGINS):
        if 26 <= j < 86:
            out[j] /= space.robot.length
        elif j >= 92:
            limit = limits.crank_speed if j < 98 else limits.torque[j - 98]
            out[j] = out[j] / limit if limit < np.inf else FAR
        out[j] = min(out[j], FAR)
        if not out[j] >= least:
            least, place = out[j], j
    return least, place


@njit
def difference(weight: float, pose: Vec6, target: Vec6, out: Vec6) -> float:
    """Way from a pose to a target in the metric [m]: the rotation vector in B times `weight` [m/rad], then the shift.

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
    angle, best = np.arctan2(sine, cosine), 0
    out[0], out[1], out[2] = x, y, z
    if sine < 1e-7 and cosine < 0.0:
        # Half a turn: the largest column of the sum of the matrix and the identity is along its axis.
        for k in range(1, 3):
            if turn[k, k] > turn[best, best]:
                best = k
        for k in range(3):
            out[k] = turn[k, best] + (1.0 if k == best else 0.0)
        sine = np.sqrt(dot(out[:3], out[:3]))
    factor, square = weight * (angle / sine if sine > 1e-12 else 0.5), 0.0
    for k in range(6):
        out[k] = factor * out[k] if k < 3 else target[k] - pose[k]
        square += out[k] * out[k]
    return np.sqrt(square)


@njit
def size_of(step: Vec6) -> float:
    """Length of a step in the metric [m]."""
    return np.sqrt(dot(step[:3], step[:3]) + dot(step[3:], step[3:]))


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
def slopes_at(space: Space, pose: Vec6, probe: Probe) -> None:
    """Fills the margins of a pose at rest as `margins_here`, and their slopes."""
    unit, still, near = np.zeros(6), np.zeros(6), np.empty(6)
    least_margin(space, pose, still, still, probe)
    copy_to(probe.margins_here[:], probe.margins[:])
    for k in range(6):
        step, unit[k] = _DIFFERENCE * space.robot.length, 1.0
        for _ in range(2):
            moved(space.weight, pose, unit, step, near)
            if least_margin(space, near, still, still, probe)[0] > -np.inf:
                break
            step = -step
        for j in range(MARGINS):
            slope = (probe.margins[j] - probe.margins_here[j]) / step
            probe.slopes[j, k] = slope if np.isfinite(slope) else 0.0
        unit[k] = 0.0


@njit
def project(probe: Probe, margins: Vector, reserve: float, step: Vec6) -> None:
    """Changes a step as little as possible so that all margins, linear in it, are at least a reserve.

    Hildreth's method: coordinate ascent on the multipliers.
    """
    size, count = size_of(step), 0
    for j in range(MARGINS):
        square = dot(probe.slopes[j, :3], probe.slopes[j, :3]) + dot(probe.slopes[j, 3:], probe.slopes[j, 3:])
        probe.pressure[j] = 0.0
        # The step never becomes more than twice as long, but where margins are broken.
        if square > 0.0 and margins[j] - reserve < 2.0 * np.sqrt(square) * size:
            probe.square[j], probe.place[count], count = square, j, count + 1
    for _ in range(_SWEEPS):
        most = 0.0
        for n in range(count):
            m = int(probe.place[n])
            row, value = probe.slopes[m], margins[m] - reserve
            for k in range(6):
                value += row[k] * step[k]
            change = max(-probe.pressure[m], -value / probe.square[m])
            if change != 0.0:
                probe.pressure[m] += change
                for k in range(6):
                    step[k] += change * row[k]
                most = max(most, abs(change) * np.sqrt(probe.square[m]))
        if most <= 1e-4 * size:
            break


@njit
def corrected(space: Space, reserve: float, pose: Vec6, probe: Probe) -> bool:
    """Moves a pose near the limits inside by a reserve, by the slopes of the probe; whether that succeeds."""
    still, step, near = np.zeros(6), np.empty(6), np.empty(6)
    for n in range(_CORRECTIONS + 1):
        least, _ = least_margin(space, pose, still, still, probe)
        if least >= reserve:
            return True
        if n == _CORRECTIONS or not least > -np.inf:
            break
        set_to(step, 0.0)
        project(probe, probe.margins[:], reserve + RESERVE, step)
        moved(space.weight, pose, step, 1.0, near)
        copy_to(pose, near)
    return False


@njit
def along(space: Space, start: Vec6, end: Vec6, probe: Probe, out: Vec6) -> bool:
    """The last checked pose within the limits on the straight line between poses; whether that is its end."""
    still, gap, pose = np.zeros(6), np.empty(6), np.empty(6)
    copy_to(out, start)
    for k in range(6):
        gap[k] = (end[k] - start[k]) * (space.weight if k < 3 else 1.0)
    count = int(np.ceil(size_of(gap) / (SPACING * space.robot.length)))
    for n in range(1, count + 1):
        for k in range(6):
            pose[k] = end[k] if n == count else start[k] + (end[k] - start[k]) * n / count
        if not least_margin(space, pose, still, still, probe)[0] >= RESERVE:
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
    for k in range(3):
        # Pitch is near already.
        out[k] -= 2.0 * np.pi * np.rint((out[k] - near[k]) / (2.0 * np.pi))


@njit
def nearest(space: Space, start: Vec6, target: Vec6, probe: Probe, out: Vec6) -> bool:
    """The nearest pose to a target that the search finds from a start within the limits; whether it is the target.

    The distance is sqrt(shift^2 + (weight turn)^2), with the angle of the turn between both orientations.
    """
    space, probe = record(space), record(probe)
    goal, step, tried = np.empty(6), np.empty(6), np.empty(6)
    far, last, before = np.empty(6), np.empty(6), np.zeros(6)
    canonical(target, start, goal)
    if along(space, start, goal, probe, out):
        return True
    length, is_new, curvature, share = space.robot.length, True, 1.0, 1.0
    radius, distance = _RADIUS * length, difference(space.weight, out, goal, far)
    for _ in range(_STEPS):
        if is_new:
            slopes_at(space, out, probe)
        copy_to(step, far)
        project(probe, probe.margins_here[:], RESERVE, step)
        size, square = size_of(step), size_of(before) ** 2
        if is_new and square > 0.0:
            # The curvature of the limits, from how the step has changed along the last one.
            product = dot(step[:3], before[:3]) + dot(step[3:], before[3:])
            curvature = max(1.0, (1.0 - product / square) / share)
        share = min(1.0 / curvature, radius / max(size, 1e-300))
        copy_to(before, step)
        moved(space.weight, out, step, share, tried)
        is_new = corrected(space, RESERVE, tried, probe)
        remaining = difference(space.weight, tried, goal, step)
        is_new = is_new and remaining < distance and along(space, out, tried, probe, last)
        if not is_new:
            radius *= 0.25
            if radius < _SMALLEST * length:
                break
            continue
        improvement = distance - remaining
        copy_to(out, tried)
        distance = difference(space.weight, out, goal, far)
        canonical(target, out, goal)
        if along(space, out, goal, probe, tried):
            copy_to(out, goal)
            return True
        if improvement < _IMPROVEMENT * distance:
            break
    return False
