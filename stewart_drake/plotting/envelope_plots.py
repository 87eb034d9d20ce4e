"""Figures of the region that controlled motions visit: among the limits, in phase planes, at the motors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.motion_envelope import crank_rates
from stewart_drake.planning.workspace_region import Survey
from stewart_drake.plotting.workspace_plots import COLORS, WORDS, Slice, limit_keys, line_keys, use_bar

_TEXT, _QUIET, _FIRST = "#222222", "#8C8C8C", "#000000"
# Okabe and Ito's palette without its yellow; the first run is black and thicker.
_RUNS = (_FIRST, "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7")
_AXES = (
    *(("roll", "deg", "deg/s"), ("pitch", "deg", "deg/s"), ("yaw", "deg", "deg/s")),
    *(("X", "mm", "mm/s"), ("Y", "mm", "mm/s"), ("Z", "mm", "mm/s")),
)
_SCALES = np.array([180.0 / np.pi] * 3 + [1e3] * 3)


def plot_motion_map(found: Survey, log: SimulationLog, use: Mapping[str, np.ndarray]) -> Figure:
    """One motion among the limits: its path over a slice, and what it takes up of each limit over time.

    Args:
        found: Survey of a grid with one side of a single cell.
        log: The run.
        use: Utilisation (n,) of each limit at the poses of the log.
    """
    figure = Figure(figsize=(12.0, 6.0), facecolor="white", layout="constrained")
    map_, time_ = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    drawn = Slice(found)
    drawn.prepare(map_)
    seen = drawn.use_image(map_)
    drawn.lines(map_)
    for path, color, width in ((log["pose"], _FIRST, 1.3), (log["reference"], "#FFFFFF", 1.3)):
        across, up = (_SCALES[c] * path[:, c] for c in drawn.columns)
        map_.plot(across, up, color=color, linewidth=width)
    map_.set_title("Path over a slice: run black, reference white", loc="left", fontsize=11, fontweight="bold")
    use_bar(figure, map_)
    lines = [
        time_.plot(log.time, values, color=COLORS[name], linewidth=1.6, label=WORDS[name])[0]
        for name, values in use.items()
    ]
    time_.axhline(1.0, color=_TEXT, linewidth=1.2)
    largest = max(float(np.nanmax(values)) for values in use.values())
    time_.set_ylim(0.0, max(1.12, 1.05 * min(2.0, largest)))
    _plain(time_)
    time_.set_xlabel("time [s]")
    time_.set_ylabel("part of the limit taken up, at rest [-]")
    time_.set_title("What the run takes up of each limit", loc="left", fontsize=11, fontweight="bold")
    keys = [*line_keys(), *limit_keys(seen), *lines]
    figure.legend(handles=keys, loc="outside lower center", ncols=5, frameon=False, fontsize=9.5)
    return figure


def plot_state_region(logs: Sequence[SimulationLog], names: Sequence[str], ranges: np.ndarray) -> Figure:
    """Phase planes of the six coordinates: what each run visits, and how far the limits let that coordinate go.

    Args:
        logs: Runs; the first is drawn thicker.
        names: Of the runs.
        ranges: (2, 6) [rad, m] lowest and highest value of each coordinate alone, from the centre.
    """
    figure, panels = _six()
    for axis, panel in enumerate(panels):
        scale = _SCALES[axis]
        name, unit, rate_unit = _AXES[axis]
        for log, style in zip(logs, _styles(names), strict=True):
            panel.plot(scale * log["pose"][:, axis], scale * log["pose_rate"][:, axis], **style)
        _open(panel, 0.02 * scale if axis < 3 else 1.0)
        low, high = panel.get_xlim()
        for end in scale * ranges[:, axis]:
            if low < end < high:
                panel.axvline(end, color=_QUIET, linestyle=(0, (4, 2)), linewidth=1.2)
        panel.set_xlabel(f"{name} [{unit}]")
        panel.set_ylabel(f"rate [{rate_unit}]")
        allowed = f"limits at rest {scale * ranges[0, axis]:.0f} .. {scale * ranges[1, axis]:.0f} {unit}"
        panel.set_title(name, loc="left", fontsize=11, fontweight="bold", color=_TEXT)
        panel.set_title(allowed, loc="right", fontsize=8.5, color=_TEXT)
    _legend(figure, panels[0])
    return figure


def plot_torque_region(
    logs: Sequence[SimulationLog], names: Sequence[str], speed_limit: float | None, torque_limit: float
) -> Figure:
    """Speed and torque of the six motors: what each run visits, against the motors' limits.

    Args:
        logs: Runs; the first is drawn thicker.
        names: Of the runs.
        speed_limit: [rad/s] or None.
        torque_limit: [N m].
    """
    figure, panels = _six()
    rates = [crank_rates(log.scenario.robot, log["pose"], log["pose_rate"]) for log in logs]
    for motor, panel in enumerate(panels):
        panel.axhline(0.0, color=_QUIET, linewidth=0.7)
        panel.axvline(0.0, color=_QUIET, linewidth=0.7)
        for log, rate, style in zip(logs, rates, _styles(names), strict=True):
            panel.plot(rate[:, motor], log["torque_applied"][:, motor], **style)
        _open(panel, 0.1)
        for limit, (low, high), draw in (
            (torque_limit, panel.get_ylim(), panel.axhline),
            (speed_limit, panel.get_xlim(), panel.axvline),
        ):
            for side in () if limit is None else (-limit, limit):
                if low < side < high:
                    draw(side, color=_QUIET, linestyle=(0, (4, 2)), linewidth=1.2)
        panel.set_xlabel("crank speed [rad/s]")
        panel.set_ylabel("torque [N m]")
        peak = max(float(np.abs(log["torque_applied"][:, motor]).max()) for log in logs)
        panel.set_title(f"Motor {motor}", loc="left", fontsize=11, fontweight="bold", color=_TEXT)
        panel.set_title(
            f"peak {peak:.2f} N m, {100.0 * peak / torque_limit:.0f} % of the limit", loc="right", fontsize=8.5
        )
    _legend(figure, panels[0])
    return figure


def _six() -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(12.0, 7.2), facecolor="white", layout="constrained")
    panels = list(figure.subplots(2, 3).ravel())
    for panel in panels:
        _plain(panel)
    return figure, panels


def _plain(panel: Axes) -> None:
    panel.spines[["top", "right"]].set_visible(False)
    panel.spines[["left", "bottom"]].set_color(_QUIET)
    panel.tick_params(colors=_TEXT, color=_QUIET, labelsize=9)
    panel.grid(color="#EBEBEB", linewidth=0.8)
    panel.set_axisbelow(True)
    panel.xaxis.set_major_locator(MaxNLocator(5))
    panel.yaxis.set_major_locator(MaxNLocator(5))


def _styles(names: Sequence[str]) -> list[dict[str, Any]]:
    return [
        {
            "color": _RUNS[run % len(_RUNS)],
            "linewidth": 2.0 if run == 0 else 0.9,
            "zorder": 3.0 - 0.1 * run,
            "label": name,
        }
        for run, name in enumerate(names)
    ]


def _open(panel: Axes, least: float) -> None:
    """Opens both ranges to at least `least`, so that rounding does not fill a panel."""
    for get, put in ((panel.get_xlim, panel.set_xlim), (panel.get_ylim, panel.set_ylim)):
        low, high = get()
        missing = max(0.0, 0.5 * (least - (high - low)))
        put(low - missing, high + missing)


def _legend(figure: Figure, panel: Axes) -> None:
    figure.legend(*panel.get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False, fontsize=10)
