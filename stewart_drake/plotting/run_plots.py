"""Figures of one run, Fig. 7 of the paper: panels on one time axis, made of what the log has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import SIGNALS, SimulationLog
from stewart_drake.logs.metrics import INTEGRAL_TIME, run_metrics, tracking_error
from stewart_drake.plotting import style as look

_AXIS_COLORS = (look.ORANGE, look.GREEN, look.BLUE)  # Axis 1, 2, 3 as in RGB triads
_FAILURE = "#B2182B"
_NEAR_LIMIT = 0.8  # Share of a motor's limit from which on limits are drawn
_SYMBOLS = (r"$\phi$", r"$\theta$", r"$\psi$", "X", "Y", "Z")
_POSES = (
    ("deg", {"Roll": (0,), "Pitch and yaw": (1, 2)}),
    ("mm", {"Height": (5,), "X and Y": (3, 4)}),
)
"""A column of the states each: unit, and axes of its upper two panels, the one that the paper moves first."""


@look.styled
def plot_states(log: SimulationLog) -> Figure:
    """The states against their reference, errors, integral states and weights [deg, mm] over time; Fig. 7(a)."""
    with np.errstate(all="ignore"):
        metrics = run_metrics(log)
    log = _drawable(log)
    weighted = "weights" in log.signals or "block_weights" in log.signals
    figure, axes = _figure(log, "states, RMS over the second half", 2.3, [1.35] + [1.0] * (3 + weighted))
    for column, (unit, panels) in zip(axes.T, _POSES, strict=True):
        _plot_poses(column, log, unit, panels, metrics[f"rmse_{unit}"])
    if weighted:
        _plot_weights(axes[-1, 0], axes[-1, 1], log)
    return figure


@look.styled
def plot_torques(log: SimulationLog) -> Figure:
    """Torques of the six motors over time [N m], on one scale, with limits where they are near; Fig. 7(b)."""
    log = _drawable(log)
    applied, commanded, limits = log["torque_applied"], log["torque"], log.scenario.robot.effort_limits
    rms, peak = np.sqrt(np.mean(applied**2, axis=0)), np.abs(applied).max(axis=0)
    near = bool((peak >= _NEAR_LIMIT * limits).any())
    figure, axes = _figure(log, "motor torques", 2.6, [1.0] * 3, sharey=True)
    entries: dict[str, Any] = {}
    for leg, (axis, limit) in enumerate(zip(axes.flat, limits.tolist(), strict=True)):
        _level(axis, log, 0.0)
        if near:
            _level(axis, log, -limit, linestyle=":")
            _level(axis, log, limit, linestyle=":", label=f"limit ±{limit:g} N m")
        if np.any(commanded[:, leg] != applied[:, leg]):
            # Thinner and underneath: seen only where the two differ.
            _plot(axis, log, commanded[:, leg], look.ORANGE, "commanded", held=True, linewidth=1.2)
        _plot(axis, log, applied[:, leg], look.BLUE, "applied", held=True)
        note = f"RMS {rms[leg]:#.3g} N m, peak {peak[leg]:#.3g} N m"
        axis.set_title(note, loc="right", fontsize=9, fontweight="normal")
        _finish(axis, f"Motor {leg}", "" if leg % 2 else "torque [N m]", 0.02, legend=False)
        handles, labels = axis.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    if near:
        # A controller that asks for far more than the motors have must not flatten what they gave.
        low, high = axes[0, 0].get_ylim()
        axes[0, 0].set_ylim(max(low, -1.4 * limits.max()), min(high, 1.4 * limits.max()))
    if len(entries) > 1:
        look.legend_below(figure, list(entries.values()), 3)
    return figure


def _drawable(log: SimulationLog) -> SimulationLog:
    if len(log.time) == 0:
        raise ConfigurationError("log", "no rows", "a log with at least one row to plot")
    return replace(
        log, signals={name: values.clip(-look.LARGEST, look.LARGEST) for name, values in log.signals.items()}
    )


def _figure(
    log: SimulationLog, what: str, row_height: float, heights: Sequence[float], **options: Any
) -> tuple[Figure, np.ndarray]:
    """Rows of two panels on one time axis, below a headline on the run; with a mark where it ended, if early."""
    scenario, height = log.scenario, row_height * len(heights)
    figure, axes = look.panels(len(heights), 2, height, 12.0, sharex=True, height_ratios=heights, **options)
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 1.0 - 0.75 / height))
    first, last = log.time[0], max(log.end_time, log.time[-1])
    span = last - first if last > first else scenario.effective_log_period
    axes[0, 0].set_xlim(first, first + span * (1.0 if log.status == "completed" else 1.04))
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    figure.align_ylabels(axes.ravel().tolist())
    ended, color = f"completed, {log.end_time:g} s", look.TEXT
    if log.status != "completed":
        when = log.end_time if log.outcome_time is None else log.outcome_time
        ended, color = f"{log.status} at {when:.3f} s of {scenario.duration:g} s", _FAILURE
        if log.reason not in (None, log.status):
            ended += f": {log.reason}" + ("" if log.leg is None else f", leg {log.leg}")
        _mark_end(axes, when, log.reason or log.status)
    top, place = 1.0 - 0.12 / height, {"x": 0.01, "ha": "left", "va": "top"}
    figure.suptitle(f"{scenario.name}: {ended}", y=top, fontsize=14, color=color, **place)
    controller = scenario.controller
    what += f"; gravity {scenario.gravity:g} m/s², {controller.label}, control period {1e3 * controller.period:g} ms"
    if "density" in log.signals:
        what += f", tuner {scenario.tuner.kind}"
    figure.text(y=top - 0.3 / height, s=what, **place)  # type: ignore[arg-type]
    return figure, axes


def _mark_end(axes: np.ndarray, when: float, reason: str) -> None:
    """From when on [s] and, in the first row, why the run is not a good one."""
    end = axes[0, 0].get_xlim()[1]
    for panel in axes.flat:
        panel.axvline(when, color=_FAILURE, linewidth=1.4)
        panel.axvspan(when, end, color=_FAILURE, alpha=0.08, linewidth=0.0)
    style: dict[str, Any] = {"rotation": 90.0, "ha": "center", "va": "center", "fontsize": 9, "color": _FAILURE}
    for panel in axes[0]:
        panel.text(0.5 * (when + end), 0.5, reason, transform=panel.get_xaxis_transform(), **style)


def _plot_poses(
    column: np.ndarray, log: SimulationLog, unit: str, panels: dict[str, tuple[int, ...]], rmse: Any
) -> None:
    """A column of the states: main axis, other axes, error, integral state."""
    group = sorted(axis for axes in panels.values() for axis in axes)
    pose, reference, error, integral = (
        look.SCALES * values for values in (log["pose"], log["reference"], tracking_error(log), log["integral"])
    )
    for panel, (title, axes) in zip(column, panels.items(), strict=False):
        for axis in axes:
            _plot(panel, log, pose[:, axis], _AXIS_COLORS[axis % 3], _SYMBOLS[axis])
        for axis in axes:
            label = "reference" if axis == axes[0] else "_"
            _plot(panel, log, reference[:, axis], look.TEXT, label, linewidth=1.0, linestyle="--")
        _finish(panel, title, f"{', '.join(_SYMBOLS[axis] for axis in axes)} [{unit}]", 1.0)
    errors, integrals = column[2:4]
    dotted = log.time[0] < INTEGRAL_TIME < log.time[-1]
    _level(errors, log, 0.0)
    _level(integrals, log, 0.0)
    for axis, value in zip(group, rmse or (None,) * 3, strict=True):
        color, symbol = _AXIS_COLORS[axis % 3], _SYMBOLS[axis]
        _plot(errors, log, error[:, axis], color, symbol if value is None else f"{symbol}  {value:.2g}")
        _plot(integrals, log, integral[:, axis], color, symbol, held=True)
    if dotted:
        integrals.axvline(INTEGRAL_TIME, color=look.QUIET, linestyle=":", linewidth=1.2, zorder=1.0)
    # Noise far below what matters must not fill a panel, nor a small error vanish in it.
    least = [float(np.clip(3.0 * np.abs(each[:, group]).max(), 1e-4, 0.02)) for each in (error, integral)]
    _finish(errors, "Error" if rmse is None else "Error and RMS", f"error [{unit}]", least[0])
    title = f"Integral state (dotted: {INTEGRAL_TIME:g} s)" if dotted else "Integral state"
    _finish(integrals, title, f"z [{unit} s]", least[1])


def _plot_weights(left: Axes, right: Axes, log: SimulationLog) -> None:
    """What the tuner gives: two weights and their ratio, or block weights."""
    titles = ("Weights of the states", "Of the torques")
    quantity = "weight [-]"
    if "weights" in log.signals:
        q, r = log["weights"].T
        # A thin line on a thick one: both are seen where they coincide, as at (1, 1).
        _plot(left, log, q, look.BLUE, r"$\omega_Q$", held=True, linewidth=2.4)
        _plot(left, log, r, look.ORANGE, r"$\omega_R$", held=True, linewidth=1.2)
        _plot(right, log, q / r, look.TEXT, "_", held=True)
        label = log.scenario.tuner.label
        titles = label[0].upper() + label[1:], "Ratio of the weights, on which alone the gain depends"
        quantity = r"$\omega_Q\,/\,\omega_R$ [-]"
    else:
        names = SIGNALS["block_weights"].components
        for at, (values, color) in enumerate(zip(log["block_weights"].T, _AXIS_COLORS * 2, strict=False)):
            _plot(left if at < 3 else right, log, values, color, names[at], held=True)
    for panel, title, unit in zip((left, right), titles, ("weight [-]", quantity), strict=True):
        look.logarithmic(panel, "y")
        _finish(panel, title, unit, 2.0)


def _plot(
    axis: Axes, log: SimulationLog, values: np.ndarray, color: str, label: str, held: bool = False, **style: Any
) -> None:
    """Values (n,) over time; a staircase where they are held from tick to tick."""
    drawstyle, marker = "steps-post" if held else "default", "o" if len(log.time) == 1 else None
    style = {"linewidth": 1.6, "drawstyle": drawstyle, "marker": marker, **style}
    axis.plot(log.time, values, color=color, label=label, **style)


def _level(axis: Axes, log: SimulationLog, value: float, label: str = "_", **style: Any) -> None:
    _plot(axis, log, np.full(len(log.time), value), look.QUIET, label, linewidth=0.8, **style)


def _finish(axis: Axes, title: str, quantity: str, least: float, legend: bool = True) -> None:
    """Texts of a panel, and a vertical range of at least `least`, in decades on a logarithmic axis."""
    axis.set(title=title, ylabel=quantity)
    if axis.get_yscale() == "linear":
        axis.yaxis.set_major_locator(MaxNLocator(5))
    transform = axis.yaxis.get_transform()
    low, high = transform.transform(np.array(axis.get_ylim()))
    missing = 0.5 * (least - (high - low))
    if missing > 0.0:
        axis.set_ylim(*transform.inverted().transform(np.array([low - missing, high + missing])))
    if legend and axis.get_legend_handles_labels()[1]:
        # Above the panel, where it hides no data.
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, frameon=False, borderaxespad=0.0)
