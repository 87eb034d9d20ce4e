import numpy as np
import pytest

from stewart_drake.hardware.seeded import tick_normal, tick_uniform


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
