"""Spectral factors of third order, in real arithmetic and positive numbers alone: no digit is lost.

Gains of regulator and observer are read off them. On the unit circle let z = (1 + s/2) / (1 - s/2), s imaginary. A
chain of three integrators with quadratic weights, and one observed through noise, lead to

    u^3 + b2 u^2 + b1 u + b0,   u = -s^2,   b2, b1 >= 0, b0 > 0,

which is p(s) p(-s) with p(s) = s^3 + c2 s^2 + c1 s + c0, roots on the left. Comparing coefficients, c0 = sqrt(b0),
c1 = sqrt(b1 + 2 c0 c2) and c2 = sqrt(b2 + 2 c1). In units in which c0 is one, the two together give c2 as a concave
function of itself with a slope of at most a quarter: Newton's method from above finds where it meets c2.
"""

from __future__ import annotations

import numpy as np

from stewart_drake.jit import njit

NEWTON = 6
"""Steps of Newton's method: five find all digits whatever the numbers."""


@njit
def spectral_factor(b2: float, b1: float, b0: float) -> tuple[float, float, float, float]:
    """The factor p(s) = s^3 + c2 s^2 + c1 s + c0, not finite where the numbers leave floating point.

    Returns:
        c2, c1, c0, all > 0, and `low`: p(s), written in d = z - 1 as s = d / (1 + d/2), times (1 + d/2)^3 and `low`
        leads with d^3.
    """
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
