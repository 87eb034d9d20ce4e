import numpy as np
import pytest
from matplotlib.ticker import FuncFormatter

from stewart_drake.paper.experiments import RATIOS
from stewart_drake.paper.plots.force_map_plots import plot_rod_force
from stewart_drake.paper.plots.in_the_loop_plots import plot_ranking, plot_weights_in_force
from stewart_drake.paper.plots.kinematics_plots import plot_misprints
from stewart_drake.paper.plots.plant_plots import plot_convergence
from stewart_drake.paper.plots.sensitivity_plots import plot_effects
from stewart_drake.paper.tuner_comparison import Comparison

X, GRID = np.array([1.0, 0.1]), np.linspace(0.1, 1.0, 9).reshape(3, 3)
AXIS, FIXED = np.array([-0.1, 0.0, 0.1]), dict.fromkeys(RATIOS, 2.0)
UNCHANGED = {"pose RMSE [mm]": 4.0, "torque RMS [N m]": 1.0}
EFFECTS = [("masses", "+20 %", [None, None]), ("omega_Q", "-50 %", [9.0, 1.1]), ("window m", "10", [2.0, 0.9])]

PLOTS = {
    "convergence": lambda: plot_convergence(X, X, X),
    "misprints": lambda: plot_misprints(AXIS, 9.0 * GRID, 9.0 * GRID, GRID < 0.5),
    "rod force": lambda: plot_rod_force(X, 1.0 / X),
    "ranking": lambda: plot_ranking([Comparison("one", 5.0, FIXED), Comparison("two", None, {**FIXED, 100.0: None})]),
    "weights": lambda: plot_weights_in_force({"a": (X, X), "b": (X, X)}, {"a": 100.0, "b": None}),
    "effects": lambda: plot_effects(UNCHANGED, EFFECTS, "pose RMSE [mm]"),
}


def said(axis):
    """Whether an axis has its unit, or names instead of numbers."""
    return "[" in axis.get_label().get_text() or isinstance(axis.get_major_formatter(), FuncFormatter)


@pytest.mark.parametrize("name", PLOTS)
def test_every_panel_is_drawn_and_says_its_quantities_with_their_units(name):
    figure = PLOTS[name]()
    figure.draw_without_rendering()
    panels = [panel for panel in figure.axes if panel.axison and panel.get_label() != "<colorbar>"]
    assert panels
    for panel in panels:
        title = panel.get_title(loc="left")
        assert title
        assert said(panel.xaxis), title
        shared = [other for other in panels if panel.get_shared_y_axes().joined(panel, other)]
        assert any(said(other.yaxis) for other in shared or [panel]), title
    assert all(said(bar.yaxis) for bar in figure.axes if bar.get_label() == "<colorbar>")


def test_effects_are_bars_from_the_unchanged_value_in_the_order_given_and_lost_runs_are_named():
    pose, torque = plot_effects(UNCHANGED, EFFECTS, "pose RMSE [mm]").axes
    assert [text.get_text() for text in pose.get_yticklabels()] == [
        "masses, +20 %",
        r"$\omega_Q$, -50 %",
        "window m, 10",
    ]
    assert list(pose.get_yticks()) == [2, 1, 0]
    assert [(bar.get_x(), bar.get_width()) for bar in pose.patches] == [(4.0, 0.0), (4.0, 5.0), (4.0, -2.0)]
    assert [text.get_text() for text in pose.texts] == ["ends early"]
    assert (pose.get_xscale(), torque.get_xscale()) == ("log", "linear")
