"""The picture of an identification."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stewart_drake.identification.identified import Identification
from stewart_drake.plotting import panels as look

_SHOWN = 20.0


def plot_identification(found: Identification, path: str | Path) -> None:
    """Each motor's torque and what is left of it, over the first seconds and over the crank's rate; a PNG."""
    figure, axes = look.panels(6, 2, 12.0, gridspec_kw={"width_ratios": [2, 1]})
    samples = found.samples
    predicted = samples.predicted(found.values)
    left = samples.torque - predicted
    first = samples.pieces[0]
    some = slice(first.start, first.start + int(_SHOWN / samples.step))
    for leg in range(6):
        over_time, over_rate = axes[leg]
        used = samples.used[some, leg]
        over_time.plot(samples.time[some], samples.torque[some, leg], color=look.BLUE, label="torque", linewidth=1.0)
        rest = np.where(used, left[some, leg], np.nan)
        over_time.plot(samples.time[some], rest, color=look.ORANGE, label="left", linewidth=1.0)
        sticks = np.where(used, np.nan, left[some, leg])
        over_time.plot(samples.time[some], sticks, color=look.QUIET, label="left, no say", linewidth=1.0)
        moving = samples.used[:, leg]
        over_rate.plot(samples.rates[moving, leg], 1e3 * left[moving, leg], ".", color=look.ORANGE, markersize=2)
        bottom = leg == 5
        look.label(over_time, f"Motor {leg}", "time [s]" if bottom else "", "N m")
        look.label(over_rate, "", "crank's rate [rad/s]" if bottom else "", "left [mN m]")
    look.legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], columns=3)
    figure.savefig(path, dpi=110)
