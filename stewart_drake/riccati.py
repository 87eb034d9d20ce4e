"""LQI gains: the discrete algebraic Riccati equation of (26), (31), (32), by Drake or split into six small problems."""

from __future__ import annotations

from typing import Literal

import numpy as np

from stewart_drake.errors import RiccatiError, drake_guard
from stewart_drake.state_space import INTEGRAL, POSITION, RATE, STATES, Discretization

RiccatiSolver = Literal["drake", "split"]


def riccati_gain(a: np.ndarray, b: np.ndarray, r: np.ndarray, p: np.ndarray) -> np.ndarray:
    """K = (R + B' P B)^-1 B' P A, (31), for u = -K x."""
    pb = p @ b
    return np.linalg.solve(r + b.T @ pb, pb.T @ a)


def solve_drake(a: np.ndarray, b: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Stabilising P of the discrete Riccati equation, by Drake.

    Deviation: (32) as printed has sizes that do not fit and lacks a factor; this is the standard equation with Q of
    (27).

    Args:
        a: (n, n) of x+ = A x + B u.
        b: (n, m).
        q: (n, n) positive semidefinite.
        r: (m, m) positive definite.

    Returns:
        (n, n).

    Raises:
        RiccatiError: Drake finds the pair not stabilisable or not detectable, or the matrices unusable.
    """
    from pydrake.math import DiscreteAlgebraicRiccatiEquation

    try:
        with drake_guard("discrete Riccati equation"):
            return np.asarray(DiscreteAlgebraicRiccatiEquation(a, b, q, r))
    except Exception as error:
        raise RiccatiError(str(error)) from error


def split_gain(
    acceleration_map: np.ndarray,
    period: float,
    weights: tuple[float, float, float, float],
    method: Discretization = "exact",
) -> np.ndarray:
    """LQI gain from six 3-state problems in the singular vectors of M^-1 tau; needs no Drake.

    With Q = diag(q_e I, q_v I, q_z I), R = r I and M^-1 tau = U S V', the coordinates U'e, U'e', U'z, V'u decouple; the
    six problems differ in r / s_i^2 alone. They are solved together by the structure-preserving doubling algorithm.

    Args:
        acceleration_map: (6, 6) M^-1 tau.
        period: [s] control period.
        weights: q_e, q_v, q_z, r, each > 0.
        method: As in `state_space.discretize`.

    Returns:
        K (6, 18) in the paper's state order, u = -K x.

    Raises:
        RiccatiError: The map is singular, not finite or not (6, 6), a weight is not positive and finite, or the
            doubling does not converge.
    """
    if acceleration_map.shape != (6, 6):
        raise RiccatiError(f"M^-1 tau has the shape {acceleration_map.shape}; expected (6, 6)")
    if not np.isfinite(acceleration_map).all() or min(weights) <= 0.0 or not np.isfinite(weights).all():
        raise RiccatiError(f"no gain for weights {weights}: they and M^-1 tau must be finite, the weights positive")
    u, s, vt = np.linalg.svd(acceleration_map)
    if s[-1] <= 1e-13 * s[0]:
        raise RiccatiError(f"M^-1 tau is singular: singular values from {s[0]:.3g} down to {s[-1]:.3g}")
    t, (q_e, q_v, q_z, r) = period, weights
    if method == "exact":
        a = np.array([[1.0, t, 0.0], [0.0, 1.0, 0.0], [t, t * t / 2.0, 1.0]])
        b = np.array([t * t / 2.0, t, t**3 / 6.0])
    else:
        a = np.array([[1.0, t, 0.0], [0.0, 1.0, 0.0], [t, 0.0, 1.0]])
        b = np.array([0.0, t, 0.0])
    q = np.diag([q_e, q_v, q_z])
    try:
        p = _doubling(a, np.outer(b, b) * (s * s / r)[:, None, None], q)
    except np.linalg.LinAlgError as error:
        raise RiccatiError(f"no gain for weights {weights}: {error}") from error
    pb = p @ b
    # In split coordinates the input matrix is s_i b.
    k = s[:, None] * (pb @ a) / (r + s * s * (pb @ b))[:, None]
    gain = np.empty((6, STATES))
    v = vt.T
    for column, states in enumerate((POSITION, RATE, INTEGRAL)):
        gain[:, states] = (v * k[:, column]) @ u.T
    return gain


def _doubling(a: np.ndarray, g: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Stabilising solutions of P = A' P (I + G P)^-1 A + H for a stack of G; (n, 3, 3).

    Structure-preserving doubling, E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, Int. J. Control 77 (2004) 767: A_k
    tends to zero quadratically, H_k to P.
    """
    identity = np.eye(3)
    a = np.broadcast_to(a, g.shape)
    h = np.broadcast_to(h, g.shape)
    for _ in range(60):
        w = identity + g @ h
        wa = np.linalg.solve(w, a)
        wg = np.linalg.solve(w, g)
        at = np.swapaxes(a, -1, -2)
        step = at @ h @ wa
        h = h + 0.5 * (step + np.swapaxes(step, -1, -2))
        grow = a @ wg @ at
        g = g + 0.5 * (grow + np.swapaxes(grow, -1, -2))
        a = a @ wa
        size = np.abs(h).max(axis=(-2, -1))
        if not np.isfinite(size).all():
            break
        if (np.abs(step).max(axis=(-2, -1)) <= 1e-16 * size).all():
            return h
    raise RiccatiError("the doubling algorithm did not converge in 60 steps")
