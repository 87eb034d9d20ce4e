"""Figure of a search for gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from stewart_drake.plotting.panels import BLUE, QUIET, label, logarithmic, panels

_BESIDE = 2


def plot_search(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Cost of every evaluation, and the least until then, a panel a controller, all on one logarithmic scale.

    Args:
        rows: See `tune.COLUMNS`.
    """
    names = list(dict.fromkeys(row["controller"] for row in rows))
    beside = min(_BESIDE, len(names))
    lines = -(-len(names) // beside)
    figure, axes = panels(lines, beside, 0.6 + 2.4 * lines, sharex=True, sharey=True)
    for panel, name in zip(axes.flat, names, strict=False):
        own = [row for row in rows if row["controller"] == name]
        number, costs, best = ([row[key] for row in own] for key in ("evaluation", "cost", "best"))
        panel.plot(number, costs, ".", color=QUIET, markersize=4.0)
        panel.step(number, best, where="post", color=BLUE, linewidth=1.8)
        logarithmic(panel, "y")
        label(panel, f"{name}: {best[0]:.3g} to {best[-1]:.3g}", "evaluation", "cost [-]")
    for panel in axes.flat[len(names) :]:
        panel.set_axis_off()
    return figure
