"""Margins of linear loops, opened at the six motors' torques: one motor at a time, and all at once.

S = (I + L)^-1 and T = I - S. With torques multiplied by f_i the loop is stable for all f_i = (1 + d_i / 2) / (1 - d_i /
2) with complex |d_i| < alpha = 1 / max mu((S - T) / 2), the disk margin. Sources: Seiler, Packard, Gahinet, IEEE
Control Systems 40(5), 2020, skew 0; for mu Packard, Doyle, Automatica 29, 1993.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance, schur
from scipy.optimize import minimize

from stewart_drake.analysis.linear_loop import LinearLoops

_SLOWEST = 0.1  # Lowest frequency of the grid over the slowest closed-loop pole; the highest is the Nyquist frequency.
_SWEEPS = 5
_POWER = 32.0  # Exponent p of the smooth approximation of the largest singular value by a p-norm.
HEADER = ("", "one motor: least", "5 %", "median", "all at once: least", "5 %", "median")


class Margins(NamedTuple):
    """Margins at m poses, (m,), or (m, 6) for the motors one at a time; 0, gains 1, where a loop is unstable."""

    disk: np.ndarray  # [-] alpha.
    gain_low: np.ndarray  # [-] smallest factor of a motor's gain.
    gain_high: np.ndarray  # [-] largest factor.
    phase: np.ndarray  # [rad].
    delay: np.ndarray  # [s] additional delay.


class LoopMargins(NamedTuple):
    """Margins of m loops."""

    radius: np.ndarray  # (m,) spectral radius of the closed loop; stable below 1.
    single: Margins  # One motor at a time, the others nominal; gain, phase and delay are the classical ones.
    all_at_once: Margins  # All motors vary independently within the margin; all follow from the disk.
    # (m,) [-] upper bound of the disk margin all at once; where it equals that of `all_at_once`, both are exact up to
    # the grid.
    not_above: np.ndarray
    frequency: np.ndarray  # (m,) [rad/s] of the smallest margin all at once.
    frequencies: np.ndarray  # (f,) [rad/s] of the grid.
    curves: np.ndarray  # (m, f) [-] disk margin all at once over frequency.


def loop_margins(loops: LinearLoops, count: int = 300) -> LoopMargins:
    """Margins of loops on a logarithmic grid of `count` frequencies."""
    poles = np.linalg.eigvals(loops.closed)
    radius = np.abs(poles).max(axis=-1)
    frequencies = _grid(poles, loops.period, count)
    points = np.exp(1j * frequencies * loops.period)
    matrices = zip(loops.closed, loops.b, loops.c, strict=True)
    results = [_of_loop(_sensitivity(*of_loop, points), frequencies) for of_loop in matrices]
    single, together, not_above, peak, curves = (np.array(column) for column in zip(*results, strict=True))
    stable = radius < 1.0
    none = np.array([0.0, 1.0, 1.0, 0.0, 0.0])
    one = Margins(*np.moveaxis(np.where(stable[:, None, None], single, none[:, None]), 1, 0))
    combined = Margins(*np.where(stable[:, None], together, none).T)
    not_above, curves = np.where(stable, not_above, 0.0), np.where(stable[:, None], curves, 0.0)
    return LoopMargins(radius, one, combined, not_above, frequencies[peak], frequencies, curves)


def gain_of_disk(disk: np.ndarray) -> np.ndarray:
    """Largest gain factor of a disk margin (...), infinite from alpha = 2 on. The smallest is its inverse."""
    with np.errstate(divide="ignore"):
        return np.where(disk < 2.0, (2.0 + disk) / (2.0 - disk), np.inf)


def _of_loop(sensitivity: np.ndarray, frequencies: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, int, np.ndarray]:
    """Fields of `Margins` (5, 6) one at a time, (5,) all at once, and `not_above`, index of the peak, curve."""
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
    # Balanced, because states of different units and sizes cost digits.
    scaled, (sizes, _) = matrix_balance(closed, permute=False, separate=True)
    triangle, turn = schur(scaled, output="complex")
    n = len(closed)
    into, x = turn.conj().T @ (b / sizes[:, None]), np.empty((n, len(points), 6), dtype=complex)
    for i in reversed(range(n)):
        x[i] = (into[i] + np.tensordot(triangle[i, i + 1 :], x[i + 1 :], 1)) / (points - triangle[i, i])[:, None]
    return np.eye(6) + np.moveaxis(np.tensordot(c * sizes @ turn, x, 1), 0, 1)


def _classical(sensitivity: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Fields of `Margins` (5, 6) of single loops from their sensitivity (6, f)."""
    disk = 1.0 / np.abs(sensitivity - 0.5).max(axis=-1)
    loop = 1.0 / sensitivity - 1.0
    # Logarithms are linear between points of the grid.
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
    # Angle from -1, in (0, 2 pi]: the lag that moves the loop onto it; 2 pi less it for a lead.
    turned = np.where(np.abs(bend) < np.pi, bend, bend - 2.0 * np.pi * np.sign(bend))
    lag = np.mod(angle[..., :-1] + share * turned, 2.0 * np.pi)
    at = np.exp(place[:-1] + share * np.diff(place))
    phase = np.where(unity, np.minimum(lag, 2.0 * np.pi - lag), np.inf).min(axis=-1)
    delay = np.where(unity, lag / at, np.inf).min(axis=-1)
    return np.array([disk, np.exp(low), np.exp(high), phase, delay])


def _disks(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Disk margin (f,), log D (f, 6), and the index of the peak of mu's upper bound, refined there."""
    logs = balanced(matrices)
    bound = upper_bound(matrices, logs)
    done = np.zeros(len(bound), dtype=bool)
    while not done[peak := int(bound.argmax())]:
        logs[peak], done[peak] = refined(matrices[peak], logs[peak]), True
        bound[peak] = upper_bound(matrices[peak], logs[peak])
    return 1.0 / bound, logs, peak


def _lag(disks: np.ndarray, complementary: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Lag (f,) [rad] that all motors may have at once: that of the disk, or of 1 + d with |d| < 1 / mu(T).

    S, T and their difference have the same off-diagonal elements, so one log D balances them all.
    """
    size = upper_bound(complementary, logs)
    chord = np.arcsin(0.5 / np.maximum(size, 0.5))
    return np.where(size < 0.5, np.inf, 2.0 * np.maximum(chord, np.arctan(0.5 * disks)))


def balanced(matrices: np.ndarray) -> np.ndarray:
    """Log D (..., n) of Osborne (J. ACM 7, 1960), which reduces the Frobenius norm of D M D^-1."""
    n = matrices.shape[-1]
    squares = np.abs(matrices) ** 2 * (1.0 - np.eye(n)) + np.finfo(float).tiny
    logs = np.zeros(squares.shape[:-1])
    for i in np.tile(np.arange(n), _SWEEPS):
        # Row i grows by e^2s, column i shrinks by it.
        step = 0.25 * np.log(squares[..., i].sum(axis=-1) / squares[..., i, :].sum(axis=-1))
        logs[..., i] += step
        squares[..., i, :] *= np.exp(2.0 * step)[..., None]
        squares[..., i] /= np.exp(2.0 * step)[..., None]
    return logs


def refined(matrix: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Log D (n,) that minimises `upper_bound` of a matrix, from a start; never worse."""

    def smooth(d: np.ndarray) -> tuple[float, np.ndarray]:
        """log(sum sigma^2p) / 2p of D M D^-1, and its derivative by log D."""
        left, sigma, right = np.linalg.svd(_scaled(matrix, d))
        share = (sigma / sigma[0]) ** (2.0 * _POWER)
        value = np.log(sigma[0]) + np.log(share.sum()) / (2.0 * _POWER)
        share /= share.sum()
        return float(value), (np.abs(left) ** 2) @ share - share @ (np.abs(right) ** 2)

    best: np.ndarray = minimize(smooth, logs, jac=True, method="BFGS", options={"gtol": 1e-4}).x
    return best if upper_bound(matrix, best) < upper_bound(matrix, logs) else logs


def upper_bound(matrices: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """sigma_max(D M D^-1) (...) of matrices (..., n, n) for log D (..., n), an upper bound of mu."""
    return np.linalg.svd(_scaled(matrices, logs), compute_uv=False)[..., 0]


def lower_bound(matrix: np.ndarray, logs: np.ndarray) -> float:
    """Lower bound of mu: spectral radius of Q M, the larger of two unitary Q, identity and one by singular vectors."""
    left, _, right = np.linalg.svd(_scaled(matrix, logs))
    turn = np.exp(-1j * np.angle(right[0] * left[:, 0]))
    return float(max(np.abs(np.linalg.eigvals(turned)).max() for turned in (matrix, turn[:, None] * matrix)))


def _scaled(matrices: np.ndarray, logs: np.ndarray) -> np.ndarray:
    return np.exp(logs[..., :, None] - logs[..., None, :]) * matrices


def quantities(results: LoopMargins, period: float) -> Iterator[tuple[str, str, np.ndarray, np.ndarray]]:
    """Margins: key, name with unit, (m,) of the worst single motor, (m,) of all at once; period [s]."""
    for key, name, field, scale in (
        ("disk", "disk margin [-]", "disk", 1.0),
        ("gain_low", "gain down to [-]", "gain_low", 1.0),
        ("gain_high", "gain up to [-]", "gain_high", 1.0),
        ("phase_deg", "phase [deg]", "phase", 180.0 / np.pi),
        ("delay_s", "delay [s]", "delay", 1.0),
        ("delay_ticks", "delay [ticks]", "delay", 1.0 / period),
    ):
        alone = getattr(results.single, field)
        worst = alone.max(axis=-1) if key == "gain_low" else alone.min(axis=-1)
        yield key, name, scale * worst, scale * getattr(results.all_at_once, field)


def spread(values: np.ndarray, most: bool) -> tuple[float, float, float]:
    """Worst of values (m,), their 5 % quantile, and the median; `most`: whether the largest is the worst."""
    worst, tail = (values.max(), 0.95) if most else (values.min(), 0.05)
    return float(worst), float(np.quantile(values, tail, method="inverted_cdf")), float(np.median(values))


def table(results: LoopMargins, period: float) -> list[tuple[str, ...]]:
    rows = []
    for key, name, alone, together in quantities(results, period):
        scale, name = (1e3, "delay [ms]") if key == "delay_s" else (1.0, name)
        numbers = (*spread(alone, key == "gain_low"), *spread(together, key == "gain_low"))
        rows.append((name, *(f"{scale * number:.3g}" for number in numbers)))
    return rows


def facts(loops: LinearLoops, results: LoopMargins) -> list[tuple[str, str]]:
    stable, worst = results.radius < 1.0, int(results.all_at_once.disk.argmin())
    pose = ", ".join(f"{coordinate:.4g}" for coordinate in loops.poses[worst])
    grid = results.frequencies
    rows = [
        ("stable", f"{stable.sum()} of {len(stable)} poses; spectral radius at most {results.radius.max():.5f}"),
        ("worst pose, all at once", f"{pose} [rad, m], at {results.frequency[worst]:.3g} rad/s"),
        ("bounds of mu", f"apart by at most {100.0 * gap(results):.2g} % where it decides"),
        ("frequencies", f"{len(grid)} from {grid[0]:.3g} to {grid[-1]:.4g} rad/s"),
    ]
    if loops.left_out:
        rows.append(("left out", f"{len(loops.left_out)} poses, such as: {loops.left_out[0]}"))
    return rows


def gap(results: LoopMargins) -> float:
    """[-] largest relative gap between the bounds of the disk margin all at once; 0 if no loop is stable."""
    stable = results.radius < 1.0
    return float(np.max(results.not_above[stable] / results.all_at_once.disk[stable] - 1.0, initial=0.0))


def document(loops: LinearLoops, results: LoopMargins) -> dict[str, object]:
    """The content of `table` and `facts` as plain values; None for an infinite margin."""

    def plain(values: np.ndarray, most: bool) -> list[float | None]:
        return [value if np.isfinite(value) else None for value in spread(values, most)]

    worst = int(results.all_at_once.disk.argmin())
    return {
        "poses": len(loops.poses),
        "left_out": len(loops.left_out),
        "stable": int((results.radius < 1.0).sum()),
        "spectral_radius": float(results.radius.max()),
        "period_s": loops.period,
        "worst_pose": loops.poses[worst].tolist(),
        "worst_frequency_rad_s": float(results.frequency[worst]),
        "bounds_apart": gap(results),
        "columns": ["worst", "all but 5 %", "median"],
        "margins": {
            key: {"one_motor": plain(alone, key == "gain_low"), "all_at_once": plain(together, key == "gain_low")}
            for key, _, alone, together in quantities(results, loops.period)
        },
    }
