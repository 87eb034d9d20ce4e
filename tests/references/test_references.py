import dataclasses
import math

import numpy as np
import pytest
from conftest import field_of
from hypothesis import given
from hypothesis import strategies as st
from references.laws import check_shapes
from strategies import vectors

from stewart_drake.errors import ConfigurationError
from stewart_drake.references import HoldReference, SineBurstsReference, SineReference, paper_reference

CENTER = (0.1, -0.05, 0.2, 0.01, -0.02, 0.3)
six = vectors(6).map(tuple)
frequencies = st.lists(st.floats(0.3, 5.0), min_size=1, max_size=4)


@st.composite
def bursts(draw):
    frequency = tuple(draw(frequencies))
    fade = draw(st.floats(0.1, 0.5))
    return SineBurstsReference(
        frequency=frequency,
        amplitude=tuple(draw(six) for _ in frequency),
        center=draw(six),
        phase=draw(six),
        fade=fade,
        burst_duration=draw(st.floats(2.0, 6.0)) * fade,
    )


holds = st.builds(HoldReference, pose=six)
sines = st.builds(SineReference, center=six, amplitude=six, angular_frequency=vectors(6, 12.0).map(tuple), phase=six)
references = st.one_of(holds, sines, bursts())


@given(references, st.floats(-0.5, 8.0))
def test_rates_and_accelerations_are_the_derivatives_of_the_pose(reference, time):
    h = 1e-6
    before, here, after = (reference.evaluate(time + k * h) for k in (-1.0, 0.0, 1.0))
    # Sizes of pose, rate, acceleration, jerk: amplitude 1, angular frequency up to 10 pi, fades down to 0.1 s.
    np.testing.assert_allclose((after[0] - before[0]) / (2.0 * h), here[1], atol=1e-5)
    # Jerk jumps where a fade ends, by up to 60 / fade^3.
    np.testing.assert_allclose((after[1] - before[1]) / (2.0 * h), here[2], atol=0.2)


@given(references, st.lists(st.floats(-1.0, 10.0), min_size=1, max_size=5))
def test_shapes(reference, times):
    check_shapes(reference, times)


@given(st.floats(0.0, 20.0))
def test_the_papers_reference_is_37_and_38(time):
    pose, rate, _ = paper_reference().evaluate(time)
    np.testing.assert_allclose(pose[0], math.pi / 6.0 * math.sin(2.0 * time), atol=1e-15)
    np.testing.assert_allclose(pose[5], 0.05 * math.sin(2.0 * time) + 0.3, atol=1e-15)
    assert not pose[1:5].any()
    # It starts in the centre, at full speed.
    _, start, _ = paper_reference().evaluate(0.0)
    np.testing.assert_allclose(start, [math.pi / 3.0, 0, 0, 0, 0, 0.1])
    assert np.all(np.abs(rate) <= np.abs(start))


@given(bursts(), st.integers(0, 4), st.sampled_from([-1e-9, 0.0, 1e-9]))
def test_between_bursts_the_platform_rests_in_the_centre(reference, index, offset):
    pose, rate, acceleration = reference.evaluate(index * reference.burst_duration + offset)
    np.testing.assert_allclose(pose, reference.center, atol=1e-12)
    np.testing.assert_allclose(rate, 0.0, atol=1e-9)
    # Jerk is 60 / fade^3 at the end of a fade at most.
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-9 * 60.0 / reference.fade**3 + 1e-5)


@given(bursts(), st.floats(0.0, 1.0))
def test_in_the_middle_of_a_burst_it_is_a_full_sine_of_its_own_frequency(reference, share):
    burst, fade = reference.burst_duration, reference.fade
    for index, (frequency, amplitude) in enumerate(zip(reference.frequency, reference.amplitude, strict=True)):
        local = fade + share * (burst - 2.0 * fade)
        pose, _, _ = reference.evaluate(index * burst + local)
        wave = [math.sin(2.0 * math.pi * frequency * local + phase) for phase in reference.phase]
        np.testing.assert_allclose(pose, np.array(reference.center) + np.array(amplitude) * wave, atol=1e-9)


@given(bursts(), st.floats(0.0, 1e6))
def test_before_the_first_and_after_the_last_burst_the_centre_is_held(reference, away):
    end = len(reference.frequency) * reference.burst_duration
    for time in (-away, end + away):
        pose, rate, acceleration = reference.evaluate(time)
        np.testing.assert_allclose(pose, reference.center, atol=1e-12)
        np.testing.assert_allclose([rate, acceleration], 0.0, atol=1e-6)


@pytest.mark.slow
@given(bursts())
def test_acceleration_has_no_jumps(reference):
    times = np.arange(0.0, len(reference.frequency) * reference.burst_duration + 0.2, 1e-4)
    _, _, acceleration = reference.evaluate(times)
    omega = 2.0 * math.pi * max(reference.frequency)
    # Product rule for the jerk, with the largest derivatives of the fade: 1.875, 5.774 and 60.
    fade = reference.fade
    jerk = 60.0 / fade**3 + 3.0 * omega * 5.774 / fade**2 + 3.0 * omega**2 * 1.875 / fade + omega**3
    assert np.abs(np.diff(acceleration, axis=0)).max() <= 1e-4 * jerk


def test_a_hold_stays():
    pose, rate, acceleration = HoldReference(pose=CENTER).evaluate(np.linspace(0.0, 1e6, 5))
    np.testing.assert_array_equal(pose, [CENTER] * 5)
    assert not rate.any()
    assert not acceleration.any()


BURSTS = {"frequency": (1.0, 2.0), "amplitude": (CENTER, CENTER)}


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"frequency": (), "amplitude": ()}, "frequency"),
        ({"frequency": (1.0, 0.0)}, "frequency"),
        ({"frequency": (1.0, -2.0)}, "frequency"),
        ({"frequency": (1.0, math.nan)}, "frequency"),
        ({"frequency": (1.0,)}, "amplitude"),
        ({"fade": 0.0}, "fade"),
        ({"fade": math.nan}, "fade"),
        ({"fade": 0.81}, "burst_duration"),
        ({"burst_duration": 0.39}, "burst_duration"),
        ({"burst_duration": math.inf}, "burst_duration"),
    ],
)
def test_bursts_that_make_no_sense_are_refused_by_name(changes, key):
    with pytest.raises(ConfigurationError) as caught:
        SineBurstsReference(**{**BURSTS, **changes})
    assert field_of(caught.value) == f"reference.{key}"


def test_a_burst_of_two_fades_and_nothing_between_is_allowed():
    reference = SineBurstsReference(**BURSTS, fade=0.8, burst_duration=1.6)
    assert np.isfinite(reference.evaluate(np.linspace(0.0, 3.2, 100))[2]).all()


def test_references_are_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        paper_reference().amplitude = CENTER
