"""Figures of one run, Fig. 7 of the paper.

Figures are plain objects made without pyplot: no backend is chosen, no window opens and no global setting changes.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.files.whole import write_atomically
from stewart_drake.logs.log import SIGNALS, SimulationLog
from stewart_drake.logs.metrics import INTEGRAL_TIME, run_metrics, tracking_error
from stewart_drake.plotting import panels as look

DPI = 150
"""[1/inch] resolution of saved figures."""

_AXIS_COLORS = (look.ORANGE, look.GREEN, look.BLUE)
"""Axis 1, 2, 3 as in RGB triads."""
LARGEST = 1e9
"""What is larger, after a blow-up, is drawn here: matplotlib's arithmetic ends long before that of numbers."""

_FAILURE = "#B2182B"
_NEAR_LIMIT = 0.8
_DASHED: dict[str, Any] = {"color": look.TEXT, "linestyle": (0, (4, 2)), "linewidth": 1.0}


class _Group(NamedTuple):
    """Three coordinates that share a unit: a column of the figure."""

    columns: slice
    unit: str
    names: tuple[str, str, str]
    symbols: tuple[str, str, str]
    main: int


_GROUPS = (
    _Group(slice(0, 3), "deg", ("roll", "pitch", "yaw"), (r"$\phi$", r"$\theta$", r"$\psi$"), main=0),
    _Group(slice(3, 6), "mm", ("X", "Y", "height"), ("X", "Y", "Z"), main=2),
)


def plot_states(log: SimulationLog) -> Figure:
    """The states against their reference, errors, integral states and weights over time; Fig. 7(a).

    Rotations [deg] on the left, translations [mm] on the right. A row each for the axis that the paper moves (roll, Z),
    the other two axes, the tracking error and the integral state; below them omega_Q, omega_R and their ratio.

    Args:
        log: A run, completed or not. The end of one that failed is marked.

    Raises:
        ConfigurationError: The log has no rows.
    """
    figure, axes = _figure(
        log, "states, RMS over the second half", rows=5, height=11.5, height_ratios=(1.35, 1.0, 1.0, 1.0, 1.0)
    )
    with np.errstate(all="ignore"):
        metrics = run_metrics(log)
    log = _drawable(log)
    for column, group in enumerate(_GROUPS):
        _plot_group(axes[:4, column], log, group, metrics[f"rmse_{group.unit}"])
    _plot_weights(axes[4], log)
    _finish(figure, axes, log)
    return figure


def plot_torques(log: SimulationLog) -> Figure:
    """Torques of the six motors over time [N m], a panel each and all on one scale; Fig. 7(b).

    The commanded torque shows where the limit of the motor cut it; the limits are drawn where they are near.

    Args:
        log: A run, completed or not. The end of one that failed is marked.

    Raises:
        ConfigurationError: The log has no rows.
    """
    figure, axes = _figure(log, "motor torques", rows=3, height=8.0, sharey=True)
    log = _drawable(log)
    time, applied, commanded = log.time, log["torque_applied"], log["torque"]
    limits, peak = log.scenario.robot.effort_limits, np.abs(applied).max(axis=0)
    near = bool((peak >= _NEAR_LIMIT * limits).any())
    for leg, panel in enumerate(axes.flat):
        limit = float(limits[leg])
        rms = np.sqrt(np.mean(applied[:, leg] ** 2))
        _title(panel, f"Motor {leg}", f"RMS {rms:#.3g} N m, peak {peak[leg]:#.3g} N m")
        panel.axhline(0.0, color=look.QUIET, linewidth=0.8)
        if near:
            for side in (-limit, limit):
                panel.axhline(side, color=look.QUIET, linestyle=":", label=_once(side > 0.0, f"limit ±{limit:g} N m"))
        if np.any(commanded[:, leg] != applied[:, leg]):
            # Thinner and underneath: seen only where the two differ.
            _draw(panel, time, commanded[:, leg], color=_AXIS_COLORS[0], label="commanded", held=True, linewidth=1.2)
        _draw(panel, time, applied[:, leg], color=_AXIS_COLORS[2], label="applied", held=True)
        if leg % 2 == 0:
            panel.set_ylabel("torque [N m]")
    _widen(axes[0, 0], 0.02)
    if near:
        # A controller that asks for far more than the motors have must not flatten what they gave.
        low, high = axes[0, 0].get_ylim()
        axes[0, 0].set_ylim(max(low, -1.4 * limit), min(high, 1.4 * limit))
    entries: dict[str, Any] = {}
    for panel in axes.flat:
        handles, labels = panel.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    if len(entries) > 1:
        look.legend_below(figure, list(entries.values()), 3)
    _finish(figure, axes, log)
    return figure


def save_figure(figure: Figure, path: str | Path) -> None:
    """Writes a figure as a PNG of 150 dots an inch; a reader sees the old file or the new one, never a half.

    Raises:
        ConfigurationError: The folder is missing or not writable.
    """
    stream = io.BytesIO()
    # Without a date or version in it, the same log gives the same file.
    figure.savefig(stream, format="png", dpi=DPI, facecolor="white", metadata={"Software": None})
    write_atomically(Path(path), stream.getvalue())


def draw(make: Callable[[], Figure], path: Path) -> str | None:
    """Makes a figure and saves it; numbers are never lost for a picture's sake.

    Returns:
        Where it is beyond matplotlib, one line that says so; an older picture of that name is gone then.

    Raises:
        StewartDrakeError: Of `make`, and see `save_figure`.
    """
    try:
        save_figure(make(), path)
    except StewartDrakeError:
        raise
    except Exception as error:
        path.unlink(missing_ok=True)
        return f"{path.name} is left out: {type(error).__name__}: {' '.join(str(error).split())}"
    return None


def _drawable(log: SimulationLog) -> SimulationLog:
    return replace(log, signals={name: values.clip(-LARGEST, LARGEST) for name, values in log.signals.items()})


def _plot_group(panels: np.ndarray, log: SimulationLog, group: _Group, rmse: list[float | None] | None) -> None:
    """One column of the states: main axis, other axes, error, integral state."""
    main, others, errors, integrals = panels
    time, unit = log.time, group.unit
    pose, reference, error, integral = (
        (look.SCALES * values)[:, group.columns]
        for values in (log["pose"], log["reference"], tracking_error(log), log["integral"])
    )
    for axis, (symbol, color) in enumerate(zip(group.symbols, _AXIS_COLORS, strict=True)):
        _draw(main if axis == group.main else others, time, pose[:, axis], color=color, label=symbol)
        rms = "" if rmse is None or rmse[axis] is None else f"  {rmse[axis]:.2g}"
        _draw(errors, time, error[:, axis], color=color, label=symbol + rms)
        _draw(integrals, time, integral[:, axis], color=color, label=symbol, held=True)
    two = [axis for axis in range(3) if axis != group.main]
    _draw(main, time, reference[:, group.main], label="reference", **_DASHED)
    for axis in two:
        _draw(others, time, reference[:, axis], label=_once(axis == two[0], "reference"), **_DASHED)
    _title(main, group.names[group.main])
    _title(others, " and ".join(group.names[axis] for axis in two))
    _title(errors, "Error" + ("" if rmse is None else " and RMS"))
    _title(integrals, "Integral state")
    # Noise far below what matters must not fill a panel, nor a small error vanish in it.
    spans = (float(np.clip(3.0 * np.abs(values).max(), 1e-4, 0.02)) for values in (error, integral))
    for panel, quantity, least in (
        (main, group.symbols[group.main], 1.0),
        (others, ", ".join(group.symbols[axis] for axis in two), 1.0),
        (errors, "error", next(spans)),
        (integrals, "z", next(spans)),
    ):
        panel.set_ylabel(f"{quantity} [{unit}{' s' * (panel is integrals)}]")
        _widen(panel, least)
        _legend(panel)
    for panel in (errors, integrals):
        panel.axhline(0.0, color=look.QUIET, linewidth=0.8, zorder=1.0)
    if time[0] < INTEGRAL_TIME < time[-1]:
        integrals.axvline(INTEGRAL_TIME, color=look.QUIET, linestyle=":", linewidth=1.2, zorder=1.0)
        _title(integrals, f"Integral state (dotted: {INTEGRAL_TIME:g} s)")


def _plot_weights(panels: np.ndarray, log: SimulationLog) -> None:
    """What the tuner gives: two weights and their ratio, or block weights; nothing where there is no tuner."""
    shown: list[tuple[str, str, list[tuple[np.ndarray, dict[str, Any]]]]] = []
    if "weights" in log.signals:
        q, r = log["weights"].T
        # A thin line on a thick one: both are seen where they coincide, as at (1, 1).
        both = [
            (q, {"color": _AXIS_COLORS[2], "linewidth": 2.4, "label": r"$\omega_Q$"}),
            (r, {"color": _AXIS_COLORS[0], "linewidth": 1.2, "label": r"$\omega_R$"}),
        ]
        shown += [(log.scenario.tuner.label, "weight", both)]
        ratio = "Ratio of the weights, on which alone the gain depends"
        shown += [(ratio, r"$\omega_Q\,/\,\omega_R$", [(q / r, {"color": look.TEXT})])]
    elif "block_weights" in log.signals:
        names = SIGNALS["block_weights"].components
        blocks = [
            (values, {"color": _AXIS_COLORS[index % 3], "label": name})
            for index, (values, name) in enumerate(zip(log["block_weights"].T, names, strict=True))
        ]
        shown += [("Weights of the states", "weight", blocks[:3]), ("Of the torques", "weight", blocks[3:])]
    for panel in panels[len(shown) :]:
        panel.axis("off")
    for panel, (title, name, lines) in zip(panels, shown, strict=False):
        for values, style in lines:
            _draw(panel, log.time, values, held=True, **style)
        _title(panel, title)
        panel.set_ylabel(f"{name} [-]")
        look.logarithmic(panel, "y")
        _widen(panel, 2.0)
        if "label" in lines[0][1]:
            _legend(panel)


def _figure(log: SimulationLog, what: str, *, rows: int, height: float, **subplots: Any) -> tuple[Figure, np.ndarray]:
    """Empty panels (rows, 2) [Axes] on one time axis, below a headline on the run."""
    if len(log.time) == 0:
        raise ConfigurationError("log", "no rows", "a log with at least one row to plot")
    figure = Figure(figsize=(12.0, height), facecolor="white")
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 1.0 - 0.75 / height), h_pad=0.06, w_pad=0.08)
    axes: np.ndarray = figure.subplots(rows, 2, sharex=True, **subplots)
    first, last = log.time[0], max(log.end_time, log.time[-1])
    span = last - first if last > first else log.scenario.effective_log_period
    for panel in axes.flat:
        look.plain(panel)
        panel.yaxis.set_major_locator(MaxNLocator(5))
    axes[0, 0].set_xlim(first, first + span * (1.0 if log.status == "completed" else 1.04))
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    top = 1.0 - 0.12 / height
    ended, color = _outcome(log)
    style: dict[str, Any] = {"x": 0.01, "ha": "left", "va": "top"}
    figure.suptitle(f"{log.scenario.name}: {ended}", y=top, fontsize=14, fontweight="bold", color=color, **style)
    figure.text(y=top - 0.3 / height, s=f"{what}; {_settings(log)}", fontsize=10, color=look.TEXT, **style)
    return figure, axes


def _outcome(log: SimulationLog) -> tuple[str, str]:
    """How the run ended, in words, and the colour of the words."""
    if log.status == "completed":
        return f"completed, {log.end_time:g} s", look.TEXT
    leg = "" if log.leg is None else f", leg {log.leg}"
    end = f"{log.status} at {_decided(log):.3f} s of {log.scenario.duration:g} s"
    return (end if log.reason in (None, log.status) else f"{end}: {log.reason}{leg}"), _FAILURE


def _decided(log: SimulationLog) -> float:
    return log.end_time if log.outcome_time is None else log.outcome_time


def _settings(log: SimulationLog) -> str:
    scenario = log.scenario
    controller = scenario.controller
    tuner = f", tuner {scenario.tuner.kind}" if "density" in log.signals else ""
    return (
        f"gravity {scenario.gravity:g} m/s², {controller.label}, control period {1e3 * controller.period:g} ms{tuner}"
    )


def _draw(panel: Axes, time: np.ndarray, values: np.ndarray, *, held: bool = False, **style: Any) -> None:
    """A line; a staircase where the value is held from tick to tick, a dot where there is but one row."""
    style = {"linewidth": 1.6, "label": "_", **style}
    if held:
        style["drawstyle"] = "steps-post"
    if len(time) == 1:
        style["marker"] = "o"
    panel.plot(time, values, **style)


def _finish(figure: Figure, axes: np.ndarray, log: SimulationLog) -> None:
    """Last touch of every figure: aligned labels, and from when on and why the run is not a good one."""
    figure.align_ylabels(axes)
    if log.status == "completed":
        return
    when = _decided(log)
    for panel in axes.flat:
        panel.axvline(when, color=_FAILURE, linewidth=1.4)
        panel.axvspan(when, panel.get_xlim()[1], color=_FAILURE, alpha=0.08, linewidth=0.0)
    for panel in axes[0]:
        middle = 0.5 * (when + panel.get_xlim()[1])
        style: dict[str, Any] = {"rotation": 90.0, "ha": "center", "va": "center", "fontsize": 9, "color": _FAILURE}
        panel.text(middle, 0.5, log.reason or log.status, transform=panel.get_xaxis_transform(), **style)


def _title(panel: Axes, left: str, right: str = "") -> None:
    look.headline(panel, left[0].upper() + left[1:], right)


def _legend(panel: Axes) -> None:
    """Above the panel, where it hides no data."""
    panel.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, frameon=False, fontsize=9, labelcolor=look.TEXT,
        borderaxespad=0.0, handlelength=1.8, columnspacing=1.4,
    )  # fmt: skip


def _once(wanted: bool, label: str) -> str:
    return label if wanted else "_"


def _widen(panel: Axes, least: float) -> None:
    """Opens the vertical range to at least `least`: a difference, or decades on a logarithmic axis."""
    transform = panel.yaxis.get_transform()
    low, high = transform.transform(np.array(panel.get_ylim()))
    missing = 0.5 * max(least - (high - low), 0.0)
    if missing > 0.0:
        panel.set_ylim(*transform.inverted().transform(np.array([low - missing, high + missing])))
