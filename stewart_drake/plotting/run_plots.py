"""Figures of one run, Fig. 7 of the paper, or of several: panels on one time axis, of what moves in them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.control.regression_records import Learnt, LearntCenter, LearntJoints
from stewart_drake.logs.log import SimulationLog, distinct_names
from stewart_drake.logs.metrics import INTEGRAL_TIME, run_metrics
from stewart_drake.logs.signals import SCALES, SIGNALS
from stewart_drake.plotting import style as look

_AXIS_COLORS = (look.ORANGE, look.GREEN, look.BLUE)  # Axis 1, 2, 3 as in RGB triads
_LINES: tuple[Any, ...] = ("-", ":", "-.", "--")  # Of one run after the other
_FAILURE = "#B2182B"
_NEAR_LIMIT = 0.8  # Share of a motor's limit from which on limits are drawn
_SHOWN = 0.1  # Of the largest motion or error: an axis with less is left out
_SMALLEST = 1e-9  # [m] of a motion or error
_SYMBOLS = (r"$\phi$", r"$\theta$", r"$\psi$", "X", "Y", "Z")
_GROUPS = (("deg", (0, 1, 2)), ("mm", (3, 4, 5)))


@dataclass(frozen=True)
class _Panel:
    """Curves over time: label -> values (n,), and how they are drawn."""

    title: str
    quantity: str
    curves: dict[str, np.ndarray]
    colors: Sequence[str] = _AXIS_COLORS
    least: float = 0.0  # Vertical range at least, in decades on a logarithmic axis
    held: bool = False  # From tick to tick
    dashed: tuple[np.ndarray, ...] = ()  # References
    decades: bool = False

    @property
    def kind(self) -> tuple[str, str]:
        """The same for the panels of several runs that are drawn as one."""
        return self.title, self.quantity


@look.styled
def plot_states(logs: SimulationLog | Sequence[SimulationLog]) -> Figure:
    """Poses against their reference, errors, integral states [deg, mm] and what the tuner sets over time; Fig. 7(a).

    Only axes that move, or err, by a tenth of the largest of them are shown.
    """
    drawn = [_drawable(log) for log in ([logs] if isinstance(logs, SimulationLog) else logs)]
    if not drawn:
        raise ConfigurationError("logs", [], "one log or more")
    moving = _largest(drawn, [log["reference"] - log["reference"][0] for log in drawn])
    erring = _largest(drawn, [log.error for log in drawn])
    panels = [list(_state_panels(log, moving, erring if len(erring) else range(6), len(drawn) == 1)) for log in drawn]
    kinds = list(dict.fromkeys(panel.kind for own in panels for panel in own))
    figure, axes = _figure(drawn, "states, RMS over the second half", len(kinds), 2.3)
    for log, own, line in zip(drawn, panels, _LINES, strict=False):
        for panel in own:
            _draw(axes[kinds.index(panel.kind)], log, panel, line)
    for axis in axes[: len(kinds)]:
        _legend(axis)
    if len(drawn) > 1:
        names = distinct_names(drawn)
        named = list(zip(names, _LINES, strict=False))
        look.legend_below(figure, [Line2D([], [], color=look.TEXT, linestyle=line, label=name) for name, line in named])
    return figure


def _largest(logs: Sequence[SimulationLog], values: Sequence[np.ndarray]) -> np.ndarray:
    """Which of the axes (n, 6) [rad, m] have at least a tenth of the largest of all."""
    size = np.array([logs[0].scenario.robot.characteristic_length] * 3 + [1.0] * 3)
    extent = size * np.max([np.nanmax(np.abs(each), axis=0) for each in values], axis=0)
    return np.flatnonzero((extent >= _SHOWN * extent.max()) & (extent > _SMALLEST))


def _state_panels(
    log: SimulationLog, moving: Sequence[int] | np.ndarray, erring: Sequence[int] | np.ndarray, alone: bool
) -> Iterator[_Panel]:
    with np.errstate(all="ignore"):
        metrics = run_metrics(log)
    pose, reference, error, integral = (
        SCALES * values for values in (log["pose"], log["reference"], log.error, log["integral"])
    )
    for unit, group in _GROUPS:
        axes = [axis for axis in group if axis in moving]
        if axes:
            title = _capital(" and ".join(look.COORDINATES[axis][0] for axis in axes))
            dashed = tuple(reference[:, axis] for axis in axes)
            yield _Panel(title, f"pose [{unit}]", *_curves(pose, axes), least=1.0, dashed=dashed)
    for name, values, quantity in (("error", error, "error [{}]"), ("integral", integral, "z [{} s]")):
        for unit, group in _GROUPS:
            axes = [axis for axis in group if axis in erring]
            if not axes or (name != "error" and not values[:, axes].any()):
                continue
            rmse = metrics[f"rmse_{unit}"] if alone and name == "error" else None
            # Noise far below what matters must not fill a panel, nor a small error vanish in it.
            least = float(np.clip(3.0 * np.nanmax(np.abs(values[:, axes])), 1e-4, 0.02))
            curves, colors = _curves(values, axes, rmse or [None] * 3)
            yield _Panel(SIGNALS[name].title, quantity.format(unit), curves, colors, least, name != "error")
    yield from _tuner_panels(log)


def _curves(
    values: np.ndarray, axes: Sequence[int], numbers: Sequence[float | None] = (None,) * 3
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Values (n, 6) of some axes by symbol, with a number of each, and colours."""
    labels = {a: _SYMBOLS[a] + ("" if numbers[a % 3] is None else f"  {numbers[a % 3]:.2g}") for a in axes}
    return {labels[a]: values[:, a] for a in axes}, [_AXIS_COLORS[a % 3] for a in axes]


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _tuner_panels(log: SimulationLog) -> Iterator[_Panel]:
    """What the tuner sets, where it changes."""
    if "setting" in log.signals:
        *names, outside = SIGNALS["setting"].components
        curves = dict(zip([*names, outside], log["setting"].T, strict=True))
        for title, shown in (
            (SIGNALS["setting"].title, names),
            ("Tuner inputs outside their training range", [outside]),
        ):
            decades = {name: curves[name] for name in shown}
            if any(np.ptp(each) > 0.0 for each in decades.values()):
                yield _Panel(title, "[decades]", decades, look.COLORS, 0.1, True)
    elif "weights" in log.signals and np.ptp(log["weights"]) > 0.0:
        q, r = log["weights"].T
        weights = {r"$\omega_Q$": q, r"$\omega_R$": r}
        title, axis = "Ratio of the weights, which alone sets the gain", r"$\omega_Q\,/\,\omega_R$ [-]"
        yield _Panel(_capital(log.scenario.tuner.label), "weight [-]", weights, look.COLORS, 2.0, True, decades=True)
        yield _Panel(title, axis, {"_": q / r}, (look.TEXT,), 2.0, True, decades=True)


@look.styled
def plot_torques(log: SimulationLog) -> Figure:
    """Torques of the six motors over time [N m], on one scale, with limits where they are near; Fig. 7(b)."""
    log = _drawable(log)
    commanded, limits = log["torque"], log.scenario.robot.effort_limits
    applied = log.signals.get("torque_applied", commanded)
    rms, peak = np.sqrt(np.mean(applied**2, axis=0)), np.abs(applied).max(axis=0)
    near = bool((peak >= _NEAR_LIMIT * limits).any())
    figure, axes = _figure([log], "motor torques", 6, 2.6, sharey=True)
    for leg, (axis, limit) in enumerate(zip(axes, limits.tolist(), strict=True)):
        curves, colors = {SIGNALS["torque_applied"].title: applied[:, leg]}, [look.BLUE]
        if np.any(commanded[:, leg] != applied[:, leg]):
            # Servos are told an angle, of which this torque is a part.
            own = log.scenario.motors.torque_of(log.signals) is commanded
            label = SIGNALS["torque"].title if own else "torque that the model asks for"
            curves, colors = {label: commanded[:, leg], **curves}, [look.ORANGE, *colors]
        _draw(axis, log, _Panel(f"Motor {leg}", "" if leg % 2 else "torque [N m]", curves, colors, 0.02, held=True))
        axis.axhline(0.0, color=look.GREY, linewidth=0.8, zorder=1.0)
        for level in (-limit, limit) if near else ():
            axis.axhline(level, color=look.GREY, linewidth=0.8, linestyle=":", label=f"limit ±{limit:g} N m")
        note = f"RMS {rms[leg]:#.3g} N m, peak {peak[leg]:#.3g} N m"
        axis.set_title(note, loc="right", fontsize=9, fontweight="normal")
    if near:
        # A controller that asks for far more than the motors have must not flatten what they gave.
        low, high = axes[0].get_ylim()
        axes[0].set_ylim(max(low, -1.4 * limits.max()), min(high, 1.4 * limits.max()))
    lines = [line for axis in axes for line in axis.lines]
    entries = {line.get_label(): line for line in lines if not str(line.get_label()).startswith("_")}
    if len(entries) > 1:
        look.legend_below(figure, list(entries.values()), 3)
    return figure


@look.styled
def plot_learnt(log: SimulationLog) -> Figure:
    """What `adaptation: regression` learnt over time, of head, motors and ball joints, with 95 % intervals."""
    log = _drawable(log)
    panels = list(_learnt_panels(log))
    figure, axes = _figure([log], "what was learnt, with 95 % intervals", len(panels), 2.3)
    for axis, (panel, widths) in zip(axes, panels, strict=False):
        _draw(axis, log, panel)
        low, high = axis.get_ylim()
        curves, motors = np.array(list(panel.curves.values())), len(panel.curves) == 6
        below, above = curves - widths, curves + widths
        if motors:
            # Six bands that overlap say no more than the one around them.
            below, above = below.min(axis=0, keepdims=True), above.max(axis=0, keepdims=True)
        for under, over, color in zip(below, above, (look.GREY,) if motors else panel.colors, strict=False):
            axis.fill_between(log.time, under, over, color=color, alpha=0.15, linewidth=0.0)
        # Intervals that are wide at first must not flatten what becomes of them.
        reach = 0.25 * (above[:, -1] - below[:, -1]).max()
        axis.set_ylim(min(low, below[:, -1].min() - reach), max(high, above[:, -1].max() + reach))
        if not motors:
            _legend(axis)
    of_motors = next(axis for axis, (panel, _) in zip(axes, panels, strict=False) if len(panel.curves) == 6)
    look.legend_below(figure, of_motors.get_legend_handles_labels()[0], 6)
    return figure


def _learnt_panels(log: SimulationLog) -> Iterator[tuple[_Panel, np.ndarray]]:
    """Panels, and half the widths (curves, n) of the intervals of their curves."""
    value, width = Learnt.of(log["learnt"]), Learnt.of(log["learnt_half_width"])
    legs = [f"motor {leg}" for leg in range(6)]

    def panel(title: str, unit: str, values: Any, widths: Any, names: Sequence[str] = "_") -> Any:
        scale = 1e3 if unit in ("mm", "ms") else 1.0
        rows, wide = (scale * np.reshape(numbers, (-1, len(names))).T for numbers in (values, widths))
        return _Panel(title, f"[{unit}]", dict(zip(names, rows, strict=True)), look.COLORS, 1e-6), wide

    yield panel("Mass of the head", "kg", value.mass, width.mass)
    if "learnt_center_of_mass" in log.signals:
        center = LearntCenter.of(log["learnt_center_of_mass"])
        yield panel("Centre of mass of the head", "mm", center.value, center.half_width, "xyz")
    if np.any(width.delay):
        yield panel("Delay of the motors, beyond that of the model", "ms", value.delay, width.delay)
    yield panel("Torque of the motors over that of the model", "-", value.drive, width.drive, legs)
    yield panel("Viscous friction", "N m s/rad", value.viscous, width.viscous, legs)
    yield panel("Coulomb friction", "N m", value.coulomb, width.coulomb, legs)
    if "learnt_joints" in log.signals:
        of, title = LearntJoints.of(log["learnt_joints"]), "friction of the ball joints"
        yield panel(f"Viscous {title}", "N m s/rad", of.viscous, of.viscous_half_width)
        yield panel(f"Dry {title}", "N m", of.coulomb, of.coulomb_half_width)


def _drawable(log: SimulationLog) -> SimulationLog:
    if len(log.time) == 0:
        raise ConfigurationError("log", "no rows", "a log with at least one row to plot")
    signals = {name: values.clip(-look.LARGEST_DRAWN, look.LARGEST_DRAWN) for name, values in log.items()}
    return replace(log, signals=signals)


def _figure(
    logs: Sequence[SimulationLog], what: str, panels: int, row_height: float, **options: Any
) -> tuple[Figure, list[Axes]]:
    """Panels, two a row, on one time axis, below a headline on the run; with a mark where it ended, if early."""
    log, rows = logs[0], -(-panels // 2)
    scenario, height = log.scenario, row_height * rows + 0.4
    figure, grid = look.panels(rows, 2, height, 12.0, sharex=True, **options)
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 1.0 - 0.75 / height))
    first, last = log.time[0], max(max(each.end_time, each.time[-1]) for each in logs)
    span = last - first if last > first else scenario.effective_log_period
    grid[0, 0].set_xlim(first, first + span * (1.0 if log.status == "completed" else 1.04))
    axes = grid.ravel().tolist()
    for panel in axes[panels:]:
        panel.set_axis_off()
    for panel in axes[panels - 2 : panels]:
        panel.set_xlabel("time [s]")
        panel.tick_params(labelbottom=True)
    figure.align_ylabels(axes)
    top, place = 1.0 - 0.12 / height, {"x": 0.01, "ha": "left", "va": "top"}
    if len(logs) > 1:
        figure.suptitle(" and ".join(each.scenario.name for each in logs), y=top, fontsize=14, **place)
        return figure, axes
    ended, color = f"completed, {log.end_time:g} s", look.TEXT
    if log.status != "completed":
        when = log.end_time if log.outcome_time is None else log.outcome_time
        ended, color = f"{log.status} at {when:.3f} s of {scenario.duration:g} s", _FAILURE
        if log.reason not in (None, log.status):
            ended += f": {log.reason}" + ("" if log.leg is None else f", leg {log.leg}")
        for panel in axes[:panels]:
            panel.axvline(when, color=_FAILURE, linewidth=1.4)
            panel.axvspan(when, grid[0, 0].get_xlim()[1], color=_FAILURE, alpha=0.08, linewidth=0.0)
    figure.suptitle(f"{scenario.name}: {ended}", y=top, fontsize=14, color=color, **place)
    controller = scenario.controller
    what += f"; gravity {scenario.gravity:g} m/s², {controller.label}, control period {1e3 * controller.period:g} ms"
    if "density" in log.signals:
        what += f", tuner {scenario.tuner.kind}"
    figure.text(y=top - 0.3 / height, s=what, **place)  # type: ignore[arg-type]
    return figure, axes


def _draw(axis: Axes, log: SimulationLog, panel: _Panel, line: str = "-") -> None:
    style: dict[str, Any] = {"drawstyle": "steps-post" if panel.held else "default", "linestyle": line}
    style["marker"] = "o" if len(log.time) == 1 else None
    # The panel may show another run already, with limits of its own.
    axis.autoscale(axis="y")
    for (label, values), color in zip(panel.curves.items(), panel.colors, strict=False):
        axis.plot(log.time, values, color=color, label=label, linewidth=1.6, **style)
    for values in panel.dashed:
        axis.plot(log.time, values, color=look.TEXT, linewidth=1.0, linestyle="--", label="reference")
    if panel.title == SIGNALS["integral"].title and log.time[0] < INTEGRAL_TIME < log.time[-1]:
        axis.axvline(INTEGRAL_TIME, color=look.GREY, linestyle=":", linewidth=1.2, zorder=1.0)
    axis.set(title=panel.title, ylabel=panel.quantity)
    if panel.decades:
        look.logarithmic(axis, "y")
    else:
        axis.yaxis.set_major_locator(MaxNLocator(5))
    transform = axis.yaxis.get_transform()
    low, high = transform.transform(np.array(axis.get_ylim()))
    missing = 0.5 * (panel.least - (high - low))
    if missing > 0.0:
        axis.set_ylim(*transform.inverted().transform(np.array([low - missing, high + missing])))


def _legend(axis: Axes) -> None:
    handles, labels = axis.get_legend_handles_labels()
    first = {label: handle for handle, label in reversed(list(zip(handles, labels, strict=True)))}
    if first:
        # Above the panel, where it hides no data.
        place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.0}
        place |= {"handlelength": 1.3, "columnspacing": 1.2}
        axis.legend([*first.values()][::-1], [*first][::-1], ncols=4, frameon=False, **place)
