"""Margins of linear loops, broken at the six motors' torques: one motor at a time, and all at once.

S = (I + L)^-1 and T = I - S, L from a motor's torque round the loop. A motor i that gives f_i times what it is told to
leaves the loop stable for every f_i = (1 + d_i / 2) / (1 - d_i / 2) with complex |d_i| < alpha, the disk margin: alone
alpha = 1 / max|(S_ii - T_ii) / 2|, all at once alpha = 1 / max mu((S - T) / 2), mu for diagonal perturbations. Source:
P. Seiler, A. Packard, P. Gahinet, "An introduction to disk margins" (IEEE Control Systems 40(5), 2020), skew 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance, schur

from stewart_drake.stability.linear_loop import LinearLoops
from stewart_drake.stability.structured_value import balanced, lower_bound, refined, upper_bound

_SLOWEST = 0.1
"""Of the slowest closed-loop pole's frequency, where the grid of frequencies begins; it ends at Nyquist's."""


class Margins(NamedTuple):
    """Margins at m poses; each (m,), or (m, 6) for the motors one at a time; 0, and gains 1, where a loop is unstable.

    Attributes:
        disk: [-] alpha.
        gain_low: [-] factor down to which a motor's gain may fall.
        gain_high: [-] factor up to which it may grow.
        phase: [rad].
        delay: [s] more than the loop has already.
    """

    disk: np.ndarray
    gain_low: np.ndarray
    gain_high: np.ndarray
    phase: np.ndarray
    delay: np.ndarray


class LoopMargins(NamedTuple):
    """What is known of m loops.

    Attributes:
        radius: (m,) spectral radius of the closed loop; stable below 1.
        single: One motor at a time, the others as they should be; gain, phase and delay are the classical ones.
        all_at_once: The motors differ at will, each within the margin; all follow from the disk.
        not_above: (m,) [-] what the disk margin all at once is certainly not above; where it meets that of
            `all_at_once`, both are exact but for the grid.
        frequency: (m,) [rad/s] at which all at once is smallest.
        frequencies: (f,) [rad/s] of the grid.
        curves: (m, f) [-] disk margin all at once at each frequency.
    """

    radius: np.ndarray
    single: Margins
    all_at_once: Margins
    not_above: np.ndarray
    frequency: np.ndarray
    frequencies: np.ndarray
    curves: np.ndarray


def loop_margins(loops: LinearLoops, count: int = 300) -> LoopMargins:
    """Margins of each of the loops, at so many frequencies, spaced evenly in their logarithm."""
    poles = np.linalg.eigvals(loops.closed)
    radius = np.abs(poles).max(axis=-1)
    frequencies = _grid(poles, loops.period, count)
    points = np.exp(1j * frequencies * loops.period)
    each = zip(loops.closed, loops.b, loops.c, strict=True)
    found = [_of_loop(_sensitivity(*matrices, points), frequencies) for matrices in each]
    single, together, not_above, peak, curves = (np.array(each) for each in zip(*found, strict=True))
    stable = radius < 1.0
    none = np.array([0.0, 1.0, 1.0, 0.0, 0.0])
    one = Margins(*np.moveaxis(np.where(stable[:, None, None], single, none[:, None]), 1, 0))
    every = Margins(*np.where(stable[:, None], together, none).T)
    not_above, curves = np.where(stable, not_above, 0.0), np.where(stable[:, None], curves, 0.0)
    return LoopMargins(radius, one, every, not_above, frequencies[peak], frequencies, curves)


def gain_of_disk(disk: np.ndarray) -> np.ndarray:
    """Largest factor of a disk (...); without end from alpha = 2 on. The smallest is its inverse."""
    with np.errstate(divide="ignore"):
        return np.where(disk < 2.0, (2.0 + disk) / (2.0 - disk), np.inf)


def _of_loop(sensitivity: np.ndarray, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, int, np.ndarray]:
    """Fields of `Margins` (5, 6) one at a time, (5,) all at once, and of that `not_above`, place of peak, and curve."""
    matrices = sensitivity - 0.5 * np.eye(6)
    curve, logs, peak = _disks(matrices)
    disk, high = curve[peak], gain_of_disk(curve[peak])
    delay = (_lag(curve, np.eye(6) - sensitivity, logs) / frequencies).min()
    together = np.array([disk, 1.0 / high, high, 2.0 * np.arctan(0.5 * disk), delay])
    single = _classical(np.diagonal(sensitivity, axis1=-2, axis2=-1).T, frequencies)
    return single, together, 1.0 / float(lower_bound(matrices[peak], logs[peak])), peak, curve


def _grid(poles: np.ndarray, period: float, count: int) -> np.ndarray:
    """Frequencies [rad/s] of all loops, from below the slowest pole to Nyquist's."""
    fast = np.abs(poles) > 1e-3
    rates = np.abs(np.log(np.where(fast, poles, 0.5))) / period
    slowest = np.clip(rates.min(), 1e-5 / period, 0.1 / period)
    return np.geomspace(_SLOWEST * slowest, np.pi / period, count)


def _sensitivity(closed: np.ndarray, b: np.ndarray, c: np.ndarray, points: np.ndarray) -> np.ndarray:
    """S (f, 6, 6) = I + C (z I - A - B C)^-1 B at points (f,) of the unit circle, by back substitution."""
    # States of other units and sizes cost digits, unless they are scaled alike before.
    scaled, (sizes, _) = matrix_balance(closed, permute=False, separate=True)
    triangle, turn = schur(scaled, output="complex")
    n = len(closed)
    into, x = turn.conj().T @ (b / sizes[:, None]), np.empty((n, len(points), 6), dtype=complex)
    for i in reversed(range(n)):
        x[i] = (into[i] + np.tensordot(triangle[i, i + 1 :], x[i + 1 :], 1)) / (points - triangle[i, i])[:, None]
    return np.eye(6) + np.moveaxis(np.tensordot(c * sizes @ turn, x, 1), 0, 1)


def _classical(own: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Fields of `Margins` (5, 6) of single loops from their sensitivity (6, f)."""
    disk = 1.0 / np.abs(own - 0.5).max(axis=-1)
    loop = 1.0 / own - 1.0
    # Between two points of the grid logarithms are taken as straight.
    size = np.log(np.maximum(np.abs(loop), np.finfo(float).tiny))
    angle, place = np.angle(-loop), np.log(frequencies)
    bend = np.diff(angle, axis=-1)
    crossing = (angle[..., 1:] * angle[..., :-1] <= 0.0) & (np.abs(bend) < np.pi)
    share = np.where(crossing, angle[..., :-1] / np.where(bend == 0.0, 1.0, -bend), 0.0)
    gain = size[..., :-1] + share * np.diff(size, axis=-1)
    high = np.where(crossing & (gain < 0.0), -gain, np.inf).min(axis=-1)
    low = np.where(crossing & (gain > 0.0), -gain, -np.inf).max(axis=-1)
    rise = np.diff(size, axis=-1)
    unity = size[..., 1:] * size[..., :-1] <= 0.0
    share = np.where(unity, size[..., :-1] / np.where(rise == 0.0, 1.0, -rise), 0.0)
    # The angle from -1, by which a lag turns the loop onto it: (0, 2 pi]; an advance is the other way round.
    turned = np.where(np.abs(bend) < np.pi, bend, bend - 2.0 * np.pi * np.sign(bend))
    lag = np.mod(angle[..., :-1] + share * turned, 2.0 * np.pi)
    at = np.exp(place[:-1] + share * np.diff(place))
    phase = np.where(unity, np.minimum(lag, 2.0 * np.pi - lag), np.inf).min(axis=-1)
    delay = np.where(unity, lag / at, np.inf).min(axis=-1)
    return np.array([disk, np.exp(low), np.exp(high), phase, delay])


def _disks(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Disk margin (f,) of matrices (f, 6, 6), log D (f, 6), and where on the grid it is smallest.

    The upper bound of mu is refined at its peak, and again wherever that makes another frequency the peak.
    """
    logs = balanced(matrices)
    bound = upper_bound(matrices, logs)
    done = np.zeros(len(bound), dtype=bool)
    while not done[peak := int(bound.argmax())]:
        logs[peak], done[peak] = refined(matrices[peak], logs[peak]), True
        bound[peak] = upper_bound(matrices[peak], logs[peak])
    return 1.0 / bound, logs, peak


def _lag(disks: np.ndarray, complementary: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Lag (f,) [rad] that all motors together bear at each frequency, each up to that.

    The larger of two bounds: of the disk, and of 1 + d with |d| < 1 / mu(T). Where mu(T) < 1/2, no lag is too much.
    S, T and their difference have the same elements off the diagonal, so one log D balances them all.
    """
    size = upper_bound(complementary, logs)
    chord = np.arcsin(0.5 / np.maximum(size, 0.5))
    return np.where(size < 0.5, np.inf, 2.0 * np.maximum(chord, np.arctan(0.5 * disks)))
