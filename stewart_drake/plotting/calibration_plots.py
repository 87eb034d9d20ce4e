"""The picture of a calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stewart_drake.calibration.model import OF_LEG, OF_ROBOT, PER_LEG
from stewart_drake.calibration.result import Calibration
from stewart_drake.plotting import panels as look
from stewart_drake.robot.leg import LEGS


def plot_calibration(found: Calibration, path: str | Path) -> None:
    """Errors of each pose before and after, and the parameters' changes with their 95 % intervals; a PNG."""
    figure, axes = look.panels(2, 2, 7.0)
    rows = np.arange(len(found.measurements)) + 1
    for panel, part, name, unit in (
        (axes[0, 0], slice(3, 6), "position", "mm"),
        (axes[1, 0], slice(0, 3), "rotation", "mrad"),
    ):
        for error, label, color in ((found.before, "before", look.ORANGE), (found.after, "after", look.BLUE)):
            panel.plot(rows, 1e3 * np.linalg.norm(error[:, part], axis=-1), ".", color=color, label=label)
        look.logarithmic(panel, "y")
        look.label(panel, f"Error of the {name}", "row", unit)
        look.legend(panel)
    of_legs = 1e3 * np.stack([found.change, found.half_width])[:, :OF_ROBOT].reshape(2, LEGS, PER_LEG)
    for panel, unit, title in ((axes[0, 1], "m", "Change of lengths"), (axes[1, 1], "rad", "Change of angles")):
        columns = [at for at, own in enumerate(OF_LEG) if own.unit == unit]
        colors = (look.BLUE, look.ORANGE, look.GREEN, look.PURPLE, look.SKY, look.YELLOW)
        for leg in range(LEGS):
            change, width = of_legs[:, leg, columns]
            # What is not told, or was held, has no change and no interval.
            width = np.where(np.isfinite(width), width, np.nan)
            at = np.arange(len(columns)) + 0.12 * (leg - 2.5)
            panel.errorbar(at, change, width, fmt=".", color=colors[leg], label=f"leg {leg}", elinewidth=1.0)
        names = [f"{OF_LEG[at].name} {OF_LEG[at].axis}".strip().replace("_", " ") for at in columns]
        panel.set_xticks(range(len(columns)), names, rotation=30, ha="right")
        look.label(panel, f"{title}, with 95 % intervals", "", f"m{unit}")
    look.legend_below(figure, axes[0, 1].get_legend_handles_labels()[0], columns=6)
    figure.savefig(path, dpi=130)
