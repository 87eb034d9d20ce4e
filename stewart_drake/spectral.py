"""Spectral factors of third order: the stable half of what is symmetric in z and 1/z.

Sampled chains of integrators lead there; the gains of LQI and observer are read off such factors.
"""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import ITERATIONS, UNSETTLED


def spectral_factor(a2: np.ndarray, a1: np.ndarray, a0: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stable polynomials d^3 + c2 d^2 + c1 d + c0, d = z - 1, from cubics x^3 + a2 x^2 + a1 x + a0.

    With x = (z - 1)(1/z - 1): each root of the cubic gives a stable pole z = 1 + d by d^2 + x d + x = 0.

    Args:
        a2: (n,).
        a1: (n,).
        a0: (n,) > 0.

    Returns:
        c2, c1 and c0, (n,) each; NaN where the numbers leave floating point.
    """
    x = np.stack([_cubic_roots(*abc) for abc in zip(a2, a1, a0, strict=True)])
    with np.errstate(all="ignore"):
        # The roots of d^2 + x d + x are z - 1 and 1/z - 1; stable is the one with |1 + d| < 1.
        root = np.sqrt(x * x - 4.0 * x)
        large = -0.5 * np.where((x.conj() * root).real >= 0.0, x + root, x - root)
        small = x / large
        d = np.where(np.abs(1.0 + large) < np.abs(1.0 + small), large, small)
        c1 = (d[:, 0] * d[:, 1] + d[:, 0] * d[:, 2] + d[:, 1] * d[:, 2]).real
        return -d.sum(axis=1).real, c1, -d.prod(axis=1).real


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
    for _ in range(ITERATIONS):
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
