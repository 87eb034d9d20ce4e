"""Figures of tuners of settings: what they cost by kind, and the front of error against torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

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
    legend,
    logarithmic,
    panels,
)

_STYLES = tuple(zip((BLUE, ORANGE, PURPLE, YELLOW, SKY, GREEN), "oDs^vP", strict=True))
_APART = 0.11
"""Of a line, between candidates."""
_SHOWN = (0.08, 12.0)
"""Ratios beyond stand at the edge, hollow."""


def plot_costs(
    kinds: Sequence[str], ratios: Mapping[str, Sequence[tuple[float, float, float]]], against: str
) -> Figure:
    """Cost over that of one candidate, a line a kind.

    Args:
        kinds: Names of the lines.
        ratios: Candidate -> for each kind, ratio with both ends of its interval.
        against: Whose cost is 1.
    """
    figure, axes = panels(1, 1, 1.6 + 0.34 * len(kinds))
    panel = axes[0, 0]
    panel.axvline(1.0, color=TEXT, linewidth=1.2)
    places = np.arange(len(kinds))[::-1]
    for number, (name, each) in enumerate(ratios.items()):
        color, marker = _STYLES[number % len(_STYLES)]
        value, low, high = np.array(each, dtype=float).T
        shown, at = np.clip(value, *_SHOWN), places - _APART * (number - 0.5 * (len(ratios) - 1))
        panel.hlines(at, np.clip(low, *_SHOWN), np.clip(high, *_SHOWN), color=color, linewidth=1.4)
        inside = shown == value
        panel.plot(shown[inside], at[inside], marker, color=color, markersize=5.0, label=name)
        panel.plot(shown[~inside], at[~inside], marker, color=color, markersize=5.0, markerfacecolor="white")
    logarithmic(panel, "x")
    panel.set_xlim(_SHOWN[0] / 1.1, _SHOWN[1] * 1.1)
    panel.set_xticks([0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0])
    panel.set_yticks(places, kinds)
    panel.set_ylim(-0.7, len(kinds) - 0.3)
    label(panel, f"Cost in situations not seen before, over that of: {against}", "ratio [-], less is better", "")
    legend(panel, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def plot_front(cloud: np.ndarray, front: np.ndarray, tastes: Sequence[float], fixed: np.ndarray) -> Figure:
    """Error against change of torque: a tuner by its taste, and settings that stay.

    Args:
        cloud: (n, 2) [mm], [N m] of settings that stay.
        front: (k, 2) likewise of the tuner, by taste.
        tastes: (k,) kappa.
        fixed: (k, 2) of the setting that is best of all that stay at each taste.
    """
    figure, axes = panels(1, 1, 5.0)
    panel = axes[0, 0]
    panel.plot(cloud[:, 1], cloud[:, 0], ".", color=QUIET, markersize=6.0, label="settings that stay")
    panel.plot(fixed[:, 1], fixed[:, 0], "D", color=ORANGE, markersize=6.0, label="the best of them at a taste")
    panel.plot(front[:, 1], front[:, 0], "o-", color=BLUE, linewidth=1.8, label="policy")
    for taste, (error, change) in zip(tastes, front, strict=True):
        panel.annotate(
            f"{taste:g}",
            (change, error),
            (-4, -8),
            textcoords="offset points",
            ha="right",
            va="top",
            color=BLUE,
            fontsize=9,
        )
    logarithmic(panel, "xy")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    label(panel, "From stiff (-1) to quiet (1)", "change of torque in a millisecond [N m] RMS", "error [mm] RMS")
    legend(panel)
    return figure
