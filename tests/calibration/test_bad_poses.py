"""Poses files that cannot be right: one line that names file, row and column."""

import numpy as np
import pytest
from simulated_calibration import deviating, measured
from strategies import ROBOT

from stewart_drake.calibration.fit import calibrate
from stewart_drake.calibration.measurements import COLUMNS, MeasurementNoise, Measurements, load_measurements
from stewart_drake.calibration.pose_plan import candidate_poses
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
        path.write_text("\n".join([",".join(header), *(",".join(map(str, row)) for row in table)]))
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
    assert (table_of(load_measurements(path)) == table_of(good)).all()
    factors = np.array([180.0 / np.pi] * 3 + [1e3] * 3 + [180.0 / np.pi] * 6)
    other = [f"{name.rpartition('_')[0]}_{'mm' if name.endswith('_m') else 'deg'}" for name in COLUMNS]
    rows = np.column_stack([np.arange(len(good)), (table_of(good) * factors)[:, ::-1]])
    lines = [",".join(["number", *reversed(other)]), *(",".join(map(repr, row)) for row in rows.tolist())]
    path.write_text("\ufeff" + "\r\n".join(lines) + "\r\n\r\n", encoding="utf-8")
    assert table_of(load_measurements(path)) == pytest.approx(table_of(good))


@pytest.mark.parametrize(("cell", "said"), [("nan", "row 7, pose_y: expected "), ("abc", "'abc'"), ("1,5", "got 13")])
def test_cells_that_are_no_numbers(refused, good, cell, said):
    table = table_of(good).astype(object)
    table[6, 4] = cell
    assert said in refused(COLUMNS, table)


def test_columns_and_rows_that_are_missing_or_there_twice(refused, good):
    table = table_of(good)
    names = ["yaw_turns" if name == "pose_yaw_rad" else name for name in COLUMNS]
    assert "column of pose_yaw: expected " in refused(names, table)
    twice = "column of crank_angle_4: expected one of"
    assert twice in refused([*COLUMNS[:-1], "crank_angle_4_deg"], table)
    assert "at least 12 poses for 66 unknown numbers, better some 60, got '11 rows'" in refused(COLUMNS, table[:11])
    table[8, :6] = table[3, :6]
    assert "the pose of row 4 again in row 9" in refused(COLUMNS, table)
    table[8] = table[3]
    assert "the row of row 4 again in row 9" in refused(COLUMNS, table)


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


def test_an_inverted_encoder_is_named(refused, good):
    table = table_of(good)
    table[:, 9] *= -1.0
    assert "crank_angle_3: expected " in refused(COLUMNS, table)


def test_swapped_encoders_are_not_taken_for_another_robot(refused, good):
    table = table_of(good)
    table[:, [7, 10]] = table[:, [10, 7]]
    assert "off the guess'; is it another one, or are two encoders swapped?" in refused(COLUMNS, table)


@pytest.mark.parametrize(
    ("column", "by"), [(5, 2e-3), (8, 0.02), (3, 1e3), (5, 1e5), (4, -5.0), (0, 2.9), (6, 12.0), (8, -3.0)]
)
def test_a_single_wrong_row_is_named_whether_it_is_a_little_off_or_absurd(refused, good, column, by):
    table = table_of(good)
    table[17, column] += by
    assert "row 18: expected " in refused(COLUMNS, table)


def test_a_position_beyond_all_trackers_is_named_by_its_cell(refused, good):
    table = table_of(good)
    table[17, 5] = -1e300
    assert "row 18, pose_z: expected metres" in refused(COLUMNS, table)


def test_another_branch_is_named(good):
    guess = ROBOT.replace(legs=[{"branch": 1 if leg == 2 else -1} for leg in range(6)])
    with pytest.raises(ConfigurationError, match=r"robot.legs.2.branch: expected -1"):
        calibrate(guess, good)


def test_words_and_shapes_that_are_none(good):
    with pytest.raises(ConfigurationError, match="known_frames: expected some of base, platform"):
        calibrate(ROBOT, good, known_frames=("world",))
    with pytest.raises(ConfigurationError, match=r"hold: expected .*got 'mass'"):
        calibrate(ROBOT, good, hold=("mass",))
    with pytest.raises(ConfigurationError, match=r"poses: angles: expected numbers of shape \(n, 6\)"):
        Measurements(np.zeros((3, 6)), np.zeros((3, 5)))
