"""What each change does to a quantity, the largest effect on top."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator

from stewart_drake.plotting.panels import BLUE, ORANGE, TEXT, label, panels

_LOST = "#B2182B"
_NAMES = {"omega_Q": r"$\omega_Q$", "omega_R": r"$\omega_R$"}


def plot_effects(
    unchanged: Mapping[str, float], effects: Sequence[tuple[str, str, Sequence[float | None]]], logarithmic: str
) -> Figure:
    """Bars from the unchanged value, blue below and orange above it, a row for each change; some runs end early.

    Args:
        unchanged: Quantity with its unit -> its value without any change; a panel for each.
        effects: What was changed, to what, and each quantity then, None where the run ended early; the top row first.
        logarithmic: The quantity that is shown on a logarithmic axis.
    """
    figure, axes = panels(1, len(unchanged), 1.1 + 0.2 * len(effects), sharey=True)
    rows = np.arange(len(effects))[::-1]
    for column, (panel, (quantity, base)) in enumerate(zip(axes[0], unchanged.items(), strict=True)):
        values = [quantities[column] for *_, quantities in effects]
        known = np.array([base if value is None else value for value in values])
        panel.barh(rows, known - base, left=base, height=0.7, color=np.where(known < base, BLUE, ORANGE), zorder=2.0)
        panel.axvline(base, color=TEXT, linewidth=1.2, zorder=3.0)
        for row, value in zip(rows, values, strict=True):
            if value is None:
                panel.annotate("ends early", (base, row), xytext=(4.0, 0.0), textcoords="offset points", va="center",
                               fontsize=8, color=_LOST)  # fmt: skip
        panel.xaxis.set_major_locator(MaxNLocator(5))
        if quantity == logarithmic:
            panel.set_xscale("log")
            panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_major_formatter("{x:g}")
        panel.grid(axis="y", visible=False)
        label(panel, f"unchanged: {base:.4g}", quantity, "")
    axes[0, 0].set_yticks(rows, [f"{_NAMES.get(factor, factor)}, {to}" for factor, to, _ in effects])
    return figure
