"""Figures of one run, Fig. 7 of the paper: panels on one time axis, made of what the log has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import SIGNALS, SimulationLog
from stewart_drake.logs.metrics import INTEGRAL_TIME, run_metrics, tracking_error
from stewart_drake.plotting import style as look

_AXIS_COLORS = (look.ORANGE, look.GREEN, look.BLUE)
"""Axis 1, 2, 3 as in RGB triads."""
_FAILURE = "#B2182B"
_NEAR_LIMIT = 0.8
"""Share of a motor's limit from which on limits are drawn."""
_SYMBOLS = (r"$\phi$", r"$\theta$", r"$\psi$", "X", "Y", "Z")
_POSES = (
    ("deg", ((0,), (1, 2)), ("Roll", "Pitch and yaw")),
    ("mm", ((5,), (3, 4)), ("Height", "X and Y")),
)
"""A column of the states each: unit, axes of its upper two panels, the one that the paper moves first, and titles."""


class Line(NamedTuple):
    """Values (n,) over time; a staircase where they are held from tick to tick."""

    values: np.ndarray
    color: str
    label: str = "_"
    held: bool = False
    width: float = 1.6
    dashes: Any = "-"


class Panel(NamedTuple):
    """What a panel shows; its vertical range is at least `least`, on a look.logarithmic axis in decades."""

    title: str
    quantity: str
    lines: Sequence[Line]
    least: float
    height: float = 1.0
    note: str = ""
    decades: bool = False
    dotted: float | None = None
    """[s] a vertical line."""
    legend: bool = True


@look.styled
def plot_states(log: SimulationLog) -> Figure:
    """The states against their reference, errors, integral states and weights over time; Fig. 7(a).

    Rotations [deg] on the left, translations [mm] on the right. A row each for the axis that the paper moves (roll, Z),
    the other two axes, the tracking error and the integral state; below them omega_Q, omega_R and their ratio, or what
    else the tuner gives.

    Args:
        log: A run, completed or not. The end of one that failed is marked.

    Raises:
        ConfigurationError: The log has no rows.
    """
    with np.errstate(all="ignore"):
        metrics = run_metrics(log)
    log = _drawable(log)
    columns = [_pose_panels(log, *column, metrics[f"rmse_{column[0]}"]) for column in _POSES]
    rows = [list(row) for row in zip(*columns, strict=True)]
    weights = _weight_panels(log)
    figure, _ = _figure(log, "states, RMS over the second half", rows + [weights] * bool(weights), 2.3)
    return figure


@look.styled
def plot_torques(log: SimulationLog) -> Figure:
    """Torques of the six motors over time [N m], a panel each and all on one scale; Fig. 7(b).

    The commanded torque shows where the limit of the motor cut it; the limits are drawn where they are near.

    Args:
        log: A run, completed or not. The end of one that failed is marked.

    Raises:
        ConfigurationError: The log has no rows.
    """
    log = _drawable(log)
    applied, commanded, limits = log["torque_applied"], log["torque"], log.scenario.robot.effort_limits
    rms, peak = np.sqrt(np.mean(applied**2, axis=0)), np.abs(applied).max(axis=0)
    near = bool((peak >= _NEAR_LIMIT * limits).any())
    motors = []
    for leg, limit in enumerate(limits.tolist()):
        lines = [_level(log, 0.0)]
        if near:
            lines += [_level(log, -limit, ":"), _level(log, limit, ":")._replace(label=f"limit ±{limit:g} N m")]
        if np.any(commanded[:, leg] != applied[:, leg]):
            # Thinner and underneath: seen only where the two differ.
            lines.append(Line(commanded[:, leg], look.ORANGE, "commanded", held=True, width=1.2))
        lines.append(Line(applied[:, leg], look.BLUE, "applied", held=True))
        note = f"RMS {rms[leg]:#.3g} N m, peak {peak[leg]:#.3g} N m"
        quantity = "" if leg % 2 else "torque [N m]"
        motors.append(Panel(f"Motor {leg}", quantity, lines, 0.02, note=note, legend=False))
    figure, axes = _figure(log, "motor torques", [motors[i : i + 2] for i in (0, 2, 4)], 2.6, sharey=True)
    if near:
        # A controller that asks for far more than the motors have must not flatten what they gave.
        low, high = axes[0].get_ylim()
        axes[0].set_ylim(max(low, -1.4 * limits.max()), min(high, 1.4 * limits.max()))
    entries: dict[str, Any] = {}
    for panel in axes:
        handles, labels = panel.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    if len(entries) > 1:
        look.legend_below(figure, list(entries.values()), 3)
    return figure


def _drawable(log: SimulationLog) -> SimulationLog:
    if len(log.time) == 0:
        raise ConfigurationError("log", "no rows", "a log with at least one row to plot")
    return replace(
        log, signals={name: values.clip(-look.LARGEST, look.LARGEST) for name, values in log.signals.items()}
    )


def _level(log: SimulationLog, value: float, dashes: str = "-") -> Line:
    return Line(np.full(len(log.time), value), look.QUIET, width=0.8, dashes=dashes)


def _pose_panels(
    log: SimulationLog, unit: str, axes: Any, titles: tuple[str, str], rmse: list[float | None] | None
) -> list[Panel]:
    """A column of the states: main axis, other axes, error, integral state."""
    group = sorted(axis for some in axes for axis in some)
    pose, reference, error, integral = (
        look.SCALES * values for values in (log["pose"], log["reference"], tracking_error(log), log["integral"])
    )

    def lines(values: np.ndarray, some: Sequence[int], held: bool = False, more: Sequence[str] = ("",) * 3) -> Any:
        return [
            Line(values[:, axis], _AXIS_COLORS[axis % 3], _SYMBOLS[axis] + more[axis % 3], held=held) for axis in some
        ]

    panels = []
    for some, title, height in zip(axes, titles, (1.35, 1.0), strict=True):
        desired = [Line(reference[:, axis], look.TEXT, "_", width=1.0, dashes="--") for axis in some]
        desired[0] = desired[0]._replace(label="reference")
        quantity = f"{', '.join(_SYMBOLS[axis] for axis in some)} [{unit}]"
        panels.append(Panel(title, quantity, [*lines(pose, some), *desired], 1.0, height))
    # Noise far below what matters must not fill a panel, nor a small error vanish in it.
    least = [float(np.clip(3.0 * np.abs(each[:, group]).max(), 1e-4, 0.02)) for each in (error, integral)]
    rms = [f"  {value:.2g}" if value is not None else "" for value in rmse or (None,) * 3]
    title = "Error" if rmse is None else "Error and RMS"
    panels.append(Panel(title, f"error [{unit}]", [_level(log, 0.0), *lines(error, group, more=rms)], least[0]))
    dotted = INTEGRAL_TIME if log.time[0] < INTEGRAL_TIME < log.time[-1] else None
    title = "Integral state" if dotted is None else f"Integral state (dotted: {dotted:g} s)"
    held = [_level(log, 0.0), *lines(integral, group, held=True)]
    return [*panels, Panel(title, f"z [{unit} s]", held, least[1], dotted=dotted)]


def _weight_panels(log: SimulationLog) -> list[Panel]:
    """What the tuner gives: two weights and their ratio, or block weights; nothing where there is no tuner."""
    if "weights" in log.signals:
        q, r = log["weights"].T
        # A thin line on a thick one: both are seen where they coincide, as at (1, 1).
        both = [Line(q, look.BLUE, r"$\omega_Q$", True, 2.4), Line(r, look.ORANGE, r"$\omega_R$", True, 1.2)]
        title = "Ratio of the weights, on which alone the gain depends"
        ratio = Panel(title, r"$\omega_Q\,/\,\omega_R$ [-]", [Line(q / r, look.TEXT, held=True)], 2.0, decades=True)
        return [Panel(log.scenario.tuner.label, "weight [-]", both, 2.0, decades=True), ratio]
    if "block_weights" in log.signals:
        columns = zip(log["block_weights"].T, _AXIS_COLORS * 2, SIGNALS["block_weights"].components, strict=False)
        lines = [Line(*column, held=True) for column in columns]
        shown = (("Weights of the states", lines[:3]), ("Of the torques", lines[3:]))
        return [Panel(title, "weight [-]", some, 2.0, decades=True) for title, some in shown]
    return []


def _figure(
    log: SimulationLog, what: str, rows: Sequence[Sequence[Panel]], row_height: float, **options: Any
) -> tuple[Figure, list[Axes]]:
    """Rows of panels on one time axis, below a headline on the run; with a mark where it ended, if early."""
    heights = [row[0].height for row in rows]
    height = row_height * len(rows)
    figure = Figure(figsize=(12.0, height))
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 1.0 - 0.75 / height))
    mosaic = [[f"{i} {j}" for j in range(len(row))] for i, row in enumerate(rows)]
    grid = figure.subplot_mosaic(mosaic, sharex=True, height_ratios=heights, **options)  # type: ignore[arg-type]
    axes = list(grid.values())
    look.quiet(axes)
    first, last = log.time[0], max(log.end_time, log.time[-1])
    span = last - first if last > first else log.scenario.effective_log_period
    axes[0].set_xlim(first, first + span * (1.0 if log.status == "completed" else 1.04))
    for name, axis in grid.items():
        i, j = map(int, name.split())
        _plot_panel(axis, log, rows[i][j])
        if i == len(rows) - 1:
            axis.set_xlabel("time [s]")
    figure.align_ylabels(axes)
    ended, color = _outcome(log)
    top, place = 1.0 - 0.12 / height, {"x": 0.01, "ha": "left", "va": "top"}
    figure.suptitle(f"{log.scenario.name}: {ended}", y=top, fontsize=14, color=color, **place)
    controller = log.scenario.controller
    what += (
        f"; gravity {log.scenario.gravity:g} m/s², {controller.label}, control period {1e3 * controller.period:g} ms"
    )
    if "density" in log.signals:
        what += f", tuner {log.scenario.tuner.kind}"
    figure.text(y=top - 0.3 / height, s=what, **place)  # type: ignore[arg-type]
    if log.status != "completed":
        _mark_end(axes, len(rows[0]), log)
    return figure, axes


def _plot_panel(axis: Axes, log: SimulationLog, panel: Panel) -> None:
    for line in panel.lines:
        style: dict[str, Any] = {"drawstyle": "steps-post"} if line.held else {}
        if len(log.time) == 1:
            style["marker"] = "o"
        axis.plot(
            log.time,
            line.values,
            color=line.color,
            label=line.label,
            linewidth=line.width,
            linestyle=line.dashes,
            **style,
        )
    if panel.dotted is not None:
        axis.axvline(panel.dotted, color=look.QUIET, linestyle=":", linewidth=1.2, zorder=1.0)
    axis.set(title=panel.title[0].upper() + panel.title[1:], ylabel=panel.quantity)
    axis.set_title(panel.note, loc="right", fontsize=9, fontweight="normal")
    axis.yaxis.set_major_locator(MaxNLocator(5))
    if panel.decades:
        look.logarithmic(axis, "y")
    _widen(axis, panel.least)
    if panel.legend and axis.get_legend_handles_labels()[1]:
        # Above the panel, where it hides no data.
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, frameon=False, borderaxespad=0.0)


def _widen(panel: Axes, least: float) -> None:
    """Opens the vertical range to at least `least`."""
    transform = panel.yaxis.get_transform()
    low, high = transform.transform(np.array(panel.get_ylim()))
    missing = 0.5 * (least - (high - low))
    if missing > 0.0:
        panel.set_ylim(*transform.inverted().transform(np.array([low - missing, high + missing])))


def _outcome(log: SimulationLog) -> tuple[str, str]:
    """How the run ended, in words, and the colour of the words."""
    if log.status == "completed":
        return f"completed, {log.end_time:g} s", look.TEXT
    leg = "" if log.leg is None else f", leg {log.leg}"
    end = f"{log.status} at {_decided(log):.3f} s of {log.scenario.duration:g} s"
    return (end if log.reason in (None, log.status) else f"{end}: {log.reason}{leg}"), _FAILURE


def _decided(log: SimulationLog) -> float:
    return log.end_time if log.outcome_time is None else log.outcome_time


def _mark_end(axes: Sequence[Axes], columns: int, log: SimulationLog) -> None:
    """From when on and, in the first row, why the run is not a good one."""
    when, end = _decided(log), axes[0].get_xlim()[1]
    for panel in axes:
        panel.axvline(when, color=_FAILURE, linewidth=1.4)
        panel.axvspan(when, end, color=_FAILURE, alpha=0.08, linewidth=0.0)
    for panel in axes[:columns]:
        style: dict[str, Any] = {"rotation": 90.0, "ha": "center", "va": "center", "fontsize": 9, "color": _FAILURE}
        reason = log.reason or log.status
        panel.text(0.5 * (when + end), 0.5, reason, transform=panel.get_xaxis_transform(), **style)
