"""Density of a signal over a sliding window, (35), (36): how far a sample stands out from its recent mean."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from stewart_drake.config import Window, check_value
from stewart_drake.jit import fields, new_record, njit
from stewart_drake.part import Part

DensityKind = Literal["magnitude", "signed"]

MEAN_FLOOR = 1e-9
"""Window means below this, in the signal's unit, count as zero; the density is 1 there."""


@njit
def density_of(samples: Any, signed: bool, out: Any) -> None:
    """Density of the last sample of a window, (35), (36).

    `signed` is the print: x over the window's mean. Deviation: the print is singular where the signed sum crosses zero;
    the result is held within +-n there. Else |x| over the window's mean |x|, which lies in [0, n] by itself.

    Args:
        samples: (n, k) the window, oldest first, n <= m + 1 (fewer while it fills).
        signed: Kind of density.
        out: (k,) out [-].
    """
    count = samples.shape[0]
    for k in range(samples.shape[1]):
        total, last = 0.0, samples[count - 1, k]
        for row in range(count):
            total += samples[row, k] if signed else abs(samples[row, k])
        mean, value = total / count, last if signed else abs(last)
        out[k] = 1.0 if abs(mean) < MEAN_FLOOR else min(max(value / mean, -count), count)


@njit
def density_tick(window: Any, filled: Any, error: Any, torque: Any, signed: bool, out: Any) -> None:
    """`density_of` an error (6,) [rad, m] and a torque (6,) [N m] that slide into a window (m + 1, 12), oldest first.

    The last `filled` (1,) rows mean something. out: (12,) [-], of the errors, then of the torques.
    """
    rows = window.shape[0]
    for row in range(rows - 1):
        window[row] = window[row + 1]
    window[rows - 1, :6], window[rows - 1, 6:] = error, torque
    filled[0] = min(filled[0] + 1.0, float(rows))
    density_of(window[rows - int(filled[0]) :], signed, out)


def density(samples: np.ndarray, kind: DensityKind = "magnitude") -> np.ndarray:
    """`density_of` a window (n, k), oldest first."""
    check_value("density", kind, DensityKind)
    values = np.ascontiguousarray(samples, dtype=float)
    out = np.empty(values.shape[1])
    density_of(values, kind == "signed", out)
    return out


def density_part(window: int, kind: DensityKind) -> Part:
    """Densities of errors and torques over a window of m ticks as a part of a loop."""
    check_value("window", window, Window)
    check_value("density", kind, DensityKind)
    signed = kind == "signed"
    initial = new_record(fields(density=12, filled=(), window=(window + 1, 12)), density=1.0)

    def tick(error: np.ndarray, torque: np.ndarray, state: np.ndarray) -> None:
        # Field by field: a record with the window in it would have to be compiled for each length.
        density_tick(state["window"][0], state["filled"], error, torque, signed, state["density"][0])

    return Part("density", {"error": 6, "torque": 6}, ("density",), initial, tick)
