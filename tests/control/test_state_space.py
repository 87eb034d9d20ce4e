import dataclasses

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from strategies import ROBOT, poses

from stewart_drake.control.state_space import (
    INTEGRAL,
    POSITION,
    RATE,
    discretize,
    hautus_detectability,
    hautus_stabilisability,
    input_matrix,
    mass_diagonal,
    output_matrix,
    state_matrix,
)
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.force_map import force_map, force_map_of_legs
from stewart_drake.mechanics.kinematics import leg_geometry, rod_lines

A, C = state_matrix(), output_matrix()
NUMBERED = 10.0 * np.arange(1, 7)[:, None] + np.arange(1, 7)
"""M^-1 tau whose entries tell their row and column."""


def acceleration_map(pose, kind="statics"):
    return force_map(ROBOT, pose, kind) / mass_diagonal(ROBOT)[:, None]


def test_mass_is_the_platforms_alone():
    np.testing.assert_array_equal(mass_diagonal(ROBOT), [0.003, 0.003, 0.006, 1.0, 1.0, 1.0])


def test_the_18_states_are_split_in_the_order_of_the_paper():
    np.testing.assert_array_equal(POSITION, [0, 2, 4, 6, 8, 10])
    np.testing.assert_array_equal(RATE, [1, 3, 5, 7, 9, 11])
    np.testing.assert_array_equal(INTEGRAL, [12, 13, 14, 15, 16, 17])


def test_a_is_21_and_24_entry_by_entry():
    ones = {(0, 1), (2, 3), (4, 5), (6, 7), (8, 9), (10, 11)}
    ones |= {(12, 0), (13, 2), (14, 4), (15, 6), (16, 8), (17, 10)}
    expected = np.zeros((18, 18))
    for entry in ones:
        expected[entry] = 1.0
    np.testing.assert_array_equal(A, expected)


def test_b_is_22_entry_by_entry_with_the_rows_of_m_inverse_tau_below_their_positions():
    expected = np.zeros((18, 6))
    for axis in range(6):
        expected[2 * axis + 1] = NUMBERED[axis]
    np.testing.assert_array_equal(input_matrix(NUMBERED), expected)


def test_c_reads_the_position_error_and_its_integral():
    state = np.arange(18.0)
    np.testing.assert_array_equal(C @ state, state[[0, 2, 4, 6, 8, 10]] + state[12:])
    assert C.shape == (6, 18)


def test_the_dynamics_are_a_double_integrator_with_an_integral_beside_it():
    state, torque = np.random.default_rng(0).normal(size=18), np.arange(1.0, 7.0)
    derivative = A @ state + input_matrix(NUMBERED) @ torque
    np.testing.assert_array_equal(derivative[POSITION], state[RATE])
    np.testing.assert_allclose(derivative[RATE], NUMBERED @ torque)
    np.testing.assert_array_equal(derivative[INTEGRAL], state[POSITION])


@pytest.mark.slow
@given(pose=poses(), period=st.floats(1e-4, 0.1))
def test_exact_discretisation_is_the_matrix_exponential(pose, period):
    b = input_matrix(acceleration_map(pose))
    block = scipy.linalg.expm(period * np.block([[A, b], [np.zeros((6, 24))]]))
    a_d, b_d = discretize(A, b, period)
    np.testing.assert_allclose(a_d, block[:18, :18], rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(b_d, block[:18, 18:], rtol=1e-12, atol=1e-14)


def test_exact_discretisation_composes_where_euler_does_not():
    b = input_matrix(NUMBERED)
    for method, exact in (("exact", True), ("euler", False)):
        a_1, b_1 = discretize(A, b, 0.01, method)
        a_2, b_2 = discretize(A, b, 0.02, method)
        assert np.allclose(a_1 @ a_1, a_2, rtol=1e-14, atol=1e-16) is exact
        assert np.allclose(a_1 @ b_1 + b_1, b_2, rtol=1e-13, atol=1e-15) is exact


def test_euler_discretisation_is_the_first_order_step():
    b = input_matrix(NUMBERED)
    a_d, b_d = discretize(A, b, 0.01, "euler")
    np.testing.assert_array_equal(a_d, np.eye(18) + 0.01 * A)
    np.testing.assert_array_equal(b_d, 0.01 * b)


def test_input_matrix_and_discretisation_are_vectorised_over_leading_axes():
    maps = np.stack([NUMBERED, -NUMBERED])
    b = input_matrix(maps)
    assert b.shape == (2, 18, 6)
    for method in ("exact", "euler"):
        _, b_d = discretize(A, b, 0.01, method)
        np.testing.assert_array_equal(b_d[1], discretize(A, input_matrix(-NUMBERED), 0.01, method)[1])


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


def test_without_the_integrals_in_c_they_are_not_detectable():
    without = C.copy()
    without[:, INTEGRAL] = 0.0
    assert hautus_detectability(A, without) == 12


def test_the_hautus_tests_ask_only_about_modes_that_are_not_stable():
    a = np.diag([-1.0, 2.0, -3.0])
    assert hautus_stabilisability(a, np.array([[0.0], [1.0], [0.0]])) == 3
    assert hautus_stabilisability(a, np.array([[1.0], [0.0], [1.0]])) == 2
    assert hautus_detectability(a, np.array([[0.0, 1.0, 0.0]])) == 3
    assert hautus_detectability(a, np.array([[1.0, 0.0, 1.0]])) == 2
    assert hautus_stabilisability(-np.eye(2), np.zeros((2, 1))) == 2


@pytest.mark.parametrize("growth", [1e-9, 1e-5, 1e-3, 1.0])
def test_a_slow_unstable_mode_is_not_mistaken_for_an_integrator(growth):
    assert hautus_stabilisability(np.array([[growth]]), np.zeros((1, 1))) == 0


def test_complex_modes_on_the_imaginary_axis_count():
    a = np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert hautus_stabilisability(a, np.array([[0.0], [1.0]])) == 2
    assert hautus_stabilisability(a, np.zeros((2, 1))) == 1


@given(rotation=st.integers(0, 2**32 - 1))
def test_the_answer_does_not_depend_on_the_coordinates_of_the_state(rotation):
    q, _ = np.linalg.qr(np.random.default_rng(rotation).normal(size=(18, 18)))
    b = input_matrix(acceleration_map(ROBOT.home_pose))
    assert hautus_stabilisability(q @ A @ q.T, q @ b) == 18
    assert hautus_detectability(q @ A @ q.T, C @ q.T) == 18
    legs = leg_geometry(ROBOT, ROBOT.home_pose)
    legs = dataclasses.replace(legs, transmission=legs.transmission * [0, 1, 1, 1, 1, 1])
    b = input_matrix(force_map_of_legs(ROBOT, legs, "printed") / mass_diagonal(ROBOT)[:, None])
    assert hautus_stabilisability(q @ A @ q.T, q @ b) == 17


def test_another_discretisation_is_refused():
    with pytest.raises(ConfigurationError, match="exact or euler"):
        discretize(np.eye(18), np.ones((18, 6)), 0.005, "tustin")
