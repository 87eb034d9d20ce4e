"""Figures on the kinematics, (1) to (6)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stewart_drake.paper.plots.drawing import contoured
from stewart_drake.plotting.panels import BLUE, ORANGE, QUIET, label, legend, panels


def plot_forward(
    outcomes: Mapping[str, tuple[int, int, int]], conditioning: np.ndarray, error: np.ndarray, across: np.ndarray
) -> Figure:
    """What Newton's method finds from home, and how exact it is.

    Args:
        outcomes: Per group of poses the numbers of those found again, of other assemblies, and of failures.
        conditioning: (n,) [-] sigma_min / sigma_max of the rods' lines at the true poses.
        error: (n,) [m] distance of the pose found to the true one, 0 and NaN left out.
        across: (n,) bool, whether a parallel singularity lies between the true pose and home.
    """
    figure, ((left, right),) = panels(1, 2, 4.2)
    counts = np.array(list(outcomes.values()), dtype=float)
    shares = 100.0 * counts / counts.sum(axis=-1, keepdims=True)
    rows, start = np.arange(len(shares))[::-1], np.zeros(len(shares))
    names = ("the true pose", "another assembly", "no convergence")
    for column, (name, color) in enumerate(zip(names, (BLUE, ORANGE, QUIET), strict=True)):
        left.barh(rows, shares[:, column], left=start, color=color, height=0.62, label=name)
        start += shares[:, column]
    left.set_yticks(rows, list(outcomes))
    left.set_xlim(0.0, 100.0)
    left.grid(axis="y", visible=False)
    label(left, "What Newton's method finds from home", "share of poses [%]", "")
    left.legend(loc="upper center", bbox_to_anchor=(0.45, -0.16), ncols=3, frameon=False, fontsize=8.5,
                handlelength=1.0, columnspacing=1.0)  # fmt: skip

    usable = np.isfinite(error) & (error > 0.0)
    sides = (~across, "home's side of the parallel singularity", BLUE, "o"), (across, "beyond it", ORANGE, "^")
    for side, name, color, marker in sides:
        right.loglog(conditioning[usable & side], error[usable & side], marker, color=color, markersize=2.5, alpha=0.5,
                     label=name)  # fmt: skip
    title = "Its error, and where it goes elsewhere"
    label(right, title, "conditioning of the rods' lines [-]", "error in the pose [m]")
    legend(right, loc="center right", markerscale=2.0)
    return figure


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
        contoured(figure, panel, degrees, degrees, 1e3 * shift, "joint misplaced by [mm]", levels)
        panel.set_aspect("equal")
        label(panel, title, "roll [deg]", "pitch [deg]" if panel is left else "")
    if not bracket_in_reach.all():
        # Contours of 0 and 1 as they are: hatched where the rods cannot span.
        outside = 1.0 - bracket_in_reach
        right.contourf(degrees, degrees, outside, levels=[0.5, 1.5], colors="none", hatches=["///"])
        right.contour(degrees, degrees, outside, levels=[0.5], colors="black", linewidths=1.2)
    return figure
