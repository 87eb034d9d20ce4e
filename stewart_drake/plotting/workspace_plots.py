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
from stewart_drake.plotting import panels as look

SERIAL, PARALLEL = "#C2270A", "#0B4FB3"
"""Colours of the two kinds of singularity."""

# Serial limits in warm colours, the parallel one in blue.
COLORS = {
    "reach": look.ORANGE,
    "transmission": look.YELLOW,
    "conditioning": look.BLUE,
    "ball_swing": look.GREEN,
    "universal_swing": "#A3CC5B",
    "clearance": look.PURPLE,
    "torque": "#7B6A3A",
    "euler_pitch": look.QUIET,
    "crank_range": look.SKY,
}
WORDS = {
    "reach": "reach (serial)",
    "transmission": "transmission (serial)",
    "conditioning": "conditioning (parallel)",
    "ball_swing": "ball joint's swing",
    "universal_swing": "universal joint's swing",
    "clearance": "clearance of links",
    "torque": "holding torque",
    "euler_pitch": "pitch of the Euler angles",
    "crank_range": "stops of the cranks",
}
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
    """A survey over two coordinates, ready to be drawn: in mm and degrees, arrays [row, column].

    Args:
        found: Survey of a grid with one side of a single cell.
    """

    def __init__(self, found: Survey) -> None:
        grid = found.grid
        self.found = found
        across, up = (axis for axis in range(3) if grid.counts[axis] > 1)
        (fixed,) = {0, 1, 2} - {across, up}
        self.turned = bool((grid.high - grid.low)[up] > (grid.high - grid.low)[across])
        if self.turned:
            across, up = up, across  # a wide picture rather than a high one
        scale = [look.SCALES[c] for c in grid.coordinates]
        names = [look.COORDINATES[c] for c in grid.coordinates]
        self.columns = (grid.coordinates[across], grid.coordinates[up])
        self.labels = tuple(f"{name} [{unit}]" for name, unit in (names[across], names[up]))
        self.x, self.y = scale[across] * grid.axes[across], scale[up] * grid.axes[up]
        self.extent = tuple(scale[axis] * end[axis] for axis in (across, up) for end in (grid.low, grid.high))
        self.title = f"{names[fixed][0]} = {scale[fixed] * grid.axes[fixed][0]:.0f} {names[fixed][1]}"
        self.center = tuple(look.SCALES[c] * grid.center[c] for c in self.columns)
        self.through_center = bool(np.isclose(grid.axes[fixed][0], grid.center[grid.coordinates[fixed]]))
        self.equal = look.SCALES[self.columns[0]] == look.SCALES[self.columns[1]]

    def field(self, values: np.ndarray) -> np.ndarray:
        """(n_up, n_across) of values (n,)."""
        field = values.reshape([n for n in self.found.grid.counts if n > 1])
        return field if self.turned else field.T

    def prepare(self, panel: Axes) -> None:
        """Axes, labels and title."""
        panel.set_xlim(self.extent[:2])
        panel.set_ylim(self.extent[2:])
        look.plain(panel, grid=False)
        panel.spines[:].set(visible=True, color=look.QUIET)
        look.label(panel, self.title, *self.labels)

    def image(self, panel: Axes, values: np.ndarray, **style: Any) -> Any:
        """A picture of an array [row, column] or [row, column, colour]."""
        left, right, bottom, top = self.extent
        picture = panel.imshow(
            values, extent=(left, right, bottom, top), origin="lower", interpolation="nearest", **style
        )
        panel.set_aspect("equal" if self.equal else "auto")
        return picture

    def use_image(self, panel: Axes) -> set[str]:
        """How much of its limits each pose takes up, and in pale colours what is broken; names of the limits seen."""
        found = self.found
        use, cause = governing_limit(found.use)
        broken = found.spanning & ~found.feasible
        image = np.tile(to_rgb(_OUT_OF_REACH), (len(use), 1))
        for index in np.unique(cause[broken]):
            image[broken & (cause == index)] = _pale(COLORS[LIMIT_NAMES[index]])
        image[found.feasible] = _USE(use[found.feasible])[:, :3]
        self.image(panel, np.stack([self.field(channel) for channel in image.T], axis=-1))
        return {LIMIT_NAMES[index] for index in np.unique(cause[broken])}

    def lines(self, panel: Axes) -> None:
        """The edge of what all limits allow, and where the two kinds of singularity lie."""

        def level(values: np.ndarray, at: float, **style: Any) -> None:
            field = np.ma.masked_invalid(self.field(values))
            if field.count() and field.min() < at < field.max():
                panel.contour(self.x, self.y, field, levels=[at], **style)

        found = self.found
        level(np.minimum(governing_limit(found.use)[0], 1.5), 1.0, colors=[look.TEXT], linewidths=1.3)
        level(found.measures.reach, 0.0, colors=[SERIAL], linewidths=2.2)
        level(found.measures.conditioning, 0.0, colors=[PARALLEL], linewidths=2.2)
        if self.through_center:
            panel.plot(*self.center, marker="+", markersize=11, markeredgewidth=2.0, color=look.TEXT)


def plot_slices(slices: Sequence[Survey]) -> Figure:
    """Slices through a workspace, six at most: how much of its limits a pose takes up, and what breaks beyond them.

    Args:
        slices: Surveys of grids with one side of a single cell.
    """
    figure, axes = look.wide(2, 3, 8.0)
    seen: set[str] = set()
    for panel, found in zip(axes.flat, slices, strict=False):
        drawn = Slice(found)
        drawn.prepare(panel)
        seen |= drawn.use_image(panel)
        drawn.lines(panel)
    for panel in axes.flat[len(slices) :]:
        panel.set_visible(False)
    use_bar(figure, axes)
    look.legend_below(figure, [*line_keys(), *limit_keys(seen)])
    return figure


def plot_capability(found: Survey) -> Figure:
    """Six measures over one slice: both singularities, clearance, holding torque, force and moment in any direction.

    Args:
        found: Survey of a grid with one side of a single cell.
    """
    drawn = Slice(found)
    left, right, bottom, top = drawn.extent
    height = 2.9 * (top - bottom) / (right - left) if drawn.equal else 2.5
    figure, axes = look.wide(2, 3, 1.1 + 2.0 * (1.0 + height))
    for panel, (name, (title, scale, cmap)) in zip(axes.flat, CAPABILITIES.items(), strict=True):
        drawn.prepare(panel)
        panel.set_facecolor(_OUT_OF_REACH)
        look.headline(panel, title)
        field = np.ma.masked_invalid(drawn.field(scale * getattr(found.measures, name)))
        # Near a singularity forces and torques have no bound; a few pixels must not take all the colours.
        low, high = np.percentile(field.compressed(), [3.0, 97.0]) if field.count() else (0.0, 1.0)
        if cmap == "RdBu":
            low, high = -max(abs(low), high), max(abs(low), high)
        image = drawn.image(panel, field, cmap=cmap, vmin=low, vmax=high)
        drawn.lines(panel)
        bar = figure.colorbar(image, ax=panel, shrink=0.75, aspect=20, pad=0.02, extend="both")
        bar.outline.set_visible(False)
        bar.ax.tick_params(labelsize=8.5)
    look.legend_below(figure, line_keys())
    figure.suptitle(f"Slice at {drawn.title}", x=0.01, ha="left", fontsize=12, fontweight="bold", color=look.TEXT)
    return figure


def line_keys() -> list[Line2D]:
    """Legend of what `Slice.lines` draws."""
    return [
        Line2D([], [], color=look.TEXT, linewidth=1.3, label="edge of what the limits allow"),
        Line2D([], [], color=SERIAL, linewidth=2.2, label="serial singularity"),
        Line2D([], [], color=PARALLEL, linewidth=2.2, label="parallel singularity"),
        Line2D([], [], color=look.TEXT, marker="+", linestyle="", markersize=10, markeredgewidth=2.0, label="centre"),
    ]


def limit_keys(seen: set[str]) -> list[Patch]:
    """Legend of what `Slice.use_image` draws beyond the limits."""
    keys = [Patch(color=_pale(COLORS[name]), label=f"beyond: {WORDS[name]}") for name in LIMIT_NAMES if name in seen]
    return [*keys, Patch(color=_OUT_OF_REACH, label="a rod cannot span")]


def use_bar(figure: Figure, axes: Any) -> None:
    """Colour bar of what `Slice.use_image` draws within the limits."""
    bar = figure.colorbar(ScalarMappable(Normalize(0.0, 1.0), _USE), ax=axes, shrink=0.6, aspect=30, pad=0.01)
    bar.set_label("within all limits: largest part of a limit taken up [-]")
    bar.outline.set_visible(False)


def _tint(color: str, white: float) -> tuple[float, float, float]:
    red, green, blue = ((1.0 - white) * part + white for part in to_rgb(color))
    return red, green, blue


def _pale(color: str) -> tuple[float, float, float]:
    return _tint(color, 0.55)
