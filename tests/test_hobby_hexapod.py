"""The page docs/hobby_hexapod.md, followed to the letter in an empty folder, but for a board that nobody has here."""

import json
import re
import shlex
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import environment

from stewart_drake import RobotParameters, inverse_kinematics, load_robot, load_scenario
from stewart_drake.mechanics.kinematics import forward_kinematics

PAGE = (Path(__file__).parents[1] / "docs" / "hobby_hexapod.md").read_text(encoding="utf-8")
CSV, YAML, OWN = re.findall(r"```(?:csv|yaml|python)\n(.*?)```", PAGE, re.DOTALL)
COMMANDS = [
    line
    for block in re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
    for line in block.replace("\\\n", " ").strip().splitlines()
]


def pose_of(row, robot):
    """The pose at a row of pulses [us]; the page's servos turn 180 deg from 500 to 2500 us, three of them downwards."""
    angles = (row[1:] - 1500.0) * np.array([1, -1, 1, -1, 1, -1]) * np.pi / 2000.0
    return forward_kinematics(robot, angles, robot.home_pose)


def test_a_perfect_servo_has_a_gain_of_one_by_the_page(tmp_path):
    """The angle that a crank turns in the step of `gain`, and where horns are at home."""
    (tmp_path / "points.csv").write_text(CSV)
    raised = float(re.search(r"reference=\{kind: hold, pose: \[0, 0, 0, 0, 0, ([\d.]+)\]", PAGE)[1])
    table = {"unit": "mm", "cranks": "towards", "crank_length": 30, "rod_length": 180}
    level, upright = (
        RobotParameters.from_table(tmp_path / "points.csv", home=home, **table) for home in ("level", "perpendicular")
    )
    home = np.degrees(inverse_kinematics(level, level.home_pose))
    turned = np.degrees(inverse_kinematics(level, [0, 0, 0, 0, 0, raised])) - home
    (said,) = {float(angle) for angle in re.findall(r"(?:up by|over) ([\d.]+) deg", PAGE)}
    assert turned == pytest.approx(said, rel=2e-3)
    assert home == pytest.approx(0.0, abs=0.2)
    above = float(re.search(r"([\d.]+) deg above level", PAGE)[1])
    assert np.degrees(inverse_kinematics(upright, upright.home_pose)) == pytest.approx(above, abs=0.2)
    assert all("controller.feedforward=none" in line for line in COMMANDS if "reference=" in line)


@pytest.mark.long
def test_the_page_takes_a_reader_from_points_to_a_platform_that_moves(call, tmp_path):
    (tmp_path / "points.csv").write_text(CSV)
    (tmp_path / "hobby.yaml").write_text(YAML)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    running, on_a_board = [], []
    try:
        for command in COMMANDS:
            words = shlex.split(command.removesuffix("&").replace("9000", port))
            if any(word.startswith("serial:/dev/") for word in words):
                on_a_board.append(words)
            elif command.endswith("&"):
                words = [sys.executable, *words[1:]] if words[0] == "python" else words
                running.append(subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment()))
                assert re.search(rf"{port}|serial:hexapod", running[-1].stdout.readline())
            elif words[0] == "stewart-drake":
                status, _, error = call(*words[1:])
                assert status == 0, (command, error)
            else:
                assert subprocess.run(command, shell=True, check=False).returncode == 0, command
        metrics = json.loads((tmp_path / "driven" / "metrics.json").read_text())
        assert metrics["status"] == "completed"
        assert max(metrics["rmse_norm_mm"], metrics["rmse_norm_deg"]) < 0.6, metrics
        running[-1].kill()
        # Poses from a program of one's own, and a board whose servos cannot tell their angles.
        running.append(subprocess.Popen(["trial/board", "hexapod", "own.csv"], stdout=subprocess.PIPE, text=True))
        assert "serial:hexapod" in running[-1].stdout.readline()
        subprocess.run([sys.executable, "-c", OWN], check=True, env=environment())
    finally:
        for process in running:
            process.kill()
            process.communicate()
    robot = load_robot("desk.yaml")
    rolls = [pose_of(row, robot)[0] for row in np.loadtxt("own.csv", delimiter=",")[::5]]
    assert max(rolls) == pytest.approx(0.05, abs=0.004)
    assert min(rolls) == pytest.approx(-0.05, abs=0.02)
    assert [words[1] for words in on_a_board] == ["drive", "drive", "live"]
    raised = load_scenario("hobby.yaml", [on_a_board[0][-1]]).reference.evaluate(0.0)[0]
    assert raised - robot.home_pose == pytest.approx([0, 0, 0, 0, 0, 0.01], abs=1e-4)
    assert (tmp_path / "driven" / "replay.html").exists()
    assert (tmp_path / "hexapod_board" / "hexapod_board.ino").exists()
