"""Figures; the only place that imports matplotlib. One module a topic, `runs` for the figures of every run."""

from stewart_drake.plotting.run_plots import plot_learnt, plot_states, plot_torques
from stewart_drake.plotting.style import DPI, save_figure

__all__ = ["DPI", "plot_learnt", "plot_states", "plot_torques", "save_figure"]
