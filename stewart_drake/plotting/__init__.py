"""Figures, the only importer of matplotlib: one module per topic, `run_plots` for the figures of a run."""

from stewart_drake.plotting.run_plots import plot_learnt, plot_states, plot_torques
from stewart_drake.plotting.style import DPI, save_figure

__all__ = ["DPI", "plot_learnt", "plot_states", "plot_torques", "save_figure"]
