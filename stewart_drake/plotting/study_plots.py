"""Figures of sweeps, comparisons of controllers, tuning of gains, and costs of tuners."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, LogLocator
from numpy.typing import ArrayLike

from stewart_drake.base.atomic_files import Document
from stewart_drake.plotting import style as look

Row = Document
Rows = Sequence[Row]
Styles = Mapping[str, Mapping[str, Any]]

_COLORS = (look.GREY, look.YELLOW, look.ORANGE, look.BLUE, look.PURPLE, look.GREEN, look.TEXT, look.SKY)
_LOOKS = tuple(zip(_COLORS, "v^Dos>h*", strict=True))
_CROSS: dict[str, Any] = {"marker": "x", "markersize": 6.5, "markeredgewidth": 2.0, "linestyle": "none"}
_DASHED: dict[str, Any] = {"color": look.TEXT, "linestyle": (0, (4, 3)), "linewidth": 0.9}
_MIN_DRAWN = 1e-6  # [mm] Smaller errors are clipped.
_MIN_RATIO = 1e-3  # Ratio of amplitudes (-60 dB) below which the phase is not drawn.


@look.styled
def plot_sweep(rows: Rows, varied: Mapping[str, str]) -> Figure:
    """RMSE of the position over the varied keys; runs that were not completed are crosses at the top.

    `varied`: column -> label of its axis.
    """
    title = f"RMSE of the position; a mark is one of {len(rows)} runs, with its own seed"
    figure, axes = _panels(title, len(varied), 3, 0.6, 2.9, sharey=True)
    completed, failed = ([row for row in rows if _completed(row) is status] for status in (True, False))
    errors = np.array([_rmse(row) for row in completed] or [1.0])
    wide = _is_wide(errors)
    top = float(errors.max()) * (2.0 if wide else 1.1)
    for panel, (key, label) in zip(axes.flat, varied.items(), strict=False):
        x_values = [_x_value(row[key]) for row in completed]
        panel.plot(x_values, errors[: len(completed)], ".", color=look.BLUE, markersize=5.0)
        panel.plot([_x_value(row[key]) for row in failed], [top] * len(failed), color=look.ORANGE, **_CROSS)
        panel.set(xlabel=label)
        if wide:
            look.logarithmic(panel, "y")
            panel.set_ylim(None, 1.3 * top)
        else:
            panel.set_ylim(0.0, 1.05 * top)
    for panel in axes[:, 0]:
        panel.set_ylabel("RMSE [mm]")
    if failed:
        look.legend_below(figure, [Line2D([], [], color=look.ORANGE, label="not completed", **_CROSS)])
    return figure


@look.styled
def plot_map(rows: Rows, varied: Mapping[str, str]) -> Figure:
    """RMSE of the position over two keys of a grid: the median of the runs of a cell; grey if none completed.

    `varied`: column -> label of its axis.
    """
    # Numbers are sorted, names keep their order.
    keys = list(varied)
    across, up = (list(dict.fromkeys(row[key] for row in rows)) for key in keys)
    across, up = (values if any(isinstance(v, str) for v in values) else sorted(values) for values in (across, up))
    cells = np.full((len(up), len(across)), np.nan)
    for (j, i), _ in np.ndenumerate(cells):
        cell = [row for row in rows if (row[keys[0]], row[keys[1]]) == (across[i], up[j]) and _completed(row)]
        cells[j, i] = np.median([_rmse(row) for row in cell]) if cell else np.nan
    several = _runs(rows, keys, "; median of {} runs, each with its own seed")
    figure, ((panel,),) = _panels(f"RMSE of the position{several}", 1, 1, 0.0, 5.0, width=6.5)
    image = panel.imshow(cells, origin="lower", aspect="auto", cmap="viridis")
    panel.set_facecolor(look.GREY)
    panel.grid(visible=False)
    for (j, i), value in np.ndenumerate(cells):
        if cells.size <= 100 and np.isfinite(value):
            dark = value < 0.5 * (np.nanmin(cells) + np.nanmax(cells))
            panel.text(i, j, f"{value:.3g}", ha="center", va="center", fontsize=8, color="white" if dark else "black")
    panel.set_xticks(range(len(across)), [_tick_label(value) for value in across], rotation=30 * (len(across) > 6))
    panel.set_yticks(range(len(up)), [_tick_label(value) for value in up])
    panel.set(xlabel=varied[keys[0]], ylabel=varied[keys[1]])
    figure.colorbar(image, label="RMSE [mm]")
    return figure


@look.styled
def plot_rmse(rows: Rows) -> Figure:
    """RMSE of the position by reference and controller, with a panel per condition; failures at the right edge."""
    styles = _styles(rows)
    conditions, references = (list(dict.fromkeys(row[name] for row in rows)) for name in ("condition", "reference"))
    several = _runs(rows, ("controller", "reference", "condition"), "; a mark is one of {} seeds of the noise")
    height = 0.6 + 0.13 * max(3, len(styles)) * len(references)
    figure, axes = _panels(f"RMSE of the position{several}", len(conditions), 3, 1.4, height, sharex=True, sharey=True)
    values = np.array([_rmse(row) for row in rows if _completed(row)] or [1.0])
    wide = _is_wide(values)
    low, high = (values.min() / 2.0, values.max() * 2.0) if wide else (0.0, values.max() * 1.1)
    edge = high * (high / low) ** 0.06 if wide else 1.06 * high
    for panel, condition in zip(axes.flat, conditions, strict=False):
        for row in (row for row in rows if row["condition"] == condition):
            style, lane = styles[row["controller"]], list(styles).index(row["controller"])
            y = references.index(row["reference"]) + (lane - 0.5 * (len(styles) - 1)) * 0.8 / max(3, len(styles))
            if _completed(row):
                panel.plot(_rmse(row), y, **style)
            else:
                panel.plot(edge, y, color=style["color"], **_CROSS)
        for number in range(0, len(references), 2):
            panel.axhspan(number - 0.5, number + 0.5, color="#F2F2F2", zorder=0.0)
        if wide:
            look.logarithmic(panel, "x")
            panel.xaxis.set_major_locator(LogLocator(numticks=7))
        panel.set(title=condition, xlabel="RMSE [mm]", xlim=(low, edge**2 / high), ylim=(len(references) - 0.5, -0.5))
        panel.set_yticks(range(len(references)), references, fontsize=10)
        panel.grid(axis="y", visible=False)
    crosses = [] if all(map(_completed, rows)) else [Line2D([], [], color=look.TEXT, label="not completed", **_CROSS)]
    _legend(figure, styles, crosses)
    return figure


@look.styled
def plot_error(rows: Rows, band: float) -> Figure:
    """Pose error over time on one reference, with a panel per condition; settled within `band` [mm]."""
    rows = [row for row in rows if row.get("trace") and len(row["trace"]["time"])]
    styles = {name: {"color": style["color"]} for name, style in _styles(rows).items()}
    conditions = list(dict.fromkeys(row["condition"] for row in rows))
    several = _runs(rows, ("controller", "condition"), "; a curve is one of {} seeds of the noise")
    title = f"Error of the pose on: {rows[0]['reference']}{several}"
    figure, axes = _panels(title, len(conditions), 1, 1.3, 2.3, sharex=True, sharey=True)
    for row in rows:
        panel, color = axes[conditions.index(row["condition"]), 0], styles[row["controller"]]["color"]
        # The axis may be logarithmic, and errors zero; null becomes NaN.
        error = np.clip(np.array(row["trace"]["pose_mm"], dtype=float), 0.1 * _MIN_DRAWN, look.LARGEST_DRAWN)
        panel.plot(row["trace"]["time"], error, color=color, linewidth=1.5)
        if row["status"] != "completed":
            panel.plot(row["trace"]["time"][-1], error[-1], color=color, **_CROSS)
    errors = [min(value, look.LARGEST_DRAWN) for row in rows for value in row["trace"]["pose_mm"] if value] or [band]
    wide = max(errors) > 10.0 * float(np.median(errors))
    limits = max(_MIN_DRAWN, 0.3 * float(np.percentile(errors, 2.0))) if wide else 0.0, 2.0 * max(errors)
    has_band = limits[0] < band < limits[1]
    for panel, condition in zip(axes.flat, conditions, strict=True):
        if has_band:
            panel.axhline(band, **_DASHED)
        if wide:
            look.logarithmic(panel, "y")
        panel.set(title=condition, ylabel="pose error [mm]")
    axes[0, 0].set_ylim(*limits)
    axes[-1, 0].set_xlabel("time [s]")
    bands = [Line2D([], [], label=f"settled: {band:g} mm", **_DASHED)] if has_band else []
    _legend(figure, styles, bands)
    return figure


@look.styled
def plot_bands(rows: Rows) -> Figure:
    """Bode plot of the closed loop, from reference to pose: magnitude and phase, with a column per axis."""
    styles = _styles(rows)
    names = list(dict.fromkeys(row["reference"] for row in rows))
    figure, grid = look.panels(2, len(names), 6.2, sharex=True, sharey="row")
    for (magnitude, phase), name in zip(grid.T, names, strict=True):
        for controller, style in styles.items():
            points = sorted(
                (row["frequency_hz"], row["ratio"], row["phase_deg"])
                for row in rows
                if (row["controller"], row["reference"]) == (controller, name) and row.get("ratio")
            )
            if points:
                frequency, ratio, angle = np.array(points, dtype=float).T
                line = {**style, "linestyle": "-", "linewidth": 1.5, "markersize": 5.6}
                magnitude.plot(frequency, 20.0 * np.log10(ratio.clip(_MIN_RATIO, look.LARGEST_DRAWN)), **line)
                angle = np.where(ratio > _MIN_RATIO, np.degrees(np.unwrap(np.radians(angle))), np.nan)
                phase.plot(frequency, angle, **line)
        for panel in (magnitude, phase):
            look.logarithmic(panel, "x")
            panel.xaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0]))
            panel.axhline(0.0, color=look.TEXT, linewidth=0.8, zorder=1.0)
        magnitude.set(title=f"{name}, from reference to pose")
        phase.set(xlabel="frequency [Hz]")
    grid[0, 0].set_ylabel("magnitude [dB]")
    grid[1, 0].set_ylabel("phase [deg]")
    _legend(figure, styles)
    return figure


@look.styled
def plot_search(rows: Rows) -> Figure:
    """Costs of all evaluations, and the least cost so far, with a panel per controller."""
    names = list(dict.fromkeys(row["controller"] for row in rows))
    title = "Cost of the settings that the search tried"
    figure, axes = _panels(title, len(names), 2, 0.6, 2.4, sharex=True, sharey=True)
    for panel, name in zip(axes.flat, names, strict=False):
        trials = [row for row in rows if row["controller"] == name]
        number, costs, best = ([row[key] for row in trials] for key in ("evaluation", "cost", "best"))
        panel.plot(number, costs, ".", color=look.GREY, markersize=4.0, label="evaluation")
        panel.step(number, best, where="post", color=look.BLUE, linewidth=1.8, label="least so far")
        look.logarithmic(panel, "y")
        panel.set(title=f"{name}: {best[0]:.3g} to {best[-1]:.3g}", xlabel="evaluation [-]", ylabel="cost [-]")
    look.legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], size=9.0)
    return figure


@look.styled
def plot_costs(kinds: Sequence[str], ratios: Mapping[str, ArrayLike], baseline: str) -> Figure:
    """Costs of candidates over that of a baseline, by kind; ratios (kinds, 3): value, ends of its interval."""
    figure, ((panel,),) = look.panels(1, 1, 1.6 + 0.34 * len(kinds))
    panel.axvline(1.0, color=look.TEXT, linewidth=1.2)
    rows = np.arange(len(kinds))[::-1]
    for number, (name, candidate) in enumerate(ratios.items()):
        color, marker = _LOOKS[(number + 3) % len(_LOOKS)]
        value, low, high = np.array(candidate, dtype=float).T
        y = rows - 0.11 * (number - 0.5 * (len(ratios) - 1))
        panel.hlines(y, low, high, color=color, linewidth=1.4)
        panel.plot(value, y, marker, color=color, markersize=5.0, label=name)
    look.logarithmic(panel, "x")
    panel.set_yticks(rows, kinds)
    panel.set_ylim(-0.7, len(kinds) - 0.3)
    title = f"Cost in new situations, relative to: {baseline}; lines are 95 % intervals over the runs"
    panel.set(title=title, xlabel="ratio [-], lower is better")
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _is_wide(values: np.ndarray) -> bool:
    """Whether values, which are not negative, need a logarithmic axis; otherwise it is linear from zero."""
    return bool(values.max() > 10.0 * values.min())


def _panels(
    title: str, count: int, columns: int, rest: float, height: float, **subplots: Any
) -> tuple[Figure, np.ndarray]:
    """A figure with a title and `count` panels of a height in up to some columns; `rest` is added to the height."""
    columns = min(columns, count)
    lines = -(-count // columns)
    figure, axes = look.panels(lines, columns, rest + height * lines, **subplots)
    for panel in axes.flat[count - columns : count]:
        panel.tick_params(labelbottom=True)
    for panel in axes.flat[count:]:
        panel.set_axis_off()
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure, axes


def _runs(rows: Rows, keys: Sequence[str], text: str) -> str:
    """A text with the largest number of runs that differ in none of `keys`; empty if that is one."""
    most = max(Counter(tuple(row[key] for key in keys) for row in rows).values())
    return text.format(most) if most > 1 else ""


def _x_value(value: float | str) -> float | str:
    """A number, or a category."""
    return str(value) if isinstance(value, (str, bool)) else value


def _tick_label(value: float | str) -> str:
    return str(value) if isinstance(value, (str, bool)) else f"{value:g}"


def _rmse(row: Row) -> float:
    return min(max(row["rmse_norm_mm"], _MIN_DRAWN), look.LARGEST_DRAWN)


def _completed(row: Row) -> bool:
    return row["status"] == "completed" and row.get("rmse_norm_mm") is not None


def _styles(rows: Rows) -> Styles:
    common = {"markersize": 7.0, "markeredgecolor": "white", "markeredgewidth": 0.7, "linestyle": "none", "zorder": 3.0}
    names = dict.fromkeys(row["controller"] for row in rows)
    styles: dict[str, dict[str, Any]] = {}
    for number, name in enumerate(names):
        color, marker = _LOOKS[number % len(_LOOKS)]
        styles[name] = {**common, "color": color, "marker": marker}
        if number // len(_LOOKS) % 2:  # Hollow, in the second round of looks.
            styles[name] |= {"markerfacecolor": "white", "markeredgecolor": color, "markeredgewidth": 1.5}
    return styles


def _legend(figure: Figure, styles: Styles, more: Sequence[Line2D] = ()) -> None:
    handles = [Line2D([], [], label=name, **style) for name, style in styles.items()]
    columns = 3 if max(map(len, styles), default=0) > 24 else 4
    look.legend_below(figure, [*handles, *more], columns, 9.0)
