"""Spectral factors of third order, in real arithmetic and positive numbers alone: no digit is lost.

Gains of regulator and observer are read off them. On the unit circle let z = (1 + s/2) / (1 - s/2), s imaginary. A
chain of three integrators with quadratic weights, and one observed through noise, lead to

    u^3 + b2 u^2 + b1 u + b0,   u = -s^2,   b2, b1 >= 0, b0 > 0,

which is p(s) p(-s) with p(s) = s^3 + c2 s^2 + c1 s + c0, roots on the left. Comparing coefficients, c0 = sqrt(b0),
c1 = sqrt(b1 + 2 c0 c2) and c2 = sqrt(b2 + 2 c1). In units in which c0 is one, the two together give c2 as a concave
function of itself with a slope of at most a quarter: Newton's method from above finds where it meets c2.
"""

from __future__ import annotations

from typing import NamedTuple

from stewart_drake.compiled.constants import NEWTON
from stewart_drake.mechanics.arrays import Array, namespace


class Factor(NamedTuple):
    """p(s) = s^3 + c2 s^2 + c1 s + c0.

    Attributes:
        c2: Of any shape, > 0.
        c1: Likewise.
        c0: Likewise.
    """

    c2: Array
    c1: Array
    c0: Array

    @property
    def low(self) -> Array:
        """p(s), written in d = z - 1 as s = d / (1 + d/2), times (1 + d/2)^3 and this leads with d^3."""
        return 1.0 / (1.0 + 0.5 * self.c2 + 0.25 * self.c1 + 0.125 * self.c0)


def spectral_factor(b2: Array, b1: Array, b0: Array) -> Factor:
    """Arrays of numpy or torch of one shape; not finite where the numbers leave floating point."""
    xp = namespace(b0)
    c0 = xp.sqrt(b0)
    unit = c0 ** (1.0 / 3.0)
    f2, f1 = b2 / (unit * unit), b1 / (unit * unit * unit * unit)
    y = 2.0 + xp.sqrt(f2) + xp.sqrt(2.0 * xp.sqrt(f1))
    for _ in range(NEWTON):
        root = xp.sqrt(f1 + 2.0 * y)
        to = xp.sqrt(f2 + 2.0 * root)
        y = y - (y - to) / (1.0 - 1.0 / (to * root))
    return Factor(unit * y, unit * unit * xp.sqrt(f1 + 2.0 * y), c0)


def chain_cubic(rate: Array, pose: Array, integral: Array) -> tuple[Array, Array, Array]:
    """b2, b1, b0 of a chain of three integrators under an exact hold, of s^2 q / r T^2, T^4, T^6."""
    lead = 1.0 / (1.0 + 0.25 * rate + integral / 576.0)
    b2, b1 = rate + 0.25 * pose + (7.0 / 144.0) * integral, pose + (5.0 / 12.0) * integral
    return b2 * lead, b1 * lead, integral * lead


def chain_read(factor: Factor) -> tuple[Array, Array, Array]:
    """Its gains of pose, rate and integral times s T^2, s T and s T^3."""
    c2, c1, c0 = factor
    low = factor.low
    return (c1 + 0.5 * c0) * low, (c2 + 0.5 * c1 + c0 / 3.0) * low, c0 * low


def filter_cubic(wandering: Array, white: Array) -> tuple[Array, Array, Array]:
    """b2, b1, b0 of the observer's filter, see `observer.kalman_gains` for the two."""
    return 0.25 * white + wandering / 16.0, white + 0.5 * wandering, wandering


def filter_read(factor: Factor, period: float) -> tuple[Array, Array, Array]:
    """Its gains to angle [-], rate [1/s] and surplus [1/s^2]."""
    c2, c1, c0 = factor
    low = factor.low
    return (c2 + 0.25 * c0) * low, c1 * low / period, c0 * low / period**2
