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
