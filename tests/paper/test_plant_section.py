import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from stewart_drake.errors import RunFailure
from stewart_drake.paper import plant_section as plant
from stewart_drake.paper.plant_section import (
    DURATION,
    START,
    TORQUE,
    exact_motion,
    observed_orders,
    plant_motion,
)
from stewart_drake.paper.plots.plant_plots import plot_convergence
from stewart_drake.paper.rendering import render
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
FREE = json.loads((Path(__file__).parent.parent / "data" / "reference_values.json").read_text())["free_motion"]


def test_the_motion_is_the_one_that_another_program_computed():
    np.testing.assert_allclose(ROBOT.home_pose + START, FREE["pose"], atol=1e-15)
    np.testing.assert_array_equal(TORQUE, FREE["torque"])
    assert FREE["time"] == DURATION
    pose = exact_motion(ROBOT, 9.81)
    np.testing.assert_allclose(pose[3:], FREE["position"], atol=1e-7)
    w, x, y, z = FREE["quaternion_wxyz"]
    turned = Rotation.from_quat([x, y, z, w]) * Rotation.from_euler("xyz", pose[:3]).inv()
    assert turned.magnitude() < 1e-7


def test_the_exact_motion_starts_where_it_should_and_does_not_depend_on_the_solver_s_steps():
    np.testing.assert_allclose(exact_motion(ROBOT, 9.81, 1e-9), ROBOT.home_pose + START, atol=1e-15)
    # From rest the displacement grows with the square of time.
    small, twice = (exact_motion(ROBOT, 9.81, t) - ROBOT.home_pose - START for t in (1e-3, 2e-3))
    np.testing.assert_allclose(twice, 4.0 * small, rtol=1e-3, atol=1e-9)


def test_a_motion_that_cannot_be_integrated_to_its_end_is_an_error(monkeypatch):
    monkeypatch.setattr(
        plant,
        "solve_ivp",
        lambda *_, **__: SimpleNamespace(success=False, t=[0.0, 0.05], message="step size too small"),
    )
    with pytest.raises(RunFailure, match=r"beyond 0.05 s: step size too small"):
        exact_motion(ROBOT, 9.81)


@given(st.floats(0.1, 5.0), st.floats(1e-6, 1e3))
def test_the_observed_order_of_a_power_law_is_its_exponent(order, factor):
    steps = np.array([2e-3, 1e-3, 4e-4, 1e-4])
    np.testing.assert_allclose(observed_orders(steps, factor * steps**order), order, rtol=1e-9)


def test_orders_are_those_between_neighbours():
    steps = np.array([4.0, 2.0, 1.0])
    np.testing.assert_allclose(observed_orders(steps, np.array([16.0, 4.0, 2.0])), [2.0, 1.0])
    np.testing.assert_allclose(observed_orders(steps, np.array([1.0, 1.0, 2.0])), [0.0, -1.0])


def test_the_plant_is_as_far_off_as_another_program_was():
    pose, _ = plant_motion(ROBOT, 9.81, 1e-3)
    assert np.abs(pose[3:] - FREE["position"]).max() == pytest.approx(1.7e-4, rel=0.05)


def test_the_plant_converges_to_the_exact_motion_with_first_order_and_its_gap_with_second(report):
    n, body = report.sections["plant"].numbers, report.sections["plant"].body
    np.testing.assert_allclose(n["orders"], 1.0, atol=0.1)
    np.testing.assert_allclose(n["gap_orders"], 2.0, atol=0.2)
    assert n["position_error"][-1] < n["position_error"][0]
    pose, gap = plant_motion(ROBOT, 9.81, 1e-3)
    at = n["step"].index(1e-3)
    assert gap == n["loop_gap"][at]
    assert np.abs(pose - exact_motion(ROBOT, 9.81))[3:].max() == n["position_error"][at]
    cells = (n["angle_error"][at], n["position_error"][at], n["orders"][at - 1], n["loop_gap"][at])
    assert "| 1 | {:.2e} | {:.2e} | {:.2f} | {:.1e} |".format(*cells) in body


NUMBERS = {
    "step": [2e-3, 1e-3, 5e-4],
    "position_error": [4e-4, 2e-4, 1e-4],
    "loop_gap": [4e-6, 1e-6, 2.5e-7],
    "orders": [1.0, 1.0],
}


def verdict(nearest=1, **changes):
    return render("plant", "verdict", n=NUMBERS | changes, nearest=nearest, duration=DURATION)


def test_the_verdict_follows_from_the_numbers():
    text = verdict()
    assert text.startswith(
        "Holds: the plant converges to rigid-body mechanics, with order 1.00 in the step; at 1 ms it"
    )
    assert text.endswith("0.2 mm off after 0.15 s and its loops are open by 0.001 mm.")
    assert "at 0.5 ms it is 0.1 mm" in verdict(2)
    for broken in ({"orders": [1.0, 0.1]}, {"orders": [-1.0, -1.0]}, {"position_error": [1e-4, 2e-4, 4e-4]}):
        assert verdict(**broken).startswith("Does not hold: the plant does not converge to rigid-body mechanics")


def test_the_figure_has_labelled_logarithmic_axes():
    steps = np.array(NUMBERS["step"])
    figure = plot_convergence(steps, np.array(NUMBERS["position_error"]), np.array(NUMBERS["loop_gap"]))
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("step [ms]", "error, gap [m]")
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    np.testing.assert_allclose(axes.lines[0].get_xdata(), [2.0, 1.0, 0.5])
    np.testing.assert_allclose(axes.lines[0].get_ydata(), NUMBERS["position_error"])
    # The guides run beside the points, not on them, with the slope that their label names.
    np.testing.assert_allclose(axes.lines[1].get_ydata(), [2e-4, 1e-4, 5e-5])
    np.testing.assert_allclose(axes.lines[3].get_ydata(), [2e-6, 5e-7, 1.25e-7])
