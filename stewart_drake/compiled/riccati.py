"""Gains of the six chains of integrators into which an LQI splits, each through its spectral factor."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import NEWTON
from stewart_drake.compiled.jit import njit


@njit(cache=True, error_model="numpy")
def spectral_factor(b2: float, b1: float, b0: float) -> tuple[float, float, float, float]:
    """c2, c1, c0 and `low` of `spectral.Factor`; reference `spectral.spectral_factor`."""
    c0 = np.sqrt(b0)
    unit = c0 ** (1.0 / 3.0)
    f2, f1 = b2 / (unit * unit), b1 / (unit * unit * unit * unit)
    y = 2.0 + np.sqrt(f2) + np.sqrt(2.0 * np.sqrt(f1))
    for _ in range(NEWTON):
        root = np.sqrt(f1 + 2.0 * y)
        to = np.sqrt(f2 + 2.0 * root)
        y -= (y - to) / (1.0 - 1.0 / (to * root))
    c2, c1 = unit * y, unit * unit * np.sqrt(f1 + 2.0 * y)
    return c2, c1, c0, 1.0 / (1.0 + 0.5 * c2 + 0.25 * c1 + 0.125 * c0)


@njit(cache=True, error_model="numpy")
def chain_gain(
    s: float, period: float, q_e: float, q_v: float, q_z: float, r: float, exact: bool, gain: np.ndarray
) -> bool:
    """Gain u = -(k_e e + k_v v + k_z z) of one chain of integrators; reference, with derivation: `riccati.chain_gains`.

    Args:
        s: Singular value of the scaled M^-1 tau, > 0.
        period: [s].
        q_e: Weight of e, > 0.
        q_v: Weight of v, > 0.
        q_z: Weight of z, > 0.
        r: Weight of u, > 0.
        exact: Zero-order hold; else Euler.
        gain: (3,) out: k_e, k_v, k_z.

    Returns:
        False where the numbers leave floating point.
    """
    t, g = period, s * s / r
    rate, pose, integral = g * (q_v * t**2), g * (q_e * t**4), g * (q_z * t**6)
    if exact:
        lead = 1.0 / (1.0 + 0.25 * rate + integral / 576.0)
        b2, b1 = rate + 0.25 * pose + (7.0 / 144.0) * integral, pose + (5.0 / 12.0) * integral
    else:
        lead = 1.0 / (1.0 + 0.25 * rate + 0.0625 * pose + integral / 64.0)
        b2, b1 = rate + 0.5 * pose + 0.1875 * integral, pose + 0.75 * integral
    c2, c1, c0, low = spectral_factor(b2 * lead, b1 * lead, integral * lead)
    k_e, k_v = (c1 + 0.5 * c0, c2 + 0.5 * c1 + c0 / 3.0) if exact else (c1 + 1.5 * c0, c2 + c1 + 0.75 * c0)
    low /= s * t
    gain[0] = k_e * low / t
    gain[1] = k_v * low
    gain[2] = c0 * low / t**2
    return np.isfinite(gain[0]) and np.isfinite(gain[1]) and np.isfinite(gain[2])
