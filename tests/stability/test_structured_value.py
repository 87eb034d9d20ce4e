"""Bounds of the structured singular value under diagonal perturbations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stewart_drake.stability.margins import balanced, lower_bound, refined, upper_bound


def random_matrices(seed, count, spread=1.0):
    rng = np.random.default_rng(seed)
    matrices = rng.normal(size=(count, 6, 6)) + 1j * rng.normal(size=(count, 6, 6))
    return np.exp(spread * rng.normal(size=(count, 6, 1))) * matrices


def bounds(matrices):
    logs = np.array([refined(*pair) for pair in zip(matrices, balanced(matrices), strict=True)])
    return np.array([lower_bound(*pair) for pair in zip(matrices, logs, strict=True)]), upper_bound(matrices, logs)


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), spread=st.floats(0.0, 5.0))
def test_bounds_are_in_order_and_refinement_never_loosens(seed, spread):
    matrices = random_matrices(seed, 2, spread)
    start = balanced(matrices)
    low, high = bounds(matrices)
    assert (low <= high * (1.0 + 1e-9)).all()
    assert (high <= upper_bound(matrices, start) * (1.0 + 1e-12)).all()
    assert (upper_bound(matrices, start) <= np.linalg.norm(matrices, axis=(-2, -1))).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_of_a_product_of_two_vectors_it_is_known(seed):
    # det(I - a b' Delta) = 1 - sum a_i b_i delta_i, so that mu = sum |a_i b_i|.
    rng = np.random.default_rng(seed)
    a, b = (rng.normal(size=6) + 1j * rng.normal(size=6) for _ in range(2))
    low, high = bounds((a[:, None] * b)[None])
    assert low == pytest.approx(np.abs(a * b).sum(), rel=1e-3)
    assert high == pytest.approx(np.abs(a * b).sum(), rel=1e-3)
