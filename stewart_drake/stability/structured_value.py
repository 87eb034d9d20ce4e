"""Structured singular value mu of complex matrices under diagonal complex perturbations, bounded from both sides.

mu(M) = 1 / min{|Delta| : det(I - M Delta) = 0, Delta diagonal}. Above it lies sigma_max(D M D^-1) for every positive
diagonal D, below it the spectral radius of Q M for every diagonal unitary Q. The upper bound is convex in log D.
Source: A. Packard, J. Doyle, "The complex structured singular value" (Automatica 29, 1993).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

_SWEEPS = 5
_POWER = 32.0
"""Of the singular values whose sum stands for the largest one: that alone has corners."""


def balanced(matrices: np.ndarray) -> np.ndarray:
    """The log D (..., n) that makes the Frobenius norm of D M D^-1 small, nearly the best for sigma_max too.

    E. Osborne, "On pre-conditioning of matrices" (J. ACM 7, 1960), row by row.
    """
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
    """The log D (n,) at which `upper_bound` of one matrix (n, n) is smallest, from one near it; never worse."""

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
    """sigma_max(D M D^-1) (...) of matrices (..., n, n) for log D (..., n); no mu is above it, whatever D."""
    return np.linalg.svd(_scaled(matrices, logs), compute_uv=False)[..., 0]


def lower_bound(matrix: np.ndarray, logs: np.ndarray) -> float:
    """Spectral radius of Q M (n, n), the larger of two unitary Q; mu is not below it.

    One Q is the identity, the other turns the left singular vector of D M D^-1 onto the right one, element by element:
    where the largest singular value is simple at the best D, that gives mu itself.
    """
    left, _, right = np.linalg.svd(_scaled(matrix, logs))
    turn = np.exp(-1j * np.angle(right[0] * left[:, 0]))
    return float(max(np.abs(np.linalg.eigvals(each)).max() for each in (matrix, turn[:, None] * matrix)))


def _scaled(matrices: np.ndarray, logs: np.ndarray) -> np.ndarray:
    return np.exp(logs[..., :, None] - logs[..., None, :]) * matrices
