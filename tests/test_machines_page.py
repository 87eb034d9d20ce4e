"""The page docs/machines.md: its class runs, and its commands for Reachy Mini are scenarios."""

import itertools
import json
import re
import shlex
from pathlib import Path

import pytest

from stewart_drake.scenario.scenario import load_driven

PAGE = (Path(__file__).parents[1] / "docs" / "machines.md").read_text(encoding="utf-8")
COMMANDS = [
    shlex.split(line)
    for block in re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
    for line in block.replace("\\\n", " ").splitlines()
]


@pytest.mark.long
@pytest.mark.slow
def test_the_machine_of_the_page_is_driven(call, tmp_path):
    (mine,) = re.findall(r"```python\n([^`]*class MyMachine.*?)```", PAGE, re.DOTALL)
    (tmp_path / "mine.py").write_text(mine)
    (command,) = [each for each in COMMANDS if "mine.py:MyMachine" in each]
    status, _, err = call(*command[1:], "--out", "mine")
    assert status == 0, err
    metrics = json.loads((tmp_path / "mine" / "metrics.json").read_text())
    assert metrics["status"] == "completed"


def test_the_commands_for_reachy_mini_are_scenarios():
    drives = [each for each in COMMANDS if each[1] == "drive" and any("reachy://" in part for part in each)]
    assert len(drives) >= 5
    for _, _, name, *rest in drives:
        sets = [value for flag, value in itertools.pairwise(rest) if flag == "--set"]
        scenario = load_driven(name, sets)
        assert scenario.controller_model.motors.command_quantity == "angle"
        if "controller.feedforward=none" in sets:
            # Nothing but the angles of the inverse kinematics.
            assert (scenario.controller_model.motors.damping, scenario.controller_model.friction) == (0.0, None)
