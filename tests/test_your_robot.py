"""The page docs/your_robot.md, walked through in an empty folder; runs shortened, campaigns left to their own tests."""

import re
import shlex
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from stewart_drake import RobotParameters, load_robot, load_scenario

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "your_robot.md").read_text()
CSV, SERVOS, OWN = re.findall(r"```(?:csv|yaml)\n(.*?)```", PAGE, re.DOTALL)
BLOCKS = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
COMMANDS = [line for block in BLOCKS for line in block.replace("\\\n", "").splitlines()]


@pytest.mark.long
def test_the_page_takes_a_reader_from_points_to_a_controlled_robot(call, tmp_path):
    assert (DOCS / "your_robot.csv").read_text() == CSV
    (tmp_path / "points.csv").write_text(CSV)
    done = set()
    for command in COMMANDS:
        name, *arguments = shlex.split(command)[1:]
        if name in ("workspace", "faults", "compare", "live"):
            continue
        short = ["--set", "duration=0.5"] if name == "run" else []
        status, _, error = call(name, *arguments, *short)
        assert status == 0, (command, error)
        done.add(name)
    assert done == {"robots", "check", "run", "write-sdf", "write-mjcf"}
    assert {"desk.yaml", "desk.png", "legs.png", "desk.sdf", "desk.xml"} <= {path.name for path in tmp_path.iterdir()}
    robot = load_robot("desk.yaml")
    again = RobotParameters.from_table("points.csv", unit="mm", cranks="towards", crank_length=30, rod_length=180)
    np.testing.assert_array_equal(robot.platform_joints, again.platform_joints)
    np.testing.assert_allclose(load_robot("again.yaml").platform_joints, robot.platform_joints, atol=1e-9)
    (tmp_path / "own.yaml").write_text(OWN)
    assert load_scenario("own.yaml").robot == robot
    assert call("check", "own.yaml")[0] == 0
    (tmp_path / "servos.yaml").write_text(SERVOS.replace("set:\n", "set:\n  duration: 2.0\n  plant: closed_form\n"))
    assert call("compare", "servos.yaml", "--out", "servos")[0] == 0
    rows = {row["controller"]: row["rmse_norm_mm"] for row in pq.read_table("servos/comparison.parquet").to_pylist()}
    plain, exact, *wrong = rows.values()
    assert exact < 0.2 * plain
    assert exact < min(wrong)
