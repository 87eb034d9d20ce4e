import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from references.laws import heartbeats

from stewart_drake.references import BreathingReference, HeartbeatReference, TremorReference


@pytest.mark.parametrize("order", [1, 2, 3])
def test_breathing_is_the_waveform_of_lujan_from_end_exhale_to_end_inhale(order):
    times = np.linspace(0.0, 5.0, 50)
    pose, _, _ = BreathingReference(frequency=0.2, order=order, phase=0.3).evaluate(times)
    z0, b, tau = 0.3, -0.012, 5.0
    np.testing.assert_allclose(pose[:, 5], z0 - b * np.cos(np.pi * times / tau - 0.3) ** (2 * order), atol=1e-15)
    start, inhaled = BreathingReference(order=order).evaluate(np.array([0.0, 2.0]))[0]
    np.testing.assert_allclose(start, BreathingReference().center, atol=1e-15)
    np.testing.assert_allclose(inhaled[3:], [0.002, 0.002, 0.312], atol=1e-15)


def steady(**keys):
    return HeartbeatReference(**{"respiratory_variation": 0.0, "slow_variation": 0.0} | keys)


def test_the_wave_has_the_harmonics_that_were_asked_for():
    reference = steady(rate=1.0, harmonics=(1.0, 0.5, 0.25), harmonic_phase=(0.3, 0.6, -0.9), phase=(0.0,) * 6)
    z = reference.evaluate(np.arange(1000) / 1000.0)[0][:, 5] - 0.3
    spectrum = np.fft.rfft(z) / 500.0
    np.testing.assert_allclose(np.abs(spectrum[1:4]) / np.abs(spectrum[1]), [1.0, 0.5, 0.25], rtol=1e-9)
    np.testing.assert_allclose(-np.angle(spectrum[1:4]), [0.3, 0.6, -0.9], atol=1e-9)
    np.testing.assert_allclose(np.abs(np.delete(spectrum, [1, 2, 3])), 0.0, atol=1e-12)


@given(heartbeats(premature=()))
@settings(max_examples=50)
def test_the_rate_stays_within_its_variation_and_keeps_its_mean(reference):
    times = np.linspace(0.0, 400.0, 8001)
    count, rate, _ = reference.beats(times)
    spread = reference.rate * (reference.respiratory_variation + reference.slow_variation)
    assert np.abs(rate - reference.rate).max() <= spread + 1e-12
    assert rate.min() > 0.0
    assert count[0] == 0.0
    # A sine of the rate moves the count by at most 2 share / omega.
    drift = reference.respiratory_variation / reference.respiratory_frequency + reference.slow_variation / 0.04
    assert abs(count[-1] - 400.0 * reference.rate) <= reference.rate * drift / math.pi


@given(st.floats(0.8, 2.5), st.integers(1, 6), st.floats(0.05, 0.7))
@settings(max_examples=50)
def test_a_premature_beat_comes_early_and_the_next_one_on_time(rate, beat, prematurity):
    reference = steady(rate=rate, premature_beats=(beat,), prematurity=prematurity)
    times = np.linspace(0.0, 9.0 / rate, 20_001)
    count = reference.beats(times)[0]
    expected = np.arange(math.floor(count[-1]) + 1) / rate
    # The two intervals around it make two beats.
    expected[beat] -= prematurity / rate
    np.testing.assert_allclose(np.interp(np.arange(len(expected)), count, times), expected, atol=1e-4)


def test_tremor_has_its_size():
    # Its sines are those of noise, whose band is in hardware/test_disturbances.py.
    reference = TremorReference(rms=(1e-3, 0.0, 0.0, 1e-4, 2e-4, 3e-4), low=6.0, high=12.0, seed=3)
    pose = reference.evaluate(np.arange(0.0, 100.0, 0.005))[0] - np.array(reference.center)
    np.testing.assert_allclose(np.sqrt(np.mean(pose**2, axis=0)), reference.rms, rtol=0.05, atol=1e-15)
