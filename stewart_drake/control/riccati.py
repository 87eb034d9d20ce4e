"""The paper's error dynamics with integral action, (19)-(29), and LQI gains: the Riccati equation of (26), (31), (32).

State order is the paper's: [phi, phi', theta, theta', psi, psi', X, X', Y, Y', Z, Z', z_1 .. z_6], errors throughout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, Literal

import numpy as np

from stewart_drake.base.errors import ConfigurationError, RiccatiError, drake_guard
from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Mat6, Mat6x3, Mat6x18, Vec3, Vec4, Vec6
from stewart_drake.mechanics.dynamics import ForceMapKind, force_map
from stewart_drake.mechanics.linear_algebra import set_to, singular_vectors, spectral_factor
from stewart_drake.robot import RobotParameters

AXES = 6
STATES = 18
RiccatiSolver = Literal["drake", "split"]
Chains = Annotated[np.ndarray, (6, 3, 3)]
Inputs = Annotated[np.ndarray, (6, 3, 1)]

POSITION = np.arange(0, 12, 2)
"""Indices of the six position errors in the 18 states."""
RATE = np.arange(1, 12, 2)
"""Indices of the six rate errors."""
INTEGRAL = np.arange(12, 18)
"""Indices of the six integrals."""


def mass_diagonal(robot: RobotParameters) -> np.ndarray:
    """Diagonal (6,) [kg m^2, kg] of M in (9): Ixx, Iyy, Izz, m, m, m of the platform alone.

    Deviation, kept from the paper: legs, gravity and gyroscopic terms are left out, and moments in B act on inertia in
    P.
    """
    return np.array([*np.diag(robot.central_inertia), *(robot.platform_mass,) * 3])


def acceleration_map(robot: RobotParameters, pose: np.ndarray, kind: ForceMapKind = "statics") -> np.ndarray:
    """M^-1 tau (..., 6, 6) of (10): second derivative of poses (..., 6) per unit torque, in the paper's model."""
    return force_map(robot, pose, kind) / mass_diagonal(robot)[:, None]


def state_matrix() -> np.ndarray:
    """A of (25), built from (21) and (24); (18, 18)."""
    matrix = np.zeros((STATES, STATES))
    matrix[POSITION, RATE] = 1.0
    matrix[INTEGRAL, POSITION] = 1.0
    return matrix


def input_matrix(acceleration_map: np.ndarray) -> np.ndarray:
    """B (..., 18, 6) of (25) from M^-1 tau (..., 6, 6). Deviation: (22) prints tau where (10) demands M^-1 tau."""
    matrix = np.zeros((*acceleration_map.shape[:-2], STATES, AXES))
    matrix[..., RATE, :] = acceleration_map
    return matrix


def output_matrix() -> np.ndarray:
    """C of (25): [C_bar, I], the six position errors plus their integrals; (6, 18)."""
    matrix = np.zeros((AXES, STATES))
    matrix[np.arange(AXES), POSITION] = 1.0
    matrix[np.arange(AXES), INTEGRAL] = 1.0
    return matrix


def discretize(a: np.ndarray, b: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Zero-order hold of x' = A x + B u over one control period.

    A of (25) is nilpotent, A^3 = 0, so that the matrix exponential is a polynomial of degree two.
    Deviation: the paper puts continuous A, B into the discrete equations (31), (32).

    Takes A (18, 18) [1/s], B (..., 18, 6), the period [s]; returns A_d and B_d of the same shapes.
    """
    identity = np.eye(a.shape[0])
    a2 = a @ a
    integral = period * identity + (period**2 / 2.0) * a + (period**3 / 6.0) * a2
    return identity + period * a + (period**2 / 2.0) * a2, integral @ b


SMALLEST_SINGULAR_VALUE = 1e-13
"""Smallest singular value over the largest one, of M^-1 tau, below which this map counts as singular."""


@cache  # An import from pydrake.math takes longer than a solution.
def equation_of_drake() -> Callable[..., np.ndarray]:
    """Drake's DiscreteAlgebraicRiccatiEquation; a ConfigurationError where Drake is not installed.

    Deviation: the standard equation; (32) as printed lacks a factor, and its sizes do not fit.
    """
    try:
        from pydrake.math import DiscreteAlgebraicRiccatiEquation
    except ImportError:
        raise ConfigurationError("controller.solver", "drake", "split, where Drake is not installed") from None
    return DiscreteAlgebraicRiccatiEquation


@njit
def chain_gain_of(p: Mat3, a: Mat3, b: Vec3, r: float, gain: Vec3) -> bool:
    """K = (r + b' P b)^-1 b' P A, (31), of a chain, see `chain_gain`; whether A - b K is stable.

    N = A - I is nilpotent, so that the closed loop's polynomial in d = z - 1 is d^3 + d^2 K b + d K N b + K N^2 b;
    stable by Routh's criterion for z = (1 + w) / (1 - w).
    """
    c, power = np.zeros(3), b.copy()
    set_to(gain, 0.0)
    for i in range(3):
        pb = p[i, 0] * b[0] + p[i, 1] * b[1] + p[i, 2] * b[2]
        r += b[i] * pb
        for k in range(3):
            gain[k] += pb * a[i, k]
    for k in range(3):
        gain[k] /= r
    for j in range(3):
        before = power.copy()
        for k in range(3):
            c[j] += gain[k] * before[k]
            power[k] = a[k, 0] * before[0] + a[k, 1] * before[1] + a[k, 2] * before[2] - before[k]
    w3, w2, w1 = 8.0 - 4.0 * c[0] + 2.0 * c[1] - c[2], 4.0 * c[0] - 4.0 * c[1] + 3.0 * c[2], 2.0 * c[1] - 3.0 * c[2]
    return w3 > 0.0 and w2 > 0.0 and w1 > 0.0 and c[2] > 0.0 and w2 * w1 > w3 * c[2]


@njit
def chain_gains_of(p: Chains, a: Mat3, b: Inputs, r: float, gains: Mat6x3) -> bool:
    """`chain_gain_of` six chains; whether all are stable."""
    stable = True
    for i in range(6):
        stable = chain_gain_of(p[i], a, b[i, :, 0], r, gains[i]) and stable
    return stable


@njit
def chain_gain(s: float, period: float, weights: Vec4, gain: Vec3) -> bool:
    """Optimal gain of a chain of integrators z' = e, e' = v, v' = s u, sampled with period T.

    The return difference on the unit circle is a cubic, see `spectral_factor`; the gain is read off the closed loop's
    polynomial in d = z - 1 (as for a single input in K. J. Astrom, B. Wittenmark, Computer-Controlled Systems).
    No digits are lost to fast sampling, where all poles crowd at z = 1, nor to weights far apart.

    Takes s > 0 per unit of u, T [s], and weights q_e, q_v, q_z, r > 0; gives k_e, k_v, k_z of
    u = -(k_e e + k_v v + k_z z). False if a gain overflows.
    """
    t, g = period, s * s / weights[3]
    pose, rate, integral = g * (weights[0] * t**4), g * (weights[1] * t**2), g * (weights[2] * t**6)
    lead = 1.0 / (1.0 + 0.25 * rate + integral / 576.0)
    b2, b1 = rate + 0.25 * pose + (7.0 / 144.0) * integral, pose + (5.0 / 12.0) * integral
    c2, c1, c0, low = spectral_factor(b2 * lead, b1 * lead, integral * lead)
    k_e, k_v = c1 + 0.5 * c0, c2 + 0.5 * c1 + c0 / 3.0
    gain[0], gain[1], gain[2] = k_e * low / (s * t * t), k_v * low / (s * t), c0 * low / (s * t**3)
    return np.isfinite(gain[0]) and np.isfinite(gain[1]) and np.isfinite(gain[2])


@njit
def decouple(acceleration_map: Mat6, length: float, left: Mat6, s: Vec6, right: Mat6) -> bool:
    """Singular vectors of M^-1 tau = U S V', rotations scaled by a length [m]; False if it is singular.

    Rows i of `left` and `right` become s_i u_i and v_i.
    """
    for i in range(6):
        for k in range(6):
            left[i, k] = acceleration_map[k, i] * (length if k < 3 else 1.0)
    singular_vectors(left, s, right, 1e-14)
    smallest, largest = s[0], s[0]
    for i in range(1, 6):
        smallest, largest = min(smallest, s[i]), max(largest, s[i])
    return smallest > SMALLEST_SINGULAR_VALUE * largest


@njit
def join(left: Mat6, s: Vec6, right: Mat6, length: float, chains: Mat6x3, gain: Mat6x18) -> None:
    """K (6, 18) in the paper's state order from gains (6, 3) k_e, k_v, k_z of six chains, see `decouple`."""
    for j in range(6):
        set_to(gain[j], 0.0)
        for k in range(6):
            scale = length if k < 3 else 1.0
            for i in range(6):
                both = scale * (right[i, j] * left[i, k] / s[i])
                gain[j, 2 * k] += both * chains[i, 0]
                gain[j, 2 * k + 1] += both * chains[i, 1]
                gain[j, 12 + k] += both * chains[i, 2]


@njit
def split_solution(acceleration_map: Mat6, length: float, period: float, weights: Vec4, gain: Mat6x18) -> bool:
    """LQI gain from six 3-state problems in the singular vectors of M^-1 tau.

    With Q = diag(q_e I, q_v I, q_z I), R = r I and M^-1 tau = U S V', the coordinates U'e, U'e', U'z, V'u decouple; the
    six problems differ in s_i alone.

    Rotations are multiplied by the length [m] in Q; 1 is the paper's, which weighs radians like metres. Period and
    weights as of `chain_gain`. `gain` becomes K in the paper's state order, u = -K x. False if the map is singular or a
    gain overflows.
    """
    left, s, right, chains = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty((6, 3))
    if not decouple(acceleration_map, length, left, s, right):
        return False
    for i in range(6):
        if not chain_gain(s[i], period, weights, chains[i]):
            return False
    join(left, s, right, length, chains, gain)
    return True


@cache
def _chain(period: float) -> tuple[np.ndarray, np.ndarray]:
    """A chain of integrators for s = 1, see `chain_gain`: its A_d (3, 3) and B_d (3, 1) for the states e, v, z."""
    return discretize(np.array([[0.0, 1.0, 0.0], [0.0] * 3, [1.0, 0.0, 0.0]]), np.eye(3)[:, 1:2], period)


def drake_gain(
    acceleration_map: np.ndarray, period: float, weights: Sequence[float], length: float = 1.0
) -> np.ndarray:
    """K (6, 18) as of `split_gain`, its six chains solved by Drake: a sixth of the time of one equation of 18 states.

    Raises:
        RiccatiError: The map is singular; Drake finds no solution, or one that does not stabilise, because the weights
            are too far apart.
        ConfigurationError: Drake is not installed.
    """
    left, s, right, gain = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.empty((6, 18))
    if not decouple(acceleration_map, length, left, s, right):
        raise _no_gain(acceleration_map, length, weights)
    (a, unit), q, r = _chain(period), np.zeros((3, 3)), np.full((1, 1), weights[3])
    q[0, 0], q[1, 1], q[2, 2] = weights[:3]
    b, p, chains, solve = s[:, None, None] * unit, np.empty((6, 3, 3)), np.empty((6, 3)), equation_of_drake()
    try:
        with drake_guard("discrete Riccati equation"):
            for i in range(6):
                p[i] = solve(a, b[i], q, r)
    except Exception as error:
        raise RiccatiError(str(error)) from error
    # Drake loses digits with the spread of Q and R, without a check.
    if not chain_gains_of(p, a, b, weights[3], chains):
        allowed = "the weights lie too far apart for it; solver: split bears them"
        raise RiccatiError(f"Drake's solution does not stabilise: {allowed}")
    join(left, s, right, length, chains, gain)
    return gain


def split_gain(
    acceleration_map: np.ndarray, period: float, weights: Sequence[float], length: float = 1.0
) -> np.ndarray:
    """`split_solution` with its input checked; K (6, 18) in the paper's state order, u = -K x.

    Raises:
        RiccatiError: A map that is singular or not (6, 6), a number that is not finite or not positive, or gains that
            overflow.
    """
    matrix, blocks, gain = np.array(acceleration_map, float, order="C"), np.array(weights, float), np.empty((6, 18))
    positive = np.array([*blocks, period, length])
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all() or not (np.isfinite(positive) & (positive > 0.0)).all():
        numbers = f"weights {weights}, a period of {period} s and a length of {length} m"
        raise RiccatiError(f"no gain for {numbers}: they must be positive and finite, M^-1 tau finite and (6, 6)")
    with np.errstate(all="ignore"):
        done = split_solution(matrix, length, period, blocks, gain)
    if not done:
        raise _no_gain(matrix, length, weights)
    return gain


def _no_gain(acceleration_map: np.ndarray, length: float, weights: Sequence[float]) -> RiccatiError:
    s = np.linalg.svd(np.array([length] * 3 + [1.0] * 3)[:, None] * acceleration_map, compute_uv=False)
    what = "M^-1 tau is singular" if s[-1] <= SMALLEST_SINGULAR_VALUE * s[0] else f"no finite gain for {weights}"
    return RiccatiError(f"{what}: singular values from {s[0]:.3g} down to {s[-1]:.3g}")
