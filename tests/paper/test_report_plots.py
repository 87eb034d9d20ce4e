import numpy as np
import pytest
from matplotlib.ticker import FuncFormatter

from stewart_drake.control.state_space import acceleration_map, input_matrix, output_matrix, state_matrix
from stewart_drake.paper.experiments import RATIOS
from stewart_drake.paper.plots import force_map_plots as force_map
from stewart_drake.paper.plots import in_the_loop_plots as loop
from stewart_drake.paper.plots import kinematics_plots as kinematics
from stewart_drake.paper.plots import state_space_plots as state_space
from stewart_drake.paper.plots.plant_plots import plot_convergence
from stewart_drake.paper.plots.sensitivity_plots import Tornado, TornadoBar, plot_tornados
from stewart_drake.paper.tuner_comparison import Comparison
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
X, GRID = np.array([1.0, 0.1]), np.linspace(0.1, 1.0, 9).reshape(3, 3)
AXIS, FIXED = np.array([-0.1, 0.0, 0.1]), dict.fromkeys(RATIOS, 2.0)
MODELS = {"statics": [0.1, 0.2, 0.3]}
SLICE = force_map.RatioSlice("a", np.arange(3.0), np.arange(3.0), GRID, "roll [deg]", "Z [mm]", np.eye(2))
FOUND = (np.array([0.3, 0.1, 0.2]), np.array([1e-14, 0.3, np.nan]), np.array([False, True, True]))
B = input_matrix(acceleration_map(ROBOT, ROBOT.home_pose))

PLOTS = {
    "convergence": lambda: plot_convergence(X, X, X),
    "forward": lambda: kinematics.plot_forward({"near": (2, 1, 0)}, *FOUND),
    "misprints": lambda: kinematics.plot_misprints(AXIS, 9.0 * GRID, 9.0 * GRID, GRID < 0.5),
    "ratio": lambda: force_map.plot_ratio({"near": GRID.ravel()}, [SLICE] * 3),
    "measured": lambda: force_map.plot_measured(X, 1.0 / X, X, {"Drake": X}, X, {"Table I": X}),
    "models": lambda: force_map.plot_models({"massless legs": MODELS, "Table I": MODELS}),
    "tilt": lambda: force_map.plot_tilt(np.array([0.0, 0.5]), {"a": np.array([0.0, 0.3])}, 0.3),
    "matrices": lambda: state_space.plot_matrices(state_matrix(), B, output_matrix()),
    "singular": lambda: state_space.plot_singular({"Serial|mm": (X, {"c": X}), "Parallel|deg": (X, {"c": X})}),
    "decay": lambda: state_space.plot_decay(X, {"equal": X}, (0.87,), {"1": X}, {"1": X}),
    "discretisation": lambda: state_space.plot_discretisation(X, {"1": X}, {"1": X}),
    "ranking": lambda: loop.plot_ranking([Comparison("one", 5.0, FIXED)]),
    "weights": lambda: loop.plot_weights_in_force({"a": (X, X), "b": (X, X)}, {"a": 100.0, "b": None}),
    "answers": lambda: loop.plot_answers(RATIOS, {"a": [0.0] * 5, "b": [1.0] * 5}),
    "tornados": lambda: plot_tornados([Tornado("pose RMSE", "mm", 4.0, [TornadoBar("a", [("+", 5.0)])])]),
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
