"""Margins of linear loops, broken at the six motors' torques: one motor at a time, and all at once.

S = (I + L)^-1 and T = I - S, L from a motor's torque round the loop. A motor i that gives f_i times what it is told to
leaves the loop stable for every f_i = (1 + d_i / 2) / (1 - d_i / 2) with complex |d_i| < alpha, the disk margin: alone
alpha = 1 / max|(S_ii - T_ii) / 2|, all at once alpha = 1 / max mu((S - T) / 2), mu for diagonal perturbations. Source:
P. Seiler, A. Packard, P. Gahinet, "An introduction to disk margins" (IEEE Control Systems 40(5), 2020), skew 0.
"""

from __future__ import annotations

import contextlib
from typing import NamedTuple

import numpy as np

from stewart_drake.stability.linear_loop import LinearLoops
from stewart_drake.stability.structured_value import balanced, lower_bound, refined, upper_bound

_SLOWEST = 0.1
"""Of the slowest closed-loop pole's frequency, where the grid of frequencies begins; it ends at Nyquist's."""
_MODAL_ERROR = 1e-7
"""Of responses by modes; loops whose modes are worse than that are solved one by one."""
_BLOCK = 50
"""Loops at once."""


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
    """Margins of each of the loops.

    Args:
        loops: At m poses, or of several settings at once, stacked.
        count: Frequencies, spaced evenly in their logarithm.
    """
    poles, modes = np.linalg.eig(loops.closed)
    radius = np.abs(poles).max(axis=-1)
    frequencies = _grid(poles, loops.period, count)
    responses = _Responses(loops, poles, modes, np.exp(1j * frequencies * loops.period))
    # What fits into a processor's cache.
    blocks = [np.arange(at, min(at + _BLOCK, len(radius))) for at in range(0, len(radius), _BLOCK)]
    parts = [_of_block(responses.sensitivity(rows), frequencies, radius[rows] < 1.0) for rows in blocks]
    single, all_at_once = (
        Margins(*map(np.concatenate, zip(*(part[k] for part in parts), strict=True))) for k in (0, 1)
    )
    not_above, at, curves = (np.concatenate([part[k] for part in parts]) for k in (2, 3, 4))
    return LoopMargins(radius, single, all_at_once, not_above, frequencies[at], frequencies, curves)


def _of_block(
    sensitivity: np.ndarray, frequencies: np.ndarray, stable: np.ndarray
) -> tuple[Margins, Margins, np.ndarray, np.ndarray, np.ndarray]:
    """One at a time, all at once, and of that the bound from above, the place on the grid and the curve."""
    single = _classical(np.einsum("mfii->mif", sensitivity), frequencies, stable)
    curves, logs, peak = _disks(sensitivity - 0.5 * np.eye(6))
    rows = np.arange(len(curves))
    not_above = 1.0 / lower_bound(sensitivity[rows, peak] - 0.5 * np.eye(6), logs[rows, peak])
    disk = curves.min(axis=-1)
    high = gain_of_disk(disk)
    delay = (_lag(curves, np.eye(6) - sensitivity, logs) / frequencies).min(axis=-1)
    found = Margins(disk, 1.0 / high, high, 2.0 * np.arctan(0.5 * disk), delay)
    return single, _where(stable, found), np.where(stable, not_above, 0.0), peak, np.where(stable[:, None], curves, 0.0)


def gain_of_disk(disk: np.ndarray) -> np.ndarray:
    """Largest factor of a disk (...); without end from alpha = 2 on. The smallest is its inverse."""
    with np.errstate(divide="ignore"):
        return np.where(disk < 2.0, (2.0 + disk) / (2.0 - disk), np.inf)


def _grid(poles: np.ndarray, period: float, count: int) -> np.ndarray:
    """Frequencies [rad/s] of all loops, from below the slowest pole to Nyquist's."""
    fast = np.abs(poles) > 1e-3
    rates = np.abs(np.log(np.where(fast, poles, 0.5))) / period
    slowest = np.clip(rates.min(), 1e-5 / period, 0.1 / period)
    return np.geomspace(_SLOWEST * slowest, np.pi / period, count)


class _Responses(NamedTuple):
    """Loops with the modes (m, n, n) of their closed loops, to be asked at points (f,) of the unit circle."""

    loops: LinearLoops
    poles: np.ndarray
    modes: np.ndarray
    points: np.ndarray

    def sensitivity(self, rows: np.ndarray) -> np.ndarray:
        """S (k, f, 6, 6) of some loops: I + C (z I - A - B C)^-1 B."""
        found = np.stack([self._by_modes(row) for row in rows])
        tried = np.array([0, len(self.points) // 2, len(self.points) - 1])
        error = np.abs(found[:, tried] - self._solved(rows, self.points[tried])).max(axis=(1, 2, 3))
        for k in np.flatnonzero(~(error <= _MODAL_ERROR)):
            found[k] = self._solved(rows[k : k + 1], self.points)[0]
        return found + np.eye(6)

    def _by_modes(self, row: int) -> np.ndarray:
        """C (z I - A - B C)^-1 B (f, 6, 6), one multiplication of matrices: (z - pole)^-1 times columns and rows."""
        into = np.full((self.modes.shape[-1], 6), np.nan + 0.0j)
        with contextlib.suppress(np.linalg.LinAlgError):
            into = np.linalg.solve(self.modes[row], self.loops.b[row].astype(complex))
        out = (self.loops.c[row] @ self.modes[row]).T
        parts = (out[:, :, None] * into[:, None, :]).reshape(-1, 36)
        found: np.ndarray = (1.0 / (self.points[:, None] - self.poles[row]) @ parts).reshape(-1, 6, 6)
        return found

    def _solved(self, rows: np.ndarray, points: np.ndarray) -> np.ndarray:
        """The same without modes, which may be hardly independent of each other."""
        closed = self.loops.closed[rows][:, None]
        left = points[:, None, None] * np.eye(closed.shape[-1]) - closed
        right = np.broadcast_to(self.loops.b[rows][:, None], (*left.shape[:-1], 6))
        solved: np.ndarray = self.loops.c[rows][:, None] @ np.linalg.solve(left, right)
        return solved


def _classical(own: np.ndarray, frequencies: np.ndarray, stable: np.ndarray) -> Margins:
    """Margins of single loops from their sensitivity (m, 6, f)."""
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
    return _where(stable[:, None], Margins(disk, np.exp(low), np.exp(high), phase, delay))


def _disks(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Disk margin (m, f) at each frequency, log D (m, f, 6), and where on the grid (m,) it is smallest.

    The upper bound of mu is refined at its peak, and again wherever that makes another frequency the peak.
    """
    logs = balanced(matrices)
    bound = upper_bound(matrices, logs)
    done = np.zeros(bound.shape, dtype=bool)
    rows = np.arange(len(bound))
    while True:
        peak = bound.argmax(axis=-1)
        left = np.flatnonzero(~done[rows, peak])
        if not len(left):
            return 1.0 / bound, logs, peak
        for place in zip(left, peak[left], strict=True):
            logs[place] = refined(matrices[place], logs[place])
        at = left, peak[left]
        bound[at], done[at] = upper_bound(matrices[at], logs[at]), True


def _lag(disks: np.ndarray, complementary: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Lag (m, f) [rad] that all motors together bear at each frequency, each up to that.

    The larger of two bounds: of the disk, and of 1 + d with |d| < 1 / mu(T). Where mu(T) < 1/2, no lag is too much.
    S, T and their difference have the same elements off the diagonal, so one log D balances them all.
    """
    size = upper_bound(complementary, logs)
    chord = np.arcsin(0.5 / np.maximum(size, 0.5))
    return np.where(size < 0.5, np.inf, 2.0 * np.maximum(chord, np.arctan(0.5 * disks)))


def _where(stable: np.ndarray, found: Margins) -> Margins:
    """The margins where a loop is stable, and those of one that has none elsewhere."""
    return Margins(*(np.where(stable, each, 1.0 if "gain" in name else 0.0) for name, each in found._asdict().items()))
