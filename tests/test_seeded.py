import numpy as np
import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.seeded import MAX_SEED, check_leg, check_positive, check_real, check_seed, tick_normal, tick_uniform


def test_a_tick_has_its_numbers_whatever_was_asked_before():
    forwards = [tick_normal(7, 1, k, 6).copy() for k in range(3000)]
    for k in (2999, 0, 1024, 1023, 5):
        np.testing.assert_array_equal(tick_normal(7, 1, k, 6), forwards[k])


@pytest.mark.parametrize("draw", [tick_normal, tick_uniform])
def test_seeds_streams_and_blocks_differ(draw):
    numbers = {
        tuple(draw(seed, stream, tick, 3)) for seed in (0, 1) for stream in (0, 1) for tick in (0, 1, 1024, 2048)
    }
    assert len(numbers) == 16


def test_the_numbers_have_the_distribution_that_they_should():
    normal = np.array([tick_normal(3, 0, k, 6) for k in range(20_000)])
    assert abs(normal.mean()) < 0.01
    assert abs(normal.std() - 1.0) < 0.01
    # Neither from tick to tick nor from channel to channel does one tell of another.
    assert abs(np.mean(normal[1:] * normal[:-1])) < 0.01
    assert np.abs(np.corrcoef(normal.T) - np.eye(6)).max() < 0.03
    uniform = np.array([tick_uniform(3, 0, k, 2) for k in range(20_000)])
    assert (uniform >= 0.0).all()
    assert (uniform < 1.0).all()
    assert abs(np.mean(uniform < 0.1) - 0.1) < 0.01


def test_nobody_can_change_what_the_next_one_gets():
    with pytest.raises(ValueError, match="read-only"):
        tick_normal(0, 0, 0, 6)[0] = 1.0


@pytest.mark.parametrize("seed", [-1, MAX_SEED + 1, 1.0, True, None])
def test_a_bad_seed_is_named(seed):
    with pytest.raises(ConfigurationError, match=r"x\.seed"):
        check_seed("x.seed", seed)


@pytest.mark.parametrize("leg", [-1, 6, 1.0, True, None])
def test_a_bad_leg_is_named(leg):
    with pytest.raises(ConfigurationError, match="leg"):
        check_leg("leg", leg)


@pytest.mark.parametrize("value", [-1e-300, np.nan, np.inf, True, "1", None])
def test_a_bad_number_is_named(value):
    with pytest.raises(ConfigurationError, match="key"):
        check_real("key", value)
    with pytest.raises(ConfigurationError, match="key"):
        check_positive("key", value)
    check_real("key", 0)
    with pytest.raises(ConfigurationError):
        check_positive("key", 0)
