"""One motion from the rows of a recording, with their noise and the jitter of their stamps."""

import numpy as np
import pytest

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.references.rows import RowsMotion

STEP = 0.01
TIME = STEP * np.arange(601)
PLACES = np.linspace(0.3, 5.5, 501)


def wave(time):
    """Roll of 0.2 rad at 0.8 Hz and x of 4 mm at 2 Hz, from rest, with rates and accelerations."""
    zero, parts = np.zeros_like(time), []
    for order in range(3):
        roll, x = (
            size * (2.0 * np.pi * f) ** order * np.sin(2.0 * np.pi * f * time + 0.5 * np.pi * order)
            for size, f in ((0.2, 0.8), (0.004, 2.0))
        )
        parts.append(np.stack([roll, zero, zero, x, zero, zero], axis=-1))
    return parts


def test_noise_goes_and_the_motion_stays():
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((601, 6)) * [*[np.radians(0.02)] * 3, *[5e-5] * 3]
    clean, noisy = RowsMotion(TIME, wave(TIME)[0]), RowsMotion(TIME, wave(TIME)[0] + noise)
    for got, true, atol in zip(clean.evaluate(PLACES), wave(PLACES), (1e-6, 5e-5, 5e-3), strict=True):
        np.testing.assert_allclose(got, true, atol=atol)
    assert clean.note == ""
    # What is left of white noise: rows at 100 Hz have 50 Hz, and 20 are kept, at f^4 in the square of accelerations.
    left = (noisy.evaluate(PLACES)[2] - wave(PLACES)[2])[:, :3].std()
    assert left == pytest.approx(np.radians(0.02) * (2.0 * np.pi * 20.0) ** 2 * np.sqrt(0.4 / 5.0), rel=0.25)
    raw = RowsMotion(TIME, wave(TIME)[0] + noise, cutoff=None)
    assert (raw.evaluate(PLACES)[2] - wave(PLACES)[2])[:, :3].std() > 5.0 * left
    assert noisy.note.startswith("low-passed at 20 Hz: moved by 0.06")


@pytest.mark.parametrize(("jitter", "left", "most"), [(0.003, 0.001, 1.1), (0.006, 0.002, 2.0)])
def test_stamps_nearer_than_half_a_step_are_jitter(jitter, left, most):
    rng = np.random.default_rng(7)
    stamps = np.maximum.accumulate(TIME + jitter * rng.uniform(-1.0, 1.0, 601))
    motion = RowsMotion(stamps, wave(TIME)[0])
    # The first stamp is off too; only an even shift of time is left.
    shift = TIME[0] - stamps[0]
    pose, _, acceleration = motion.evaluate(PLACES)
    ways = [np.abs(pose - wave(PLACES + shift + s)[0])[:, 0].max() for s in np.linspace(-jitter, jitter, 121)]
    assert min(ways) < 0.2 * 0.8 * 2.0 * np.pi * left
    assert np.abs(acceleration[:, 0]).max() < most * 0.2 * (1.6 * np.pi) ** 2
    assert f"stamps evened by up to {3 if jitter < 0.005 else 5}" in motion.note


def test_missing_rows_are_a_gap_and_not_jitter():
    kept = np.ones(601, dtype=bool)
    kept[[100, 101, 102, 250, 400]] = False
    motion = RowsMotion(TIME[kept], wave(TIME)[0][kept])
    np.testing.assert_allclose(motion.evaluate(PLACES)[0], wave(PLACES)[0], atol=2e-4)
    assert motion.evened < 1e-9


def test_way_points_are_passed_where_and_when_they_are():
    time = np.array([0.0, 0.4, 1.0, 1.3, 2.0, 2.2])
    motion = RowsMotion(time, wave(time)[0])
    np.testing.assert_allclose(motion.evaluate(time[:-1])[0], wave(time)[0][:-1], atol=1e-12)
    assert (motion.note, motion.length, motion.end) == ("", 2.2, 2.325)


def test_a_gap_that_fits_in_no_memory_is_a_line():
    time = np.append(TIME, 1e6)
    with pytest.raises(ConfigurationError, match=r"move: expected rows without so long a gap, got 'a gap of 999994"):
        RowsMotion(time, np.zeros((602, 6)))


@pytest.mark.parametrize("count", [4, 5, 20])
def test_few_rows_are_a_motion_too(count):
    motion = RowsMotion(TIME[:count], wave(TIME[:count])[0])
    assert np.isfinite(motion.evaluate(np.linspace(-1.0, 2.0, 301))).all()
    np.testing.assert_allclose(motion.evaluate(9.0)[0], wave(TIME[count - 1])[0], atol=1e-3)
