"""The core of calibration and identification: which parameters data determine, and tables of readings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.estimation.core import Estimate, Parameter, free_directions, identifiable
from stewart_drake.estimation.poses import Measurements

PARAMETERS = (Parameter("mass", "", "kg"), *(Parameter("place", axis, "m", "body") for axis in "xyz"))
KINDS = ("mass", "place")


def estimate_of(slope, free, scales, preference=1.0):
    """What data with this slope determine, with the values zero."""
    left, fixed = identifiable(slope @ (scales[:, None] * free), free, scales, 0.1, preference)
    k = left.shape[1]
    return Estimate(PARAMETERS, scales, np.zeros(4), scales[:, None] * left, np.eye(k), np.eye(k), fixed)


@given(st.integers(0, 1000), st.integers(0, 3))
def test_data_notice_nothing_of_an_unidentifiable_change_and_everything_else(seed, rank):
    rng = np.random.default_rng(seed)
    scales = rng.uniform(0.1, 10.0, 4)
    slope = 1e4 * rng.standard_normal((8, rank)) @ rng.standard_normal((rank, 4)) / scales
    estimate = estimate_of(slope, np.eye(4), scales)
    assert len(estimate.unidentifiable) == 4 - rank
    for each in estimate.unidentifiable:
        assert each.direction[each.at] == 1.0
        assert np.abs(slope @ each.direction).max() * scales[each.at] < 1e-6
        assert estimate.half_width[each.at] == 0.0
    change = scales * rng.standard_normal(4)
    seen = estimate.identifiable_part(change)
    assert slope @ seen == pytest.approx(slope @ change, rel=1e-6, abs=1e-6)
    assert [seen[each.at] for each in estimate.unidentifiable] == pytest.approx([0.0] * (4 - rank), abs=1e-9)
    # What is left is a change along the directions that were estimated.
    step = np.linalg.lstsq(estimate.directions, seen, rcond=None)[0]
    assert estimate.directions @ step == pytest.approx(seen, abs=1e-6)


def test_a_sentence_names_parameters_that_cannot_be_separated_with_units():
    # Only the sum of the mass and a tenth of x is noticed; y a little, z well.
    slope = np.array([[100.0, 10.0, 0.0, 0.0], [0.0, 0.0, 5.0, 0.0], [0.0, 0.0, 0.0, 100.0]])
    first = np.array([1.0, 9.0, 1.0, 1.0])
    lines = estimate_of(slope, np.eye(4), np.ones(4), first).unidentifiable_sentences()
    assert lines == (
        "body place x (undetermined): with each mm more of it mass by -0.0001 kg",
        "body place y (uncertain by 2e+02 mm): with each mm more of it nothing",
    )


def test_directions_keep_what_is_held_known_or_constrained():
    free = free_directions(PARAMETERS, KINDS, ["mass"], constraints=[np.array([0.0, 1.0, 1.0, 0.0])])
    assert free.shape == (4, 2)
    assert free.T @ free == pytest.approx(np.eye(2))
    assert free[0] == pytest.approx([0.0, 0.0])
    assert free[1] == pytest.approx(-free[2])
    for hold, message in ((["length"], "hold: expected some of mass, place, got 'length'"), (KINDS, "not all")):
        with pytest.raises(ConfigurationError, match=message):
            free_directions(PARAMETERS, KINDS, hold)


def test_readings_are_copied_locked_and_come_back_from_their_file(tmp_path):
    pose, angles = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 3, 6))
    readings = Measurements(pose, angles)
    assert not np.shares_memory(readings.pose, pose)
    with pytest.raises(ValueError, match="read-only"):
        readings.pose[0, 0] = 1.0
    (tmp_path / "poses.csv").write_text(readings.to_csv())
    again = Measurements.of_file(tmp_path / "poses.csv", "again")
    assert again.table == pytest.approx(readings.table, abs=1e-15)
    for wrong in (pose[:2], pose[:, :5], 1.0):
        with pytest.raises(ConfigurationError, match=r"poses: (pose|angles): expected numbers of shape \(n, 6\)"):
            Measurements(wrong, angles)
