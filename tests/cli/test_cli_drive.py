"""`drive`, with a machine of the user's own whose servos are at once where they are told to be."""

import pytest

from stewart_drake.logs.log import load_log

MINE = """
import numpy as np
from stewart_drake import inverse_kinematics

class Servos:
    period, takes, reads, paced, count = 0.02, "angle", True, True, 0

    def __init__(self, robot):
        self.angles = inverse_kinematics(robot, robot.home_pose)

    def connect(self): pass
    def disconnect(self): pass

    def read(self):
        self.count += 1
        return self.angles.copy(), 0.02 * self.count

    def command(self, values):
        self.angles = np.array(values)
"""


@pytest.fixture
def drive(call, tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    return lambda *more: call("drive", "reachy_servos", "--machine", "mine.py:Servos", "--trust-code", *more)


@pytest.mark.parametrize("seconds", ["nan", "inf", "-1", "0", "1e9"])
def test_a_time_that_is_none_is_one_line(drive, seconds):
    status, out, err = drive("--for", seconds, "--out", "there")
    assert (status, out) == (2, "")
    assert "--for: expected from 0.1 to 40000 s of the motion" in err
    assert len(err.strip().splitlines()) == 1


def test_results_of_the_same_scenario_are_replaced_and_no_others(drive, tmp_path):
    assert drive("--for", "500ms", "--out", "there")[0] == 0
    first = load_log(tmp_path / "there")
    assert drive("--for", "1", "--out", "there")[0] == 0
    assert load_log(tmp_path / "there").end_time > first.end_time
    status, _, err = drive("--for", "1", "--out", "there", "--set", "model.gravity=9.8")
    assert status == 2
    assert "a folder without the results of another scenario, or --force" in err
