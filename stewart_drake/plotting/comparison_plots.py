"""Figures of a comparison of controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogLocator

from stewart_drake.plotting.panels import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    QUIET,
    SKY,
    TEXT,
    YELLOW,
    label,
    legend_below,
    logarithmic,
    panels,
)

_Styles = Mapping[str, Mapping[str, Any]]
_STYLES = tuple(zip((QUIET, YELLOW, ORANGE, BLUE, PURPLE, GREEN, TEXT, SKY), "v^Dos>h*", strict=True))
_BAND = "#F4F6F8"
_BESIDE = 3
"""Panels that have room side by side."""
_SMALLEST, _LARGEST = 1e-6, 1e9
"""[mm] what is smaller or larger is drawn here."""
_CROSS: dict[str, Any] = {"marker": "x", "markersize": 6.5, "markeredgewidth": 2.0, "linestyle": "none"}
_PHASE_SHOWN = 1e-3
"""Amplitude ratio below which a phase says nothing."""


def plot_rmse(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """RMSE of the pose by reference and controller, a panel a condition, logarithmic; failures at the right edge.

    Args:
        rows: Of a comparison; `pose_rmse_mm` is drawn, of several seeds each.
    """
    styles = _styles(rows)
    shown: dict[str, list[str]] = {}
    for row in rows:
        here = shown.setdefault(row["condition"], [])
        if row["reference"] not in here:
            here.append(row["reference"])
    beside = 1 < len(shown) <= _BESIDE and len(set(map(tuple, shown.values()))) == 1
    lanes = {
        condition: len(references) * max(2.5, len({r["controller"] for r in rows if r["condition"] == condition}))
        for condition, references in shown.items()
    }
    if beside:
        figure, axes = panels(1, len(shown), 1.5 + 0.14 * max(lanes.values()), sharex=True, sharey=True)
    else:
        height = 1.4 + 0.2 * sum(lanes.values()) + 0.55 * len(shown)
        figure, axes = panels(len(shown), 1, height, sharex=True, height_ratios=list(lanes.values()))
    values = [_within(row["pose_rmse_mm"]) for row in rows if _done(row)]
    low, high = (min(values) / 2.0, max(values) * 2.0) if values else (0.1, 10.0)
    edge = high * (high / low) ** 0.05
    for panel, (condition, references) in zip(axes.flat, shown.items(), strict=True):
        for place, reference in enumerate(reversed(references)):
            if place % 2 == 0:
                panel.axhspan(place - 0.5, place + 0.5, color=_BAND, zorder=0.0)
            runs = [row for row in rows if (row["reference"], row["condition"]) == (reference, condition)]
            _plot_lanes(panel, runs, styles, place, low, edge)
        logarithmic(panel, "x")
        panel.set_xlim(low, high * (high / low) ** 0.09)
        panel.xaxis.set_major_locator(LogLocator(numticks=6 if beside else 12))
        panel.set_ylim(-0.5, len(references) - 0.5)
        panel.set_yticks(range(len(references)), list(reversed(references)), fontsize=10)
        panel.tick_params(axis="y", length=0)
        panel.grid(axis="y", visible=False)
        bottom = beside or condition == list(shown)[-1]
        label(panel, condition, "pose RMSE [mm]" if bottom else "", "")
    _legend(figure, styles, [Line2D([], [], color=TEXT, label="failed", **_CROSS)])
    return figure


def _plot_lanes(
    panel: Axes, rows: Sequence[Mapping[str, Any]], styles: _Styles, place: int, low: float, edge: float
) -> None:
    """Dots of one reference, a lane for each controller; crosses at `edge` for runs that failed."""
    here = list(dict.fromkeys(row["controller"] for row in rows))
    for row in rows:
        style = styles[row["controller"]]
        y = place + (0.5 * (len(here) - 1) - here.index(row["controller"])) * 0.8 / max(4, len(here))
        if _done(row):
            value = _within(row["pose_rmse_mm"])
            panel.plot([low, value], [y, y], color=style["color"], linewidth=1.0, alpha=0.45)
            panel.plot(value, y, **style)
        else:
            panel.plot(edge, y, color=style["color"], **_CROSS)


def plot_error(rows: Sequence[Mapping[str, Any]], band: float) -> Figure:
    """Size of the pose error over time on one reference, a panel a condition, logarithmic.

    Args:
        rows: With `trace`, see `runs.measure_run`.
        band: [mm] drawn as the band within which a run counts as settled.
    """
    rows = [row for row in rows if row.get("trace") and len(row["trace"]["time"])]
    styles = _styles(rows)
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    figure, axes = panels(len(conditions), 1, 1.3 + 2.3 * len(conditions), sharex=True, sharey=True)
    for (panel,), condition in zip(axes, conditions, strict=True):
        panel.axhline(band, color=TEXT, linestyle=(0, (4, 3)), linewidth=0.9)
        for row in rows:
            if row["condition"] != condition:
                continue
            color, time = styles[row["controller"]]["color"], np.array(row["trace"]["time"])
            # What is exactly zero, such as the start, has no place on this axis; null was no number.
            size = np.clip(np.array(row["trace"]["pose_mm"], dtype=float), 1e-7, _LARGEST)
            panel.plot(time, size, color=color, linewidth=1.5)
            if row["status"] != "completed":
                panel.plot(time[-1], size[-1], color=color, **_CROSS)
        logarithmic(panel, "y")
        label(panel, condition, "time [s]" if condition == conditions[-1] else "", "pose error [mm]")
    sizes = [min(value, _LARGEST) for row in rows for value in row["trace"]["pose_mm"] if value]
    if sizes:
        axes[0, 0].set_ylim(max(1e-6, 0.3 * float(np.percentile(sizes, 2.0))), 2.0 * max(sizes))
    settled = Line2D([], [], color=TEXT, linestyle=(0, (4, 3)), linewidth=0.9, label=f"settled: {band:g} mm")
    _legend(figure, styles, [settled], lines=True)
    return figure


def plot_bands(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Closed-loop amplitude, phase and what is left of the motion over frequency, a column an axis.

    Args:
        rows: Of the bands of a comparison.
    """
    styles = _styles(rows)
    axes_names = list(dict.fromkeys(row["reference"] for row in rows))
    figure, grid = panels(3, len(axes_names), 8.6, sharex=True, sharey="row")
    for column, name in enumerate(axes_names):
        amplitude, phase, rest = grid[:, column]
        for controller, style in styles.items():
            found = sorted(
                (row["frequency_hz"], row["ratio"], row["phase_deg"])
                for row in rows
                if (row["controller"], row["reference"]) == (controller, name) and row.get("ratio") is not None
            )
            if not found:
                continue
            frequency, ratio, lag = np.array(found, dtype=float).T
            ratio = ratio.clip(max=_LARGEST)
            look = {**style, "linestyle": "-", "linewidth": 1.5, "markersize": style["markersize"] * 0.8}
            amplitude.plot(frequency, ratio, **look)
            lag = np.where(ratio > _PHASE_SHOWN, np.degrees(np.unwrap(np.radians(lag))), np.nan)
            phase.plot(frequency, lag, **look)
            left = np.abs(1.0 - ratio * np.exp(1j * np.radians(lag)))
            rest.plot(frequency, left, **look)
        for panel in (amplitude, phase, rest):
            logarithmic(panel, "x")
            panel.xaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0]))
        logarithmic(rest, "y")
        for panel, level in ((amplitude, 1.0), (phase, 0.0), (rest, 1.0)):
            panel.axhline(level, color=TEXT, linewidth=0.8, zorder=1.0)
        first = column == 0
        label(amplitude, f"{name}: amplitude", "", "pose / reference [-]" if first else "")
        label(phase, f"{name}: phase", "", "phase [deg]" if first else "")
        label(rest, f"{name}: error", "frequency [Hz]", "error / reference [-]" if first else "")
    _legend(figure, styles)
    return figure


def _within(value: float) -> float:
    return min(max(value, _SMALLEST), _LARGEST)


def _done(row: Mapping[str, Any]) -> bool:
    return row["status"] == "completed" and row.get("pose_rmse_mm") is not None


def _styles(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Look of each controller, in the order of the rows."""
    names = dict.fromkeys(row["controller"] for row in rows)
    styles: dict[str, dict[str, Any]] = {}
    for index, name in enumerate(names):
        color, marker = _STYLES[index % len(_STYLES)]
        styles[name] = {
            "color": color, "marker": marker, "markersize": 7.0, "markeredgecolor": "white", "markeredgewidth": 0.7,
            "linestyle": "none", "zorder": 3.0,
        }  # fmt: skip
    return styles


def _legend(figure: Figure, styles: _Styles, more: Sequence[Line2D] = (), lines: bool = False) -> None:
    handles: list[Any] = [
        Line2D([], [], color=style["color"], linewidth=2.0, label=name)
        if lines
        else Line2D([], [], label=name, **style)
        for name, style in styles.items()
    ]
    columns = 3 if max(map(len, styles), default=0) > 24 else 4
    legend_below(figure, [*handles, *more], columns, 9.0)
