"""Poses files that cannot be right: one line that names file, row and column."""

import numpy as np
import pytest
from strategies import ROBOT

from stewart_drake.calibration import fit
from stewart_drake.calibration.fit import calibrate
from stewart_drake.calibration.measurements import COLUMNS, MeasurementNoise, Measurements, load_measurements
from stewart_drake.calibration.pose_plan import candidate_poses
from stewart_drake.calibration.simulate import deviating, measured
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.planning.limits import Limits


@pytest.fixture(scope="module")
def good():
    rng = np.random.default_rng(0)
    pose = candidate_poses(ROBOT, 25, Limits(), rng)
    exact = Measurements(pose, inverse_kinematics(ROBOT, pose))
    return measured(deviating(ROBOT, rng), exact, MeasurementNoise(), rng)


@pytest.fixture
def refused(tmp_path):
    """The line with which a table is refused."""

    def refused(header, table, **options):
        path = tmp_path / "poses.csv"
        rows = [",".join(str(cell) for cell in row) for row in table]
        path.write_text("\n".join([",".join(header), *rows]))
        with pytest.raises(ConfigurationError) as caught:
            calibrate(ROBOT, path, **options)
        assert len(str(caught.value).splitlines()) == 1
        assert str(path) in str(caught.value)
        return str(caught.value).replace(str(path), "poses.csv")

    return refused


def table_of(measurements):
    return np.concatenate([measurements.pose, measurements.angles], axis=-1)


def test_a_file_is_read_back_and_other_units_and_columns_will_do(good, tmp_path):
    path = tmp_path / "poses.csv"
    path.write_text(good.to_csv())
    again = load_measurements(path)
    assert (again.pose == good.pose).all()
    assert (again.angles == good.angles).all()
    factors = np.array([180.0 / np.pi] * 3 + [1e3] * 3 + [180.0 / np.pi] * 6)
    other = [f"{name.rpartition('_')[0]}_{'mm' if name.endswith('_m') else 'deg'}" for name in COLUMNS]
    rows = np.column_stack([np.arange(len(good)), (table_of(good) * factors)[:, ::-1]])
    lines = [",".join(["number", *reversed(other)]), *(",".join(map(repr, row)) for row in rows.tolist())]
    path.write_text("\ufeff" + "\r\n".join(lines) + "\r\n\r\n", encoding="utf-8")
    assert load_measurements(path).pose == pytest.approx(good.pose)
    assert load_measurements(path).angles == pytest.approx(good.angles)


@pytest.mark.parametrize(
    ("cell", "said"),
    [("nan", "got nan"), ("", "got nan"), ("abc", "'abc'"), ("inf", "got inf"), ("1,5", "got 13")],
)
def test_cells_that_are_no_numbers(refused, good, cell, said):
    table = table_of(good).astype(object)
    table[6, 4] = cell
    text = refused(COLUMNS, table)
    assert "row 7" in text or "Row #8" in text
    assert said in text
    assert cell in ("1,5", "abc") or ": row 7, pose_y" in text


def test_columns_that_are_missing_or_there_twice(refused, good):
    names = ["yaw_turns" if name == "pose_yaw_rad" else name for name in COLUMNS]
    assert "column of pose_yaw: expected " in refused(names, table_of(good))
    twice = [*COLUMNS[:-1], "crank_angle_4_deg"]
    assert "column of crank_angle_4: expected one of" in refused(twice, table_of(good))


def test_too_few_poses(refused, good):
    text = refused(COLUMNS, table_of(good)[:11])
    assert "expected at least 12 poses for 66 unknown numbers" in text


@pytest.mark.parametrize(("columns", "what"), [(slice(0, 12), "row"), (slice(0, 6), "pose")])
def test_poses_that_are_there_twice(refused, good, columns, what):
    table = table_of(good)
    table[8, columns] = table[3, columns]
    assert f"the {what} of row 4 again in row 9" in refused(COLUMNS, table)


@pytest.mark.parametrize(
    ("columns", "factor", "said"),
    [
        (slice(3, 6), 1e3, "millimetres for metres"),
        (slice(3, 6), 1e-3, "metres for millimetres"),
        (slice(6, 12), 180.0 / np.pi, "crank_angle"),
        (slice(6, 12), np.pi / 180.0, "radians for degrees"),
        (slice(0, 3), np.pi / 180.0, "radians for degrees"),
        (slice(0, 3), 180.0 / np.pi, "degrees by _deg"),
    ],
)
def test_wrong_units(refused, good, columns, factor, said):
    table = table_of(good)
    table[:, columns] *= factor
    assert said in refused(COLUMNS, table)


@pytest.mark.slow
@pytest.mark.parametrize(("one", "other", "known"), [(0, 1, ()), (1, 4, ("base", "platform"))])
def test_swapped_encoders_are_named(refused, good, known, one, other):
    table = table_of(good)
    table[:, [6 + one, 6 + other]] = table[:, [6 + other, 6 + one]]
    assert f"crank_angle_{one} and crank_angle_{other}: expected " in refused(COLUMNS, table, known_frames=known)


@pytest.mark.slow
def test_an_inverted_encoder_is_named(refused, good):
    table = table_of(good)
    table[:, 9] *= -1.0
    assert "crank_angle_3: expected " in refused(COLUMNS, table)


@pytest.mark.slow
@pytest.mark.parametrize(("column", "by"), [(5, 2e-3), (8, 0.02)])
def test_a_single_wrong_row_is_named(refused, good, column, by):
    table = table_of(good)
    table[17, column] += by
    assert "row 18: expected " in refused(COLUMNS, table)


@pytest.fixture
def fits(monkeypatch):
    """How many rows each fit was of."""
    counts, nearby = [], fit.nearby
    monkeypatch.setattr(
        fit, "nearby", lambda guess, each, *args: (counts.append(len(each)), nearby(guess, each, *args))[1]
    )
    return counts


@pytest.mark.parametrize(
    ("column", "value"), [(3, 1e3), (5, 1e6), (4, -5.0), (3, 100.0), (0, 3.1), (2, -3.0), (6, 12.0), (8, -3.0)]
)
def test_an_absurd_cell_is_refused_after_one_fit_of_the_other_rows(refused, good, fits, column, value):
    table = table_of(good)
    table[17, column] = value
    assert "row 18: expected " in refused(COLUMNS, table)
    assert fits == [24]


@pytest.mark.parametrize("value", [1e10, -1e300])
def test_a_position_beyond_all_trackers_is_named_by_its_cell(refused, good, fits, value):
    table = table_of(good)
    table[17, 5] = value
    assert "row 18, pose_z: expected metres" in refused(COLUMNS, table)
    assert fits == []


def test_a_row_that_is_a_little_off_is_the_first_that_is_tried(refused, good, fits):
    table = table_of(good)
    table[17, 8] += 0.02
    assert "row 18: expected " in refused(COLUMNS, table)
    assert fits == [25, 24]


def test_a_row_that_only_looks_astray_is_kept(good, monkeypatch):
    plain = calibrate(ROBOT, good)
    monkeypatch.setattr(fit, "stray_rows", lambda *_: [3, 11])
    np.testing.assert_array_equal(calibrate(ROBOT, good).change, plain.change)


def test_another_branch_is_named(good):
    guess = ROBOT.replace(legs=[{"branch": 1 if leg == 2 else -1} for leg in range(6)])
    with pytest.raises(ConfigurationError, match=r"robot.legs.2.branch: expected -1"):
        calibrate(guess, good)


def test_words_that_are_none(good):
    with pytest.raises(ConfigurationError, match="known_frames: expected some of base, platform"):
        calibrate(ROBOT, good, known_frames=("world",))
    with pytest.raises(ConfigurationError, match=r"hold: expected .*got 'mass'"):
        calibrate(ROBOT, good, hold=("mass",))


def test_arrays_of_another_shape():
    with pytest.raises(ConfigurationError, match=r"poses: angles: expected numbers of shape \(n, 6\)"):
        Measurements(np.zeros((3, 6)), np.zeros((3, 5)))
