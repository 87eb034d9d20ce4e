"""Logs that cannot be right: one line that says what, where, and what is allowed."""

import dataclasses
import math

import numpy as np
import pytest
from recordings import motion, recording, truth_of
from strategies import ROBOT

from stewart_drake import Scenario, load_robot, run
from stewart_drake.errors import ConfigurationError
from stewart_drake.identification.identified import identify
from stewart_drake.identification.samples import of_log
from stewart_drake.references.motions import HoldReference

LOG = recording(ROBOT, truth_of(ROBOT), rate=100.0)


def refused(log, robot=ROBOT, **options):
    """The line."""
    with pytest.raises(ConfigurationError) as caught:
        identify(robot, [log], **options)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def changed(**changes):
    return dataclasses.replace(LOG, **changes)


def test_angles_that_wrap_or_were_homed_a_turn_away_are_the_same_log():
    # They jump where each crank is in the middle of the log.
    there = LOG.angles[len(LOG.time) // 2]
    wrapped = there + (LOG.angles - there) % math.tau
    assert (np.abs(np.diff(wrapped, axis=0)).max(axis=0) > 6.0).all()
    for angles in (wrapped, LOG.angles - math.tau):
        np.testing.assert_allclose(changed(angles=angles).angles, LOG.angles, atol=1e-12)


def test_a_file_without_a_column(tmp_path):
    rows = [",".join(line.split(",")[:12]) for line in LOG.to_csv().splitlines()]
    (tmp_path / "log.csv").write_text("\n".join(rows))
    assert "column of torque_5: expected " in refused(tmp_path / "log.csv")
    assert "readable" in refused(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"torque": LOG.torque * [1, 1, 0, 1, 1, 1]}, "torque_2: expected "),
        ({"time": LOG.time + 0.3 * (LOG.time > LOG.time[700])}, "row 702'"),
        ({"angles": LOG.angles + np.where(np.arange(len(LOG.time)) == 41, np.nan, 0.0)[:, None]}, "row 42"),
        ({"angles": np.degrees(LOG.angles)}, "radians within"),
    ],
    ids=["still", "gap", "nan", "degrees"],
)
def test_readings_that_cannot_be_right(change, wanted):
    with pytest.raises(ConfigurationError, match=wanted):
        changed(**change)


def test_readings_and_torques_that_are_not_those_of_the_robot():
    assert "cannot be assembled" in refused(changed(angles=np.degrees(LOG.angles) / 4.0))
    assert "N m" in refused(changed(torque=1e3 * LOG.torque))
    other = recording(ROBOT, truth_of(ROBOT), motion(ROBOT, seed=9), rate=100.0)
    assert "no parameters explain" in refused(changed(torque=other.torque))
    assert "s of motion" in refused(recording(ROBOT, truth_of(ROBOT), seconds=1.0, rate=100.0))
    assert "hold: expected " in refused(LOG, hold=["mass"])


def test_a_motion_that_does_not_tell_what_is_asked():
    line = refused(recording(ROBOT, truth_of(ROBOT), HoldReference(pose=tuple(ROBOT.home_pose)), rate=100.0))
    assert "excite" in line
    slow = recording(ROBOT, truth_of(ROBOT), motion(ROBOT, size=0.02), rate=100.0, noise=0.02)
    assert "platform_inertia" in refused(slow, ask=["platform_inertia"])


def test_a_log_of_another_robot_or_with_a_pose_that_was_not_read():
    log = run(Scenario(duration=0.1))
    with pytest.raises(ConfigurationError, match="expected a log of the robot that is guessed"):
        of_log(log, load_robot("reachy_mini"))
    scenario = log.scenario.replace({"estimator": {"kind": "observer"}, "sensors": {"kind": "encoders"}})
    with pytest.raises(ConfigurationError, match="estimator"):
        of_log(dataclasses.replace(log, scenario=scenario), ROBOT)
