"""What figures share: size, palette, names and units of the coordinates, panels that are plain and quiet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

BLUE, ORANGE, GREEN, PURPLE, SKY, YELLOW = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
"""Okabe and Ito's palette, which people with any colour vision can tell apart."""
QUIET, TEXT = "#8C8C8C", "#222222"

COORDINATES = (("roll", "deg"), ("pitch", "deg"), ("yaw", "deg"), ("X", "mm"), ("Y", "mm"), ("Z", "mm"))
"""Names and units in figures; `SCALES` brings a pose to them."""
SCALES = np.array([180.0 / np.pi] * 3 + [1e3] * 3)

WIDTH = 9.0
"""[inch] of a figure; at 900 pixels a text of 10 points is then 14 pixels high."""


def panels(rows: int, columns: int, height: float, **subplots: Any) -> tuple[Figure, np.ndarray]:
    """A figure and its panels (rows, columns) [Axes]."""
    figure = Figure(figsize=(WIDTH, height), facecolor="white")
    figure.set_layout_engine("constrained", h_pad=0.08, w_pad=0.08, hspace=0.03, wspace=0.03)
    axes: np.ndarray = figure.subplots(rows, columns, squeeze=False, **subplots)
    for panel in axes.flat:
        plain(panel)
    return figure, axes


def wide(rows: int, columns: int, height: float, **subplots: Any) -> tuple[Figure, np.ndarray]:
    """A figure of a page's whole width and its panels (rows, columns) [Axes], unstyled."""
    figure = Figure(figsize=(12.0, height), facecolor="white", layout="constrained")
    axes: np.ndarray = figure.subplots(rows, columns, squeeze=False, **subplots)
    return figure, axes


def plain(panel: Axes, grid: bool = True) -> None:
    """Two quiet axes, and a grid behind what is drawn; nothing of the user's own style."""
    panel.set_facecolor("white")
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color(QUIET)
    for axis in (panel.xaxis, panel.yaxis):
        axis.label.set(color=TEXT, fontsize=10)
    panel.tick_params(which="both", colors=TEXT, color=QUIET, labelsize=9)
    if grid:
        panel.grid(color="#E6E6E6", linewidth=0.8)
        panel.set_axisbelow(True)


def headline(panel: Axes, left: str, right: str = "") -> None:
    """What a panel of a wide figure shows, and beside it a number or two."""
    panel.set_title(left, loc="left", fontsize=11, fontweight="bold", color=TEXT)
    panel.set_title(right, loc="right", fontsize=9, color=TEXT)


def label(panel: Axes, title: str, x: str, y: str) -> None:
    """Title, and axes with their units."""
    panel.set_title(title, loc="left", fontsize=10, fontweight="bold", color=TEXT)
    panel.set_xlabel(x, fontsize=10, color=TEXT)
    panel.set_ylabel(y, fontsize=10, color=TEXT)


def legend(panel: Axes, **options: Any) -> None:
    """A legend without a frame that lets the lines show through."""
    settings: dict[str, Any] = {"fontsize": 9, "frameon": True, "framealpha": 0.85, "edgecolor": "none"}
    panel.legend(**{**settings, **options})


def logarithmic(panel: Axes, which: str) -> None:
    """Logarithmic axes (`x`, `y` or both), with plain numbers at their decades and no ticks between."""
    for name in which:
        panel.set(**{f"{name}scale": "log"})
        axis = panel.xaxis if name == "x" else panel.yaxis
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())


def legend_below(figure: Figure, handles: Sequence[Any], columns: int = 4, size: float = 10.0) -> None:
    """One legend for all panels, below them."""
    style: dict[str, Any] = {"frameon": False, "fontsize": size, "labelcolor": TEXT}
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, **style)


def chart(
    title: str,
    x: str,
    y: str,
    curves: Mapping[str, tuple[Any, Any]],
    style: str = "-",
    decades: str = "",
    height: float = 4.0,
) -> Figure:
    """Curves (x, y) by name in one panel; `decades` are the axes that are logarithmic; texts for y are named rows."""
    figure, ((panel,),) = panels(1, 1, height)
    for name, (along, values) in curves.items():
        panel.plot(along, values, style, label=name)
    logarithmic(panel, decades)
    label(panel, title, x, y)
    legend(panel)
    return figure
