"""Figures of workspaces: slices, maps of what the robot can do, the boundary in space, what each limit takes.

One colour means one limit in all of them; serial singularities are red, parallel ones blue.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped] # this part has no types

from stewart_drake.mechanics.kinematics import leg_geometry
from stewart_drake.planning import workspace_region
from stewart_drake.planning.workspace_boundary import Boundary
from stewart_drake.planning.workspace import LIMIT_NAMES, Loss, Survey, governing_limit
from stewart_drake.plotting import panels as look
from stewart_drake.robot import RobotParameters

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


def plot_boundaries(boundaries: Sequence[Boundary], robot: RobotParameters) -> Figure:
    """The surfaces on which straight ways from the centre first break a limit, in space; a panel each.

    Args:
        boundaries: One or two.
        robot: Drawn at the centre, below the surface of the positions.
    """
    figure = Figure(figsize=(12.0, 6.4), facecolor="white")
    seen: set[str] = set()
    for column, surface in enumerate(boundaries):
        share = 1.0 / len(boundaries)
        place = (column * share - 0.005, 0.09, share - 0.02, 0.87)
        panel: Any = figure.add_axes(place, projection="3d", computed_zorder=False)
        columns = workspace_region.COORDINATES[surface.kind]
        points = look.SCALES[list(columns)] * surface.points
        low, high = points.min(axis=0), points.max(axis=0)
        if surface.kind == "position":
            ends = np.concatenate(_draw_robot(panel, robot, surface.center))
            low, high = np.minimum(low, ends.min(axis=0)), np.maximum(high, ends.max(axis=0))
        margin = 0.08 * max((high - low).max(), 1e-9)
        low, high = low - margin, high + margin
        corners = points[surface.triangles]
        limit = surface.limit[surface.triangles]
        cause = np.where(limit[:, 1] == limit[:, 2], limit[:, 1], limit[:, 0])
        seen |= {LIMIT_NAMES[i] for i in np.unique(cause[cause >= 0])}
        base = np.array([to_rgb(COLORS[LIMIT_NAMES[i]] if i >= 0 else look.QUIET) for i in cause])
        shadow = corners.copy()
        shadow[..., 2] = low[2]
        for order, polygons, colors in ((1, shadow, to_rgb("#E2E2E2")), (3, corners, _shade(corners, base))):
            style = {"facecolor": colors, "edgecolor": colors, "linewidth": 0.3, "zorder": order}
            panel.add_collection3d(Poly3DCollection(polygons, **style))
        panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        panel.set_box_aspect(high - low)
        panel.view_init(elev=22.0, azim=-55.0)
        for axis, coordinate in zip((panel.xaxis, panel.yaxis, panel.zaxis), columns, strict=True):
            axis.set_label_text("{} [{}]".format(*look.COORDINATES[coordinate]), color=look.TEXT)
            axis.labelpad = 5.0
            axis.set_pane_color((0.97, 0.97, 0.97, 1.0))
            axis.set_major_locator(MaxNLocator(5))
        panel.grid(False)
        panel.tick_params(labelsize=8.5, pad=1, colors=look.TEXT)
        what = "Positions at the fixed orientation", "Orientations at the fixed position"
        title = what[0] if surface.kind == "position" else what[1]
        figure.text(place[0] + 0.5 * share, 0.95, title, ha="center", fontsize=12, fontweight="bold", color=look.TEXT)
    handles = [Patch(color=COLORS[name], label=f"first cut by {WORDS[name]}") for name in LIMIT_NAMES if name in seen]
    figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=10)
    return figure


def _draw_robot(panel: Any, robot: RobotParameters, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Base, cranks, rods and platform at a pose, behind the surface; shafts and crank tips (6, 3) [mm]."""
    legs = leg_geometry(robot, pose)
    shafts = 1e3 * robot.shaft_positions
    tips = shafts + 1e3 * robot.crank_lengths[:, None] * legs.crank
    joints = 1e3 * (legs.arm + pose[3:])
    for ring in (shafts, joints):
        panel.plot(*np.concatenate([ring, ring[:1]]).T, color="#9A9A9A", linewidth=1.2, zorder=2)
    for shaft, tip, joint in zip(shafts, tips, joints, strict=True):
        panel.plot(*np.stack([tip, joint]).T, color="#5F6B76", linewidth=2.0, zorder=2)
        panel.plot(*np.stack([shaft, tip]).T, color=look.TEXT, linewidth=3.0, zorder=2)
    return shafts, tips


def plot_losses(rows: Sequence[tuple[str, Sequence[Loss], Mapping[str, float]]]) -> Figure:
    """What each limit takes, a panel for each workspace.

    Args:
        rows: Title, losses on the grid, and share of the directions in which each limit cuts first.
    """
    figure, (panels,) = look.wide(1, len(rows), 4.4, sharey=True)
    kinds = (
        (0.27, 0.0, "poses that break it and no other"),
        (0.0, 0.55, "poses that break it"),
        (-0.27, 1.0, "directions from the centre in which it cuts first"),
    )
    for panel, (title, lost, first) in zip(panels, rows, strict=True):
        height = np.arange(len(lost))[::-1]
        values = [[loss.alone, loss.broken, first.get(loss.limit, 0.0)] for loss in lost]
        for (shift, tint, _), shares in zip(kinds, zip(*values, strict=True), strict=True):
            for y, share, loss in zip(height + shift, shares, lost, strict=True):
                if share > 0.0:
                    color = COLORS[loss.limit]
                    bar = panel.barh(y, 100.0 * share, 0.24, color=_tint(color, tint), edgecolor=color, linewidth=0.8)
                    shown = f"{100.0 * share:.2g} %" if share >= 0.001 else "< 0.1 %"
                    panel.bar_label(bar, [shown], padding=3, fontsize=8.5, color=look.TEXT)
        for y, of_limit in zip(height, values, strict=True):
            if not any(of_limit):
                panel.text(0.8, y, "nothing", va="center", fontsize=8.5, color=look.QUIET)
        panel.set_yticks(height, [WORDS[loss.limit] for loss in lost])
        panel.set_xlim(0.0, 112.0)
        panel.set_xlabel("share [%]")
        look.headline(panel, title)
        look.plain(panel, grid=False)
    keys = [Patch(facecolor=_tint(look.TEXT, tint), edgecolor=look.TEXT, label=what) for _, tint, what in kinds]
    look.legend_below(figure, keys, 3)
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


def _shade(corners: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Colours (k, 3) of triangles (k, 3, 3) lit from above and from the viewer's left."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    light = np.array([0.1, -0.65, 0.75])
    lit = np.clip(normal @ (light / np.linalg.norm(light)), -1.0, 1.0)
    strength = 0.62 + 0.38 * lit
    shine = 0.22 * np.clip(lit, 0.0, 1.0) ** 8
    return np.clip(base * strength[:, None] + shine[:, None], 0.0, 1.0)
