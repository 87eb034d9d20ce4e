"""LQI gains: the discrete algebraic Riccati equation of (26), (31), (32), by Drake or split into six small problems."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from stewart_drake.compiled.constants import SMALLEST_SINGULAR_VALUE
from stewart_drake.control.state_space import INTEGRAL, POSITION, RATE, STATES, Discretization
from stewart_drake.errors import ConfigurationError, RiccatiError, drake_guard
from stewart_drake.spectral import chain_cubic, chain_read, spectral_factor

RiccatiSolver = Literal["drake", "split"]


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

    The return difference on the unit circle is a cubic, see `spectral`; the gains are read off the closed loop's
    polynomial in d = z - 1 (as for a single input in K. J. Astrom, B. Wittenmark, Computer-Controlled Systems). No
    digits are lost to fast sampling, where all poles crowd at z = 1, nor to weights far apart.

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
        rate, pose, integral = g * (q_v * t**2), g * (q_e * t**4), g * (q_z * t**6)
        if method == "exact":
            k_e, k_v, k_z = chain_read(spectral_factor(*chain_cubic(rate, pose, integral)))
        else:
            lead = 1.0 / (1.0 + 0.25 * rate + 0.0625 * pose + integral / 64.0)
            b2, b1 = rate + 0.5 * pose + 0.1875 * integral, pose + 0.75 * integral
            factor = spectral_factor(b2 * lead, b1 * lead, integral * lead)
            c2, c1, c0 = (each * factor.low for each in factor)
            k_e, k_v, k_z = c1 + 1.5 * c0, c2 + c1 + 0.75 * c0, c0
        return np.stack([k_e / (s * t * t), k_v / (s * t), k_z / (s * t**3)], axis=-1)
