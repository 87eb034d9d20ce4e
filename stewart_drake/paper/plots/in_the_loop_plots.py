"""Figures on the tuner in the loop: ranking, and weights in force."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator

from stewart_drake.paper.tuner_comparison import Comparison
from stewart_drake.plotting.panels import BLUE, GREEN, ORANGE, TEXT, label, legend_below, logarithmic, panels

_RATIO_COLORS = ("#08306B", "#2171B5", "#6BAED6", "#A6CEE3", "#D2E4F0")
_SPAN = "#E3E8ED"
_ALONE: dict[str, Any] = {"linestyle": "none"}
_DOT = {**_ALONE, "marker": "o", "markersize": 7.5, "markeredgecolor": TEXT, "markeredgewidth": 0.6, "zorder": 3.0}
_TICK = {**_ALONE, "marker": "|", "markersize": 17.0, "markeredgewidth": 1.8, "color": TEXT, "zorder": 3.5}
_RING = {**_ALONE, "marker": "o", "markersize": 13.0, "markeredgewidth": 1.8, "markerfacecolor": "none",
         "markeredgecolor": GREEN, "zorder": 4.0}  # fmt: skip
_DIAMOND = {**_ALONE, "marker": "D", "markersize": 8.0, "markeredgewidth": 0.8, "markeredgecolor": "white",
            "color": ORANGE, "zorder": 5.0}  # fmt: skip


def plot_ranking(ranking: Sequence[Comparison]) -> Figure:
    """Pose RMSE on every trajectory: bars from the best to the worst of the nine, the five controllers, the tuner."""
    figure, ((panel,),) = panels(1, 1, 1.6 + 0.42 * len(ranking))
    rows = np.arange(len(ranking))[::-1]
    for row, entry in zip(rows, ranking, strict=True):
        completed = [rmse for rmse in entry.fixed.values() if rmse is not None]
        if completed:
            low, high = min(completed), max(completed)
            panel.barh(row, high - low, left=low, height=0.5, color=_SPAN, zorder=2.0)
            panel.plot(low, row, **_RING)
        for color, rmse in zip(_RATIO_COLORS, entry.fixed.values(), strict=True):
            if rmse is not None:
                panel.plot(rmse, row, color=color, **_DOT)
        for value, style in ((entry.mean_of_nine, _TICK), (entry.tuner, _DIAMOND)):
            if value is not None:
                panel.plot(value, row, **style)
    logarithmic(panel, "x")
    panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    drawn = [v for r in ranking for v in (r.tuner, *r.fixed.values()) if v is not None]
    if drawn:
        panel.set_xlim(min(drawn) / 1.2, max(drawn) * 1.2)
    panel.set_yticks(rows, [r.name for r in ranking], fontsize=10)
    panel.set_ylim(-0.7, len(ranking) - 0.3)
    panel.grid(axis="y", visible=False)
    label(panel, "The tuner among the nine pairs", "pose RMSE over the second half [mm], logarithmic", "")
    keys: list[Line2D | Patch] = [
        Line2D([], [], label="tuner", **_DIAMOND),
        Line2D([], [], label="oracle: best of the nine", **_RING),
        Line2D([], [], label="mean of the nine", **_TICK),
        Patch(color=_SPAN, label="span of the nine"),
    ]
    for color, ratio in zip(_RATIO_COLORS, ranking[0].fixed, strict=True):
        keys.append(Line2D([], [], color=color, label=f"ratio {ratio:g}", **_DOT))
    figure.legend(handles=keys, loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    return figure


def plot_weights_in_force(
    ratios: Mapping[str, tuple[np.ndarray, np.ndarray]], best: Mapping[str, float | None]
) -> Figure:
    """Ratio of the weights over time, a panel for each trajectory.

    Args:
        ratios: Trajectory -> time (n,) [s] and omega_Q / omega_R (n,) under the tuner.
        best: Ratio of the best of the nine on it.
    """
    columns = min(3, len(ratios))
    rows = -(-len(ratios) // columns)
    figure, axes = panels(rows, columns, 1.0 + 1.75 * rows, sharex=True, sharey=True)
    for panel in axes.flat[len(ratios) :]:
        panel.axis("off")
    for index, (panel, (name, (time, ratio))) in enumerate(zip(axes.flat, ratios.items(), strict=False)):
        mean = float(np.exp(np.log(ratio).mean()))
        panel.plot(time, ratio, color=BLUE, linewidth=0.6, drawstyle="steps-post", label="in force")
        panel.axhline(mean, color=ORANGE, linewidth=1.8, label="its geometric mean")
        if (wanted := best[name]) is not None:
            panel.axhline(wanted, color=GREEN, linewidth=1.8, linestyle=(0, (4, 2)), label="best of the nine")
        logarithmic(panel, "y")
        panel.set_ylim(0.006, 170.0)
        label(panel, name, "", r"$\omega_Q\,/\,\omega_R$ [-]" if index % columns == 0 else "")
        if index + columns >= len(ratios):
            panel.set_xlabel("time [s]", fontsize=10, color=TEXT)
            panel.tick_params(labelbottom=True)
    legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], 3, 9.0)
    return figure
