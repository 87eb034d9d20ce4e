"""Frequency response of the loop, and figures of a step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.analysis.linear_loop import LinearLoops, StateSpace, linearize
from stewart_drake.analysis.margins import loop_margins
from stewart_drake.analysis.response import bode, frequency_response, step_figures


def test_a_frequency_response_is_the_sum_of_the_answers_to_an_impulse():
    rng = np.random.default_rng(0)
    a, b, c, d = (
        0.2 * rng.normal(size=(4, 4)),
        rng.normal(size=(4, 2)),
        rng.normal(size=(3, 4)),
        rng.normal(size=(3, 2)),
    )
    system = StateSpace(a, b, c, d, 0.01)
    frequency = np.array([0.0, 1.0, 20.0, 50.0])
    answers = [d, *(c @ np.linalg.matrix_power(a, k) @ b for k in range(200))]
    points = np.exp(2j * np.pi * frequency * 0.01)
    expected = [sum(answer * z ** (-k) for k, answer in enumerate(answers)) for z in points]
    assert np.allclose(frequency_response(system, frequency), expected)


def test_sensitivity_and_its_complement_are_those_of_the_margins():
    at = linearize("exact_breathing")
    loops = LinearLoops(at.loop.a[None], at.loop.b[None], at.loop.c[None], at.loop.period, at.pose[None], ())
    margins = loop_margins(loops, 60)
    response = bode("exact_breathing", frequency=margins.frequencies / (2.0 * np.pi))
    assert np.allclose(response.sensitivity @ (np.eye(6) + response.loop), np.eye(6))
    assert np.allclose(response.complementary, response.loop @ response.sensitivity)
    # A single motor's disk margin is 1 / max |S_ii - 1/2| (Seiler, Packard, Gahinet 2020).
    own = np.abs(np.diagonal(response.sensitivity, axis1=1, axis2=2) - 0.5).max(axis=0)
    assert margins.single.disk[0] == pytest.approx(1.0 / own, rel=1e-6)
    low, high = response.crossover
    assert 1.0 < low <= high < 100.0


@given(st.floats(0.2, 0.9), st.floats(1.0, 50.0))
def test_a_step_of_second_order_has_its_overshoot_and_rise_time(damping, frequency):
    # K. J. Astrom, R. M. Murray, Feedback Systems, 2008, section 6.3.
    time = np.linspace(0.0, 40.0 / (damping * frequency), 20_000)
    turning = frequency * np.sqrt(1.0 - damping**2)
    envelope = np.exp(-damping * frequency * time)
    value = 1.0 - envelope * (np.cos(turning * time) + damping * frequency / turning * np.sin(turning * time))
    found = step_figures(time, value)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2)), abs=1e-4)
    assert 0.0 < found.rise_time < np.pi / turning
    assert 0.0 <= found.settling_time <= 1.05 * 4.7 / (damping * frequency)


def test_a_step_that_ends_elsewhere_does_not_settle():
    time = np.linspace(0.0, 1.0, 11)
    assert np.isnan(step_figures(time, np.full_like(time, np.nan)).settling_time)
    found = step_figures(time, 0.5 * time)
    assert np.isnan([found.rise_time, found.settling_time]).all()
    assert found.overshoot == 0.0
    assert np.isnan(step_figures(time, np.array([0.0, *[1.1, 0.9] * 4, 1.1, 1.0])).settling_time)
