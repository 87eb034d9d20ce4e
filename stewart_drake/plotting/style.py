"""Common style and helpers of figures, without pyplot: no window opens and no global setting changes."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib.style
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
from numpy.typing import ArrayLike

from stewart_drake.base import tables
from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.logs.signals import DISPLAY_UNITS

P = ParamSpec("P")
T = TypeVar("T")

DPI = 150
LARGEST_DRAWN = 1e9  # Larger values of a diverging run are clipped, as matplotlib cannot draw them.
BLUE, ORANGE, GREEN, PURPLE, SKY, YELLOW = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"
"""The palette of Okabe and Ito, for any colour vision."""
COLORS = (BLUE, ORANGE, GREEN, PURPLE, SKY, YELLOW)
GREY, TEXT = "#8C8C8C", "#222222"

COORDINATES = tuple(zip(tables.COORDINATES, DISPLAY_UNITS, strict=True))
"""Names and units of a pose in figures, see `SCALES`."""

_STYLE_FILE = Path(__file__).with_name("figure.mplstyle")


def styled(plot: Callable[P, T]) -> Callable[P, T]:
    """Decorator: draws in the style of this package, independent of the user's settings of matplotlib."""

    @wraps(plot)
    def draw_styled(*args: P.args, **options: P.kwargs) -> T:
        with matplotlib.style.context(["default", _STYLE_FILE]):
            return plot(*args, **options)

    return draw_styled


def panels(rows: int, columns: int, height: float, width: float = 9.0, **subplots: Any) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(width, height))
    axes: np.ndarray = figure.subplots(rows, columns, squeeze=False, **subplots)
    # Matplotlib creates ticks and grids later, outside of `styled`, so their colours are set here.
    for panel in axes.flat:
        panel.tick_params(which="both", color=GREY, labelcolor=TEXT, labelsize=9)
        panel.grid(color="#E6E6E6", linewidth=0.8)
        panel.set_axisbelow(True)
    return figure, axes


class _Decades(LogLocator):
    """Ticks at decades, and over less than two decades also at 2 and 5 times these."""

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        self.set_params(subs=(1.0, 2.0, 5.0) if vmax < 100.0 * vmin else (1.0,))
        return super().tick_values(vmin, vmax)


def logarithmic(panel: Axes, which: str) -> None:
    for name in which:
        panel.set(**{f"{name}scale": "log"})
        axis = panel.xaxis if name == "x" else panel.yaxis
        axis.set_major_locator(_Decades())
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())


def legend_below(figure: Figure, handles: Sequence[Artist], columns: int = 4, size: float = 10.0) -> None:
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, fontsize=size)


@styled
def chart(
    title: str,
    x: str,
    y: str,
    curves: Mapping[str, tuple[ArrayLike, ArrayLike]],
    style: str = "-",
    decades: str = "",
    height: float = 4.0,
) -> Figure:
    """Curves (x, y) by name in one panel; `decades` names the logarithmic axes; y may be texts."""
    figure, ((panel,),) = panels(1, 1, height)
    for number, (name, (x_values, y_values)) in enumerate(curves.items()):
        # Once the colours repeat, lines are dashed.
        (line,) = panel.plot(x_values, y_values, style, label=name)
        if number >= len(COLORS) and line.get_linestyle() == "-":
            line.set_linestyle("--")
    logarithmic(panel, decades)
    panel.set(title=title, xlabel=x, ylabel=y)
    panel.legend()
    return figure


@styled
def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure as PNG with `DPI`, or as PDF; a file is complete or not written at all."""
    stream, path = io.BytesIO(), Path(path)
    # Without date and versions, so that the same log gives the same file.
    omitted = ("Creator", "Producer", "CreationDate") if path.suffix == ".pdf" else ("Software",)
    metadata = dict.fromkeys(omitted)
    figure.savefig(stream, format=path.suffix[1:], dpi=DPI, facecolor="white", metadata=metadata)
    write_atomically(path, stream.getvalue())
