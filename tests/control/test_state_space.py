import dataclasses

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from strategies import ROBOT, poses

from stewart_drake.control.riccati import (
    INTEGRAL,
    discretize,
    hautus_detectability,
    hautus_stabilisability,
    input_matrix,
    mass_diagonal,
    output_matrix,
    state_matrix,
)
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import force_map, force_map_of_legs
from stewart_drake.mechanics.kinematics import leg_geometry, rod_lines

A, C = state_matrix(), output_matrix()
NUMBERED = 10.0 * np.arange(1, 7)[:, None] + np.arange(1, 7)
"""M^-1 tau whose entries tell their row and column."""


def acceleration_map(pose, kind="statics"):
    return force_map(ROBOT, pose, kind) / mass_diagonal(ROBOT)[:, None]


def test_a_b_and_c_are_21_to_24_entry_by_entry_in_the_order_of_the_paper():
    state, torque = np.arange(18.0), np.arange(1.0, 7.0)
    derivative = np.zeros(18)
    derivative[[0, 2, 4, 6, 8, 10]] = state[[1, 3, 5, 7, 9, 11]]
    derivative[12:] = state[[0, 2, 4, 6, 8, 10]]
    np.testing.assert_array_equal(A @ state, derivative)
    assert set(np.unique(A)) == {0.0, 1.0}
    assert A.sum() == 12.0
    forces = np.zeros(18)
    forces[[1, 3, 5, 7, 9, 11]] = NUMBERED @ torque
    maps = np.stack([NUMBERED, -NUMBERED])
    np.testing.assert_allclose(input_matrix(maps) @ torque, [forces, -forces])
    np.testing.assert_array_equal(C @ state, state[[0, 2, 4, 6, 8, 10]] + state[12:])


@pytest.mark.slow
@given(pose=poses(), period=st.floats(1e-4, 0.1))
def test_exact_discretisation_is_the_matrix_exponential(pose, period):
    b = input_matrix(acceleration_map(pose))
    block = scipy.linalg.expm(period * np.block([[A, b], [np.zeros((6, 24))]]))
    a_d, b_d = discretize(A, b, period)
    np.testing.assert_allclose(a_d, block[:18, :18], rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(b_d, block[:18, 18:], rtol=1e-12, atol=1e-14)


def test_euler_discretisation_is_the_first_order_step():
    b = input_matrix(NUMBERED)
    a_d, b_d = discretize(A, b, 0.01, "euler")
    np.testing.assert_array_equal(a_d, np.eye(18) + 0.01 * A)
    np.testing.assert_array_equal(b_d, 0.01 * b)
    with pytest.raises(ConfigurationError, match="exact or euler"):
        discretize(A, b, 0.005, "tustin")


@given(pose=poses(), kind=st.sampled_from(["printed", "statics"]))
def test_stabilisable_at_regular_poses(pose, kind):
    assert hautus_stabilisability(A, input_matrix(acceleration_map(pose, kind))) == 18


@pytest.mark.parametrize("kind", ["printed", "statics"])
@pytest.mark.parametrize(("axis", "beyond"), [(0, 1.4), (1, -1.3), (2, 1.56)])
def test_not_stabilisable_at_a_parallel_singularity(kind, axis, beyond):
    def turned(angle):
        return ROBOT.home_pose + angle * np.eye(6)[axis]

    angle = brentq(lambda x: np.linalg.det(rod_lines(leg_geometry(ROBOT, turned(x)))), 0.0, beyond, xtol=1e-15)
    assert hautus_stabilisability(A, input_matrix(acceleration_map(turned(angle), kind))) == 17
    assert hautus_stabilisability(A, input_matrix(acceleration_map(turned(0.99 * angle), kind))) == 18


@pytest.mark.parametrize("dead", [1, 2, 6])
def test_the_printed_map_is_not_stabilisable_where_cranks_are_at_their_dead_centres(dead):
    legs = leg_geometry(ROBOT, ROBOT.home_pose)
    legs = dataclasses.replace(legs, transmission=np.where(np.arange(6) < dead, 0.0, legs.transmission))
    tau = force_map_of_legs(ROBOT, legs, "printed")
    assert hautus_stabilisability(A, input_matrix(tau / mass_diagonal(ROBOT)[:, None])) == 18 - dead


def test_detectable_at_every_pose_because_the_outputs_contain_the_integrals():
    assert hautus_detectability(A, C) == 18
    without = C.copy()
    without[:, INTEGRAL] = 0.0
    assert hautus_detectability(A, without) == 12


def test_the_hautus_tests_ask_only_about_modes_that_are_not_stable():
    a = np.diag([-1.0, 2.0, -3.0])
    assert hautus_stabilisability(a, np.array([[0.0], [1.0], [0.0]])) == 3
    assert hautus_stabilisability(a, np.array([[1.0], [0.0], [1.0]])) == 2
    assert hautus_detectability(a, np.array([[1.0, 0.0, 1.0]])) == 2
    # A slow unstable mode is not taken for an integrator, and complex modes on the axis count.
    for growth in (1e-9, 1e-5, 1.0):
        assert hautus_stabilisability(np.array([[growth]]), np.zeros((1, 1))) == 0
    a = np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert hautus_stabilisability(a, np.array([[0.0], [1.0]])) == 2
    assert hautus_stabilisability(a, np.zeros((2, 1))) == 1
