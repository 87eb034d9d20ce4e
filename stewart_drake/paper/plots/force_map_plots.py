"""Figures on the force map, (7) to (18)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.paper.plots.drawing import COLORS, contoured, curves
from stewart_drake.plotting.panels import BLUE, ORANGE, QUIET, TEXT, label, legend, panels


@dataclass(frozen=True)
class RatioSlice:
    """The smallest (e_l.e_N)^2 of the six legs over a slice of the workspace.

    Attributes:
        title: What is varied.
        x: (n,) in the unit of `x_label`.
        y: (m,) in the unit of `y_label`.
        values: (m, n) [-], NaN out of reach.
        x_label: Name and unit.
        y_label: Name and unit.
        path: (k, 2) a motion in the slice, or None.
    """

    title: str
    x: np.ndarray
    y: np.ndarray
    values: np.ndarray
    x_label: str
    y_label: str
    path: np.ndarray | None = None


def plot_ratio(ratios: Mapping[str, np.ndarray], slices: Sequence[RatioSlice]) -> Figure:
    """What part of the true rod force (15) sees: over random poses, and its worst leg over three slices.

    Args:
        ratios: Name of a box -> (n,) [-] (e_l.e_N)^2 of all legs at random poses of it.
        slices: Three slices.
    """
    figure, axes = panels(2, 2, 7.2)
    bins = np.linspace(0.0, 1.0, 41)
    for (name, values), color in zip(ratios.items(), COLORS, strict=False):
        weights = np.full(values.size, 100.0 / max(values.size, 1))
        axes[0, 0].hist(values, bins=bins, weights=weights, histtype="step", color=color, linewidth=1.8, label=name)
    label(axes[0, 0], "All legs at random poses", r"$(e_l \cdot e_N)^2$: force by (15) / true force [-]", "legs [%]")
    legend(axes[0, 0], title="box", title_fontsize=9, loc="upper left")
    for panel, of in zip(axes.flat[1:], slices, strict=True):
        contoured(figure, panel, of.x, of.y, of.values, "worst leg [-]", [0.2, 0.4, 0.6, 0.8, 0.9], vmax=1.0)
        if of.path is not None:
            panel.plot(*of.path.T, color=ORANGE, linewidth=2.0, label="(37), (38)")
            legend(panel, loc="lower right")
        label(panel, of.title, of.x_label, of.y_label)
    return figure


def plot_measured(
    transmission: np.ndarray,
    force: np.ndarray,
    scales: np.ndarray,
    scale_errors: Mapping[str, Sequence[float]],
    steps: np.ndarray,
    step_errors: Mapping[str, Sequence[float]],
) -> Figure:
    """Rod force per torque in Drake's massless limit, and how that limit and the step to zero are approached.

    Args:
        transmission: (n,) [-] e_l.e_N.
        force: (n,) [-] |a| F / T as measured.
        scales: (k,) [-] factors on the masses of the legs.
        scale_errors: Name -> (k,) [-] relative error of an acceleration map.
        steps: (j,) [s] plant steps.
        step_errors: Name -> (j,) [-] likewise.
    """
    figure, axes = panels(1, 3, 3.9, width_ratios=(1.25, 1.0, 1.0))
    left, middle, right = axes[0]
    x = np.linspace(min(0.15, float(np.abs(transmission).min())), 1.0, 200)
    left.plot(x, 1.0 / x, color=BLUE, linewidth=1.8, label="statics: $1/(e_l \\cdot e_N)$")
    left.plot(x, x, color=ORANGE, linewidth=1.8, linestyle=(0, (5, 2)), label="(15): $e_l \\cdot e_N$")
    left.plot(np.abs(transmission), np.abs(force), "o", color=TEXT, markersize=3.0, alpha=0.6, label="Drake")
    left.set_ylim(0.0, min(8.0, 1.1 * float(np.abs(force).max())))
    label(left, "Force of a rod, massless legs", "$e_l \\cdot e_N$ [-]", "$|a| F / T$ [-]")
    legend(left, loc="upper right")
    for panel, at, errors in ((middle, scales, scale_errors), (right, steps, step_errors)):
        curves(panel, at, errors, "os^", linewidth=1.6)
        panel.set(xscale="log", yscale="log")
        panel.invert_xaxis()
        legend(panel, loc="lower left")
    label(middle, "Legs made lighter", "factor on the legs' masses [-]", "relative error [-]")
    label(right, "Plant step made smaller", "time step [s]", "relative error [-]")
    return figure


def plot_models(errors: Mapping[str, Mapping[str, Sequence[float]]]) -> Figure:
    """Error of each model of the acceleration, on each plant.

    Args:
        errors: Plant -> model -> 5 %, 50 % and 95 % quantile [-] over poses.
    """
    figure, axes = panels(1, len(errors), 3.6, sharey=True)
    for panel, (plant, models) in zip(axes[0], errors.items(), strict=True):
        rows = np.arange(len(models))[::-1]
        low, middle, high = 100.0 * np.array(list(models.values())).T
        panel.hlines(rows, low, high, color=BLUE, linewidth=5.0, alpha=0.45)
        panel.plot(middle, rows, "o", color=BLUE, markersize=6.0)
        for row, value in zip(rows, middle, strict=True):
            text = f"{value:.0f}" if value >= 1.0 else f"{value:.1g}"
            panel.annotate(text, (value, row), (0, 7), textcoords="offset points", ha="center", fontsize=9)
        panel.set_yticks(rows, list(models))
        panel.set_ylim(-0.6, len(models) - 0.3)
        panel.set_xlim(0.0, 1.08 * float(np.max(high)))
        label(panel, plant, "relative error of the acceleration [%]", "")
    return figure


def plot_tilt(angle: np.ndarray, errors: Mapping[str, np.ndarray], marked: float) -> Figure:
    """What the departures of (9) and (11) cost as the platform turns about all three axes at once.

    Args:
        angle: (n,) [rad] roll = pitch = yaw.
        errors: Name -> (n,) [-] relative error.
        marked: [rad] the paper's largest angle.
    """
    figure, ((panel,),) = panels(1, 1, 3.8)
    curves(panel, np.degrees(angle), {name: 100.0 * values for name, values in errors.items()})
    panel.axvline(np.degrees(marked), color=QUIET, linestyle=":", linewidth=1.4)
    panel.set_xlim(0.0, float(np.degrees(angle[-1])))
    panel.set_ylim(bottom=0.0)
    label(panel, "Turned about all three axes at once", "roll = pitch = yaw [deg]", "error [%]")
    legend(panel, loc="upper left")
    return figure
