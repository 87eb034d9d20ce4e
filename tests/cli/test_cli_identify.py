"""The commands `identify` and `excite`."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest
from strategies import ROBOT

from stewart_drake import load_robot, load_scenario
from stewart_drake.identification.parameters import COULOMB, of_robot
from stewart_drake.robot.leg import FrictionOptions

sys.path.insert(0, str(Path(__file__).parents[1] / "identification"))
from recordings import motion, recording, truth_of

GOOD = ("identify", "log.csv", "--robot", "paper")


@pytest.fixture
def truth(tmp_path):
    truth = truth_of(ROBOT)
    for name, seed in (("log.csv", 3), ("other.csv", 4)):
        (tmp_path / name).write_text(recording(ROBOT, truth, motion(ROBOT, seed), rate=100.0, noise=0.005).to_csv())
    return truth


def test_from_a_log_to_a_robot(call, tmp_path, truth):
    status, out, err = call(*GOOD, "--out", "mine.yaml", "--report", "report", "--validate", "other.csv")
    assert (status, err) == (0, "")
    assert "not used: recording other.csv" in out
    assert "3 rod_mass" in out
    robot = load_robot(tmp_path / "mine.yaml")
    assert robot.platform_mass == pytest.approx(truth[0], rel=0.01)
    assert {path.name for path in (tmp_path / "report").iterdir()} == {
        "friction.yaml",
        "identification.png",
        "parameters.csv",
        "report.md",
    }
    with (tmp_path / "report" / "parameters.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(of_robot(ROBOT))
    assert float(rows[0]["value"]) == pytest.approx(robot.platform_mass)
    # The friction goes into a scenario as it stands.
    friction = (tmp_path / "report" / "friction.yaml").read_text()
    (tmp_path / "run.yaml").write_text(f"model_robot: mine.yaml\n{friction}")
    believed = load_scenario(tmp_path / "run.yaml")
    assert isinstance(believed.plant.friction, FrictionOptions)
    np.testing.assert_allclose(believed.plant.friction.coulomb, truth[COULOMB], rtol=0.1)


@pytest.mark.usefixtures("truth")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("identify", "--robot", "paper"), "LOGS"),
        (("identify", "none.csv", "--robot", "paper"), "No such file"),
        ((*GOOD, "--hold", "mass"), "--hold"),
        ((*GOOD, "--bandwidth", "50"), "bandwidth: expected "),
        ((*GOOD, "--validate", "none.csv"), "No such file"),
        (("identify", "log.csv", "--robot", "nobody"), "robot"),
        (("identify", "log.csv", "--robot", "reachy_mini"), "expected a log of the robot that is guessed"),
        (("excite", "--robot", "paper", "--set", "limits.torque_fraction=1e-4"), "limits: expected "),
        (("excite", "--robot", "paper", "--duration", "1"), "--duration"),
    ],
)
def test_bad_input_ends_in_one_line(call, tmp_path, arguments, said):
    before = set(tmp_path.rglob("*"))
    status, out, err = call(*arguments, *(("--out", "mine.yaml") if "--robot" in arguments else ()))
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert said in err
    assert set(tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_a_designed_motion_is_run_and_its_log_identified(call, tmp_path):
    status, out, err = call("excite", "--robot", "paper", "--duration", 6, "--out", "excite.yaml")
    assert (status, err) == (0, "")
    assert "condition number" in out
    assert load_scenario(tmp_path / "excite.yaml").duration == 6.0
    loaded = (
        "plant.payload_mass=0.2",
        "plant.friction={coulomb: 0.02, viscous: 0.01}",
        "plant.payload_position=[0.02, 0, 0.03]",
    )
    sets = [word for each in loaded for word in ("--set", each)]
    status, _, err = call("run", "excite.yaml", *sets, "--out", "run", "--quiet")
    assert (status, err) == (0, "")
    status, _, err = call("identify", "run", "--robot", "paper", "--out", "mine.yaml", "--report", "report")
    assert (status, err) == (0, "")
    with (tmp_path / "report" / "parameters.csv").open() as stream:
        values = [float(row["value"]) for row in csv.DictReader(stream)]
    assert values[0] == pytest.approx(1.2, rel=0.005)
    np.testing.assert_allclose(values[1:4], [0.004, 0.0, 0.006], atol=1e-4)
    np.testing.assert_allclose(values[14:20], 0.02, rtol=0.02)
    np.testing.assert_allclose(values[20:26], 0.01, rtol=0.02)
