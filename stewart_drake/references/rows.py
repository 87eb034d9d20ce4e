"""One motion from the rows of a recording: even in time, without noise above a frequency, at rest at its last row."""

from __future__ import annotations

import itertools
import math
from functools import cached_property
from typing import Any

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.references.paced import risen, timed

CUTOFF = 20.0
"""[Hz] of the low pass: most of what a head does is slower, and a loop of 50 Hz follows nothing that is faster."""
SETTLE = 0.25
"""[s] in which a motion slows down to rest."""
WINDOW = 1.0
"""[s] over which stamps are averaged."""
MOST_ROWS = 1_000_000
_ORDER = 4  # Of the Butterworth filter; it runs forwards and backwards.
_PERIODS = 10.0  # Of the cutoff, in which what the filter does at an end fades.
_FASTER = 2.2  # Rows a period of the cutoff from which on a filter is possible.
_GAP = 1.95  # Median steps between two stamps from which on rows are missing: jitter makes less than 2.


class RowsMotion:
    """A motion through rows of poses, for `moves`, `run` and `drive` alike.

    Rows of 2.2 times the cutoff or faster, for ten of its periods at least, are a signal. Their stamps are
    averaged over `WINDOW`, which moves none by more than half of the median step: so far it is jitter. The poses are
    resampled on that step, and low-passed forwards and backwards, so without delay. Other rows are way points, and so
    are all without a cutoff: a cubic spline passes through them as they are. At the end the motion slows down on its
    way, to rest at its last row.

    Args:
        time: (n,) [s] of the rows, which do not go back.
        pose: (n, 6) [rad, m], angles without jumps.
        cutoff: [Hz] of the low pass; None for none.
        settle: [s] in which it slows down.
        name: What messages call it.
    """

    def __init__(
        self,
        time: np.ndarray,
        pose: np.ndarray,
        cutoff: float | None = CUTOFF,
        settle: float = SETTLE,
        name: str = "move",
    ) -> None:
        from scipy.interpolate import CubicSpline, PchipInterpolator
        from scipy.signal import butter, sosfiltfilt

        # Where most stamps are those of the row before, the mean.
        step = float(np.median(np.diff(time))) or float(time[-1] - time[0]) / (len(time) - 1)
        self.evened, self._cutoff, time = 0.0, cutoff, time - time[0]
        if is_signal := cutoff is not None and _FASTER * cutoff * step < 1.0 and time[-1] * cutoff > _PERIODS:
            even = _evened(time, step)
            self.evened, time = float(np.abs(even - time).max()), even
        # Of rows at the same time the first.
        time, new = np.unique(np.maximum.accumulate(time - time[0]), return_index=True)
        pose = pose[new]
        self.length = float(time[-1])
        """[s] from the first row to the last."""
        self.recorded: Any = CubicSpline(time, pose)
        """Poses (n, 6) at times (n,) [s], before the low pass."""
        self._grid, spline = time, self.recorded
        if is_signal and cutoff is not None:
            steps = round(self.length / step)
            if steps > MOST_ROWS:
                gap = float(np.diff(time).max())
                raise ConfigurationError(name, f"a gap of {gap:g} s", "rows without so long a gap")
            self.recorded, self._grid = PchipInterpolator(time, pose), np.linspace(0.0, self.length, steps + 1)
            low_pass = butter(_ORDER, cutoff, fs=steps / self.length, output="sos")
            padding = min(math.ceil(_PERIODS / (cutoff * step)), steps)
            smooth = sosfiltfilt(low_pass, self.recorded(self._grid), axis=0, padlen=padding)
            spline = CubicSpline(self._grid, smooth)
        self._splines: tuple[Any, ...] = spline, spline.derivative(1), spline.derivative(2)
        self._settle = min(settle, self.length)
        self.end = self.length + 0.5 * self._settle
        """[s] from when on it is at rest."""

    @cached_property
    def note(self) -> str:
        """By how much stamps and poses were changed; empty where that is too little to tell."""
        moved = self.rows(self._grid) - self.recorded(self._grid)
        far = 1e3 * np.linalg.norm(moved[:, 3:], axis=1), np.degrees(np.linalg.norm(moved[:, :3], axis=1))
        # In texts down to a tenth of a micrometre.
        (mm, most_mm), (deg, most_deg) = ((round(np.sqrt(np.mean(x**2)), 4), round(x.max(), 4)) for x in far)
        notes = [f"stamps evened by up to {1e3 * self.evened:.2g} ms"] if self.evened > 1e-4 else []
        if most_mm > 1e-2 or most_deg > 1e-2:
            most = f"at most {most_mm:.2g} mm, {most_deg:.2g} deg"
            notes.append(f"low-passed at {self._cutoff:g} Hz: moved by {mm:.2g} mm, {deg:.2g} deg RMS, {most}")
        return "; ".join(notes)

    def rows(self, time: np.ndarray) -> np.ndarray:
        """Poses (n, 6) at times [s] of the rows, before it slows down."""
        return np.asarray(self._splines[0](time))

    def own_time(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """[s] of the rows at times from 0, the pace at which that goes, and its change [1/s]."""
        gone, pace, change = risen(time - (self.length - 0.5 * self._settle), self._settle)
        own = np.where(time < self.end, np.clip(time - gone, 0.0, self.length), self.length)
        return own, 1.0 - pace, -change

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration (..., 6) at times [s] from 0."""
        time = np.asarray(time, dtype=float)
        own, pace, change = self.own_time(time)
        pace, change = np.where(time < 0.0, 0.0, pace), np.where(time < 0.0, 0.0, change)
        pose, rate, acceleration = (spline(own) for spline in self._splines)
        return timed((pose, rate, acceleration), pace, change)


def _evened(time: np.ndarray, step: float) -> np.ndarray:
    """Stamps (n,) averaged between gaps, by lines through `WINDOW`, none moved by more than half a step."""
    from scipy.signal import savgol_filter

    even = time.copy()
    places = [0, *(np.flatnonzero(np.diff(time) > _GAP * step) + 1), len(time)]
    for first, end in itertools.pairwise(places):
        width = min(2 * round(0.5 * WINDOW / step) + 1, end - first - (end - first + 1) % 2)
        if width >= 3:
            even[first:end] = savgol_filter(time[first:end], width, 1, mode="interp")
    return np.clip(even, time - 0.5 * step, time + 0.5 * step)
