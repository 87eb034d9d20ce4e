"""Tornado plots: what each change does to a quantity, the largest effect on top."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from stewart_drake.plotting.panels import BLUE, ORANGE, TEXT, label, panels

_FONT, _LOST, _PALE = 8.5, "#B2182B", "#F8E3E1"
_HEIGHT = 0.6
_CHARACTER = 0.0105
"""Width of a character of a label, as a share of a panel."""

_NAMES = {"omega_Q": r"$\omega_Q$", "omega_R": r"$\omega_R$"}


@dataclass(frozen=True)
class TornadoBar:
    """One factor.

    Attributes:
        name: Of the factor.
        levels: What it was changed to, and the quantity then; None where the run ended early.
    """

    name: str
    levels: Sequence[tuple[str, float | None]]


@dataclass(frozen=True)
class Tornado:
    """One quantity.

    Attributes:
        quantity: Its name.
        unit: Its unit.
        unchanged: Its value without any change.
        bars: The largest effect first.
        logarithmic: Equal lengths for equal factors.
    """

    quantity: str
    unit: str
    unchanged: float
    bars: Sequence[TornadoBar]
    logarithmic: bool = False


def plot_tornados(tornados: Sequence[Tornado]) -> Figure:
    """A panel for each quantity: bars from the unchanged value, blue below and orange above it, ends labelled.

    Levels on one side of the unchanged value are named from it outwards, with a white line at each but the last. A
    pale bar across the panel stands for runs that ended early.
    """
    bars = [len(t.bars) for t in tornados]
    figure, axes = panels(len(tornados), 1, 0.9 * len(bars) + 0.31 * sum(bars), height_ratios=bars)
    for panel, tornado in zip(axes[:, 0], tornados, strict=True):
        _draw(panel, tornado)
    return figure


@dataclass(frozen=True)
class _Side:
    """Levels of one factor above (`sign` 1) or below (-1) the unchanged value, from it outwards.

    Attributes:
        row: Height of the bar.
        sign: 1 or -1.
        values: Ascending distance from the unchanged value; empty where all runs of this side ended early.
        names: Of the levels.
        lost: Levels whose runs ended early; written on the upper side.
    """

    row: int
    sign: float
    values: list[float]
    names: str
    lost: str


def _sides(tornado: Tornado) -> list[_Side]:
    found = []
    for index, bar in enumerate(tornado.bars):
        row = len(tornado.bars) - 1 - index
        known = [(value, name) for name, value in bar.levels if value is not None]
        lost = ", ".join(name for name, value in bar.levels if value is None)
        above = sorted(level for level in known if level[0] >= tornado.unchanged)
        below = sorted((level for level in known if level[0] < tornado.unchanged), reverse=True)
        for sign, side, ended in ((1.0, above, lost and f"{lost}: ends early"), (-1.0, below, "")):
            if side or ended:
                names = ", ".join(name for _, name in side)
                found.append(_Side(row, sign, [value for value, _ in side], names, ended))
    return found


def _draw(panel: Axes, tornado: Tornado) -> None:
    base, sides = tornado.unchanged, _sides(tornado)
    if tornado.logarithmic:
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.xaxis.set_minor_formatter(NullFormatter())
    else:
        panel.xaxis.set_major_locator(MaxNLocator(6))
    panel.xaxis.set_major_formatter("{x:g}")
    low, high = _limits(tornado, sides)
    panel.set_xlim(low, high)
    for side in sides:
        end = side.values[-1] if side.values else base
        color = ORANGE if side.sign > 0.0 else BLUE
        panel.barh(side.row, end - base, left=base, height=_HEIGHT, color=color, zorder=2.0)
        panel.vlines(side.values[:-1], side.row - 0.5 * _HEIGHT, side.row + 0.5 * _HEIGHT, color="white",
                     linewidth=1.4, zorder=3.0)  # fmt: skip
        if side.lost:
            panel.barh(side.row, high - base, left=base, height=_HEIGHT, color=_PALE, zorder=1.5)
        style: dict[str, Any] = {"va": "center", "fontsize": _FONT, "zorder": 4.0}
        panel.annotate(side.names, (end, side.row), xytext=(4.0 * side.sign, 0.0), textcoords="offset points",
                       ha="left" if side.sign > 0.0 else "right", color=TEXT, **style)  # fmt: skip
        across = panel.get_yaxis_transform()
        panel.text(0.995, side.row, side.lost, transform=across, ha="right", color=_LOST, **style)
    panel.axvline(base, color=TEXT, linewidth=1.2, zorder=3.5)
    rows = np.arange(len(tornado.bars))[::-1]
    panel.set_yticks(rows, [_NAMES.get(bar.name, bar.name) for bar in tornado.bars])
    panel.set_ylim(-0.6, len(tornado.bars) - 0.4)
    panel.grid(axis="y", visible=False)
    panel.spines["left"].set_visible(False)
    panel.tick_params(axis="y", length=0.0)
    scale = ", logarithmic" if tornado.logarithmic else ""
    unchanged = f"unchanged: {base:.4g} {tornado.unit}"
    label(panel, f"{tornado.quantity}; {unchanged}", f"{tornado.quantity} [{tornado.unit}]{scale}", "")


def _limits(tornado: Tornado, sides: Sequence[_Side]) -> tuple[float, float]:
    """Ends of the axis with room for every label beside its bar."""
    forward, back = (np.log, np.exp) if tornado.logarithmic else (np.array, np.array)
    base = float(forward(tornado.unchanged))
    ends = [
        (
            float(forward(side.values[-1])) if side.values else base,
            side.sign,
            _CHARACTER * (len(side.names) + len(side.lost) + 3),
        )
        for side in sides
    ]
    low, high = (pick([base, *(end for end, _, _ in ends)]) for pick in (min, max))
    if high == low:
        low, high = base - 0.05 * abs(base or 1.0), base + 0.05 * abs(base or 1.0)
    # A label takes a share of the axis, whose length depends on the room that it leaves: a few rounds settle it.
    for _ in range(20):
        width = high - low
        low = min([low, *(end - share * width for end, sign, share in ends if sign < 0.0)])
        high = max([high, *(end + share * width for end, sign, share in ends if sign > 0.0)])
    return float(back(low)), float(back(high))
