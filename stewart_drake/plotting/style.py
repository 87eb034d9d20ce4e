"""What figures share; they are made without pyplot: no window opens and no global setting changes."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib.style
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from stewart_drake.base import tables
from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.logs.signals import DISPLAY_UNITS

P = ParamSpec("P")
T = TypeVar("T")

DPI = 150
LARGEST_DRAWN = 1e9
"""What is larger, after a blow-up, is drawn here: matplotlib's arithmetic ends long before that of numbers."""
BLUE, ORANGE, GREEN, PURPLE, SKY, YELLOW = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
"""Okabe and Ito's palette, which people with any colour vision can tell apart."""
COLORS = (BLUE, ORANGE, GREEN, PURPLE, SKY, YELLOW)
GREY, TEXT = "#8C8C8C", "#222222"

COORDINATES = tuple(zip(tables.COORDINATES, DISPLAY_UNITS, strict=True))
"""Names and units in figures; `SCALES` brings a pose to them."""

_STYLE: Any = ["default", Path(__file__).with_name("figure.mplstyle")]


def styled(plot: Callable[P, T]) -> Callable[P, T]:
    """A function that draws in the style of this package, whatever the user's matplotlib is set to."""

    @wraps(plot)
    def draw_styled(*args: P.args, **options: P.kwargs) -> T:
        with matplotlib.style.context(_STYLE):
            return plot(*args, **options)

    return draw_styled


def panels(rows: int, columns: int, height: float, width: float = 9.0, **subplots: Any) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(width, height))
    axes: np.ndarray = figure.subplots(rows, columns, squeeze=False, **subplots)
    quiet(axes.flat)
    return figure, axes


def quiet(axes: Any) -> None:
    """Ticks and grids in quiet colours; they are made when a figure is shown, out of `styled`."""
    for panel in axes:
        panel.tick_params(which="both", color=GREY, labelcolor=TEXT, labelsize=9)
        panel.grid(color="#E6E6E6", linewidth=0.8)
        panel.set_axisbelow(True)


class _Decades(LogLocator):
    """Ticks at decades, and at 2 and 5 times those where there are few."""

    def tick_values(self, vmin: float, vmax: float) -> Any:
        self.set_params(subs=(1.0, 2.0, 5.0) if vmax < 100.0 * vmin else (1.0,))
        return super().tick_values(vmin, vmax)


def logarithmic(panel: Axes, which: str) -> None:
    for name in which:
        panel.set(**{f"{name}scale": "log"})
        axis = panel.xaxis if name == "x" else panel.yaxis
        axis.set_major_locator(_Decades())
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())


def legend_below(figure: Figure, handles: Sequence[Any], columns: int = 4, size: float = 10.0) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, fontsize=size)


@styled
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
    for number, (name, (along, values)) in enumerate(curves.items()):
        # Colours come again after the last; dashes tell such curves apart.
        (line,) = panel.plot(along, values, style, label=name)
        if number >= len(COLORS) and line.get_linestyle() == "-":
            line.set_linestyle("--")
    logarithmic(panel, decades)
    panel.set(title=title, xlabel=x, ylabel=y)
    panel.legend()
    return figure


@styled
def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure, whole or not at all: as a PNG of 150 dots an inch, or for print as a PDF."""
    stream, path = io.BytesIO(), Path(path)
    # Without a date or version in it, the same log gives the same file.
    unsaid = ("Creator", "Producer", "CreationDate") if path.suffix == ".pdf" else ("Software",)
    metadata: Any = dict.fromkeys(unsaid)
    figure.savefig(stream, format=path.suffix[1:], dpi=DPI, facecolor="white", metadata=metadata)
    write_atomically(path, stream.getvalue())
