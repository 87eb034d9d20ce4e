"""Switched loops whose stability is known."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.stability.switching import (
    common_lyapunov,
    driven,
    even,
    greedy,
    growth,
    lyapunov_field,
    monodromy,
    moves,
    shares,
)

# Each turns by a right angle and shrinks; one after the other they stretch an axis by four.
TURNS = 0.95 * np.array([[[0.0, 2.0], [-0.5, 0.0]], [[0.0, 0.5], [-2.0, 0.0]]])
ONE = np.ones((2, 1))


def radius(matrices):
    return np.abs(np.linalg.eigvals(matrices)).max(axis=-1)


def test_two_stable_loops_whose_switching_is_not_are_found_out():
    assert (radius(TURNS) < 0.96).all()
    assert monodromy(TURNS) > 1.8
    assert common_lyapunov(TURNS) is None
    *_, (state, _) = greedy(np.zeros(1), TURNS, (2,), 1.0, np.array([1.0, 0.1]), 40)
    assert np.linalg.norm(state) > 1e6


def test_slow_enough_changes_between_them_are_proved_stable_and_an_adversary_cannot_do_harm():
    knots, step = (15,), 0.002
    at = np.linspace(0.0, 1.0, 29)[:, None]
    # A turn whose axes change in length from one to the other.
    ratio = 2.0 ** (1.0 - 2.0 * at[:, 0])
    matrices = 0.95 * np.stack([[[0.0, each], [-1.0 / each, 0.0]] for each in ratio])
    np.testing.assert_allclose(matrices[[0, -1]], TURNS)
    assert common_lyapunov(matrices) is None
    here, later = shares(at, knots), shares(moves(at, step), knots)
    field = lyapunov_field(matrices, here, later)
    assert field is not None
    assert growth(matrices, field, here, later).max() < 1.0
    assert lyapunov_field(matrices, here, shares(moves(at, 1.0), knots)) is None
    *_, (state, _) = greedy(np.zeros(1), matrices, (29,), step, np.ones(2), 2000)
    assert np.linalg.norm(state) < 1e-3


@given(st.integers(0, 10**6))
def test_loops_that_commute_have_a_common_norm(seed):
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(3, 3)) + 3.0 * np.eye(3)
    values = rng.uniform(-0.9, 0.9, size=(2, 3))
    matrices = axes @ (values[:, :, None] * np.eye(3)) @ np.linalg.inv(axes)
    p = common_lyapunov(matrices)
    assert p is not None
    for a in matrices:
        assert np.linalg.eigvalsh(p - a.T @ p @ a).min() > 0.0
    assert np.linalg.eigvalsh(p).min() > 0.0


def test_growth_is_the_largest_ratio_of_norms():
    rng = np.random.default_rng(1)
    a, root = rng.normal(size=(2, 3, 3)), rng.normal(size=(3, 3))
    p = root @ root.T
    found = growth(a, p[None], ONE, ONE[:, None])
    x = rng.normal(size=(3, 100_000))
    norm = np.sqrt(np.einsum("is,ij,js->s", x, p, x))
    tried = [np.sqrt(np.einsum("is,ij,js->s", y, p, y)) / norm for y in a @ x]
    np.testing.assert_allclose(found, np.max(tried, axis=1), rtol=1e-2)
    assert (found >= np.max(tried, axis=1)).all()
    assert growth(a, -p[None], ONE, ONE[:, None]).tolist() == [np.inf, np.inf]


def test_in_even_coordinates_a_stable_matrix_shrinks_every_state():
    a = np.array([[0.99, 1e4], [0.0, 0.5]])
    w = even(a)
    b = w @ a @ np.linalg.inv(w)
    assert radius(b) == pytest.approx(0.99)
    assert np.linalg.norm(a, 2) > 1e4
    assert np.linalg.norm(b, 2) < 1.0


@given(st.lists(st.floats(0.0, 1.0), min_size=2, max_size=2))
def test_shares_add_up_and_give_back_the_place(place):
    knots, at = (3, 4), np.array(place)
    found = shares(at, knots)
    grid = np.array(list(itertools.product(np.linspace(0, 1, 3), np.linspace(0, 1, 4))))
    assert found.sum() == pytest.approx(1.0)
    assert (found >= 0.0).all()
    np.testing.assert_allclose(found @ grid, at, atol=1e-12)
    ends = moves(at, 0.1)
    assert ends.shape == (4, 2)
    assert (np.abs(ends - at) <= 0.1 + 1e-12).all()
    assert ((ends >= 0.0) & (ends <= 1.0)).all()


def test_what_can_be_reached_splits_a_cascade():
    rng = np.random.default_rng(2)
    triangular = rng.normal(size=(3, 5, 5))
    triangular[:, 3:, :3] = 0.0
    turn = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    matrices = turn @ triangular @ turn.T
    basis = driven(matrices, turn[:, 0])
    assert basis.shape == (5, 3)
    np.testing.assert_allclose(basis @ basis.T, turn[:, :3] @ turn[:, :3].T, atol=1e-9)
    assert driven(matrices, turn[:, 4]).shape == (5, 5)
