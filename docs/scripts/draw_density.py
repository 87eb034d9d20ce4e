"""Draws docs/images/density.svg, what a density says: `python docs/scripts/draw_density.py`."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from stewart_drake.control.features import density

PERIOD, WINDOW = 0.005, 50
time = PERIOD * np.arange(300)
signal = 1.0 + 0.15 * np.sin(12.0 * time) + 2.0 * (time > 0.6)
samples = np.stack([signal, 2.0 * signal], axis=1)
densities = np.array([density(samples[max(0, end - WINDOW) : end]) for end in range(1, len(time) + 1)])

plt.rcParams["svg.hashsalt"] = "density"  # the same picture again, to the byte
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 3.8), sharex=True, layout="constrained")
for column, label, style in ((0, "a signal", "C0-"), (1, "twice the signal", "C1--")):
    above.plot(time, samples[:, column], style, label=label)
    below.plot(time, densities[:, column], style)
above.set(ylabel="signal")
above.legend(loc="upper left", frameon=False)
below.set(ylabel="density", xlabel="time [s]")
below.axhline(1.0, color="gray", linewidth=0.7)
for axes in (above, below):
    axes.spines[["top", "right"]].set_visible(False)
figure.savefig(Path(__file__).parents[1] / "images" / "density.svg", metadata={"Date": None})
