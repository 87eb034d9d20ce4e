import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses

from stewart_drake.errors import RiccatiError
from stewart_drake.force_map import force_map
from stewart_drake.riccati import riccati_gain, solve_drake, split_gain
from stewart_drake.state_space import INTEGRAL, POSITION, RATE, discretize, input_matrix, mass_diagonal, state_matrix

PERIOD = 0.005
METHODS = ("exact", "euler")
HOME_MAP = force_map(ROBOT, ROBOT.home_pose) / mass_diagonal(ROBOT)[:, None]
weights = st.floats(-1.0, 1.0).map(lambda exponent: 10.0**exponent)
"""omega_Q and omega_R of the paper, from 0.1 to 10."""
maps = st.builds(
    lambda pose, kind: force_map(ROBOT, pose, kind) / mass_diagonal(ROBOT)[:, None],
    poses(0.7),
    st.sampled_from(["statics", "printed"]),
)


def system(acceleration_map, method="exact"):
    return discretize(state_matrix(), input_matrix(acceleration_map), PERIOD, method)


def state_cost(q_e, q_v, q_z):
    diagonal = np.empty(18)
    diagonal[POSITION], diagonal[RATE], diagonal[INTEGRAL] = q_e, q_v, q_z
    return np.diag(diagonal)


def drake_gain(acceleration_map, q_e, q_v, q_z, r, method="exact"):
    a, b = system(acceleration_map, method)
    cost = r * np.eye(6)
    return riccati_gain(a, b, cost, solve_drake(a, b, state_cost(q_e, q_v, q_z), cost))


def assert_same(gain, expected, rtol):
    np.testing.assert_allclose(gain, expected, rtol=0.0, atol=rtol * np.abs(expected).max())


def spectral_radius(matrix):
    return np.abs(np.linalg.eigvals(matrix)).max()


@settings(max_examples=40)
@given(acceleration_map=maps, omega_q=weights, omega_r=weights, method=st.sampled_from(METHODS))
def test_drakes_solution_satisfies_the_equation_and_stabilises(acceleration_map, omega_q, omega_r, method):
    a, b = system(acceleration_map, method)
    q, r = omega_q * np.eye(18), omega_r * np.eye(6)
    p = solve_drake(a, b, q, r)
    gain = riccati_gain(a, b, r, p)
    residual = a.T @ p @ a - a.T @ p @ b @ gain + q - p
    assert np.abs(residual).max() < 1e-9 * np.abs(p).max()
    np.testing.assert_allclose(p, p.T, atol=1e-10 * np.abs(p).max())
    assert np.linalg.eigvalsh(p).min() > 0.0
    assert spectral_radius(a - b @ gain) < 1.0


@settings(max_examples=40)
@given(acceleration_map=maps, omega_q=weights, omega_r=weights, method=st.sampled_from(METHODS))
def test_split_is_drakes_gain_at_the_papers_weights(acceleration_map, omega_q, omega_r, method):
    split = split_gain(acceleration_map, PERIOD, (omega_q, omega_q, omega_q, omega_r), method)
    assert_same(split, drake_gain(acceleration_map, omega_q, omega_q, omega_q, omega_r, method), 1e-10)


@settings(max_examples=40)
@given(acceleration_map=maps, q_e=weights, q_v=weights, q_z=weights, r=weights, method=st.sampled_from(METHODS))
def test_split_is_drakes_gain_at_a_weight_for_each_block(acceleration_map, q_e, q_v, q_z, r, method):
    split = split_gain(acceleration_map, PERIOD, (q_e, q_v, q_z, r), method)
    assert_same(split, drake_gain(acceleration_map, q_e, q_v, q_z, r, method), 1e-10)


@settings(max_examples=40)
@given(acceleration_map=maps, exponents=st.tuples(*[st.floats(-4.0, 4.0)] * 4), method=st.sampled_from(METHODS))
def test_split_gain_is_optimal_by_one_policy_iteration_without_drake(acceleration_map, exponents, method):
    q_e, q_v, q_z, r = 10.0 ** np.array(exponents)
    a, b = system(acceleration_map, method)
    gain = split_gain(acceleration_map, PERIOD, (q_e, q_v, q_z, r), method)
    closed = a - b @ gain
    assert spectral_radius(closed) < 1.0
    # The cost of this very controller; the gain that is greedy for it is the gain itself.
    cost = state_cost(q_e, q_v, q_z) + r * gain.T @ gain
    p = scipy.linalg.solve_discrete_lyapunov(closed.T, cost)
    assert_same(riccati_gain(a, b, r * np.eye(6), p), gain, 1e-6)


@settings(max_examples=40)
@given(acceleration_map=maps, omega_q=weights, omega_r=weights, factor=st.floats(1e-3, 1e3))
def test_only_the_ratio_of_the_weights_matters(acceleration_map, omega_q, omega_r, factor):
    one = split_gain(acceleration_map, PERIOD, (omega_q, omega_q, omega_q, omega_r))
    other = split_gain(acceleration_map, PERIOD, (*(factor * omega_q,) * 3, factor * omega_r))
    assert_same(other, one, 1e-10)
    assert_same(drake_gain(acceleration_map, *(factor * omega_q,) * 3, factor * omega_r), one, 1e-10)


def test_the_papers_nine_pairs_are_five_controllers():
    levels = (0.1, 1.0, 10.0)
    gains = [split_gain(HOME_MAP, PERIOD, (q, q, q, r)) for q in levels for r in levels]
    different = []
    for gain in gains:
        if not any(np.allclose(gain, known, rtol=1e-9, atol=1e-9) for known in different):
            different.append(gain)
    assert len(different) == 5


@given(acceleration_map=maps, seed=st.integers(0, 2**32 - 1))
def test_turning_the_motors_coordinates_turns_the_gain_with_them(acceleration_map, seed):
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(6, 6)))
    gain = split_gain(acceleration_map, PERIOD, (1.0, 2.0, 3.0, 0.5))
    assert_same(split_gain(acceleration_map @ turn, PERIOD, (1.0, 2.0, 3.0, 0.5)), turn.T @ gain, 1e-10)


def test_split_survives_equal_and_widely_spread_singular_values():
    for singular in (np.ones(6), np.logspace(0, -6, 6)):
        turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))
        acceleration_map = turn * singular @ turn.T
        gain = split_gain(acceleration_map, PERIOD, (1.0, 1.0, 1.0, 1.0))
        a, b = system(acceleration_map)
        assert spectral_radius(a - b @ gain) < 1.0


def test_the_position_error_decays_no_faster_than_the_printed_weighting_allows():
    for ratio in (0.01, 1.0, 100.0):
        a, b = system(HOME_MAP)
        gain = split_gain(HOME_MAP, PERIOD, (ratio, ratio, ratio, 1.0))
        slowest = -np.log(spectral_radius(a - b @ gain)) / PERIOD
        assert slowest < 0.87


UNUSABLE = {
    "not stabilisable": {"b": np.zeros((18, 6))},
    "not detectable": {"q": np.zeros((18, 18))},
    "A infinite": {"a": np.full((18, 18), np.inf)},
    "Q not a number": {"q": np.full((18, 18), np.nan)},
    "Q not symmetric": {"q": np.triu(np.ones((18, 18)))},
    "Q of the wrong shape": {"q": np.eye(17)},
    "Q not a matrix": {"q": np.ones(18)},
    "B of the wrong shape": {"b": np.zeros((17, 6))},
    "R zero": {"r": np.zeros((6, 6))},
    "R negative": {"r": -np.eye(6)},
}


@pytest.mark.parametrize("change", UNUSABLE.values(), ids=UNUSABLE.keys())
def test_unusable_matrices_raise_our_error_and_never_leave_the_process(change):
    a, b = system(HOME_MAP)
    matrices = {"a": a, "b": b, "q": np.eye(18), "r": np.eye(6)} | change
    with pytest.raises(RiccatiError) as caught:
        solve_drake(**matrices)
    assert caught.value.reason == "riccati"
    assert str(caught.value)


@pytest.mark.parametrize(
    ("acceleration_map", "weights"),
    [
        (np.full((6, 6), np.nan), (1.0, 1.0, 1.0, 1.0)),
        (HOME_MAP * [1, 1, np.inf, 1, 1, 1], (1.0, 1.0, 1.0, 1.0)),
        (HOME_MAP * [1, 1, 0, 1, 1, 1], (1.0, 1.0, 1.0, 1.0)),
        (np.zeros((6, 6)), (1.0, 1.0, 1.0, 1.0)),
        (HOME_MAP[:5], (1.0, 1.0, 1.0, 1.0)),
        (HOME_MAP, (1.0, 1.0, 1.0, 0.0)),
        (HOME_MAP, (0.0, 1.0, 1.0, 1.0)),
        (HOME_MAP, (1.0, -1.0, 1.0, 1.0)),
        (HOME_MAP, (1.0, 1.0, np.nan, 1.0)),
        (HOME_MAP, (np.nan, 1.0, 1.0, 1.0)),
        (HOME_MAP, (1.0, 1.0, np.inf, 1.0)),
    ],
)
@pytest.mark.parametrize("method", METHODS)
def test_split_refuses_what_has_no_gain(acceleration_map, weights, method):
    with pytest.raises(RiccatiError):
        split_gain(acceleration_map, PERIOD, weights, method)
