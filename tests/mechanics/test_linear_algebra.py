import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from stewart_drake.mechanics.linear_algebra import any_nonzero, largest_size, singular_vectors, solve

seeds = st.integers(0, 2**32 - 1)


def made(seed, n, log_condition):
    rng = np.random.default_rng(seed)
    left, right = (np.linalg.qr(rng.normal(size=(n, n)))[0] for _ in range(2))
    return left * np.logspace(0.0, -log_condition, n) @ right


@settings(max_examples=60)
@given(seeds, st.integers(1, 6), st.integers(1, 3), st.floats(0.0, 6.0))
def test_solve_is_numpys_and_tells_the_determinants_sign(seed, n, columns, log_condition):
    matrix = made(seed, n, log_condition)
    wanted = np.random.default_rng(seed).normal(size=(n, columns))
    right = matrix @ wanted
    sign = solve(matrix.copy(), right)
    np.testing.assert_allclose(right, wanted, atol=1e-13 * 10.0**log_condition)
    assert sign == np.linalg.slogdet(matrix)[0]


@settings(max_examples=60)
@given(seeds, st.integers(2, 6), st.floats(0.0, 8.0), st.sampled_from([1e-14, 1e-7]))
def test_singular_vectors_are_numpys(seed, n, log_condition, tolerance):
    matrix = made(seed, n, log_condition)
    work, s, v = matrix.T.copy(), np.empty(n), np.empty((n, n))
    singular_vectors(work, s, v, tolerance)
    np.testing.assert_allclose(np.sort(s)[::-1], np.linalg.svd(matrix, compute_uv=False), rtol=tolerance, atol=1e-14)
    # matrix = U S V', U's columns in the rows of what was worked on, V's in those of v.
    np.testing.assert_allclose(work.T @ v, matrix, atol=1e-13)
    np.testing.assert_allclose(v @ v.T, np.eye(n), atol=1e-13)
    u = work / s[:, None]
    np.testing.assert_allclose(u @ u.T, np.eye(n), atol=10.0 * tolerance + 1e-13)


def test_nan_counts_as_the_largest_size_wherever_it_is():
    assert largest_size(np.array([1.0, -3.0, 2.0])) == 3.0
    for place in range(3):
        values = np.ones(3)
        values[place] = np.nan
        assert np.isnan(largest_size(values))
        assert any_nonzero(values)
    assert not any_nonzero(np.zeros(3))
