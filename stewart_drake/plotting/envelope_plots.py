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
from stewart_drake.planning.workspace import Survey
from stewart_drake.plotting import panels as look
from stewart_drake.plotting.workspace_plots import COLORS, WORDS, Slice, limit_keys, line_keys, use_bar

_RUNS = ("#000000", look.YELLOW, look.SKY, look.GREEN, look.BLUE, look.ORANGE, look.PURPLE)
"""The first run is black and thicker."""


def plot_motion_map(found: Survey, log: SimulationLog, use: Mapping[str, np.ndarray]) -> Figure:
    """One motion among the limits: its path over a slice, and what it takes up of each limit over time.

    Args:
        found: Survey of a grid with one side of a single cell.
        log: The run.
        use: Utilisation (n,) of each limit at the poses of the log.
    """
    figure, ((map_, time_),) = look.wide(1, 2, 6.0, width_ratios=(1.25, 1.0))
    drawn = Slice(found)
    drawn.prepare(map_)
    seen = drawn.use_image(map_)
    drawn.lines(map_)
    for path, color, width in ((log["pose"], _RUNS[0], 1.3), (log["reference"], "#FFFFFF", 1.3)):
        across, up = (look.SCALES[c] * path[:, c] for c in drawn.columns)
        map_.plot(across, up, color=color, linewidth=width)
    look.headline(map_, "Path over a slice: run black, reference white")
    use_bar(figure, map_)
    lines = [
        time_.plot(log.time, values, color=COLORS[name], linewidth=1.6, label=WORDS[name])[0]
        for name, values in use.items()
    ]
    time_.axhline(1.0, color=look.TEXT, linewidth=1.2)
    largest = max(float(np.nanmax(values)) for values in use.values())
    time_.set_ylim(0.0, max(1.12, 1.05 * min(2.0, largest)))
    _open_grid(time_)
    time_.set_xlabel("time [s]")
    time_.set_ylabel("part of the limit taken up, at rest [-]")
    look.headline(time_, "What the run takes up of each limit")
    look.legend_below(figure, [*line_keys(), *limit_keys(seen), *lines], 5, 9.5)
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
        scale = look.SCALES[axis]
        name, unit = look.COORDINATES[axis]
        for log, style in zip(logs, _styles(names), strict=True):
            panel.plot(scale * log["pose"][:, axis], scale * log["pose_rate"][:, axis], **style)
        _open(panel, 0.02 * scale if axis < 3 else 1.0)
        low, high = panel.get_xlim()
        for end in scale * ranges[:, axis]:
            if low < end < high:
                panel.axvline(end, color=look.QUIET, linestyle=(0, (4, 2)), linewidth=1.2)
        panel.set_xlabel(f"{name} [{unit}]")
        panel.set_ylabel(f"rate [{unit}/s]")
        allowed = f"limits at rest {scale * ranges[0, axis]:.0f} .. {scale * ranges[1, axis]:.0f} {unit}"
        look.headline(panel, name, allowed)
    look.legend_below(figure, panels[0].get_legend_handles_labels()[0])
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
        panel.axhline(0.0, color=look.QUIET, linewidth=0.7)
        panel.axvline(0.0, color=look.QUIET, linewidth=0.7)
        for log, rate, style in zip(logs, rates, _styles(names), strict=True):
            panel.plot(rate[:, motor], log["torque_applied"][:, motor], **style)
        _open(panel, 0.1)
        for limit, (low, high), draw in (
            (torque_limit, panel.get_ylim(), panel.axhline),
            (speed_limit, panel.get_xlim(), panel.axvline),
        ):
            for side in () if limit is None else (-limit, limit):
                if low < side < high:
                    draw(side, color=look.QUIET, linestyle=(0, (4, 2)), linewidth=1.2)
        panel.set_xlabel("crank speed [rad/s]")
        panel.set_ylabel("torque [N m]")
        peak = max(float(np.abs(log["torque_applied"][:, motor]).max()) for log in logs)
        look.headline(panel, f"Motor {motor}", f"peak {peak:.2f} N m, {100.0 * peak / torque_limit:.0f} % of the limit")
    look.legend_below(figure, panels[0].get_legend_handles_labels()[0])
    return figure


def _six() -> tuple[Figure, list[Axes]]:
    figure, panels = look.wide(2, 3, 7.2)
    for panel in panels.flat:
        _open_grid(panel)
    return figure, list(panels.flat)


def _open_grid(panel: Axes) -> None:
    look.plain(panel)
    panel.xaxis.set_major_locator(MaxNLocator(5))
    panel.yaxis.set_major_locator(MaxNLocator(5))


def _styles(names: Sequence[str]) -> list[dict[str, Any]]:
    return [
        {"color": _RUNS[run % len(_RUNS)], "linewidth": 0.9 if run else 2.0, "zorder": 3.0 - 0.1 * run, "label": name}
        for run, name in enumerate(names)
    ]


def _open(panel: Axes, least: float) -> None:
    """Opens both ranges to at least `least`, so that rounding does not fill a panel."""
    for get, put in ((panel.get_xlim, panel.set_xlim), (panel.get_ylim, panel.set_ylim)):
        low, high = get()
        missing = max(0.0, 0.5 * (least - (high - low)))
        put(low - missing, high + missing)
