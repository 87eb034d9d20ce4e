import math

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest
from references.laws import check_derivatives, check_means, check_shapes, check_smooth

from stewart_drake.errors import ConfigurationError
from stewart_drake.references import RecordedReference, SineReference, center_of, recorded
from stewart_drake.references.recorded import load_recording

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


@pytest.mark.parametrize("name", ["motion.csv", "motion.parquet", "MOTION.CSV"])
def test_a_recording_comes_back_row_by_row_and_smoothly_between(tmp_path, name):
    path = save(table(offset=17.0), tmp_path / "motion.csv" if "csv" in name.lower() else tmp_path / name)
    path = path.rename(tmp_path / name)
    motion = reference(path)
    np.testing.assert_allclose(motion.evaluate(TIMES)[0], MOTION.evaluate(TIMES)[0], atol=1e-12)
    between = np.linspace(0.1, 2.9, 777)
    # A cubic spline of step h errs by h^4, h^3 and h^2: 0.02 s of a sine of 2 rad/s and 0.52 rad.
    for values, true, atol in zip(motion.evaluate(between), MOTION.evaluate(between), (1e-7, 2e-5, 2e-3), strict=True):
        np.testing.assert_allclose(values, true, atol=atol)
    np.testing.assert_array_equal(center_of(motion), motion.evaluate(0.0)[0])


def test_rates_and_accelerations_are_the_derivatives_of_the_pose_and_do_not_jump(tmp_path):
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.1, 0.4, 12))
    motion = reference(save(table(times), tmp_path / "motion.parquet"), settle=0.5)
    rows = times - times[0]
    for time in rng.uniform(0.0, rows[-1] + 1.0, 60):
        check_means(motion, time)
        if np.abs(np.append(rows, rows[-1] + 0.5) - time).min() > 3e-4:
            check_derivatives(motion, time)
    check_smooth(motion, [*rows[1:], rows[-1] + 0.5], jerk=1000.0)
    check_shapes(motion, [0.3, 1.2, rows[-1] + 0.2, -1.0])


def wrapped(yaw, lowest):
    """Angles from `lowest` to a turn above it."""
    return lowest + (yaw - lowest) % math.tau


@pytest.mark.parametrize(("middle", "lowest"), [(math.pi, -math.pi), (-math.pi, -math.pi), (0.0, 0.0)])
def test_angles_that_wrap_are_followed_as_if_they_did_not(tmp_path, middle, lowest):
    yaw = middle + 0.3 * np.sin(2.0 * TIMES + 0.1)
    smooth = reference(save(table(yaw=yaw), tmp_path / "smooth.csv"))
    motion = reference(save(table(yaw=wrapped(yaw, lowest)), tmp_path / "motion.csv"))
    assert np.abs(np.diff(wrapped(yaw, lowest))).max() > 6.0
    assert np.abs(motion.evaluate(0.0)[0][:3]).max() <= math.pi
    between = np.linspace(0.0, 3.0, 777)
    (pose, *derivatives), (there, *those) = motion.evaluate(between), smooth.evaluate(between)
    turns = (pose - there)[:, 2] / math.tau
    np.testing.assert_allclose(turns, round(turns[0]), atol=1e-9)
    for found, true in zip(derivatives, those, strict=True):
        np.testing.assert_allclose(found, true, atol=1e-8)


def test_it_starts_with_its_own_velocity_and_coasts_to_rest(tmp_path):
    motion = reference(save(table(), tmp_path / "motion.csv"), settle=0.4)
    start, rate, _ = motion.evaluate(0.0)
    np.testing.assert_allclose(start, MOTION.evaluate(0.0)[0], atol=1e-12)
    np.testing.assert_allclose(rate, MOTION.evaluate(0.0)[1], atol=1e-3)
    last, there, later = (motion.evaluate(time) for time in (3.0, 3.4, 1e6))
    for pose, one, two in zip(*(there, later, motion.evaluate(3.5)), strict=True):
        np.testing.assert_allclose(pose, one, atol=1e-12)
        np.testing.assert_allclose(pose, two, atol=1e-12)
    assert not later[1].any()
    assert not later[2].any()
    # Half of the way that the last velocity would have gone, give or take what the last acceleration does.
    coasted = last[1] * 0.4 / 2.0 + last[2] * 0.4**2 / 12.0
    np.testing.assert_allclose(there[0] - last[0], coasted, atol=1e-12)


def changed(name, row, value):
    column = table().column(name).to_pylist()
    column[row] = value
    return table(**{name: column})


BAD = {
    "missing column": (lambda: table().drop_columns(["yaw"]), "got 'none among time, roll"),
    "misspelt column": (lambda: table().rename_columns([*COLUMNS[:6], "Z"]), "got 'none among"),
    "nan": (lambda: changed("x", 4, math.nan), "row 5, pose_x: expected a finite number"),
    "infinite": (lambda: changed("roll", 4, math.inf), "row 5, pose_roll: expected a finite"),
    "empty cell": (lambda: changed("z", 0, None), "row 1, pose_z"),
    "time stands": (lambda: changed("time", 3, 0.04), "row 4, time: expected a time after"),
    "time goes back": (lambda: changed("time", 150, 0.0), "row 151, time: "),
    "three rows": (lambda: table(TIMES[:3]), "expected at least 4 rows"),
    "no rows": (lambda: table(TIMES[:0]), "got '0 rows'"),
    "words": (lambda: table(pitch=["a"] * 151), "a table of numbers"),
}


@pytest.mark.parametrize("rows", BAD, ids=str)
def test_a_recording_that_cannot_be_used_is_one_clear_line(tmp_path, rows):
    make, words = BAD[rows]
    path = save(make(), tmp_path / "motion.csv")
    with pytest.raises(ConfigurationError) as caught:
        reference(path).evaluate(0.0)
    assert caught.value.key.startswith(f"recorded motion {path}")
    assert words in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_file_of_another_kind_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"ends in \.csv or \.parquet"):
        load_recording(tmp_path / "motion.txt")


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_huge_recording_is_refused_before_it_is_unpacked(tmp_path, monkeypatch, suffix):
    path = save(table(), tmp_path / f"motion{suffix}")
    monkeypatch.setattr(recorded, "MAX_RECORDING_ROWS", 150)
    with pytest.raises(ConfigurationError, match="151 rows"):
        load_recording(path)
    monkeypatch.setattr(recorded, "MAX_RECORDING_BYTES", 1000)
    with pytest.raises(ConfigurationError, match="at most 1000 bytes"):
        load_recording(path)
