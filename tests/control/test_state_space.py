import numpy as np
import pytest

from stewart_drake.control.riccati import (
    INTEGRAL,
    discretize,
    hautus_detectability,
    hautus_stabilisability,
    input_matrix,
    output_matrix,
    state_matrix,
)
from stewart_drake.errors import ConfigurationError

A, C = state_matrix(), output_matrix()
NUMBERED = 10.0 * np.arange(1, 7)[:, None] + np.arange(1, 7)
"""M^-1 tau whose entries tell their row and column."""


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


def test_euler_discretisation_is_the_first_order_step():
    b = input_matrix(NUMBERED)
    a_d, b_d = discretize(A, b, 0.01, "euler")
    np.testing.assert_array_equal(a_d, np.eye(18) + 0.01 * A)
    np.testing.assert_array_equal(b_d, 0.01 * b)
    with pytest.raises(ConfigurationError, match="exact or euler"):
        discretize(A, b, 0.005, "tustin")


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
    assert hautus_stabilisability(np.array([[1e-9]]), np.zeros((1, 1))) == 0
    assert hautus_stabilisability(np.array([[0.0, 1.0], [-1.0, 0.0]]), np.zeros((2, 1))) == 1
