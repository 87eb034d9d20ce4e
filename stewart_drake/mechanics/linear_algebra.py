"""Solves and singular values of 6 x 6 matrices, spectral factors of third order, derivatives of functions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Vector

JACOBI_SWEEPS = 30
"""Largest number of sweeps; six suffice."""
NEWTON_STEPS = 6
"""Steps of Newton's method; five reach full precision for all arguments."""
DIFFERENCE_STEP = 1e-5
"""Step of finite differences, in SI units: a compromise between truncation and rounding errors."""


@njit
def copy_to(out: Vector, values: Vector) -> None:
    """Copies a vector; `out[:] = values` would take numba seconds to compile.

    Pass slices of a record's fields, `field[:]`: they have the type of other arrays, so that one compiled copy does.
    """
    for k in range(len(out)):
        out[k] = values[k]


@njit
def set_to(out: Vector, value: float) -> None:
    """Sets all numbers of a vector."""
    for k in range(len(out)):
        out[k] = value


@njit
def multiply(left: Matrix, right: Matrix, out: Matrix) -> None:
    """Product of two matrices; `out` is another array than both."""
    for i in range(left.shape[0]):
        for k in range(right.shape[1]):
            value = 0.0
            for m in range(left.shape[1]):
                value += left[i, m] * right[m, k]
            out[i, k] = value


@njit
def largest_size(values: Vector) -> float:
    """Largest |value| of a vector; NaN if it has one."""
    largest = 0.0
    for k in range(len(values)):
        size = abs(values[k])
        if size > largest or np.isnan(size):
            largest = size
    return largest


@njit
def any_nonzero(values: Vector) -> bool:
    """Whether a vector has a number other than zero."""
    for k in range(len(values)):  # noqa: SIM110 - numba knows no generators here
        if values[k] != 0.0:
            return True
    return False


@njit
def all_finite(values: Vector) -> bool:
    """Whether all numbers of a vector are finite."""
    for k in range(len(values)):  # noqa: SIM110 - numba knows no generators here
        if not np.isfinite(values[k]):
            return False
    return True


@njit
def solve(matrix: Matrix, right: Matrix) -> float:
    """Gaussian elimination with partial pivoting, in place: `right` (n, k) becomes the solution, `matrix` is destroyed.

    Returns the sign of the determinant; 0 where a pivot is zero or not finite, and `right` is then meaningless.
    """
    n, k = right.shape
    sign = 1.0
    for i in range(n):
        best, row = -1.0, i
        for j in range(i, n):
            size = abs(matrix[j, i])
            if size > best:
                best, row = size, j
        if not (best > 0.0 and best < np.inf):
            return 0.0
        if row != i:
            sign = -sign
            for j in range(i, n):
                matrix[i, j], matrix[row, j] = matrix[row, j], matrix[i, j]
            for j in range(k):
                right[i, j], right[row, j] = right[row, j], right[i, j]
        if matrix[i, i] < 0.0:
            sign = -sign
        inverse = 1.0 / matrix[i, i]
        for j in range(i + 1, n):
            factor = matrix[j, i] * inverse
            if factor != 0.0:
                for m in range(i + 1, n):
                    matrix[j, m] -= factor * matrix[i, m]
                for m in range(k):
                    right[j, m] -= factor * right[i, m]
    for i in range(n - 1, -1, -1):
        for m in range(k):
            value = right[i, m]
            for j in range(i + 1, n):
                value -= matrix[i, j] * right[j, m]
            right[i, m] = value / matrix[i, i]
    return sign


@njit
def singular_vectors(matrix: Matrix, s: Vector, v: Matrix, tolerance: float) -> None:
    """Singular values by one-sided Jacobi rotations (Hestenes), in place.

    Small singular values keep their relative accuracy. They are not sorted.

    Args:
        matrix: (n, n), transposed: A'. Row i becomes s_i u_i, with A = sum of s_i u_i v_i'.
        s: (n,) singular values, out.
        v: (n, n), out; row i is v_i.
        tolerance: Cosine between rows at which they count as orthogonal. That is the relative error of equal singular
            values; that of others is its square.
    """
    n = matrix.shape[0]
    for i in range(n):
        for j in range(n):
            v[i, j] = 1.0 if i == j else 0.0
    for _ in range(JACOBI_SWEEPS):
        turned = False
        for i in range(n - 1):
            for j in range(i + 1, n):
                aa, bb, ab = 0.0, 0.0, 0.0
                for m in range(n):
                    x, y = matrix[i, m], matrix[j, m]
                    aa += x * x
                    bb += y * y
                    ab += x * y
                if ab * ab <= tolerance * tolerance * aa * bb:
                    continue
                turned = True
                zeta = (bb - aa) / (2.0 * ab)
                t = 1.0 / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                if zeta < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(1.0 + t * t)
                sine = c * t
                for m in range(n):
                    x, y = matrix[i, m], matrix[j, m]
                    matrix[i, m] = c * x - sine * y
                    matrix[j, m] = sine * x + c * y
                    x, y = v[i, m], v[j, m]
                    v[i, m] = c * x - sine * y
                    v[j, m] = sine * x + c * y
        if not turned:
            break
    for i in range(n):
        size = 0.0
        for m in range(n):
            size += matrix[i, m] * matrix[i, m]
        s[i] = np.sqrt(size)


@njit
def spectral_factor(b2: float, b1: float, b0: float) -> tuple[float, float, float, float]:
    """Spectral factor p(s) = s^3 + c2 s^2 + c1 s + c0; not finite where the numbers overflow.

    All arithmetic is real and of positive numbers, so that no digit is lost. Gains of regulator and observer follow
    from the factor. On the unit circle let z = (1 + s/2) / (1 - s/2), s imaginary. A chain of three integrators with
    quadratic weights, and one observed through noise, lead to

        u^3 + b2 u^2 + b1 u + b0 = p(s) p(-s),   u = -s^2,   b2, b1 >= 0, b0 > 0,

    with the roots of p on the left. Comparing coefficients, c0 = sqrt(b0), c1 = sqrt(b1 + 2 c0 c2) and
    c2 = sqrt(b2 + 2 c1). In units in which c0 is one, the last two give c2 as a fixed point of a concave function with
    a slope of at most a quarter; Newton's method from above finds it.

    Returns:
        c2, c1, c0, all > 0, and `low`: p(s), written in d = z - 1 as s = d / (1 + d/2), times (1 + d/2)^3 and `low`
        leads with d^3.
    """
    c0 = np.sqrt(b0)
    unit = c0 ** (1.0 / 3.0)
    f2, f1 = b2 / (unit * unit), b1 / (unit * unit * unit * unit)
    y = 2.0 + np.sqrt(f2) + np.sqrt(2.0 * np.sqrt(f1))
    for _ in range(NEWTON_STEPS):
        root = np.sqrt(f1 + 2.0 * y)
        to = np.sqrt(f2 + 2.0 * root)
        y -= (y - to) / (1.0 - 1.0 / (to * root))
    c2, c1 = unit * y, unit * unit * np.sqrt(f1 + 2.0 * y)
    return c2, c1, c0, 1.0 / (1.0 + 0.5 * c2 + 0.25 * c1 + 0.125 * c0)


def derivatives(function: Callable[[np.ndarray], np.ndarray], at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Value (m,) and derivative (m, n), by central differences."""
    columns = []
    for k, way in enumerate(DIFFERENCE_STEP * np.eye(len(at))):
        ahead, behind = at + way, at - way
        columns.append((function(ahead) - function(behind)) / (ahead[k] - behind[k]))
    return function(at), np.stack(columns, axis=-1)
