"""Maps of the robot's capabilities over its workspace."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stewart_drake.analysis.workspace import Survey, governing_limit
from stewart_drake.logs.signals import SCALES
from stewart_drake.plotting import style as look

CAPABILITIES = {
    "transmission": ("Transmission, serial [-]", 1.0, "YlOrBr_r"),
    "conditioning": ("Conditioning, parallel [-]", 1.0, "RdBu"),
    "clearance": ("Clearance of links [mm]", 1e3, "cividis"),
    "holding_torque": ("Holding torque [N m]", 1.0, "magma_r"),
    "force": ("Force in any direction [N]", 1.0, "viridis"),
    "moment": ("Moment in any direction [N m]", 1.0, "viridis"),
}
"""Measures of the capabilities at a pose: title with unit, factor to the unit, colour map."""


@look.styled
def plot_capability(survey: Survey) -> Figure:
    """Six measures over a slice of a grid, with the boundary of the limits and both kinds of singularity."""
    grid, measures = survey.grid, survey.measures
    # In mm and degrees, with the longer side along x.
    x, y = sorted((i for i in range(3) if grid.counts[i] > 1), key=lambda i: -(grid.high - grid.low)[i])
    (fixed,) = {0, 1, 2} - {x, y}
    coordinates, scales = list(grid.coordinates), SCALES[list(grid.coordinates)]
    names, units = zip(*(look.COORDINATES[axis] for axis in coordinates), strict=True)
    ends = scales * np.stack([grid.low, grid.high])
    (left, right), (bottom, top) = ends[:, x].tolist(), ends[:, y].tolist()

    def field(values: np.ndarray) -> np.ma.MaskedArray:
        """(n_y, n_x) of values (n,)."""
        on_grid = values.reshape(grid.counts[min(x, y)], grid.counts[max(x, y)])
        return np.ma.masked_invalid(on_grid.T if x < y else on_grid)

    lines = (
        ("boundary of the limits", np.minimum(governing_limit(survey.use)[0], 1.5), 1.0, look.TEXT, 1.3),
        ("serial singularity", measures.reach_margin, 0.0, "#C2270A", 2.2),
        ("parallel singularity", measures.conditioning, 0.0, "#0B4FB3", 2.2),
    )
    equal = units[x] == units[y]
    height = 2.9 * np.ptp(ends[:, y]) / np.ptp(ends[:, x]) if equal else 2.5
    figure, axes = look.panels(2, 3, 1.1 + 2.0 * (1.0 + height), width=12.0)
    for panel, (name, (title, scale, cmap)) in zip(axes.flat, CAPABILITIES.items(), strict=True):
        values = field(scale * getattr(measures, name))
        # Percentiles, as forces and torques are unbounded near a singularity.
        low, high = np.percentile(values.compressed(), [3.0, 97.0]) if values.count() else (0.0, 1.0)
        if cmap == "RdBu":
            low, high = -max(abs(low), high), max(abs(low), high)
        extent = left, right, bottom, top
        image = panel.imshow(
            values, extent=extent, origin="lower", interpolation="nearest", cmap=cmap, vmin=low, vmax=high
        )
        figure.colorbar(image, ax=panel, shrink=0.75, aspect=20, pad=0.02, extend="both")
        labels = {"xlabel": f"{names[x]} [{units[x]}]", "ylabel": f"{names[y]} [{units[y]}]", "title": title}
        panel.set(aspect="equal" if equal else "auto", facecolor="#E9E9E6", **labels)
        panel.grid(visible=False)
        panel.spines[:].set(visible=True, color=look.GREY)
        for _, margin, level, color, width in lines:
            drawn = field(margin)
            if drawn.count() and drawn.min() < level < drawn.max():
                axes_values = (scales[i] * grid.axes[i] for i in (x, y))
                panel.contour(*axes_values, drawn, levels=[level], colors=[color], linewidths=width)
        if np.isclose(grid.axes[fixed][0], grid.center[coordinates[fixed]]):
            center = (scales[i] * grid.center[coordinates[i]] for i in (x, y))
            panel.plot(*center, "+", color=look.TEXT, markersize=11, mew=2)
    keys = [Line2D([], [], color=color, linewidth=width, label=label) for label, _, _, color, width in lines]
    look.legend_below(figure, [*keys, Line2D([], [], color=look.TEXT, marker="+", linestyle="", label="centre")])
    at = f"{names[fixed]} = {scales[fixed] * grid.axes[fixed][0]:.0f} {units[fixed]}"
    figure.suptitle(f"Slice at {at}", x=0.01, ha="left")
    return figure
