"""Densities and the network's answer."""

from __future__ import annotations

import numpy as np

from stewart_drake.compiled.constants import MEAN_FLOOR
from stewart_drake.compiled.jit import njit


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
def weights(densities: np.ndarray, layers: np.ndarray, largest: float, result: np.ndarray) -> None:
    """Reference `network.TunerNetwork.weights`, with the scaling of the inputs folded into the hidden layer.

    Args:
        densities: (n,).
        layers: (h + k, n + 1): a row for each of h hidden units, its weights and bias; then a row for each of k
            outputs, h weights, bias, smallest and largest answer. One array, because each costs the caller time.
        largest: Densities are held within it.
        result: (k,) out; NaN where a density is not finite.
    """
    outputs = result.shape[0]
    hidden, inputs = layers.shape[0] - outputs, densities.shape[0]
    units, finite = np.empty(hidden), True
    for k in range(inputs):
        finite = finite and np.isfinite(densities[k])
    for i in range(hidden):
        value = layers[i, inputs]
        for k in range(inputs):
            value += layers[i, k] * min(max(densities[k], -largest), largest)
        units[i] = np.tanh(value)
    for i in range(outputs):
        row = layers[hidden + i]
        value = row[hidden]
        for k in range(hidden):
            value += row[k] * units[k]
        result[i] = min(max(10.0**value, row[hidden + 1]), row[hidden + 2]) if finite else np.nan
