"""Poses files that cannot be right: one line that names file, row and column."""

import numpy as np
import pytest
from simulated_calibration import deviating, measured
from strategies import ROBOT

from stewart_drake.calibration.fit import calibrate
from stewart_drake.calibration.poses import COLUMNS, MeasurementNoise, Measurements, candidate_poses
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.planning.limits import Limits

TURN = 180.0 / np.pi


@pytest.fixture(scope="module")
def good():
    rng = np.random.default_rng(0)
    pose = candidate_poses(ROBOT, 25, Limits(), rng)
    exact = Measurements(pose, inverse_kinematics(ROBOT, pose))
    return measured(deviating(ROBOT, rng), exact, MeasurementNoise(), rng)


@pytest.fixture
def refused(tmp_path):
    """The line with which a table is refused."""

    def refused(header, table):
        path = tmp_path / "poses.csv"
        path.write_text("\n".join([",".join(header), *(",".join(map(str, row)) for row in table)]))
        with pytest.raises(ConfigurationError) as caught:
            calibrate(ROBOT, path)
        assert len(str(caught.value).splitlines()) == 1
        assert str(path) in str(caught.value)
        return str(caught.value)

    return refused


@pytest.mark.parametrize(
    ("columns", "factor", "said"),
    [
        (slice(3, 6), 1e3, "millimetres for metres"),
        (slice(6, 12), 1.0 / TURN, "radians for degrees"),
        (slice(0, 3), TURN, "degrees by _deg"),
        (9, -1.0, "crank_angle_3: expected "),
    ],
)
def test_wrong_units_and_an_inverted_encoder(refused, good, columns, factor, said):
    table = good.table.copy()
    table[:, columns] *= factor
    assert said in refused(COLUMNS, table)


@pytest.mark.parametrize(("column", "by"), [(5, 2e-3), (8, 0.02), (3, 1e3), (0, 2.9)])
def test_a_single_wrong_row_is_named_whether_it_is_a_little_off_or_absurd(refused, good, column, by):
    table = good.table.copy()
    table[17, column] += by
    assert "row 18: expected " in refused(COLUMNS, table)


def test_cells_rows_and_columns_that_cannot_be(refused, good):
    table = good.table.copy()
    assert "column of pose_yaw: expected " in refused([*COLUMNS[:2], "yaw_turns", *COLUMNS[3:]], table)
    assert "at least 12 poses for 66 unknown numbers, better some 60, got '11 rows'" in refused(COLUMNS, table[:11])
    table[8, :6] = table[3, :6]
    assert "the pose of row 4 again in row 9" in refused(COLUMNS, table)
    table[6, 4] = -1e300
    assert "row 7, pose_y: expected metres" in refused(COLUMNS, table)
    table = good.table.copy()
    table[:, [7, 10]] = table[:, [10, 7]]
    assert "off the guess'; is it another one, or are two encoders swapped?" in refused(COLUMNS, table)


def test_another_branch_is_named_and_words_that_are_none(good):
    guess = ROBOT.replace(legs=[{"branch": 1 if leg == 2 else -1} for leg in range(6)])
    with pytest.raises(ConfigurationError, match=r"robot.legs.2.branch: expected -1"):
        calibrate(guess, good)
    with pytest.raises(ConfigurationError, match=r"hold: expected .*got 'mass'"):
        calibrate(ROBOT, good, hold=("mass",))
