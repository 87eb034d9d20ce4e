"""Densities and the network's answer."""

from __future__ import annotations

import numpy as np
from numba import njit

from stewart_drake.density import MEAN_FLOOR


@njit(cache=True, error_model="numpy")
def density_tick(previous: np.ndarray, error: np.ndarray, torque: np.ndarray, signed: bool, result: np.ndarray) -> None:
    """References `density.push`, `density.density`.

    Args:
        previous: (13 + 12 (m + 1),) densities, rows filled, window with the oldest row first, of the tick before.
        error: (6,) [rad, m].
        torque: (6,) [N m].
        signed: Kind of density.
        result: out, of this tick.
    """
    rows = (previous.size - 13) // 12
    filled = min(int(previous[12]) + 1, rows)
    for k in range(13, previous.size - 12):
        result[k] = previous[k + 12]
    last = previous.size - 12
    for k in range(6):
        result[last + k], result[last + 6 + k] = error[k], torque[k]
    for k in range(12):
        total = 0.0
        for row in range(rows - filled, rows):
            value = result[13 + 12 * row + k]
            total += value if signed else abs(value)
        mean, value = total / filled, result[last + k] if signed else abs(result[last + k])
        result[k] = 1.0 if abs(mean) < MEAN_FLOOR else min(max(value / mean, -filled), filled)
    result[12] = filled


@njit(cache=True, error_model="numpy")
def weights(
    densities: np.ndarray, hidden: np.ndarray, hidden_bias: np.ndarray, out: np.ndarray, out_bias: np.ndarray,
    low: np.ndarray, high: np.ndarray, largest: float, result: np.ndarray,
) -> None:  # fmt: skip
    """Reference `network.TunerNetwork.weights`, with the scaling of the inputs folded into the hidden layer."""
    units = np.empty(hidden.shape[0])
    for i in range(hidden.shape[0]):
        value = hidden_bias[i]
        for k in range(hidden.shape[1]):
            density = densities[k]
            if density > largest:
                density = largest
            elif density < -largest:
                density = -largest
            value += hidden[i, k] * density
        units[i] = np.tanh(value)
    for i in range(out.shape[0]):
        value = out_bias[i]
        for k in range(out.shape[1]):
            value += out[i, k] * units[k]
        answer = 10.0**value
        if answer < low[i]:
            answer = low[i]
        elif answer > high[i]:
            answer = high[i]
        result[i] = answer
