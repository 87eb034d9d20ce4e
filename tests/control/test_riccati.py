import sys

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import ROBOT, poses

from stewart_drake.control.riccati import (
    INTEGRAL,
    POSITION,
    RATE,
    SMALLEST_SINGULAR_VALUE,
    chain_gain,
    discretize,
    input_matrix,
    mass_diagonal,
    riccati_gain,
    solve_drake,
    split_gain,
    state_matrix,
)
from stewart_drake.errors import ConfigurationError, RiccatiError
from stewart_drake.mechanics.dynamics import force_map, pose_acceleration_map

PERIOD = 0.005
METHODS = ("exact", "euler")
HOME_MAP = force_map(ROBOT, ROBOT.home_pose) / mass_diagonal(ROBOT)[:, None]


def system(acceleration_map, method="exact"):
    return discretize(state_matrix(), input_matrix(acceleration_map), PERIOD, method)


def state_cost(q_e, q_v, q_z):
    diagonal = np.empty(18)
    diagonal[POSITION], diagonal[RATE], diagonal[INTEGRAL] = q_e, q_v, q_z
    return np.diag(diagonal)


def assert_same(gain, expected, rtol):
    np.testing.assert_allclose(gain, expected, rtol=0.0, atol=rtol * np.abs(expected).max())


# --- beyond the paper's weights ------------------------------------------------------------------------------------


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


def assert_split_is_drakes(acceleration_map, blocks, method, length, period, rtol):
    """With rotations weighed by the square of a length, in Drake's Q, and by scaling in the split solution."""
    q_e, q_v, q_z, r = blocks
    scale = np.array([length**2] * 3 + [1.0] * 3)
    a, b = discretize(state_matrix(), input_matrix(acceleration_map), period, method)
    cost = r * np.eye(6)
    expected = riccati_gain(a, b, cost, solve_drake(a, b, state_cost(q_e * scale, q_v * scale, q_z * scale), cost))
    assert_same(split_gain(acceleration_map, period, blocks, method, length), expected, rtol)


@settings(max_examples=150)
@given(
    acceleration_map=wide_maps,
    q_e=logs(-2.0, 6.0),
    q_v=logs(-2.0, 4.0),
    q_z=logs(-2.0, 6.0),
    r=logs(-3.0, 3.0),
    method=st.sampled_from(METHODS),
    length=st.sampled_from([1.0, 0.11]),
    period=st.sampled_from([0.001, 0.005]),
)
def test_split_is_drakes_gain_over_eight_decades_of_weights(acceleration_map, q_e, q_v, q_z, r, method, length, period):
    # Only the ratios of the weights matter.
    blocks = (r * q_e, r * q_v, r * q_z, r)
    assert_split_is_drakes(acceleration_map, blocks, method, length, period, 1e-9)


DIGITS = 60


def gain_at_many_digits(s, period, blocks, method):
    """k_e, k_v, k_z of the 3-state equation by structured doubling, which shares nothing with the polynomial.

    E. K.-W. Chu et al., Int. J. Control 77 (2004) 767.
    """
    with mpmath.workdps(DIGITS):
        s, t, r = (mpmath.mpf(float(value)) for value in (s, period, blocks[3]))
        if method == "exact":
            a = mpmath.matrix([[1, t, 0], [0, 1, 0], [t, t**2 / 2, 1]])
            b = mpmath.matrix([s * t**2 / 2, s * t, s * t**3 / 6])
        else:
            a, b = mpmath.matrix([[1, t, 0], [0, 1, 0], [t, 0, 1]]), mpmath.matrix([0, s * t, 0])
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


def worst_digit(gains, expected):
    return max(float(abs(mpmath.mpf(float(k)) / exact - 1)) for k, exact in zip(gains, expected, strict=True))


def gain_of_chain(s, period, blocks, method):
    gain = np.empty(3)
    with np.errstate(all="ignore"):
        done = chain_gain(np.float64(s), period, np.array(blocks), method == "exact", gain)
    return gain if done else None


@pytest.mark.slow
@settings(max_examples=120)
@example(1.0, 0.1, (0.0, -2.0, 6.0, 0.0), "exact")  # Long periods: what a hold adds to Euler's terms is felt.
@example(1.0, 0.1, (6.0, -2.0, 0.0, 0.0), "exact")
@example(1e3, 0.02, (4.0, 0.0, 6.0, 0.0), "euler")
@given(
    s=logs(-6.0, 6.0),
    period=logs(-4.0, -1.0),
    exponents=st.tuples(*[st.floats(-2.0, 6.0)] * 4) | st.tuples(*[st.floats(-12.0, 12.0)] * 4),
    method=st.sampled_from(METHODS),
)
def test_each_chain_has_the_gain_of_sixty_digits_or_says_that_it_has_none(s, period, exponents, method):
    blocks = tuple((10.0 ** np.array(exponents)).tolist())
    gain = gain_of_chain(s, period, blocks, method)
    assert gain is not None or max(map(abs, exponents)) > 6.0 or not 1e-2 <= s <= 1e4
    assert gain is None or worst_digit(gain, gain_at_many_digits(s, period, blocks, method)) < 1e-13


def test_a_map_is_singular_from_a_share_on():
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))
    for factor, usable in ((0.0, False), (1e-3, False), (1e3, True)):
        singular = np.array([1.0, 1.0, 1.0, 1.0, 1.0, factor * SMALLEST_SINGULAR_VALUE])
        acceleration_map = singular[:, None] * turn
        if usable:
            assert np.isfinite(split_gain(acceleration_map, PERIOD, (1.0, 1.0, 1.0, 1.0))).all()
        else:
            with pytest.raises(RiccatiError, match="singular"):
                split_gain(acceleration_map, PERIOD, (1.0, 1.0, 1.0, 1.0))


def test_without_drake_the_option_that_needs_none_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pydrake.math", None)
    with pytest.raises(ConfigurationError, match=r"controller\.solver.*split"):
        solve_drake(np.eye(1), np.eye(1), np.eye(1), np.eye(1))


# --- what is refused -----------------------------------------------------------------------------------------------

UNUSABLE = {
    "not stabilisable": {"b": np.zeros((18, 6))},
    "not detectable": {"q": np.zeros((18, 18))},
    "Q not a number": {"q": np.full((18, 18), np.nan)},
    "Q not symmetric": {"q": np.triu(np.ones((18, 18)))},
    "B of the wrong shape": {"b": np.zeros((17, 6))},
    "beyond the digits of Drake": {"q": 1e20 * np.eye(18)},
}


@pytest.mark.parametrize("case", UNUSABLE)
def test_unusable_matrices_raise_our_error_and_never_leave_the_process(case):
    a, b = system(HOME_MAP)
    words = r"does not stabilise.*solver: split" if case.startswith("beyond") else None
    with pytest.raises(RiccatiError, match=words) as caught:
        solve_drake(**{"a": a, "b": b, "q": np.eye(18), "r": np.eye(6)} | UNUSABLE[case])
    assert caught.value.reason == "riccati"


@pytest.mark.parametrize(
    "change",
    [
        *({"acceleration_map": HOME_MAP * [1, 1, x, 1, 1, 1]} for x in (np.nan, np.inf, 0.0)),
        {"acceleration_map": HOME_MAP[:5]},
        *({"weights": tuple(np.where(np.arange(4) == k, x, 1.0))} for k, x in ((3, 0.0), (0, np.nan), (1, -1.0))),
        *({name: x} for name in ("period", "length") for x in (0.0, -0.11, np.nan, np.inf)),
    ],
)
def test_split_refuses_what_has_no_gain(change):
    with pytest.raises(RiccatiError):
        split_gain(**{"acceleration_map": HOME_MAP, "period": PERIOD, "weights": (1.0, 1.0, 1.0, 1.0)} | change)
