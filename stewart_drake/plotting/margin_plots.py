"""The picture of a loop's margins over many poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stewart_drake.plotting import panels as look
from stewart_drake.stability.margins import LoopMargins

_LARGEST = 2.0
"""[-] disk margin from which on it bounds no gain; drawn no further."""


def plot_margins(found: LoopMargins, path: str | Path) -> None:
    """Disk margin all at once at each frequency, and which share of the poses has less than a margin; a PNG."""
    figure, ((curves, shares),) = look.panels(1, 2, 4.0)
    drawn = np.minimum(found.curves, _LARGEST)
    curves.fill_between(found.frequencies, drawn.min(axis=0), drawn.max(axis=0), color=look.SKY, alpha=0.5, lw=0)
    curves.plot(found.frequencies, np.median(drawn, axis=0), color=look.BLUE, label="median, and all poses")
    look.logarithmic(curves, "x")
    curves.set_ylim(0.0)
    look.label(curves, "All motors at once, at each frequency", "rad/s", "disk margin [-]")
    look.legend(curves)
    percent = 100.0 * (np.arange(len(found.radius)) + 1) / len(found.radius)
    colors = (look.SKY, look.ORANGE, look.GREEN, look.PURPLE, look.YELLOW, look.QUIET)
    for motor, color in enumerate(colors):
        own = np.sort(np.minimum(found.single.disk[:, motor], _LARGEST))
        shares.plot(own, percent, color=color, lw=1.0, label=f"motor {motor} alone")
    every = np.sort(np.minimum(found.all_at_once.disk, _LARGEST))
    shares.plot(every, percent, color=look.BLUE, lw=2.0, label="all at once")
    shares.set_xlim(0.0)
    look.label(shares, "Poses with less than that", "disk margin [-]", "%")
    look.legend(shares)
    figure.savefig(path, dpi=130)
