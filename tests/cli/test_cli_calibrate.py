"""The command `calibrate`."""

import csv

import numpy as np
import pytest
from simulated_calibration import aligned, change_to, deviating, measured
from strategies import ROBOT

from stewart_drake.calibration.poses import MeasurementNoise, load_measurements
from stewart_drake.robot.robot_files import load_robot


@pytest.mark.slow
def test_from_a_plan_to_a_robot(call, tmp_path):
    status, out, err = call("calibrate", "--plan", 20, "--robot", "paper", "--out", "plan.csv")
    assert (status, err) == (0, "")
    assert "rod length" in out
    planned = load_measurements(tmp_path / "plan.csv")
    assert len(planned) == 20
    rng = np.random.default_rng(0)
    truth = deviating(ROBOT, rng)
    (tmp_path / "poses.csv").write_text(measured(truth, planned, MeasurementNoise(), rng).to_csv())
    arguments = ("calibrate", "poses.csv", "--robot", "paper", "--out", "mine.yaml", "--report", "report")
    status, out, err = call(*arguments)
    assert (status, err) == (0, "")
    assert "pose error after" in out
    off = change_to(aligned(truth, ROBOT), load_robot(tmp_path / "mine.yaml"))
    assert np.abs(off).max() < 5e-3
    names = {path.name for path in (tmp_path / "report").iterdir()}
    assert names == {"calibration.png", "parameters.csv", "report.md", "residuals.csv"}
    with (tmp_path / "report" / "parameters.csv").open() as stream:
        assert len(list(csv.DictReader(stream))) == 66


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--robot", "paper"), "either POSES or --plan N"),
        (("poses.csv", "--robot", "paper"), "No such file"),
        (("--plan", "5", "--robot", "paper"), "--plan: expected a number of poses from 12"),
        (("--plan", "60", "--robot", "nobody"), "robot"),
        (("poses.csv", "--robot", "paper", "--position-noise", "0"), "noise.position: expected "),
        (("poses.csv", "--robot", "paper", "--set", "limits.reach=0.9"), "--set changes limits"),
    ],
)
def test_bad_input_ends_in_one_line(call, tmp_path, arguments, said):
    status, out, err = call("calibrate", *arguments)
    assert (status, out) == (2, "")
    assert said in err
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
