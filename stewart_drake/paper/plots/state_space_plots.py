"""Figures on the state space and the LQI, (19) to (34)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stewart_drake.paper.plots.drawing import COLORS, curves
from stewart_drake.plotting.panels import QUIET, TEXT, label, legend, legend_below, logarithmic, panels

STATE_NAMES = (
    r"$\phi$", r"$\dot\phi$", r"$\theta$", r"$\dot\theta$", r"$\psi$", r"$\dot\psi$",
    "X", r"$\dot X$", "Y", r"$\dot Y$", "Z", r"$\dot Z$",
    r"$z_\phi$", r"$z_\theta$", r"$z_\psi$", "$z_X$", "$z_Y$", "$z_Z$",
)  # fmt: skip
"""The 18 errors in the paper's order."""


def plot_matrices(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Figure:
    """A (18, 18), B (18, 6) and C (6, 18) of (25), entry by entry; empty cells are zero."""
    figure, axes = panels(2, 2, 9.0, width_ratios=(18, 11), height_ratios=(18, 6))
    motors = [f"$T_{i}$" for i in range(6)]
    outputs = [f"$y_{i}$" for i in range(1, 7)]
    _entries(axes[0, 0], a, STATE_NAMES, STATE_NAMES, "A, 18 by 18")
    _entries(axes[0, 1], b, STATE_NAMES, motors, "B, 18 by 6, at home, $M^{-1}\\tau$")
    _entries(axes[1, 0], c, outputs, STATE_NAMES, "C, 6 by 18")
    axes[1, 1].axis("off")
    return figure


def plot_singular(approaches: Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray]]]) -> Figure:
    """Singular values of M^-1 tau on the way to a singular pose, and the two measures that tell its kind.

    Args:
        approaches: Title with the distance's unit after a bar -> (n,) distances and name -> (n,) values.
    """
    figure, axes = panels(1, len(approaches), 4.4, sharey=True)
    for panel, (title, (distance, named)) in zip(axes[0], approaches.items(), strict=True):
        name, unit = title.split("|")
        curves(panel, distance, named)
        panel.set(xscale="log", yscale="log")
        panel.invert_xaxis()
        label(panel, name, f"distance to the singular pose [{unit}]", "")
    axes[0, 0].set_ylabel("singular values [SI], others [-]", fontsize=10, color=TEXT)
    legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], 3, 9.0)
    return figure


def plot_decay(
    strength: np.ndarray,
    weightings: Mapping[str, np.ndarray],
    limits: Sequence[float],
    channels: Mapping[str, np.ndarray],
    channel_decay: Mapping[str, np.ndarray],
) -> Figure:
    """Slowest decay of one channel over g = s^2 omega_Q / omega_R.

    Args:
        strength: (n,) [1/s^4] g.
        weightings: Name -> (n,) [rad/s].
        limits: [rad/s] what each weighting comes to for large g.
        channels: Ratio -> (k,) g of the robot's six channels at home.
        channel_decay: Ratio -> (k,) [rad/s].
    """
    figure, ((panel,),) = panels(1, 1, 4.2)
    curves(panel, strength, weightings, linestyle="-")
    panel.set(xscale="log", yscale="log")
    for limit, color in zip(limits, COLORS, strict=False):
        panel.axhline(limit, color=color, linestyle=":", linewidth=1.2)
    for (name, at), marker in zip(channels.items(), "ovs^D", strict=False):
        panel.plot(at, channel_decay[name], marker, color=TEXT, markersize=4.5, linestyle="none", alpha=0.75,
                   label=f"this robot at home, ratio {name}")  # fmt: skip
    panel.yaxis.set_major_formatter("{x:g}")
    label(panel, "How fast the position error can decay", "$g = s_i^2\\,\\omega_Q/\\omega_R$ [1/s$^4$]",
          "slowest decay of a channel [rad/s]")  # fmt: skip
    legend(panel, loc="lower right", ncols=2)
    return figure


def plot_discretisation(period: np.ndarray, gain: Mapping[str, np.ndarray], decay: Mapping[str, np.ndarray]) -> Figure:
    """Euler against exact discretisation over the control period.

    Args:
        period: (n,) [s].
        gain: Ratio -> (n,) [-] relative difference of the gains.
        decay: Ratio -> (n,) [-] relative difference of the slowest decay that they give the exact sampled loop.
    """
    figure, ((left, right),) = panels(1, 2, 3.8)
    for panel, differences in ((left, gain), (right, decay)):
        curves(panel, 1e3 * period, {f"ratio {name}": 100.0 * values for name, values in differences.items()})
    logarithmic(left, "xy")
    logarithmic(right, "x")
    right.axhline(0.0, color=QUIET, linewidth=0.8)
    label(left, "Gain", "control period [ms]", "size of the difference [%]")
    label(right, "Slowest decay of the sampled loop", "control period [ms]", "difference [%]")
    legend(left, loc="upper left")
    legend(right, loc="upper left")
    return figure


def _entries(panel: Axes, matrix: np.ndarray, rows: Sequence[str], columns: Sequence[str], title: str) -> None:
    """A matrix as a table of its non-zero entries."""
    panel.grid(visible=False)
    panel.imshow(matrix != 0.0, cmap="Blues", vmin=0.0, vmax=4.0, aspect="auto")
    for edge in np.arange(-0.5, max(matrix.shape), 1.0):
        if edge < matrix.shape[0]:
            panel.axhline(edge, color="#E6E6E6", linewidth=0.6)
        if edge < matrix.shape[1]:
            panel.axvline(edge, color="#E6E6E6", linewidth=0.6)
    for row, column in zip(*np.nonzero(matrix), strict=True):
        value = matrix[row, column]
        text = f"{value:.0f}" if value == round(value) or abs(value) >= 100.0 else f"{value:.1f}"
        panel.text(column, row, text, ha="center", va="center", fontsize=8, color=TEXT)
    panel.set_xticks(np.arange(matrix.shape[1]), columns, fontsize=8)
    panel.set_yticks(np.arange(matrix.shape[0]), rows, fontsize=8)
    panel.tick_params(length=0.0, labeltop=True, labelbottom=False)
    panel.spines[:].set_color(QUIET)
    panel.set_title(title, loc="left", fontsize=10, fontweight="bold", color=TEXT)
