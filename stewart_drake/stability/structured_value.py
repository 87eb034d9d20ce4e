"""Structured singular value mu of complex matrices under diagonal complex perturbations, bounded from both sides.

mu(M) = 1 / min{|Delta| : det(I - M Delta) = 0, Delta diagonal}. Above it lies sigma_max(D M D^-1) for every positive
diagonal D, below it the spectral radius of Q M for every diagonal unitary Q. The upper bound is convex in log D.
Source: A. Packard, J. Doyle, "The complex structured singular value" (Automatica 29, 1993). All functions take stacks
(..., n, n).
"""

from __future__ import annotations

import numpy as np

_SWEEPS = 5
_POWERS = (4.0, 32.0, 256.0)
"""Of the singular values whose sum stands for the largest one, from smooth to sharp."""
_NEWTON_STEPS = 4
_DIFFERENCE = 1e-4
_SHARES = np.array([1.0, 0.5, 0.2, 0.05])
"""Lengths of a step that are tried."""
CLOSE = 1e-4
"""Bounds that are nearer to each other than this, as a share, need no more work."""


def balanced(matrices: np.ndarray) -> np.ndarray:
    """The log D (..., n) that makes the Frobenius norm of D M D^-1 as small as it gets, nearly.

    E. Osborne, "On pre-conditioning of matrices" (J. ACM 7, 1960), row by row.

    Args:
        matrices: (..., n, n) M.
    """
    squares = np.abs(matrices) ** 2
    n = squares.shape[-1]
    squares[..., np.arange(n), np.arange(n)] = 0.0
    squares += np.finfo(float).tiny
    logs = np.zeros(squares.shape[:-1])
    for _ in range(_SWEEPS):
        for i in range(n):
            # Row i grows by e^2s, column i shrinks by it.
            step = 0.25 * np.log(squares[..., i].sum(axis=-1) / squares[..., i, :].sum(axis=-1))
            logs[..., i] += step
            factor = np.exp(2.0 * step)[..., None]
            squares[..., i, :] *= factor
            squares[..., i] /= factor
    return logs - logs.mean(axis=-1, keepdims=True)


def upper_bound(matrices: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """sigma_max(D M D^-1) (...) for log D (..., n); no mu is above it, whatever D."""
    largest: np.ndarray = np.linalg.svd(_scaled(matrices, logs), compute_uv=False)[..., 0]
    return largest


def refined(matrices: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """The log D (..., n) at which `upper_bound` is smallest, nearly; never worse than at the start.

    Newton's method on log(sum sigma^2p) / 2p, which is convex and smooth, and comes near to log sigma_max as p grows;
    it ends where the lower bound is met.

    Args:
        matrices: (..., n, n) M.
        logs: (..., n) to start from, see `balanced`.
    """
    shape, n = logs.shape, logs.shape[-1]
    m, best = matrices.reshape(-1, n, n), logs.reshape(-1, n).copy()
    least = upper_bound(m, best)
    for power in _POWERS:
        left = np.flatnonzero(least > (1.0 + CLOSE) * lower_bound(m, best))
        d = best[left]
        for _ in range(_NEWTON_STEPS if len(left) else 0):
            d = _newton_step(m[left], d, power)
            now = upper_bound(m[left], d)
            better = now < least[left]
            best[left[better]], least[left[better]] = d[better], now[better]
    return best.reshape(shape)


def _newton_step(matrices: np.ndarray, logs: np.ndarray, power: float) -> np.ndarray:
    """The next log D (k, n), the best of several lengths of the step; where none is better, the same again."""
    n = logs.shape[-1]
    value, slope = _smooth(matrices, logs, power)
    sides = _DIFFERENCE * np.concatenate([np.eye(n), -np.eye(n)])
    slopes = _smooth(matrices[:, None], logs[:, None] + sides, power)[1]
    curvature = (slopes[:, :n] - slopes[:, n:]) / (2.0 * _DIFFERENCE)
    curvature = 0.5 * (curvature + curvature.swapaxes(-1, -2))
    # A common factor of all D changes nothing: without what is added the matrix would be singular.
    size = 1e-9 + np.abs(np.trace(curvature, axis1=-2, axis2=-1))[:, None, None] / n
    curvature = curvature + size * (1e-6 * np.eye(n) + 1.0 / n)
    step = -np.linalg.solve(curvature, slope[..., None])[..., 0]
    step /= np.maximum(1.0, np.abs(step).max(axis=-1, keepdims=True))
    tried = np.concatenate([logs[:, None], logs[:, None] + _SHARES[:, None] * step[:, None]], axis=1)
    values = np.concatenate([value[:, None], _smooth(matrices[:, None], tried[:, 1:], power)[0]], axis=1)
    return tried[np.arange(len(logs)), values.argmin(axis=1)]


def lower_bound(matrices: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """Spectral radius (...) of Q M, the larger of two unitary Q; no mu is below it.

    One Q is the identity, the other turns the left singular vector of D M D^-1 onto the right one, element by element:
    where the largest singular value is simple at the best D, that gives mu itself.

    Args:
        matrices: (..., n, n) M.
        logs: (..., n) log D, see `refined`.
    """
    left, _, right = np.linalg.svd(_scaled(matrices, logs))
    turn = right[..., 0, :].conj() * left[..., :, 0].conj()
    turn = np.where(np.abs(turn) > 0.0, turn / np.maximum(np.abs(turn), 1e-300), 1.0)
    return np.maximum(_radius(matrices), _radius(turn[..., None] * matrices))


def _scaled(matrices: np.ndarray, logs: np.ndarray) -> np.ndarray:
    scaled: np.ndarray = np.exp(logs[..., :, None] - logs[..., None, :]) * matrices
    return scaled


def _radius(matrices: np.ndarray) -> np.ndarray:
    largest: np.ndarray = np.abs(np.linalg.eigvals(matrices)).max(axis=-1)
    return largest


def _smooth(matrices: np.ndarray, logs: np.ndarray, power: float) -> tuple[np.ndarray, np.ndarray]:
    """log(sum sigma^2p) / 2p of D M D^-1, and its derivative (..., n) by log D."""
    left, sigma, right = np.linalg.svd(_scaled(matrices, logs))
    parts = (sigma / np.maximum(sigma[..., :1], 1e-300)) ** (2.0 * power)
    total = parts.sum(axis=-1)
    value = np.log(np.maximum(sigma[..., 0], 1e-300)) + np.log(total) / (2.0 * power)
    share = (parts / total[..., None])[..., None, :]
    rows = (share * np.abs(left) ** 2).sum(axis=-1)
    columns = (share.swapaxes(-1, -2) * np.abs(right) ** 2).sum(axis=-2)
    return value, rows - columns
