"""Density of a signal over a sliding window, (35), (36): how far a sample stands out from its recent mean."""

from __future__ import annotations

from typing import Literal

import numpy as np

from stewart_drake.compiled.constants import MEAN_FLOOR
from stewart_drake.errors import ConfigurationError

DensityKind = Literal["magnitude", "signed"]


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
