"""Figures of workspaces: slices, maps of what the robot can do, the boundary in space, what each limit takes.

One colour means one limit in all of them; serial singularities are red, parallel ones blue.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from stewart_drake.workspace_boundary import Boundary
from stewart_drake.workspace_region import LIMIT_NAMES, Loss, Survey, governing_limit

SERIAL, PARALLEL = "#C2270A", "#0B4FB3"
"""Colours of the two kinds of singularity."""

# Okabe and Ito's palette; serial limits in warm colours, the parallel one in blue.
_COLORS = {
    "reach": "#D55E00",
    "transmission": "#E69F00",
    "conditioning": "#0072B2",
    "ball_swing": "#009E73",
    "universal_swing": "#56B4E9",
    "clearance": "#CC79A7",
    "torque": "#7B6A3A",
    "euler_pitch": "#8C8C8C",
}
_WORDS = {
    "reach": "reach (serial)",
    "transmission": "transmission (serial)",
    "conditioning": "conditioning (parallel)",
    "ball_swing": "ball joint's swing",
    "universal_swing": "universal joint's swing",
    "clearance": "clearance of links",
    "torque": "holding torque",
    "euler_pitch": "pitch of the Euler angles",
}
_OUT_OF_REACH, _TEXT, _QUIET = "#E9E9E6", "#222222", "#8C8C8C"
_USE = LinearSegmentedColormap.from_list("use", ["#FFFDE9", "#F3E2A9", "#C9C08A", "#86977C", "#49706F", "#1F4A5C"])
_COORDINATES = (("roll", "deg"), ("pitch", "deg"), ("yaw", "deg"), ("X", "mm"), ("Y", "mm"), ("Z", "mm"))


def _scale(kind: str) -> float:
    return 1e3 if kind == "position" else 180.0 / np.pi


class _Slice:
    """A survey over two coordinates, ready to be drawn: in mm or degrees, arrays [row, column]."""

    def __init__(self, found: Survey) -> None:
        grid = found.grid
        self.found, self.kind, self.scale = found, grid.kind, _scale(grid.kind)
        across, up = (axis for axis in range(3) if grid.counts[axis] > 1)
        (self.fixed,) = {0, 1, 2} - {across, up}
        offset = 3 if grid.kind == "position" else 0
        self.names = tuple("{} [{}]".format(*_COORDINATES[offset + axis]) for axis in (across, up))
        self.x, self.y = (self.scale * grid.axes[axis] for axis in (across, up))
        low, high = self.scale * grid.low, self.scale * grid.high
        self.extent = (low[across], high[across], low[up], high[up])
        name, unit = _COORDINATES[offset + self.fixed]
        self.title = f"{name} = {self.scale * grid.axes[self.fixed][0]:.0f} {unit}"
        center = self.scale * grid.center[offset : offset + 3]
        self.center = (center[across], center[up])
        self.through_center = bool(np.isclose(self.scale * grid.axes[self.fixed][0], center[self.fixed]))

    def field(self, values: np.ndarray) -> np.ndarray:
        """(n_up, n_across) of values (n,)."""
        return values.reshape([n for n in self.found.grid.counts if n > 1]).T

    def prepare(self, panel: Axes) -> None:
        panel.set_aspect("equal")
        panel.set_xlim(self.extent[:2])
        panel.set_ylim(self.extent[2:])
        panel.set_xlabel(self.names[0])
        panel.set_ylabel(self.names[1])
        panel.tick_params(colors=_TEXT, color=_QUIET, labelsize=9)
        panel.spines[:].set_color(_QUIET)
        panel.set_title(self.title, loc="left", fontsize=11, fontweight="bold", color=_TEXT)

    def lines(self, panel: Axes) -> None:
        """The edge of what all limits allow, and where the two kinds of singularity lie."""
        found = self.found

        def level(values: np.ndarray, at: float, **style: Any) -> None:
            field = np.ma.masked_invalid(self.field(values))
            if field.count() and field.min() < at < field.max():
                panel.contour(self.x, self.y, field, levels=[at], **style)

        level(found.feasible.astype(float), 0.5, colors=[_TEXT], linewidths=1.4)
        level(found.measures.reach, 0.0, colors=[SERIAL], linewidths=2.2)
        level(found.measures.conditioning, 0.0, colors=[PARALLEL], linewidths=2.2)
        if self.through_center:
            panel.plot(*self.center, marker="+", markersize=11, markeredgewidth=2.0, color=_TEXT)


def plot_slices(slices: Sequence[Survey]) -> Figure:
    """Slices through a workspace, six at most: how much of its limits a pose takes up, and what breaks beyond them.

    Args:
        slices: Surveys of grids with one side of a single cell.
    """
    figure = Figure(figsize=(12.0, 8.6), facecolor="white", layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    seen: set[int] = set()
    for panel, found in zip(axes, slices, strict=False):
        slice_ = _Slice(found)
        use, cause = governing_limit(found.use)
        broken = found.spanning & ~found.feasible
        image = np.tile(to_rgb(_OUT_OF_REACH), (len(use), 1))
        for index in np.unique(cause[broken]):
            seen.add(int(index))
            image[broken & (cause == index)] = _pale(_COLORS[LIMIT_NAMES[index]])
        image[found.feasible] = _USE(use[found.feasible])[:, :3]
        pixels = np.stack([slice_.field(channel) for channel in image.T], axis=-1)
        slice_.prepare(panel)
        panel.imshow(pixels, extent=slice_.extent, origin="lower", interpolation="nearest", aspect="equal")
        slice_.lines(panel)
    for panel in axes[len(slices) :]:
        panel.set_visible(False)
    bar = figure.colorbar(_mappable(0.0, 1.0, _USE), ax=axes.tolist(), shrink=0.6, aspect=30, pad=0.01)
    bar.set_label("within all limits: largest part of a limit taken up [-]")
    bar.outline.set_visible(False)
    patches = [Patch(color=_pale(_COLORS[LIMIT_NAMES[i]]), label=f"beyond: {_WORDS[LIMIT_NAMES[i]]}") for i in sorted(seen)]
    patches.append(Patch(color=_OUT_OF_REACH, label="a rod cannot span"))
    figure.legend(handles=[*_line_keys(), *patches], loc="outside lower center", ncols=4, frameon=False, fontsize=10)
    return figure


def plot_capability(found: Survey) -> Figure:
    """Six measures over one slice: both singularities, clearance, holding torque, force and moment in any direction.

    Args:
        found: Survey of a grid with one side of a single cell.
    """
    figure = Figure(figsize=(12.0, 8.0), facecolor="white", layout="constrained")
    slice_, measures = _Slice(found), found.measures
    panels: list[tuple[str, np.ndarray, str, bool]] = [
        ("Transmission: zero at a serial singularity [-]", measures.transmission, "YlOrBr_r", False),
        ("Conditioning: zero at a parallel singularity [-]", measures.conditioning, "RdBu", False),
        ("Clearance of links [mm]", 1e3 * measures.clearance, "magma", False),
        ("Holding torque [N m]", measures.holding_torque, "magma_r", True),
        ("Force in any direction [N]", measures.force, "viridis", True),
        ("Moment in any direction [N m]", measures.moment, "viridis", True),
    ]
    for panel, (title, values, cmap, log) in zip(figure.subplots(2, 3).ravel(), panels, strict=True):
        slice_.prepare(panel)
        panel.set_facecolor(_OUT_OF_REACH)
        panel.set_title(title, loc="left", fontsize=10.5, fontweight="bold", color=_TEXT)
        field = np.ma.masked_invalid(slice_.field(values))
        shades: dict[str, Any] = {}
        if field.count():
            # Near a singularity forces and torques have no bound; a few pixels must not take all the colours.
            low, high = np.percentile(field.compressed(), [2.0, 98.0])
            if log:
                field = np.ma.masked_less_equal(field, 0.0)
                shades = {"norm": LogNorm(max(low, 1e-3 * high), high)}
            elif cmap == "RdBu":
                shades = {"vmin": -max(abs(low), high), "vmax": max(abs(low), high)}
            else:
                shades = {"vmin": low, "vmax": high}
        image = panel.imshow(field, extent=slice_.extent, origin="lower", cmap=cmap, aspect="equal", **shades)
        slice_.lines(panel)
        bar = figure.colorbar(image, ax=panel, shrink=0.8, aspect=22, extend="both")
        bar.outline.set_visible(False)
        bar.ax.tick_params(labelsize=8)
        if log:
            bar.ax.yaxis.set_major_formatter("{x:g}")
            bar.ax.yaxis.set_minor_formatter("{x:g}")
    figure.legend(handles=_line_keys(), loc="outside lower center", ncols=4, frameon=False, fontsize=10)
    figure.suptitle(f"Slice at {slice_.title}", x=0.01, ha="left", fontsize=12, fontweight="bold", color=_TEXT)
    return figure


def plot_boundaries(boundaries: Sequence[Boundary]) -> Figure:
    """The surfaces on which straight ways from the centre first break a limit, in space; a panel each."""
    figure = Figure(figsize=(12.0, 6.6), facecolor="white")
    seen: set[int] = set()
    for column, surface in enumerate(boundaries):
        panel: Any = figure.add_subplot(1, len(boundaries), column + 1, projection="3d", computed_zorder=False)
        scale, offset = _scale(surface.kind), 3 if surface.kind == "position" else 0
        points = scale * surface.points
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.08 * (high - low).max()
        low, high = low - margin, high + margin
        corners = points[surface.triangles]
        limit = surface.limit[surface.triangles]
        cause = np.where(limit[:, 1] == limit[:, 2], limit[:, 1], limit[:, 0])
        seen |= set(np.unique(cause[cause >= 0]).tolist())
        base = np.array([to_rgb(_COLORS[LIMIT_NAMES[i]] if i >= 0 else _QUIET) for i in cause])
        panel.add_collection3d(_shadow(corners, low[2]))
        faces = Poly3DCollection(corners, zorder=2)
        colors = _shade(corners, base)
        faces.set_facecolor(colors)
        faces.set_edgecolor(colors)
        faces.set_linewidth(0.3)
        panel.add_collection3d(faces)
        panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        panel.set_box_aspect(high - low)
        panel.view_init(elev=24.0, azim=-52.0)
        for axis, (name, unit) in zip("xyz", _COORDINATES[offset : offset + 3], strict=True):
            getattr(panel, f"set_{axis}label")(f"{name} [{unit}]", labelpad=6)
            getattr(panel, f"{axis}axis").set_pane_color((0.975, 0.975, 0.975, 1.0))
            getattr(panel, f"{axis}axis")._axinfo["grid"].update(color="#DDDDDD", linewidth=0.6)
        panel.tick_params(labelsize=8.5, pad=1)
        what = "Positions at the fixed orientation" if surface.kind == "position" else "Orientations at the fixed position"
        panel.set_title(what, fontsize=12, fontweight="bold", color=_TEXT, y=1.0)
    handles = [Patch(color=_COLORS[LIMIT_NAMES[i]], label=f"first cut by {_WORDS[LIMIT_NAMES[i]]}") for i in sorted(seen)]
    figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=10.5)
    figure.subplots_adjust(left=0.0, right=0.97, bottom=0.09, top=0.95, wspace=0.02)
    return figure


def plot_losses(rows: Sequence[tuple[str, Sequence[Loss], Mapping[str, float]]]) -> Figure:
    """What each limit takes, a panel for each workspace.

    Args:
        rows: Title, losses on the grid, and share of the directions in which each limit cuts first.
    """
    figure = Figure(figsize=(12.0, 4.2), facecolor="white", layout="constrained")
    for panel, (title, lost, first) in zip(np.atleast_1d(figure.subplots(1, len(rows), sharey=True)), rows, strict=True):
        height = np.arange(len(lost))[::-1]
        shares = (
            ([first.get(loss.limit, 0.0) for loss in lost], 1.0, "directions from the centre in which it cuts first"),
            ([loss.broken for loss in lost], 0.55, "poses that break it"),
            ([loss.alone for loss in lost], 0.0, "poses that break it and no other"),
        )
        for shift, (values, tint, _) in zip((0.27, 0.0, -0.27), shares, strict=True):
            colors = [_tint(_COLORS[loss.limit], tint) for loss in lost]
            bars = panel.barh(height + shift, [100.0 * v for v in values], 0.24, color=colors)
            for bar, loss in zip(bars, lost, strict=True):
                bar.set_edgecolor(_COLORS[loss.limit])
                bar.set_linewidth(0.8)
            panel.bar_label(bars, [f"{100.0 * v:.2g} %" if v >= 0.0005 else "0" for v in values], padding=3, fontsize=8)
        panel.set_yticks(height, [_WORDS[loss.limit] for loss in lost])
        panel.set_xlim(0.0, 112.0)
        panel.set_xlabel("share [%]")
        panel.set_title(title, loc="left", fontsize=11, fontweight="bold", color=_TEXT)
        panel.spines[["top", "right"]].set_visible(False)
        panel.spines[["left", "bottom"]].set_color(_QUIET)
        panel.tick_params(colors=_TEXT, color=_QUIET)
    keys = [Patch(facecolor=_tint(_TEXT, tint), edgecolor=_TEXT, label=label) for _, tint, label in shares]
    figure.legend(handles=keys, loc="outside lower center", ncols=3, frameon=False, fontsize=10)
    return figure


def _line_keys() -> list[Line2D]:
    return [
        Line2D([], [], color=_TEXT, linewidth=1.4, label="edge of what the limits allow"),
        Line2D([], [], color=SERIAL, linewidth=2.2, label="serial singularity"),
        Line2D([], [], color=PARALLEL, linewidth=2.2, label="parallel singularity"),
        Line2D([], [], color=_TEXT, marker="+", linestyle="", markersize=10, markeredgewidth=2.0, label="centre"),
    ]


def _mappable(low: float, high: float, cmap: Any) -> Any:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(low, high), cmap)


def _tint(color: str, white: float) -> tuple[float, ...]:
    return tuple((1.0 - white) * np.array(to_rgb(color)) + white)


def _pale(color: str) -> tuple[float, ...]:
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


def _shadow(corners: np.ndarray, floor: float) -> Poly3DCollection:
    flat = corners.copy()
    flat[..., 2] = floor
    return Poly3DCollection(flat, facecolor="#E2E2E2", edgecolor="#E2E2E2", linewidth=0.3, zorder=1)
