"""The six 3-state Riccati equations of `riccati.split_gain`, each solved through its spectral polynomial."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import ITERATIONS, UNSETTLED
from stewart_drake.compiled.jit import njit


@njit(cache=True, error_model="numpy")
def spectral_factor(a2: float, a1: float, a0: float, c: np.ndarray) -> bool:
    """Reference `spectral.spectral_factor`.

    Args:
        a2: Of the cubic.
        a1: Likewise.
        a0: Likewise, > 0.
        c: (3,) out: c2, c1, c0.

    Returns:
        False where the iteration did not converge or left floating point.
    """
    if not (0.0 < a0 < np.inf and abs(a1) < np.inf and abs(a2) < np.inf):
        return False
    x = np.empty(3, np.complex128)
    _starts(a2, a1, a0, x)
    moved = np.inf
    for _ in range(ITERATIONS):
        moved = 0.0
        for i in range(3):
            z = x[i]
            value = ((z + a2) * z + a1) * z + a0
            slope = (3.0 * z + 2.0 * a2) * z + a1
            # Complex division by zero raises, whatever the error model; the other roots' moves lead out of it.
            if value == 0.0 or slope == 0.0:
                continue
            newton = value / slope
            pull = 0.0 + 0.0j
            for j in range(3):
                if j != i and z != x[j]:
                    pull += 1.0 / (z - x[j])
            bottom = 1.0 - newton * pull
            if bottom == 0.0:
                continue
            move = newton / bottom
            x[i] = z - move
            moved = max(moved, abs(move) / abs(x[i]))
        if not moved < np.inf:
            return False
        # The iteration is of third order: this step's length is the cube root of what is left.
        if moved < 1e-7:
            break
    # Roots that coincide are never still, but for that they are near.
    if moved > UNSETTLED:
        return False
    # d^2 + x d + x = 0 has the roots z - 1 and 1/z - 1; the stable one has |1 + d| < 1.
    d = np.empty(3, np.complex128)
    for i in range(3):
        root = np.sqrt(x[i] * x[i] - 4.0 * x[i])
        large = -0.5 * (x[i] + root) if (x[i].conjugate() * root).real >= 0.0 else -0.5 * (x[i] - root)
        if large == 0.0:
            return False
        small = x[i] / large
        d[i] = large if abs(1.0 + large) < abs(1.0 + small) else small
    c[0] = -(d[0] + d[1] + d[2]).real
    c[1] = (d[0] * d[1] + d[0] * d[2] + d[1] * d[2]).real
    c[2] = -(d[0] * d[1] * d[2]).real
    return True


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
        False where the iteration did not converge or left floating point.
    """
    t, g = period, s * s / r
    a0 = g * q_z * t**6
    if exact:
        a1 = g * (q_e * t**4 - q_z * t**6 / 3.0)
        a2 = g * (q_v * t**2 - 0.25 * q_e * t**4 + q_z * t**6 / 36.0)
    else:
        a1, a2 = g * q_e * t**4, g * q_v * t**2
    c = np.empty(3)
    if not spectral_factor(a2, a1, a0, c):
        return False
    c2, c1, c0 = c
    gain[0] = (c1 - c0) / (s * t * t) if exact else c1 / (s * t * t)
    gain[1] = (c2 - 0.5 * (c1 - c0) - c0 / 6.0) / (s * t) if exact else c2 / (s * t)
    gain[2] = c0 / (s * t**3)
    return np.isfinite(gain[0]) and np.isfinite(gain[1]) and np.isfinite(gain[2])


@njit(cache=True, error_model="numpy")
def _starts(a2: float, a1: float, a0: float, x: np.ndarray) -> None:
    """First guesses on the circles of the Newton polygon of x^3 + a2 x^2 + a1 x + a0; a0 > 0."""
    size = np.array([abs(a0), abs(a1), abs(a2), 1.0])
    low = 0
    while low < 3:
        best, to = np.inf, 3
        for k in range(low + 1, 4):
            if size[k] > 0.0:
                radius = (size[low] / size[k]) ** (1.0 / (k - low))
                if radius <= best:
                    best, to = radius, k
        for k in range(low, to):
            x[k] = best * np.exp(1j * (2.0 * np.pi * (k - low) / (to - low) + 2.3 + 0.7 * k))
        low = to
