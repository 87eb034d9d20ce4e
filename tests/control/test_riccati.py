import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses

from stewart_drake.base.errors import RiccatiError
from stewart_drake.control.riccati import (
    INTEGRAL,
    POSITION,
    RATE,
    SMALLEST_SINGULAR_VALUE,
    chain_gain,
    chain_gain_of,
    discretize,
    drake_gain,
    input_matrix,
    mass_diagonal,
    output_matrix,
    split_gain,
    state_matrix,
)
from stewart_drake.mechanics.dynamics import force_map, pose_acceleration_map
from stewart_drake.paper.state_space import whole_gain

PERIOD = 0.005
HOME_MAP = force_map(ROBOT, ROBOT.home_pose) / mass_diagonal(ROBOT)[:, None]


def logs(low, high):
    """10^low .. 10^high, evenly in the exponent, both ends likely."""
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


def made_map(seed, condition, largest):
    """M^-1 tau with known singular values, turned at random."""
    rng = np.random.default_rng(seed)
    left, right = (np.linalg.qr(rng.normal(size=(6, 6)))[0] for _ in range(2))
    spread = np.sort(np.concatenate([[0.0, 1.0], rng.uniform(0.0, 1.0, 4)]))
    return largest * (left * condition**-spread) @ right.T


wide_maps = st.one_of(
    st.builds(made_map, st.integers(0, 2**32 - 1), logs(0.0, 3.0), logs(-1.0, 2.7)),
    st.builds(pose_acceleration_map, st.just(ROBOT), poses(0.8)),
)


@settings(max_examples=150)
@given(
    acceleration_map=wide_maps,
    q=st.tuples(logs(-2.0, 6.0), logs(-2.0, 4.0), logs(-2.0, 6.0)),
    r=logs(-3.0, 3.0),
    length=st.sampled_from([1.0, 0.11]),
    period=st.sampled_from([0.001, 0.005]),
)
def test_split_is_drakes_gain_over_eight_decades_of_weights(acceleration_map, q, r, length, period):
    # Rotations are weighed by the square of a length, in Q of 18 states, and by scaling where it decouples.
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), period)
    scale, diagonal = np.array([length**2] * 3 + [1.0] * 3), np.empty(18)
    for part, each in zip((POSITION, RATE, INTEGRAL), q, strict=True):
        diagonal[part] = r * each * scale
    expected = whole_gain(a, b, np.diag(diagonal), r * np.eye(6))
    # Only the ratios of the weights matter.
    for solved in (split_gain, drake_gain):
        found = solved(acceleration_map, period, (*(r * each for each in q), r), length)
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


DIGITS = 60


def gain_at_many_digits(s, period, blocks):
    """k_e, k_v, k_z of the 3-state equation by structured doubling, which shares nothing with the polynomial.

    E. K.-W. Chu et al., Int. J. Control 77 (2004) 767.
    """
    with mpmath.workdps(DIGITS):
        s, t, r = (mpmath.mpf(float(value)) for value in (s, period, blocks[3]))
        a = mpmath.matrix([[1, t, 0], [0, 1, 0], [t, t**2 / 2, 1]])
        b = mpmath.matrix([s * t**2 / 2, s * t, s * t**3 / 6])
        step, g, p = a, b * b.T / r, mpmath.diag([mpmath.mpf(float(q)) for q in blocks[:3]])
        for _ in range(100):
            inner = (mpmath.eye(3) + g * p) ** -1
            step, g, new = step * inner * step, g + step * inner * g * step.T, p + step.T * p * inner * step
            moved, p = mpmath.norm(new - p, 1), new
            if moved <= mpmath.mpf(10) ** (10 - DIGITS) * mpmath.norm(p, 1):
                break
        else:
            raise AssertionError("doubling has not converged")
        # It is a solution, by residual.
        gain = (b.T * p * a) / (r + (b.T * p * b)[0])
        residual = a.T * p * (a - b * gain) + mpmath.diag([mpmath.mpf(float(q)) for q in blocks[:3]]) - p
        assert mpmath.norm(residual, 1) < mpmath.mpf(10) ** -25 * mpmath.norm(p, 1)
        return [gain[0], gain[1], gain[2]]


@pytest.mark.slow
@settings(max_examples=120)
@example(1.0, 0.1, (0.0, -2.0, 6.0, 0.0))
@example(1.0, 0.1, (6.0, -2.0, 0.0, 0.0))
@given(
    s=logs(-6.0, 6.0),
    period=logs(-4.0, -1.0),
    exponents=st.tuples(*[st.floats(-2.0, 6.0)] * 4) | st.tuples(*[st.floats(-12.0, 12.0)] * 4),
)
def test_a_chain_has_the_gain_of_sixty_digits_or_reports_that_it_has_none(s, period, exponents):
    blocks, gain = tuple((10.0 ** np.array(exponents)).tolist()), np.empty(3)
    with np.errstate(all="ignore"):
        done = chain_gain(np.float64(s), period, np.array(blocks), gain)
    assert done or max(map(abs, exponents)) > 6.0 or not 1e-2 <= s <= 1e4
    if done:
        expected = gain_at_many_digits(s, period, blocks)
        assert max(abs(mpmath.mpf(float(k)) / exact - 1) for k, exact in zip(gain, expected, strict=True)) < 1e-13


def test_a_map_is_singular_from_a_share_on():
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))
    maps = [np.array([[1.0]] * 5 + [[factor * SMALLEST_SINGULAR_VALUE]]) * turn for factor in (1e-3, 1e3)]
    with pytest.raises(RiccatiError, match="singular"):
        split_gain(maps[0], PERIOD, (1.0, 1.0, 1.0, 1.0))
    assert np.isfinite(split_gain(maps[1], PERIOD, (1.0, 1.0, 1.0, 1.0))).all()


@pytest.mark.parametrize(
    ("at_pose", "weight", "words"),
    [
        (np.zeros((6, 6)), 1.0, "singular"),
        (HOME_MAP, np.nan, None),
        (HOME_MAP, 1e20, "does not stabilise.*solver: split"),
    ],
    ids=["not stabilisable", "not a number", "beyond the digits of Drake"],
)
def test_what_drake_cannot_solve_raises_our_error_and_never_leaves_the_process(at_pose, weight, words):
    with pytest.raises(RiccatiError, match=words) as caught:
        drake_gain(at_pose, PERIOD, (weight, weight, weight, 1.0))
    assert caught.value.reason == "riccati"


@settings(max_examples=200)
@given(s=logs(-2.0, 3.0), period=logs(-3.0, -1.0), p=st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))
def test_a_chain_is_stable_where_its_eigenvalues_are(s, period, p):
    a = np.eye(3) + period * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.5 * period, 0]])
    b = s * np.array([0.5 * period**2, period, period**3 / 6.0])
    cost, gain = np.empty((3, 3)), np.empty(3)
    cost[np.triu_indices(3)] = cost.T[np.triu_indices(3)] = np.array(p) / np.outer(b, b)[1, 1]
    stable = chain_gain_of(cost, a, b, 1.0, gain)
    if not np.isfinite(gain).all():  # 1 + b' P b is zero.
        assert not stable
        return
    radius = np.abs(np.linalg.eigvals(a - np.outer(b, gain))).max()
    assert stable == (radius < 1.0) or abs(radius - 1.0) < 1e-4


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
