"""Figure of the plant's convergence."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.plotting.panels import BLUE, ORANGE, label, legend, panels


def plot_convergence(steps: np.ndarray, errors: np.ndarray, gaps: np.ndarray) -> Figure:
    """Position error (n,) [m] and loop gap (n,) [m] against the step (n,) [s], both axes logarithmic."""
    figure, grid = panels(1, 1, 4.2)
    axes = grid[0, 0]
    lines = (errors, BLUE, "o", "position error", 1), (gaps, ORANGE, "s", "loop gap", 2)
    for values, color, marker, name, order in lines:
        axes.loglog(1e3 * steps, values, marker=marker, color=color, label=name)
        # Beside the points, which would hide it.
        slope = 0.5 * values[-1] * (steps / steps[-1]) ** order
        axes.loglog(1e3 * steps, slope, color=color, linestyle=":", linewidth=1.2, label=f"slope of order {order}")
    label(axes, "The plant against exact rigid-body mechanics", "step [ms]", "error, gap [m]")
    legend(axes)
    axes.set_xticks(1e3 * steps, [f"{1e3 * step:g}" for step in steps])
    axes.minorticks_off()
    return figure
