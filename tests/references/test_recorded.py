import math

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest

from stewart_drake import ConfigurationError, Scenario, SineReference, run
from stewart_drake.references import RecordedReference, center_of

COLUMNS = ("time", "roll", "pitch", "yaw", "x", "y", "z")
MOTION = SineReference()
TIMES = np.linspace(0.0, 3.0, 151)


def table(times=TIMES, offset=0.0, **changes):
    values = np.column_stack([times + offset, MOTION.evaluate(times)[0]])
    return pa.table(dict(zip(COLUMNS, values.T, strict=True)) | changes)


def save(rows, path):
    (pc.write_csv if path.suffix == ".csv" else pq.write_table)(rows, path)
    return path


def reference(path, **keys):
    return RecordedReference(motion_file=str(path), **keys)


@pytest.mark.parametrize("name", ["motion.csv", "motion.parquet"])
def test_a_recording_comes_back_row_by_row_and_smoothly_between(tmp_path, name):
    path = save(table(offset=17.0), tmp_path / name)
    motion, rows = reference(path), TIMES[TIMES < 2.8]
    np.testing.assert_allclose(reference(path, cutoff=None).evaluate(rows)[0], MOTION.evaluate(rows)[0], atol=1e-12)
    np.testing.assert_allclose(motion.evaluate(rows)[0], MOTION.evaluate(rows)[0], atol=2e-6)
    between = np.linspace(0.2, 2.6, 777)
    # A cubic spline of step h errs by h^4, h^3 and h^2: 0.02 s of a sine of 2 rad/s and 0.52 rad.
    for values, true, atol in zip(motion.evaluate(between), MOTION.evaluate(between), (1e-7, 2e-5, 2e-3), strict=True):
        np.testing.assert_allclose(values, true, atol=atol)
    np.testing.assert_array_equal(center_of(motion), motion.evaluate(0.0)[0])


@pytest.mark.parametrize("middle", [math.pi, -math.pi])
def test_angles_that_wrap_are_followed_as_if_they_did_not(tmp_path, middle):
    yaw = middle + 0.3 * np.sin(2.0 * TIMES + 0.1)
    wrapped = (yaw + math.pi) % math.tau - math.pi
    assert np.abs(np.diff(wrapped)).max() > 6.0
    smooth, motion = (
        reference(save(table(yaw=values), tmp_path / f"{name}.csv")) for name, values in (("a", yaw), ("b", wrapped))
    )
    assert np.abs(motion.evaluate(0.0)[0][:3]).max() <= math.pi
    between = np.linspace(0.0, 3.0, 777)
    (pose, *derivatives), (there, *those) = motion.evaluate(between), smooth.evaluate(between)
    turns = (pose - there)[:, 2] / math.tau
    np.testing.assert_allclose(turns, round(turns[0]), atol=1e-9)
    np.testing.assert_allclose(derivatives, those, atol=1e-8)


def test_a_run_is_as_long_as_its_recording_by_default(tmp_path):
    motion = {"kind": "recorded", "motion_file": str(save(table(), tmp_path / "motion.csv")), "settle": 0.25}
    scenario = Scenario(reference=motion)
    assert scenario.duration == 3.125
    assert scenario.replace({"reference.time_scale": 2.0}).duration == 6.125
    assert scenario.replace({"reference": {"kind": "hold"}}).duration == 10.0
    assert Scenario(reference=motion, duration=10.0).duration == 10.0
    fast = {"plant.kind": "closed_form", "tuner": {"kind": "fixed"}, "controller.feedforward": "platform"}
    warnings = [run(scenario.replace({**fast, **more})).warnings for more in ({}, {"duration": 5.0}, {"duration": 1.5})]
    said = ["".join(each["text"] for each in found if each["name"] == "motion_length") for found in warnings]
    assert said[0] == ""
    assert said[1].startswith("the motion ends at 3.1")
    assert said[2] == "the recorded motion of 3.125 s is cut at 1.5 s"


def test_it_starts_with_its_own_velocity_and_slows_down_within_its_rows(tmp_path):
    motion = reference(save(table(), tmp_path / "motion.csv"), settle=0.4)
    np.testing.assert_allclose(motion.evaluate(0.0)[1], MOTION.evaluate(0.0)[1], atol=1e-3)
    assert motion.end == pytest.approx(3.2)
    there, later = motion.evaluate(3.2), motion.evaluate(1e6)
    np.testing.assert_allclose(there, later, atol=1e-12)
    np.testing.assert_array_equal(later[1:], 0.0)
    np.testing.assert_allclose(later[0], MOTION.evaluate(3.0)[0], atol=1e-4)
    # The last rows rise, and so it does until it rests, at a rate and an acceleration that do not jump.
    times = np.linspace(2.7, 3.3, 601)
    pose, rate, acceleration = (signal[:, 0] for signal in motion.evaluate(times))
    assert np.diff(pose).min() >= -1e-12
    np.testing.assert_allclose(np.gradient(pose, times)[1:-1], rate[1:-1], atol=1e-4)
    np.testing.assert_allclose(np.gradient(rate, times)[1:-1], acceleration[1:-1], atol=2e-2)
    assert np.abs(np.diff(acceleration)).max() < 0.05


def changed(name, row, value):
    column = table().column(name).to_pylist()
    column[row] = value
    return table(**{name: column})


BAD = {
    "missing column": (lambda: table().drop_columns(["yaw"]), "got 'none among time, roll"),
    "infinite": (lambda: changed("roll", 4, math.inf), "row 5, pose_roll: expected a finite"),
    "empty cell": (lambda: changed("z", 0, None), "row 1, pose_z"),
    "time stands": (lambda: changed("time", 3, 0.04), "row 4, time: expected a time after"),
    "three rows": (lambda: table(TIMES[:3]), "expected at least 4 rows"),
    "words": (lambda: table(pitch=["a"] * 151), "a table of numbers"),
}


def test_numbers_in_the_first_line_are_a_header_that_is_missing(tmp_path):
    (tmp_path / "motion.csv").write_text("0.1500,0,0,0,0,0\n0.1515,0,0,0,0,0\n")
    with pytest.raises(
        ConfigurationError, match=r"column of time: .*; the first line is numbers: is the header missing"
    ):
        reference(tmp_path / "motion.csv").evaluate(0.0)


@pytest.mark.parametrize(("make", "words"), BAD.values(), ids=BAD)
def test_a_recording_that_cannot_be_used_is_one_clear_line(tmp_path, make, words):
    path = save(make(), tmp_path / "motion.csv")
    with pytest.raises(ConfigurationError) as caught:
        reference(path).evaluate(0.0)
    assert caught.value.key.startswith(f"recorded motion {path}")
    assert words in str(caught.value)
    assert str(caught.value).isprintable()
