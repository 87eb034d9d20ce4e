"""What the pictures of the report share beyond plain panels: curves by name, maps with contours, logarithmic axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stewart_drake.plotting.panels import BLUE, GREEN, ORANGE, PURPLE, SKY, heatmap

COLORS = (BLUE, ORANGE, GREEN, PURPLE, SKY)
STYLES = ("-", (0, (6, 2)), (0, (3, 1.5)), (0, (6, 1.5, 1, 1.5)), (0, (1, 1)))


def curves(
    panel: Axes, x: np.ndarray, named: Mapping[str, Sequence[float] | np.ndarray], markers: str = "", **style: Any
) -> None:
    """Lines (n,) over x (n,) by name: each with its own colour and marker, or dashes where there are no markers."""
    for index, (name, values) in enumerate(named.items()):
        look = {"marker": markers[index], "markersize": 4.0} if markers else {"linestyle": STYLES[index]}
        panel.plot(x, values, **{"color": COLORS[index], "linewidth": 1.8, "label": name, **look, **style})


def contoured(
    figure: Figure, panel: Axes, x: np.ndarray, y: np.ndarray, values: np.ndarray, unit: str, levels: Any, **kept: Any
) -> None:
    """Values (len(y), len(x)) as colours with named contours; grey where they are NaN."""
    heatmap(figure, panel, x, y, values, unit, cmap="cividis", vmin=0.0, **kept)
    lines = panel.contour(x, y, values, levels=levels, colors="black", linewidths=0.7)
    panel.clabel(lines, fmt="%g", fontsize=8)
