"""Figures of one run or of several, as Fig. 7 of the paper: panels on one time axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.control.regression_records import Learnt, LearntCenter, LearntJoints
from stewart_drake.logs.log import SimulationLog, distinct_names
from stewart_drake.logs.metrics import INTEGRAL_TIME, run_metrics
from stewart_drake.logs.signals import SCALES, SIGNALS
from stewart_drake.plotting import style as look
from stewart_drake.robot.gravity import gravity_text

_AXIS_COLORS = (look.ORANGE, look.GREEN, look.BLUE)  # Colours of axes 1, 2, 3, in the order of RGB triads.
_LINES: tuple[Literal["-", ":", "-.", "--"], ...] = ("-", ":", "-.", "--")  # By run.
_FAILURE = "#B2182B"
_NEAR_LIMIT = 0.8  # Share of a motor's limit; limits are drawn if torques exceed it.
_MIN_SHARE = 0.1  # Share of the largest motion or error; axes with less are not drawn.
_MIN_SIZE = 1e-9  # [m] of a motion or error.
_SYMBOLS = (r"$\phi$", r"$\theta$", r"$\psi$", "X", "Y", "Z")
_GROUPS = (("deg", (0, 1, 2)), ("mm", (3, 4, 5)))


@dataclass(frozen=True)
class _Panel:
    """Curves over time."""

    title: str
    quantity: str
    curves: dict[str, np.ndarray]  # Label -> values (n,).
    colors: Sequence[str] = _AXIS_COLORS
    min_range: float = 0.0  # Least vertical range, in decades on a logarithmic axis.
    steps: bool = False  # Values are constant between ticks.
    references: tuple[np.ndarray, ...] = ()
    decades: bool = False  # Logarithmic axis.

    @property
    def kind(self) -> tuple[str, str]:
        """Panels of several runs with the same kind are drawn as one."""
        return self.title, self.quantity


@look.styled
def plot_states(logs: SimulationLog | Sequence[SimulationLog]) -> Figure:
    """Poses and references, errors, integral states [deg, mm] and the tuner's outputs over time; Fig. 7(a).

    Axes with less than a tenth of the largest motion or error are left out.
    """
    drawn = [_drawable(log) for log in ([logs] if isinstance(logs, SimulationLog) else logs)]
    if not drawn:
        raise ConfigurationError("logs", [], "one log or more")
    moving = _largest(drawn, [log["reference"] - log["reference"][0] for log in drawn])
    erring = _largest(drawn, [log.error for log in drawn])
    erring = erring if len(erring) else np.arange(6)
    panels = [list(_state_panels(log, moving, erring, len(drawn) == 1)) for log in drawn]
    kinds = list(dict.fromkeys(panel.kind for of_log in panels for panel in of_log))
    figure, axes = _figure(drawn, "states, RMS over the second half", len(kinds), 2.3)
    for log, of_log, line in zip(drawn, panels, _LINES, strict=False):
        for panel in of_log:
            _draw(axes[kinds.index(panel.kind)], log, panel, line)
    for axis in axes[: len(kinds)]:
        _legend(axis)
    if len(drawn) > 1:
        named = zip(distinct_names(drawn), _LINES, strict=False)
        look.legend_below(figure, [Line2D([], [], color=look.TEXT, linestyle=line, label=name) for name, line in named])
    return figure


def _largest(logs: Sequence[SimulationLog], values: Sequence[np.ndarray]) -> np.ndarray:
    """Indices of the axes of values (n, 6) [rad, m] with at least a tenth of the largest of all."""
    size = np.array([logs[0].scenario.robot.characteristic_length] * 3 + [1.0] * 3)
    extent = size * np.max([np.nanmax(np.abs(of_log), axis=0) for of_log in values], axis=0)
    return np.flatnonzero((extent >= _MIN_SHARE * extent.max()) & (extent > _MIN_SIZE))


def _state_panels(log: SimulationLog, moving: np.ndarray, erring: np.ndarray, with_rmse: bool) -> Iterator[_Panel]:
    with np.errstate(all="ignore"):
        metrics = run_metrics(log)
    pose, reference, error, integral = (
        SCALES * values for values in (log["pose"], log["reference"], log.error, log["integral"])
    )
    for unit, group in _GROUPS:
        axes = [axis for axis in group if axis in moving]
        if axes:
            title = _capital(" and ".join(look.COORDINATES[axis][0] for axis in axes))
            references = tuple(reference[:, axis] for axis in axes)
            yield _Panel(title, f"pose [{unit}]", *_curves(pose, axes), min_range=1.0, references=references)
    for name, values, quantity in (("error", error, "error [{}]"), ("integral", integral, "z [{} s]")):
        for unit, group in _GROUPS:
            axes = [axis for axis in group if axis in erring]
            if not axes or (name != "error" and not values[:, axes].any()):
                continue
            rmse = metrics[f"rmse_{unit}"] if with_rmse and name == "error" else None
            # Negligible noise does not fill a panel, and a small error stays visible.
            min_range = float(np.clip(3.0 * np.nanmax(np.abs(values[:, axes])), 1e-4, 0.02))
            curves, colors = _curves(values, axes, rmse or [None] * 3)
            yield _Panel(SIGNALS[name].title, quantity.format(unit), curves, colors, min_range, name != "error")
    if "ball" in log.signals:
        target = () if log.scenario.ball_control is None else log.scenario.ball_control.target.evaluate(log.time).T[:2]
        curves = dict(zip(("x", "y"), 1e3 * log["ball"].T, strict=True))
        yield _Panel("Ball on the plate", "place [mm]", curves, references=tuple(1e3 * axis for axis in target))
    yield from _tuner_panels(log)


def _curves(
    values: np.ndarray, axes: Sequence[int], numbers: Sequence[float | None] = (None,) * 3
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns of values (n, 6) by symbol and, if given, number, and their colours."""
    labels = {a: _SYMBOLS[a] + ("" if numbers[a % 3] is None else f"  {numbers[a % 3]:.2g}") for a in axes}
    return {labels[a]: values[:, a] for a in axes}, [_AXIS_COLORS[a % 3] for a in axes]


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _tuner_panels(log: SimulationLog) -> Iterator[_Panel]:
    """Outputs of the tuner, if they change."""
    if "setting" in log.signals:
        *names, outside = SIGNALS["setting"].components
        curves = dict(zip([*names, outside], log["setting"].T, strict=True))
        for title, shown in (
            (SIGNALS["setting"].title, names),
            ("Tuner inputs outside their training range", [outside]),
        ):
            decades = {name: curves[name] for name in shown}
            if any(np.ptp(values) > 0.0 for values in decades.values()):
                yield _Panel(title, "[decades]", decades, look.COLORS, 0.1, True)
    elif "weights" in log.signals and np.ptp(log["weights"]) > 0.0:
        q, r = log["weights"].T
        weights = {r"$\omega_Q$": q, r"$\omega_R$": r}
        title, axis = "Ratio of the weights, which alone sets the gain", r"$\omega_Q\,/\,\omega_R$ [-]"
        yield _Panel(_capital(log.scenario.tuner.label), "weight [-]", weights, look.COLORS, 2.0, True, decades=True)
        yield _Panel(title, axis, {"_": q / r}, (look.TEXT,), 2.0, True, decades=True)


@look.styled
def plot_torques(log: SimulationLog) -> Figure:
    """Torques of the six motors over time [N m], on one scale, with limits if they are near; Fig. 7(b)."""
    log = _drawable(log)
    commanded, limits = log["torque"], log.scenario.robot.effort_limits
    applied = log.signals.get("torque_applied", commanded)
    rms, peak = np.sqrt(np.mean(applied**2, axis=0)), np.abs(applied).max(axis=0)
    near = bool((peak >= _NEAR_LIMIT * limits).any())
    figure, axes = _figure([log], "motor torques", 6, 2.6, sharey=True)
    for leg, (axis, limit) in enumerate(zip(axes, limits.tolist(), strict=True)):
        curves, colors = {SIGNALS["torque_applied"].title: applied[:, leg]}, [look.BLUE]
        if np.any(commanded[:, leg] != applied[:, leg]):
            # The command of a servo is an angle, computed with this torque.
            by_torque = log.scenario.motors.torque_of(log.signals) is commanded
            label = SIGNALS["torque"].title if by_torque else "torque that the model asks for"
            curves, colors = {label: commanded[:, leg], **curves}, [look.ORANGE, *colors]
        _draw(axis, log, _Panel(f"Motor {leg}", "" if leg % 2 else "torque [N m]", curves, colors, 0.02, steps=True))
        axis.axhline(0.0, color=look.GREY, linewidth=0.8, zorder=1.0)
        for level in (-limit, limit) if near else ():
            axis.axhline(level, color=look.GREY, linewidth=0.8, linestyle=":", label=f"limit ±{limit:g} N m")
        note = f"RMS {rms[leg]:#.3g} N m, peak {peak[leg]:#.3g} N m"
        axis.set_title(note, loc="right", fontsize=9, fontweight="normal")
    if near:
        # Commands far beyond the limits do not set the scale.
        low, high = axes[0].get_ylim()
        axes[0].set_ylim(max(low, -1.4 * limits.max()), min(high, 1.4 * limits.max()))
    lines = [line for axis in axes for line in axis.lines]
    entries = {line.get_label(): line for line in lines if not str(line.get_label()).startswith("_")}
    if len(entries) > 1:
        look.legend_below(figure, list(entries.values()), 3)
    return figure


@look.styled
def plot_learnt(log: SimulationLog) -> Figure:
    """Parameters learnt by `adaptation: regression` over time, with 95 % intervals."""
    log = _drawable(log)
    panels = list(_learnt_panels(log))
    figure, axes = _figure([log], "what was learnt, with 95 % intervals", len(panels), 2.3)
    for axis, (panel, widths) in zip(axes, panels, strict=False):
        _draw(axis, log, panel)
        low, high = axis.get_ylim()
        curves, motors = np.array(list(panel.curves.values())), len(panel.curves) == 6
        below, above = curves - widths, curves + widths
        if motors:
            # One band around the six, which would overlap.
            below, above = below.min(axis=0, keepdims=True), above.max(axis=0, keepdims=True)
        for under, over, color in zip(below, above, (look.GREY,) if motors else panel.colors, strict=False):
            axis.fill_between(log.time, under, over, color=color, alpha=0.15, linewidth=0.0)
        # The last interval sets the scale; the first may be far wider.
        margin = 0.25 * (above[:, -1] - below[:, -1]).max()
        axis.set_ylim(min(low, below[:, -1].min() - margin), max(high, above[:, -1].max() + margin))
        if not motors:
            _legend(axis)
    of_motors = next(axis for axis, (panel, _) in zip(axes, panels, strict=False) if len(panel.curves) == 6)
    look.legend_below(figure, of_motors.get_legend_handles_labels()[0], 6)
    return figure


def _learnt_panels(log: SimulationLog) -> Iterator[tuple[_Panel, np.ndarray]]:
    """Panels, and the half widths (curves, n) of their curves' intervals."""
    value, width = Learnt.of(log["learnt"]), Learnt.of(log["learnt_half_width"])
    legs = [f"motor {leg}" for leg in range(6)]

    def panel(
        title: str, unit: str, values: ArrayLike, widths: ArrayLike, names: Sequence[str] = "_"
    ) -> tuple[_Panel, np.ndarray]:
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
        joints, title = LearntJoints.of(log["learnt_joints"]), "friction of the ball joints"
        yield panel(f"Viscous {title}", "N m s/rad", joints.viscous, joints.viscous_half_width)
        yield panel(f"Dry {title}", "N m", joints.coulomb, joints.coulomb_half_width)


def _drawable(log: SimulationLog) -> SimulationLog:
    if len(log.time) == 0:
        raise ConfigurationError("log", "no rows", "a log with at least one row to plot")
    signals = {name: values.clip(-look.LARGEST_DRAWN, look.LARGEST_DRAWN) for name, values in log.items()}
    return replace(log, signals=signals)


def _figure(
    logs: Sequence[SimulationLog], subtitle: str, panels: int, row_height: float, sharey: bool = False
) -> tuple[Figure, list[Axes]]:
    """Two columns of panels with one time axis, a title on the run, and a mark at an early end."""
    log, rows = logs[0], -(-panels // 2)
    scenario, height = log.scenario, row_height * rows + 0.4
    figure, grid = look.panels(rows, 2, height, 12.0, sharex=True, sharey=sharey)
    figure.set_layout_engine("constrained", rect=(0.0, 0.0, 1.0, 1.0 - 0.75 / height))
    first, last = log.time[0], max(max(run.end_time, run.time[-1]) for run in logs)
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
        figure.suptitle(" and ".join(run.scenario.name for run in logs), y=top, fontsize=14, **place)
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
    text = f"{subtitle}; gravity {gravity_text(scenario.gravity_in_base)} m/s², {controller.label}, "
    text += f"control period {1e3 * controller.period:g} ms"
    if "density" in log.signals:
        text += f", tuner {scenario.tuner.kind}"
    figure.text(y=top - 0.3 / height, s=text, **place)  # type: ignore[arg-type]
    return figure, axes


def _draw(axis: Axes, log: SimulationLog, panel: _Panel, line: str = "-") -> None:
    style: dict[str, Any] = {"drawstyle": "steps-post" if panel.steps else "default", "linestyle": line}
    style["marker"] = "o" if len(log.time) == 1 else None
    # Undoes the limits of a run that was drawn before.
    axis.autoscale(axis="y")
    for (label, values), color in zip(panel.curves.items(), panel.colors, strict=False):
        axis.plot(log.time, values, color=color, label=label, linewidth=1.6, **style)
    for values in panel.references:
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
    missing = 0.5 * (panel.min_range - (high - low))
    if missing > 0.0:
        axis.set_ylim(*transform.inverted().transform(np.array([low - missing, high + missing])))


def _legend(axis: Axes) -> None:
    handles, labels = axis.get_legend_handles_labels()
    first = {label: handle for handle, label in reversed(list(zip(handles, labels, strict=True)))}
    if first:
        # Above the panel, to hide no data.
        place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.98), "borderaxespad": 0.0}
        place |= {"handlelength": 1.3, "columnspacing": 1.2}
        axis.legend([*first.values()][::-1], [*first][::-1], ncols=4, frameon=False, **place)
