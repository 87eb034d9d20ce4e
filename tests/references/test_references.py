import math

import numpy as np
import pytest
from conftest import field_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from references.laws import KINDS, check_derivatives, ends

from stewart_drake.errors import ConfigurationError
from stewart_drake.references import (
    HeartbeatReference,
    MinimumJerkReference,
    SineBurstsReference,
    SplineReference,
    TremorReference,
    paper_reference,
)
from stewart_drake.scenario import Scenario

CENTER = (0.1, -0.05, 0.2, 0.01, -0.02, 0.3)


@pytest.mark.parametrize("motions", KINDS.values(), ids=KINDS.keys())
@settings(max_examples=30)
@given(st.data(), st.floats(-0.1, 1.1))
def test_rates_and_accelerations_are_the_derivatives_of_the_pose(motions, data, share):
    reference = data.draw(motions)
    end = ends(reference).max()
    time = share * (end if 0.0 < end < math.inf else 20.0)
    assume(np.abs(ends(reference) - time).min() > 3e-4)
    check_derivatives(reference, time)


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


# What a field alone takes is asked of every section by tests/test_config.py; here are rules between fields.
TWO = ((0.0,) * 6, (1.0,) * 6)
BURSTS = {"frequency": (1.0, 2.0), "amplitude": (CENTER, CENTER)}
REFUSED = [
    (SineBurstsReference, BURSTS | {"frequency": (1.0,)}, "amplitude"),
    (SineBurstsReference, BURSTS | {"fade": 0.81}, "burst_duration"),
    (MinimumJerkReference, {"poses": TWO, "durations": (1.0, 1.0)}, "durations"),
    (SplineReference, {"poses": TWO, "times": (0.0, 0.0)}, "times"),
    (HeartbeatReference, {"harmonics": (1.0, 0.5)}, "harmonic_phase"),
    (HeartbeatReference, {"slow_variation": 0.5, "respiratory_variation": 0.5}, "slow_variation"),
    (TremorReference, {"high": 6.0}, "high"),
]


@pytest.mark.parametrize(("kind", "keys", "key"), REFUSED)
def test_what_makes_no_sense_is_refused_by_name(kind, keys, key):
    with pytest.raises(ConfigurationError) as caught:
        kind(**keys)
    assert field_of(caught.value) == f"reference.{key}"


def test_a_function_of_the_pose_alone_is_a_motion_with_rates_by_differences():
    def wave(t):
        return np.array(CENTER) + [0.1 * np.sin(2.0 * t), 0.0, 0.0, 0.0, 0.0, 0.01 * np.cos(3.0 * t)]

    times = np.linspace(0.0, 1.0, 7)
    reference = Scenario(reference=wave).reference
    pose, rate, acceleration = reference.evaluate(times)
    assert "differences" in reference.note
    np.testing.assert_allclose(pose[:, 0], 0.1 + 0.1 * np.sin(2.0 * times), atol=1e-15)
    np.testing.assert_allclose(rate[:, 0], 0.2 * np.cos(2.0 * times), atol=1e-7)
    np.testing.assert_allclose(acceleration[:, 5], -0.09 * np.cos(3.0 * times), atol=1e-5)
