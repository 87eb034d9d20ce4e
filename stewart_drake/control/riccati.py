"""LQI gains: the discrete algebraic Riccati equation of (26), (31), (32), by Drake or split into six small problems."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from stewart_drake.compiled.constants import SMALLEST_SINGULAR_VALUE, UNSETTLED
from stewart_drake.control.state_space import INTEGRAL, POSITION, RATE, STATES, Discretization
from stewart_drake.errors import ConfigurationError, RiccatiError, drake_guard

RiccatiSolver = Literal["drake", "split"]

_ITERATIONS = 60


def riccati_gain(a: np.ndarray, b: np.ndarray, r: np.ndarray, p: np.ndarray) -> np.ndarray:
    """K = (R + B' P B)^-1 B' P A, (31), for u = -K x.

    Raises:
        RiccatiError: R + B' P B is singular, as far as floating point can tell.
    """
    pb = p @ b
    try:
        return np.linalg.solve(r + b.T @ pb, pb.T @ a)
    except np.linalg.LinAlgError:
        raise RiccatiError("R + B' P B is singular: masses or weights lie too far apart") from None


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
        RiccatiError: Drake finds the pair not stabilisable or not detectable, or the matrices unusable; what it finds
            does not stabilise, as happens where weights lie too far apart for it.
        ConfigurationError: Drake is not installed.
    """
    try:
        from pydrake.math import DiscreteAlgebraicRiccatiEquation
    except ImportError:
        raise ConfigurationError("controller.solver", "drake", "split, where Drake is not installed") from None

    try:
        with drake_guard("discrete Riccati equation"):
            p = np.asarray(DiscreteAlgebraicRiccatiEquation(a, b, q, r))
    except Exception as error:
        raise RiccatiError(str(error)) from error
    # Drake loses digits with the spread of Q and R, and does not look at what is left.
    with np.errstate(all="ignore"):
        closed = a - b @ riccati_gain(a, b, r, p)
    radius = float(np.abs(np.linalg.eigvals(closed)).max()) if np.isfinite(closed).all() else math.inf
    if not radius < 1.0:
        raise RiccatiError(
            f"Drake's solution does not stabilise (spectral radius {radius:.6g}): the weights lie too far apart for "
            "it; solver: split bears them"
        )
    return p


def split_gain(
    acceleration_map: np.ndarray,
    period: float,
    weights: Sequence[float],
    method: Discretization = "exact",
    length: float = 1.0,
) -> np.ndarray:
    """LQI gain from six 3-state problems in the singular vectors of M^-1 tau; needs no Drake.

    With Q = diag(q_e I, q_v I, q_z I), R = r I and M^-1 tau = U S V', the coordinates U'e, U'e', U'z, V'u decouple; the
    six problems differ in s_i alone.

    Args:
        acceleration_map: (6, 6) M^-1 tau.
        period: [s] control period.
        weights: q_e, q_v, q_z, r, each > 0.
        method: As in `state_space.discretize`.
        length: [m] rotations in Q are multiplied by this; 1 is the paper, which weighs radians like metres.

    Returns:
        K (6, 18) in the paper's state order, u = -K x.

    Raises:
        RiccatiError: The map is singular, not finite or not (6, 6), a weight, the period or the length is not positive
            and finite, or the gains leave floating point.
    """
    if acceleration_map.shape != (6, 6):
        raise RiccatiError(f"M^-1 tau has the shape {acceleration_map.shape}; expected (6, 6)")
    if not np.isfinite(acceleration_map).all() or min(weights) <= 0.0 or not np.isfinite(weights).all():
        raise RiccatiError(f"no gain for weights {weights}: they and M^-1 tau must be finite, the weights positive")
    if not (0.0 < period < math.inf and 0.0 < length < math.inf):
        raise RiccatiError(f"no gain for a period of {period} s and a length of {length} m: both must be positive")
    scale = np.array([length] * 3 + [1.0] * 3)
    u, s, vt = np.linalg.svd(scale[:, None] * acceleration_map)
    if s[-1] <= SMALLEST_SINGULAR_VALUE * s[0]:
        raise RiccatiError(f"M^-1 tau is singular: singular values from {s[0]:.3g} down to {s[-1]:.3g}")
    chains = chain_gains(s, period, weights, method)
    if not np.isfinite(chains).all():
        raise RiccatiError(f"no finite gain for weights {weights} and singular values {s[0]:.3g} to {s[-1]:.3g}")
    gain = np.empty((6, STATES))
    for column, states in enumerate((POSITION, RATE, INTEGRAL)):
        gain[:, states] = (vt.T * chains[:, column]) @ (u.T * scale)
    return gain


def chain_gains(s: np.ndarray, period: float, weights: Sequence[float], method: Discretization = "exact") -> np.ndarray:
    """Optimal gains of chains of integrators z' = e, e' = v, v' = s u, sampled with period T.

    On the unit circle let x = (z - 1)(1/z - 1). The return difference times x^3 is a cubic in x. Each of its roots
    gives a stable pole z = 1 + d by d^2 + x d + x = 0, and the gains are read off the closed loop's polynomial in d
    (spectral factorisation, as for a single input in K. J. Astrom, B. Wittenmark, Computer-Controlled Systems). No
    digits are lost to fast sampling, where all poles crowd at z = 1, nor to weights far apart. Where two roots coincide
    to all digits half of the digits are.

    Args:
        s: (n,) > 0.
        period: [s].
        weights: q_e, q_v, q_z, r, each > 0.
        method: As in `state_space.discretize`.

    Returns:
        (n, 3) k_e, k_v, k_z of u = -(k_e e + k_v v + k_z z); NaN where the numbers leave floating point.
    """
    t, (q_e, q_v, q_z, r) = period, (float(w) for w in weights)
    s = np.asarray(s, dtype=float)
    with np.errstate(all="ignore"):
        g = s * s / r
        a0 = g * (q_z * t**6)
        if method == "exact":
            a1 = g * (q_e * t**4 - q_z * t**6 / 3.0)
            a2 = g * (q_v * t**2 - 0.25 * q_e * t**4 + q_z * t**6 / 36.0)
        else:
            a1, a2 = g * (q_e * t**4), g * (q_v * t**2)
        x = np.stack([_cubic_roots(*abc) for abc in zip(a2, a1, a0, strict=True)])
        # The roots of d^2 + x d + x are z - 1 and 1/z - 1; stable is the one with |1 + d| < 1.
        root = np.sqrt(x * x - 4.0 * x)
        large = -0.5 * np.where((x.conj() * root).real >= 0.0, x + root, x - root)
        small = x / large
        d = np.where(np.abs(1.0 + large) < np.abs(1.0 + small), large, small)
        c2 = -d.sum(axis=1).real
        c1 = (d[:, 0] * d[:, 1] + d[:, 0] * d[:, 2] + d[:, 1] * d[:, 2]).real
        c0 = -d.prod(axis=1).real
        if method == "exact":
            c2, c1 = c2 - 0.5 * (c1 - c0) - c0 / 6.0, c1 - c0
        return np.stack([c1 / (s * t * t), c2 / (s * t), c0 / (s * t**3)], axis=-1)


def _cubic_roots(a2: float, a1: float, a0: float) -> np.ndarray:
    """Roots of x^3 + a2 x^2 + a1 x + a0, a0 > 0, each to its own relative accuracy; (3,) complex.

    O. Aberth's simultaneous iteration (Math. Comp. 27 (1973) 339) from circles that the Newton polygon suggests
    (D. Bini, Numer. Algorithms 13 (1996) 179): the roots may lie twenty decades apart.
    """
    size, x, low = np.abs([a0, a1, a2, 1.0]), np.empty(3, complex), 0
    if not np.isfinite(size).all() or size[0] == 0.0:
        return np.full(3, np.nan, complex)
    while low < 3:
        radii = [(size[low] / size[k]) ** (1.0 / (k - low)) if size[k] > 0.0 else np.inf for k in range(low + 1, 4)]
        radius = min(radii)
        to = max(k for k, value in zip(range(low + 1, 4), radii, strict=True) if value == radius)
        for k in range(low, to):
            x[k] = radius * np.exp(1j * (2.0 * np.pi * (k - low) / (to - low) + 2.3 + 0.7 * k))
        low = to
    for _ in range(_ITERATIONS):
        moved = 0.0
        for i in range(3):
            value = ((x[i] + a2) * x[i] + a1) * x[i] + a0
            slope = (3.0 * x[i] + 2.0 * a2) * x[i] + a1
            if value == 0.0 or slope == 0.0:
                continue
            newton = value / slope
            bottom = 1.0 - newton * sum(1.0 / (x[i] - x[j]) for j in range(3) if j != i and x[j] != x[i])
            if bottom == 0.0:
                continue
            move = newton / bottom
            x[i] -= move
            moved = max(moved, abs(move) / abs(x[i]))
        if not moved > 1e-15:
            break
    return x if moved <= UNSETTLED else np.full(3, np.nan, complex)
