"""Figures of workspaces: slices, and maps of what the robot can do.

One colour means one limit in all of them; serial singularities are red, parallel ones blue.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from stewart_drake.planning.workspace import LIMIT_NAMES, Survey, governing_limit
from stewart_drake.plotting import style as look

_SERIAL, _PARALLEL = "#C2270A", "#0B4FB3"
LIMITS = {
    "reach": (look.ORANGE, "reach (serial)"),
    "transmission": (look.YELLOW, "transmission (serial)"),
    "conditioning": (look.BLUE, "conditioning (parallel)"),
    "ball_swing": (look.GREEN, "ball joint's swing"),
    "universal_swing": ("#A3CC5B", "universal joint's swing"),
    "clearance": (look.PURPLE, "clearance of links"),
    "torque": ("#7B6A3A", "holding torque"),
    "euler_pitch": (look.QUIET, "pitch of the Euler angles"),
    "crank_range": (look.SKY, "stops of the cranks"),
}
"""Colour and words: serial limits in warm colours, the parallel one in blue."""
CAPABILITIES = {
    "transmission": ("Transmission, serial [-]", 1.0, "YlOrBr_r"),
    "conditioning": ("Conditioning, parallel [-]", 1.0, "RdBu"),
    "clearance": ("Clearance of links [mm]", 1e3, "cividis"),
    "holding_torque": ("Holding torque [N m]", 1.0, "magma_r"),
    "force": ("Force in any direction [N]", 1.0, "viridis"),
    "moment": ("Moment in any direction [N m]", 1.0, "viridis"),
}
"""Measures of what the robot can do at a pose: name with unit, factor to it, colours."""
_OUT_OF_REACH = "#E9E9E6"
_USE = LinearSegmentedColormap.from_list("use", ["#FFFDE9", "#F3E2A9", "#C9C08A", "#86977C", "#49706F", "#1F4A5C"])


class Slice:
    """A survey over two coordinates, ready to be drawn in mm and degrees, the longer side along x.

    Args:
        survey: Of a grid with one side of a single cell.
    """

    def __init__(self, survey: Survey) -> None:
        self.survey, grid = survey, survey.grid
        of = list(grid.coordinates)
        (fixed,) = (axis for axis in range(3) if grid.counts[axis] == 1)
        # On equal lengths the first is along x.
        self._sides = sorted({0, 1, 2} - {fixed}, key=lambda axis: -(grid.high - grid.low)[axis])
        ends = look.SCALES[of] * np.stack([grid.low, grid.high])
        self.extent = [float(end) for axis in self._sides for end in ends[:, axis]]
        self.x, self.y = (look.SCALES[of[axis]] * grid.axes[axis] for axis in self._sides)
        self.labels = [" [".join(look.COORDINATES[of[axis]]) + "]" for axis in self._sides]
        self.equal = len({look.COORDINATES[of[axis]][1] for axis in self._sides}) == 1
        (name, unit), at = look.COORDINATES[of[fixed]], grid.axes[fixed][0]
        self.title = f"{name} = {look.SCALES[of[fixed]] * at:.0f} {unit}"
        center = (look.SCALES * grid.center)[[of[axis] for axis in self._sides]]
        self.center = center if np.isclose(at, grid.center[of[fixed]]) else None

    def field(self, values: np.ndarray) -> np.ndarray:
        """(n_y, n_x, ...) of values (n, ...)."""
        field = values.reshape(*(n for n in self.survey.grid.counts if n > 1), *values.shape[1:])
        return field.swapaxes(0, 1) if self._sides[0] < self._sides[1] else field

    def image(self, panel: Axes, values: np.ndarray, title: str, **style: Any) -> Any:
        """A picture of values (n,) or colours (n, 3), with axes and the lines of limits and singularities."""
        extent: Any = self.extent
        image = panel.imshow(self.field(values), extent=extent, origin="lower", interpolation="nearest", **style)
        panel.set(aspect="equal" if self.equal else "auto", xlabel=self.labels[0], ylabel=self.labels[1], title=title)
        panel.set(facecolor=_OUT_OF_REACH, xlim=self.extent[:2], ylim=self.extent[2:])
        panel.grid(visible=False)
        panel.spines[:].set(visible=True, color=look.QUIET)
        measures = self.survey.measures
        edge = np.minimum(governing_limit(self.survey.use)[0], 1.5)
        lines = (
            (edge, 1.0, look.TEXT, 1.3),
            (measures.reach, 0.0, _SERIAL, 2.2),
            (measures.conditioning, 0.0, _PARALLEL, 2.2),
        )
        for each, level, color, width in lines:
            field = np.ma.masked_invalid(self.field(each))
            if field.count() and field.min() < level < field.max():
                panel.contour(self.x, self.y, field, levels=[level], colors=[color], linewidths=width)
        if self.center is not None:
            panel.plot(*self.center, marker="+", markersize=11, markeredgewidth=2.0, color=look.TEXT)
        return image


@look.styled
def plot_slices(slices: Sequence[Survey]) -> Figure:
    """Slices through a workspace, six at most: how much of its limits a pose takes up, and what breaks beyond them.

    Args:
        slices: Surveys of grids with one side of a single cell.
    """
    figure, axes = look.panels(2, 3, 8.0, width=12.0)
    broken_limits: set[int] = set()
    for panel, found in zip(axes.flat, slices, strict=False):
        use, cause = governing_limit(found.use)
        broken = found.spanning & ~found.feasible
        colors = np.tile(to_rgb(_OUT_OF_REACH), (len(use), 1))
        for index in np.unique(cause[broken]).tolist():
            colors[broken & (cause == index)] = _pale(index)
            broken_limits.add(index)
        colors[found.feasible] = _USE(use[found.feasible])[:, :3]
        drawn = Slice(found)
        drawn.image(panel, colors, drawn.title)
    for panel in axes.flat[len(slices) :]:
        panel.set_visible(False)
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, 1.0), _USE), ax=axes, shrink=0.6, aspect=30, pad=0.01)
    bar.set_label("within all limits: largest part of a limit taken up [-]")
    beyond = [Patch(color=_pale(i), label=f"beyond: {LIMITS[LIMIT_NAMES[i]][1]}") for i in sorted(broken_limits)]
    look.legend_below(figure, [*_line_keys(), *beyond, Patch(color=_OUT_OF_REACH, label="a rod cannot span")])
    return figure


@look.styled
def plot_capability(survey: Survey) -> Figure:
    """Six measures over one slice: both singularities, clearance, holding torque, force and moment in any direction.

    Args:
        survey: Of a grid with one side of a single cell.
    """
    drawn = Slice(survey)
    left, right, bottom, top = drawn.extent
    height = 2.9 * (top - bottom) / (right - left) if drawn.equal else 2.5
    figure, axes = look.panels(2, 3, 1.1 + 2.0 * (1.0 + height), width=12.0)
    for panel, (name, (title, scale, cmap)) in zip(axes.flat, CAPABILITIES.items(), strict=True):
        values = np.ma.masked_invalid(scale * getattr(survey.measures, name))
        # Near a singularity forces and torques have no bound; a few pixels must not take all the colours.
        low, high = np.percentile(values.compressed(), [3.0, 97.0]) if values.count() else (0.0, 1.0)
        if cmap == "RdBu":
            low, high = -max(abs(low), high), max(abs(low), high)
        image = drawn.image(panel, values, title, cmap=cmap, vmin=low, vmax=high)
        figure.colorbar(image, ax=panel, shrink=0.75, aspect=20, pad=0.02, extend="both")
    look.legend_below(figure, _line_keys())
    figure.suptitle(f"Slice at {drawn.title}", x=0.01, ha="left")
    return figure


def _line_keys() -> list[Line2D]:
    """Legend of the lines in each slice."""
    return [
        Line2D([], [], color=look.TEXT, linewidth=1.3, label="edge of what the limits allow"),
        Line2D([], [], color=_SERIAL, linewidth=2.2, label="serial singularity"),
        Line2D([], [], color=_PARALLEL, linewidth=2.2, label="parallel singularity"),
        Line2D([], [], color=look.TEXT, marker="+", linestyle="", markersize=10, label="centre"),
    ]


def _pale(limit: int) -> tuple[float, float, float]:
    red, green, blue = (0.55 + 0.45 * part for part in to_rgb(LIMITS[LIMIT_NAMES[limit]][0]))
    return red, green, blue
