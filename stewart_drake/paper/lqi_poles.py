"""Gains of the LQI and what becomes of the error under them: closed-loop poles and decay."""

from __future__ import annotations

import itertools

import numpy as np

from stewart_drake.control.riccati import riccati_gain, solve_drake, split_gain
from stewart_drake.control.state_space import (
    AXES,
    STATES,
    Discretization,
    discretize,
    input_matrix,
    state_matrix,
)


def closed_loop(acceleration_map: np.ndarray, gain: np.ndarray, period: float) -> np.ndarray:
    """Eigenvalues (18,) of one tick of (25) under u = -gain x held over the tick; the exact sampled system."""
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), period)
    return np.asarray(np.linalg.eigvals(a - b @ gain))


def slowest_decay(eigenvalues: np.ndarray, period: float) -> float:
    """Rate [rad/s] at which the slowest mode decays; negative where it grows."""
    return float(-np.log(np.abs(eigenvalues).max()) / period)


def gain_of_ratio(
    acceleration_map: np.ndarray, period: float, ratio: float, method: Discretization = "exact"
) -> np.ndarray:
    """K (6, 18) of (31) for omega_Q / omega_R = ratio."""
    return split_gain(acceleration_map, period, (ratio, ratio, ratio, 1.0), method)


def gain_without_discretisation(acceleration_map: np.ndarray, ratio: float) -> np.ndarray:
    """K (6, 18) of the discrete (31) with the continuous A, B of (25) in it, as the paper's text has it."""
    a, b = state_matrix(), input_matrix(acceleration_map)
    q, r = ratio * np.eye(STATES), np.eye(AXES)
    return riccati_gain(a, b, r, solve_drake(a, b, q, r))


def riccati_residual(acceleration_map: np.ndarray, period: float, omega_q: float, omega_r: float) -> float:
    """What is left of the standard discrete Riccati equation at Drake's P, relative to P [-]."""
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), period)
    q, r = omega_q * np.eye(STATES), omega_r * np.eye(AXES)
    p = solve_drake(a, b, q, r)
    residual = q + a.T @ p @ a - a.T @ p @ b @ riccati_gain(a, b, r, p) - p
    return float(np.linalg.norm(residual) / np.linalg.norm(p))


def product_shape(*shapes: tuple[int, int]) -> tuple[int, int] | None:
    """Shape of a product of matrices; None where two neighbours do not fit."""
    for (_, columns), (rows, _) in itertools.pairwise(shapes):
        if columns != rows:
            return None
    return shapes[0][0], shapes[-1][1]


def channel_decay(strength: np.ndarray, weights: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> np.ndarray:
    """Slowest decay of one of the six channels into which the LQI splits, in continuous time.

    A channel is e'' = s u, z' = e with the cost q_e e^2 + q_v e'^2 + q_z z^2 + r u^2. Its closed-loop poles are the
    stable roots of p^6 - g (q_v p^4 - q_e p^2 + q_z), g = s^2 / r.

    Args:
        strength: (n,) g > 0.
        weights: q_e, q_v, q_z.

    Returns:
        (n,) [rad/s].
    """
    q_e, q_v, q_z = weights
    rates = np.empty(len(strength))
    for index, g in enumerate(strength):
        # In w = p^2, so that no root comes out on the wrong side by rounding.
        rates[index] = np.sqrt(np.roots([1.0, -g * q_v, g * q_e, -g * q_z]).astype(complex)).real.min()
    return rates


def decay_limit(weights: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> float:
    """Slowest decay that remains however cheap the torque: stable roots of q_v p^4 - q_e p^2 + q_z; [rad/s].

    sqrt(3) / 2 for equal weights.
    """
    q_e, q_v, q_z = weights
    return float(np.sqrt(np.roots([q_v, -q_e, q_z]).astype(complex)).real.min())


def faster_weights(factor: float) -> tuple[float, float, float]:
    """q_e, q_v, q_z under which `decay_limit` is `factor` times that of equal weights: time runs faster by that."""
    return 1.0, factor**-2, factor**2
