"""Figure of the plant's convergence."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure


def plot_convergence(steps: np.ndarray, errors: np.ndarray, gaps: np.ndarray) -> Figure:
    """Position error (n,) [m] and loop gap (n,) [m] against the step (n,) [s], both axes logarithmic."""
    figure = Figure(figsize=(6.5, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for values, color, marker, label, order in (
        (errors, "#0072b2", "o", "position error", 1),
        (gaps, "#d55e00", "s", "loop gap", 2),
    ):
        axes.loglog(1e3 * steps, values, marker=marker, color=color, label=label)
        slope = values[-1] * (steps / steps[-1]) ** order
        axes.loglog(1e3 * steps, slope, color=color, linestyle=":", linewidth=1.0, label=f"order {order}")
    axes.set_xlabel("step [ms]")
    axes.set_ylabel("[m]")
    axes.legend(frameon=False)
    axes.grid(color="#e4e8ed", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure
