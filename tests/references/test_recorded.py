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
from stewart_drake.runs.checks import check_scenario
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario

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


def test_a_recording_begins_within_half_a_turn(tmp_path):
    for start in (-0.1, math.tau - 0.1):
        path = save(table(yaw=start + 0.01 * TIMES), tmp_path / "motion.csv")
        np.testing.assert_allclose(load_recording(path)[:, 3], -0.1 + 0.01 * TIMES, atol=1e-12)


def test_degrees_are_no_turns(tmp_path):
    path = save(table(yaw=45.0 + 5.0 * TIMES), tmp_path / "motion.csv")
    np.testing.assert_array_equal(load_recording(path)[:, 3], 45.0 + 5.0 * TIMES)
    degrees = Scenario(reference=reference(path), duration=1.0)
    with pytest.raises(ConfigurationError, match=r"did you mean 0.873\?.*yaw 50 rad at t = 1.000 s"):
        check_scenario(degrees)


def test_a_swing_about_half_a_turn_can_be_taken_as_a_swing_about_home(tmp_path):
    swing = -0.15 * np.sin(2.0 * TIMES)
    path = save(table(roll=0.0 * TIMES, yaw=wrapped(math.pi + swing, -math.pi)), tmp_path / "motion.csv")
    about_home = {"kind": "sum", "parts": [reference(path)], "center": (0.0, 0.0, 0.0, 0.0, 0.0, 0.3)}
    log = run(Scenario(reference=about_home, duration=1.0, controller={"model": "exact"}, tuner="block"))
    assert log.status == "completed"
    assert log["pose"][-1, 2] == pytest.approx(swing[50], abs=2e-3)


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


def test_time_scale_slows_it_down(tmp_path):
    path = save(table(), tmp_path / "motion.csv")
    plain, slow = reference(path), reference(path, time_scale=2.0)
    for power, (fast, values) in enumerate(zip(plain.evaluate(TIMES), slow.evaluate(2.0 * TIMES), strict=True)):
        np.testing.assert_allclose(values, fast / 2.0**power, atol=1e-9)


def test_whole_numbers_further_columns_and_any_order_will_do(tmp_path):
    columns = {name: [0, 1, 2, 4] for name in (*COLUMNS[::-1], "pulse")}
    path = save(pa.table(columns | {"note": ["a", "b", "c", "d"]}), tmp_path / "motion.csv")
    np.testing.assert_array_equal(load_recording(path), np.tile([[0], [1], [2], [4]], 7))


def test_windows_line_ends_and_a_byte_order_mark_will_do(tmp_path):
    rows = [",".join(COLUMNS), *(f"{i},0,0,0,0,0,0.3" for i in range(4))]
    (tmp_path / "motion.csv").write_bytes(b"\xef\xbb\xbf" + "\r\n".join(rows).encode() + b"\r\n")
    assert load_recording(tmp_path / "motion.csv").shape == (4, 7)


def changed(name, row, value):
    column = table().column(name).to_pylist()
    column[row] = value
    return table(**{name: column})


BAD = {
    "missing column": (lambda: table().drop_columns(["yaw"]), "got 'none among time, roll"),
    "misspelt column": (lambda: table().rename_columns([*COLUMNS[:6], "Z"]), "got 'none among"),
    "nan": (lambda: changed("x", 4, math.nan), "pose_x: expected finite numbers"),
    "infinite": (lambda: changed("roll", 4, math.inf), "got 'inf in row 5'"),
    "empty cell": (lambda: changed("z", 0, None), "got 'nan in row 1'"),
    "time stands": (lambda: changed("time", 3, 0.04), "time: expected ascending"),
    "time goes back": (lambda: changed("time", 150, 0.0), "'0 after 2.98 in row 151'"),
    "three rows": (lambda: table(TIMES[:3]), "expected at least 4 rows"),
    "no rows": (lambda: table(TIMES[:0]), "got '0 rows'"),
    "words": (lambda: table(pitch=["a"] * 151), "a table of numbers"),
}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("rows", BAD, ids=str)
def test_a_recording_that_cannot_be_used_is_one_clear_line(tmp_path, rows, suffix):
    make, words = BAD[rows]
    path = save(make(), tmp_path / f"motion{suffix}")
    with pytest.raises(ConfigurationError) as caught:
        reference(path).evaluate(0.0)
    assert caught.value.key.startswith(f"recorded motion {path}")
    assert words in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("motion.csv", None, "No such file"),
        ("motion.csv", b"", "no columns"),
        ("motion.csv", b"\xff\xfe\x00", "expected a table"),
        ("motion.csv", b"time,roll\n1,2,3\n", "got 'none among"),
        ("motion.parquet", b"time,roll\n1,2\n", "a table of numbers"),
        ("motion.parquet", b"", "a table of numbers"),
        ("motion.txt", b"", "ends in .csv or .parquet"),
        ("motion", b"", "ends in .csv or .parquet"),
        ("motion\0.csv", None, "a readable file"),
    ],
)
def test_a_file_that_is_no_recording_is_one_clear_line(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigurationError) as caught:
        load_recording(tmp_path / name)
    assert words in str(caught.value)


def test_a_folder_and_a_twofold_column_are_refused(tmp_path):
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(ConfigurationError, match="a folder"):
        load_recording(tmp_path / "folder.csv")
    twice = ",".join((*COLUMNS, "x")) + "\n" + "0,0,0,0,0,0,0,0\n" * 5
    (tmp_path / "twice.csv").write_text(twice)
    with pytest.raises(ConfigurationError, match="got 'x, x'"):
        load_recording(tmp_path / "twice.csv")


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_huge_recording_is_refused_before_it_is_unpacked(tmp_path, monkeypatch, suffix):
    path = save(table(), tmp_path / f"motion{suffix}")
    monkeypatch.setattr(recorded, "MAX_RECORDING_ROWS", 150)
    with pytest.raises(ConfigurationError, match="151 rows"):
        load_recording(path)
    monkeypatch.setattr(recorded, "MAX_RECORDING_BYTES", 1000)
    with pytest.raises(ConfigurationError, match="at most 1000 bytes"):
        load_recording(path)


def test_times_too_close_for_numbers_are_refused(tmp_path):
    times = [0.0, 5e-324, 1e-323, 1.0]
    path = save(table(np.linspace(0.0, 3.0, 4), time=times), tmp_path / "motion.parquet")
    with pytest.raises(ConfigurationError, match="a spline can join"):
        reference(path).evaluate(0.0)
