"""Figures of the tuner's data and training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from stewart_drake.control.network import TunerNetwork
from stewart_drake.logs.log import AXIS_NAMES
from stewart_drake.plotting.panels import BLUE, GREEN, ORANGE, SKY, TEXT, YELLOW, label, legend, panels
from stewart_drake.training.dataset import Dataset

if TYPE_CHECKING:
    from stewart_drake.control.density import DensityKind
    from stewart_drake.training.train import Split, TrainingResult

_RATIO_COLORS = (BLUE, SKY, GREEN, YELLOW, ORANGE)
"""From low to high ratio."""
_SPLIT_COLORS = {"samples": BLUE, "runs": ORANGE}


def plot_densities(dataset: Dataset) -> Figure:
    """Median and 5 to 95 % band of each of the twelve densities, by ratio omega_Q / omega_R."""
    ratio = np.round(np.log10(dataset.outputs[:, 0] / dataset.outputs[:, 1])).astype(int)
    values = np.unique(ratio)
    names = [f"error {a if i < 3 else a.upper()}" for i, a in enumerate(AXIS_NAMES)] + [f"torque {i}" for i in range(6)]
    figure, grid = panels(1, 1, 4.2)
    axes = grid[0, 0]
    width = 0.8 / len(values)
    for index, value in enumerate(values):
        low, middle, high = np.quantile(dataset.inputs[ratio == value], (0.05, 0.5, 0.95), axis=0)
        at = np.arange(12) + (index - 0.5 * (len(values) - 1)) * width
        color = _RATIO_COLORS[index % len(_RATIO_COLORS)]
        axes.vlines(at, low, high, color=color, linewidth=3.0, alpha=0.55)
        axes.plot(at, middle, "o", color=color, markersize=3.5, label=f"{10.0**value:g}")
    axes.axvline(5.5, color=TEXT, linewidth=0.6)
    axes.axhline(1.0, color=TEXT, linewidth=0.6, linestyle=":")
    axes.set_xticks(range(12), names, rotation=35, ha="right")
    axes.grid(visible=False, axis="x")
    label(axes, "", "", "density [-]")
    style = {"title": "ratio of weights", "fontsize": 9, "title_fontsize": 9, "frameon": False}
    figure.legend(ncols=len(values), loc="outside upper right", **style)
    return figure


def plot_learning_curves(results: Mapping[tuple[DensityKind, Split], TrainingResult]) -> Figure:
    """Training and validation loss by epoch, one panel per kind of density."""
    kinds = list(dict.fromkeys(kind for kind, _ in results))
    figure, grid = panels(1, len(kinds), 3.6, sharey=True)
    for axes, kind in zip(grid[0], kinds, strict=True):
        for (k, split), result in results.items():
            if k != kind:
                continue
            epochs = np.arange(1, len(result.training_loss) + 1)
            color = _SPLIT_COLORS[split]
            losses = {"training": (result.training_loss, "-"), "validation": (result.validation_loss, "--")}
            for side, (loss, style) in losses.items():
                axes.plot(epochs, loss, color=color, linestyle=style, label=f"split by {split}: {side}")
        axes.set_xscale("log")
        label(axes, f"{kind} densities", "epoch", "")
    grid[0, 0].set_ylabel("mean squared error of log10 weights", fontsize=10)
    legend(grid[0, -1])
    return figure


def plot_predictions(network: TunerNetwork, dataset: Dataset) -> Figure:
    """Predicted omega_Q, omega_R and ratio against their labels, one mark per experiment."""
    predicted, target = network.log_weights(dataset.inputs), np.log10(dataset.outputs)
    mixes = (("omega_Q", (1.0, 0.0)), ("omega_R", (0.0, 1.0)), ("omega_Q / omega_R", (1.0, -1.0)))
    figure, grid = panels(1, 3, 3.4)
    for axes, (name, mix) in zip(grid[0], mixes, strict=True):
        labels, answers = target @ mix, predicted @ mix
        for run in np.unique(dataset.run):
            rows = dataset.run == run
            low, middle, high = np.quantile(answers[rows], (0.05, 0.5, 0.95))
            # Labels repeat; a small shift per experiment keeps the marks apart.
            at = labels[rows][0] + 0.05 * (run - 4)
            axes.vlines(at, low, high, color=_RATIO_COLORS[0], linewidth=2.0, alpha=0.5)
            axes.plot(at, middle, "o", color=_RATIO_COLORS[0], markersize=4.0)
        reach = float(np.abs(labels).max()) * 1.25
        axes.plot([-reach, reach], [-reach, reach], color=TEXT, linewidth=0.8, linestyle=":")
        label(axes, name, "log10 of the label", "")
    grid[0, 0].set_ylabel("log10 of the network's answer", fontsize=10)
    return figure
