"""Density of a signal over a sliding window, (35), (36): how far a sample stands out from its recent mean."""

from __future__ import annotations

from typing import Literal

import numpy as np

from stewart_drake.compiled.constants import MEAN_FLOOR
from stewart_drake.errors import ConfigurationError
from stewart_drake.sampling import Sampled

DensityKind = Literal["magnitude", "signed"]

_SIGNALS = 12


def density(samples: np.ndarray, kind: DensityKind = "magnitude", scale: float | np.ndarray = 1.0) -> np.ndarray:
    """Density of the last sample of a window, (35), (36).

    `signed` is the print: x over the window's mean. Deviation: the print is singular where the signed sum crosses zero;
    the result is held within +-n there. `magnitude` is |x| over the window's mean |x|, which lies in [0, n] by itself.

    Args:
        samples: (n, k) the window, oldest first, n <= m + 1 (fewer while it fills).
        kind: `magnitude` or `signed`.
        scale: (k,) or scalar, size of each signal in its own unit, for the floor.

    Returns:
        (k,) [-].

    Raises:
        ConfigurationError: Another `kind`.
    """
    if kind == "magnitude":
        values = np.abs(samples)
    elif kind == "signed":
        values = samples
    else:
        raise ConfigurationError("density", kind, "magnitude or signed")
    count = len(values)
    mean = np.add.reduce(values, axis=0) / count
    flat = np.abs(mean) < MEAN_FLOOR * scale
    ratio = values[-1] / np.where(flat, 1.0, mean)
    return np.where(flat, 1.0, np.minimum(np.maximum(ratio, -count), count))


def push(window: np.ndarray, count: int, sample: np.ndarray) -> tuple[np.ndarray, int]:
    """Window with `sample` appended and, once it is full, the oldest dropped.

    Args:
        window: (m + 1, k); the last `count` rows are filled.
        count: Rows filled.
        sample: (k,).

    Returns:
        The new window (m + 1, k) and its count.
    """
    shifted = np.empty_like(window)
    shifted[:-1] = window[1:]
    shifted[-1] = sample
    return shifted, min(count + 1, len(window))


def density_part(window: int, kind: DensityKind, compiled: bool) -> Sampled:
    """Densities (12,) of errors (6,) and torques (6,) over a window of m ticks, tick by tick; compiled or not.

    Raises:
        ConfigurationError: A window below one tick.
    """
    if window < 1:
        raise ConfigurationError("window", window, "at least 1 tick")
    # Density, then rows filled, then the window.
    initial = np.concatenate([np.ones(_SIGNALS), [0.0], np.zeros((window + 1) * _SIGNALS)])
    if not compiled:

        def tick(error: np.ndarray, torque: np.ndarray, memory: np.ndarray) -> np.ndarray:
            old = memory[_SIGNALS + 1 :].reshape(-1, _SIGNALS)
            rows, filled = push(old, int(memory[_SIGNALS]), np.concatenate([error, torque]))
            return np.concatenate([density(rows[-filled:], kind), [filled], rows.ravel()])

        return Sampled(initial, tick)
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled.tuner import density_tick

    def fast(error: np.ndarray, torque: np.ndarray, memory: np.ndarray) -> np.ndarray:
        result = np.empty_like(memory)
        density_tick(memory, error, torque, kind == "signed", result)
        return result

    return Sampled(initial, fast)
