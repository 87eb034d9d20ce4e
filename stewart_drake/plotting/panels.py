"""What the figures of the report share: size, palette, and panels that are plain and quiet."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, PURPLE, SKY, YELLOW = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
"""Okabe and Ito's palette, which people with any colour vision can tell apart."""
QUIET, TEXT, OUTSIDE = "#8C8C8C", "#222222", "#DADADA"

WIDTH = 9.0
"""[inch] of a figure; at 900 pixels a text of 10 points is then 14 pixels high."""


def panels(rows: int, columns: int, height: float, **subplots: Any) -> tuple[Figure, np.ndarray]:
    """A figure and its panels (rows, columns) [Axes]."""
    figure = Figure(figsize=(WIDTH, height), facecolor="white")
    figure.set_layout_engine("constrained", h_pad=0.08, w_pad=0.08, hspace=0.03, wspace=0.03)
    axes: np.ndarray = figure.subplots(rows, columns, squeeze=False, **subplots)
    for panel in axes.flat:
        panel.spines[["top", "right"]].set_visible(False)
        panel.spines[["left", "bottom"]].set_color(QUIET)
        panel.tick_params(colors=TEXT, color=QUIET, labelsize=9)
        panel.grid(color="#E6E6E6", linewidth=0.8)
        panel.set_axisbelow(True)
    return figure, axes


def label(panel: Axes, title: str, x: str, y: str) -> None:
    """Title, and axes with their units."""
    panel.set_title(title, loc="left", fontsize=10, fontweight="bold", color=TEXT)
    panel.set_xlabel(x, fontsize=10, color=TEXT)
    panel.set_ylabel(y, fontsize=10, color=TEXT)


def legend(panel: Axes, **options: Any) -> None:
    """A legend without a frame that lets the lines show through."""
    settings: dict[str, Any] = {"fontsize": 9, "frameon": True, "framealpha": 0.85, "edgecolor": "none"}
    panel.legend(**{**settings, **options})


def heatmap(
    figure: Figure, panel: Axes, x: np.ndarray, y: np.ndarray, values: np.ndarray, unit: str, **options: Any
) -> None:
    """Values (len(y), len(x)) as colours with a scale beside them; grey where they are NaN."""
    panel.set_facecolor(OUTSIDE)
    panel.grid(visible=False)
    mesh = panel.pcolormesh(x, y, np.ma.masked_invalid(values), shading="nearest", rasterized=True, **options)
    bar = figure.colorbar(mesh, ax=panel, pad=0.02)
    bar.set_label(unit, fontsize=10, color=TEXT)
    bar.ax.tick_params(labelsize=9, color=QUIET, labelcolor=TEXT)
    bar.outline.set_visible(False)
