"""Logs that cannot be right: one line that says what, where, and what is allowed."""

import dataclasses
import math

import numpy as np
import pytest
from recordings import motion, recording, truth_of
from strategies import ROBOT

from stewart_drake import Scenario, load_robot, run
from stewart_drake.errors import ConfigurationError
from stewart_drake.identification.identify import identify
from stewart_drake.identification.recording import load_recording, of_log
from stewart_drake.references.basic import HoldReference

LOG = recording(ROBOT, truth_of(ROBOT), rate=100.0)


def refused(log, robot=ROBOT, **options):
    """The line."""
    with pytest.raises(ConfigurationError) as caught:
        identify(robot, [log], **options)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def changed(**changes):
    return dataclasses.replace(LOG, **changes)


def test_a_good_log_is_read_back_from_its_file(tmp_path):
    (tmp_path / "log.csv").write_text(LOG.to_csv())
    read = load_recording(tmp_path / "log.csv", ROBOT)
    for name in ("time", "angles", "torque"):
        np.testing.assert_array_equal(getattr(read, name), getattr(LOG, name))


def test_degrees_and_millis_are_the_same_log(tmp_path):
    header, *_ = LOG.to_csv().splitlines()
    names = header.replace("time_s", "time_ms").replace("_rad", "_deg").replace("_Nm", "_mNm")
    table = np.column_stack([1e3 * LOG.time, np.degrees(LOG.angles), 1e3 * LOG.torque])
    text = "\n".join([names, *(",".join(map(repr, row)) for row in table.tolist())])
    (tmp_path / "log.csv").write_text(text)
    read = load_recording(tmp_path / "log.csv", ROBOT)
    np.testing.assert_allclose(read.angles, LOG.angles, atol=1e-14)
    np.testing.assert_allclose(read.torque, LOG.torque, atol=1e-14)


def test_angles_that_wrap_are_the_same_log():
    # They jump where each crank is in the middle of the log.
    there = LOG.angles[len(LOG.time) // 2]
    wrapped = there + (LOG.angles - there) % math.tau
    assert (np.abs(np.diff(wrapped, axis=0)).max(axis=0) > 6.0).all()
    np.testing.assert_allclose(changed(angles=wrapped).angles, LOG.angles, atol=1e-12)


def test_an_encoder_that_was_homed_a_turn_away_is_the_same_log():
    np.testing.assert_allclose(changed(angles=LOG.angles - math.tau).angles, LOG.angles, atol=1e-12)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (slice(0, 7), "column of torque_0: expected "),
        (slice(0, 12), "column of torque_5"),
        (slice(1, 13), "column of time"),
    ],
)
def test_a_file_without_a_column(tmp_path, columns, said):
    rows = [",".join(line.split(",")[columns]) for line in LOG.to_csv().splitlines()]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    assert said in refused(tmp_path / "log.csv")


def test_a_file_that_is_no_table(tmp_path):
    (tmp_path / "log.csv").write_text("time_s\nnow\n")
    assert "column of crank_angle_0" in refused(tmp_path / "log.csv")
    assert "readable" in refused(tmp_path / "none.csv")
    assert "log" in refused(tmp_path / "none.parquet")


def test_torques_that_nobody_measured():
    still = LOG.torque.copy()
    still[:, 2] = 0.0
    with pytest.raises(ConfigurationError, match=r"torque_2: expected .*got '0 in all rows'"):
        changed(torque=still)


@pytest.mark.parametrize("row", [0, 700])
def test_a_gap_in_time(row):
    time = LOG.time.copy()
    time[row + 1 :] += 0.3
    with pytest.raises(ConfigurationError, match=rf"expected rows at an even rate, without gaps.*row {row + 2}'"):
        changed(time=time)


def test_times_that_go_back():
    with pytest.raises(ConfigurationError, match="even rate"):
        changed(time=LOG.time[::-1])


def test_not_a_number():
    angles = LOG.angles.copy()
    angles[41, 3] = np.nan
    with pytest.raises(ConfigurationError, match="row 42, angles"):
        changed(angles=angles)


def test_degrees_that_say_radians():
    with pytest.raises(ConfigurationError, match="radians within"):
        changed(angles=np.degrees(LOG.angles))
    assert "cannot be assembled" in refused(changed(angles=np.degrees(LOG.angles) / 4.0))


def test_torques_in_another_unit():
    line = refused(changed(torque=1e3 * LOG.torque))
    assert "torque" in line
    assert "N m" in line


def test_torques_of_another_motion():
    other = recording(ROBOT, truth_of(ROBOT), motion(ROBOT, seed=9), rate=100.0)
    assert "no parameters explain" in refused(changed(torque=other.torque))


def test_too_short():
    assert "s of motion" in refused(recording(ROBOT, truth_of(ROBOT), seconds=1.0, rate=100.0))


def test_a_bandwidth_that_the_rows_do_not_carry():
    assert "bandwidth: expected above 0, at most 20 Hz" in refused(LOG, bandwidth=40.0)


def test_a_robot_that_stands_still():
    still = recording(ROBOT, truth_of(ROBOT), HoldReference(pose=tuple(ROBOT.home_pose)), rate=100.0)
    line = refused(still)
    assert "coulomb motor 0" in line or "platform_mass" in line
    assert "excite" in line


def test_a_motion_that_tells_no_inertia():
    slow = recording(ROBOT, truth_of(ROBOT), motion(ROBOT, size=0.02), rate=100.0, noise=0.02)
    line = refused(slow, ask=["platform_inertia"])
    assert "platform_inertia" in line
    assert "times its size" in line


def test_unknown_kinds_and_no_logs():
    assert "hold: expected " in refused(LOG, hold=["mass"])
    with pytest.raises(ConfigurationError, match="at least one log"):
        identify(ROBOT, [])


@pytest.fixture(scope="module")
def short_run():
    return run(Scenario(duration=0.1))


def test_a_log_of_another_robot(short_run):
    assert "another" not in str(of_log(short_run, ROBOT).source)
    with pytest.raises(ConfigurationError, match="expected a log of the robot that is guessed"):
        of_log(short_run, load_robot("reachy_mini"))


def test_a_log_whose_pose_is_not_what_was_read(short_run):
    scenario = short_run.scenario.replace({"estimator": {"kind": "observer"}, "sensors": {"kind": "encoders"}})
    with pytest.raises(ConfigurationError, match="estimator"):
        of_log(dataclasses.replace(short_run, scenario=scenario), ROBOT)
