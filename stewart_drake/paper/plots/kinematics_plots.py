"""Figure on the kinematics, (1) to (6)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stewart_drake.plotting.panels import heatmap, label, panels


def plot_misprints(
    angle: np.ndarray, rotation_shift: np.ndarray, bracket_shift: np.ndarray, bracket_in_reach: np.ndarray
) -> Figure:
    """How far the misprints of (3) and (5) misplace the platform's joints, over roll and pitch at home.

    Args:
        angle: (n,) [rad] of both axes.
        rotation_shift: (n, n) [m] by entry (3,1) of (3), pitch along the first axis.
        bracket_shift: (n, n) [m] by the bracket of (5).
        bracket_in_reach: (n, n) bool, whether the rods can follow (5).
    """
    figure, ((left, right),) = panels(1, 2, 3.9, sharey=True)
    degrees = np.degrees(angle)
    shifts = (left, rotation_shift, "Entry (3,1) of (3)"), (right, bracket_shift, "Bracket of (5)")
    for panel, shift, title in shifts:
        levels = MaxNLocator(5).tick_values(0.0, 1e3 * float(shift.max()))[1:]
        heatmap(figure, panel, degrees, degrees, 1e3 * shift, "joint misplaced by [mm]", cmap="cividis", vmin=0.0)
        lines = panel.contour(degrees, degrees, 1e3 * shift, levels=levels, colors="black", linewidths=0.7)
        panel.clabel(lines, fmt="%g", fontsize=8)
        panel.set_aspect("equal")
        label(panel, title, "roll [deg]", "pitch [deg]" if panel is left else "")
    if not bracket_in_reach.all():
        # Contours of 0 and 1 as they are: hatched where the rods cannot span.
        outside = 1.0 - bracket_in_reach
        right.contourf(degrees, degrees, outside, levels=[0.5, 1.5], colors="none", hatches=["///"])
        right.contour(degrees, degrees, outside, levels=[0.5], colors="black", linewidths=1.2)
    return figure
