"""Figure on the force map, (7) to (18)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.plotting.panels import BLUE, ORANGE, TEXT, label, legend, panels


def plot_rod_force(transmission: np.ndarray, force: np.ndarray) -> Figure:
    """Rod force per torque in Drake's massless limit.

    Args:
        transmission: (n,) [-] e_l.e_N.
        force: (n,) [-] |a| F / T as measured.
    """
    figure, ((panel,),) = panels(1, 1, 3.9)
    x = np.linspace(min(0.15, float(np.abs(transmission).min())), 1.0, 200)
    panel.plot(x, 1.0 / x, color=BLUE, label=r"statics: $1/(e_l \cdot e_N)$")
    panel.plot(x, x, color=ORANGE, linestyle="--", label=r"(15): $e_l \cdot e_N$")
    panel.plot(np.abs(transmission), np.abs(force), "o", color=TEXT, markersize=3.0, alpha=0.6, label="Drake")
    panel.set_ylim(0.0, min(8.0, 1.1 * float(np.abs(force).max())))
    label(panel, "Force of a rod, massless legs", r"$e_l \cdot e_N$ [-]", "$|a| F / T$ [-]")
    legend(panel, loc="upper right")
    return figure
