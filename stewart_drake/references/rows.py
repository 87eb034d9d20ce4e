"""A smooth motion from the rows of a recording: even in time, low-passed, at rest at its last row."""

from __future__ import annotations

import itertools
import math
from functools import cached_property

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.references.motions import Curve
from stewart_drake.references.paced import risen, timed

CUTOFF = 20.0
"""[Hz] of the low pass: a head moves more slowly, and a loop of 50 Hz follows nothing faster."""
SETTLE = 0.25
"""[s] in which a motion slows down to rest."""
WINDOW = 1.0
"""[s] over which stamps are averaged."""
MOST_ROWS = 1_000_000
_ORDER = 4  # Order of the Butterworth filter, which runs forwards and backwards.
_PERIODS = 10.0  # Periods of the cutoff frequency after which the filter's transient has decayed.
_MIN_RATE = 2.2  # Rows per period of the cutoff, at least, for a filter.
_GAP = 1.95  # Median steps between two stamps with missing rows between them; jitter makes less than 2.


class RowsMotion:
    """A motion through rows of poses, for `moves`, `run` and `drive`.

    Rows at 2.2 times the cutoff or faster, for at least ten of its periods, are a signal. Their stamps are averaged
    over `WINDOW`, which removes jitter: no stamp moves by more than half of the median step. The poses are resampled on
    that step, and low-passed forwards and backwards, so without delay. Other rows are way points, as are all without a
    cutoff: a cubic spline passes through them. At the end the motion slows down along its path, to rest at its last
    row.

    Args:
        time: (n,) [s] of the rows, not decreasing.
        pose: (n, 6) [rad, m], angles without jumps.
        cutoff: [Hz] of the low pass; None for none.
        settle: [s] in which it slows down.
        name: For messages.
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

        # The mean, if most stamps repeat that of the row before.
        step = float(np.median(np.diff(time))) or float(time[-1] - time[0]) / (len(time) - 1)
        self.evened, self._cutoff, time = 0.0, cutoff, time - time[0]
        if is_signal := cutoff is not None and _MIN_RATE * cutoff * step < 1.0 and time[-1] * cutoff > _PERIODS:
            even = _evened(time, step)
            self.evened, time = float(np.abs(even - time).max()), even
        # The first of rows at the same time.
        time, new = np.unique(np.maximum.accumulate(time - time[0]), return_index=True)
        pose = pose[new]
        self.length = float(time[-1])
        """[s] from the first row to the last."""
        self.recorded: Curve = CubicSpline(time, pose)
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
        self._splines: tuple[Curve, ...] = spline, spline.derivative(1), spline.derivative(2)
        self._settle = min(settle, self.length)
        self.end = self.length + 0.5 * self._settle
        """[s] time from which it is at rest."""

    @cached_property
    def note(self) -> str:
        """Changes of stamps and poses, for reports; empty if negligible."""
        moved = self.rows(self._grid) - self.recorded(self._grid)
        far = 1e3 * np.linalg.norm(moved[:, 3:], axis=1), np.degrees(np.linalg.norm(moved[:, :3], axis=1))
        # Rounded to a tenth of a micrometre.
        (mm, most_mm), (deg, most_deg) = ((round(np.sqrt(np.mean(x**2)), 4), round(x.max(), 4)) for x in far)
        notes = [f"stamps evened by up to {1e3 * self.evened:.2g} ms"] if self.evened > 1e-4 else []
        if most_mm > 1e-2 or most_deg > 1e-2:
            most = f"at most {most_mm:.2g} mm, {most_deg:.2g} deg"
            notes.append(f"low-passed at {self._cutoff:g} Hz: moved by {mm:.2g} mm, {deg:.2g} deg RMS, {most}")
        return "; ".join(notes)

    def rows(self, time: np.ndarray) -> np.ndarray:
        """Poses (n, 6) at times [s] of the rows, before it slows down."""
        return np.asarray(self._splines[0](time))

    def rows_time(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time of the rows [s] at times from 0, its pace and the change of that [1/s]."""
        lost, pace, change = risen(time - (self.length - 0.5 * self._settle), self._settle)
        rows_time = np.where(time < self.end, np.clip(time - lost, 0.0, self.length), self.length)
        return rows_time, 1.0 - pace, -change

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration (..., 6) at times [s] from 0."""
        time = np.asarray(time, dtype=float)
        rows_time, pace, change = self.rows_time(time)
        pace, change = np.where(time < 0.0, 0.0, pace), np.where(time < 0.0, 0.0, change)
        pose, rate, acceleration = (spline(rows_time) for spline in self._splines)
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
