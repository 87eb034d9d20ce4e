"""Recorded moves of Reachy Mini, in its maker's JSON, against the maker's own kinematics."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from stewart_drake import ConfigurationError, inverse_kinematics, load_robot
from stewart_drake.reachy.moves import HEAD_HEIGHT, Move, head_of_pose, move_json, moves_of, pose_of_head, read_move
from stewart_drake.references import RecordedReference

sys.path.insert(0, str(Path(__file__).parents[1]))
from test_reachy_mini import makers

TIME = 5.0 + np.linspace(0.0, 1.0, 51)


def waving(body=0.3):
    wave = np.sin(np.outer(TIME, [5.0, 6.0, 7.0, 8.0, 9.0, 4.0])) * [0.1, 0.15, 0.2, 0.005, 0.005, 0.005]
    pose, yaw = wave + [0, 0, 0, 0, 0, HEAD_HEIGHT], body * np.cos(TIME)
    return Move("a wave", TIME, pose, np.column_stack([np.sin(TIME), TIME]), yaw)


def test_a_move_comes_back_from_its_file(tmp_path):
    move, path = waving(), tmp_path / "wave.json"
    path.write_bytes(move_json(move))
    back = read_move(path)
    assert back.description == "a wave"
    for name in ("time", "pose", "antennas", "body_yaw"):
        np.testing.assert_allclose(getattr(back, name), getattr(move, name), rtol=0.0, atol=1e-14)
    reference, rows = RecordedReference(motion_file=str(path), cutoff=None), TIME - TIME[0]
    before = rows < rows[-1] - 0.13  # it slows down
    np.testing.assert_allclose(reference.evaluate(rows[before])[0], move.pose[before], atol=1e-12)
    # A head may be sixteen numbers in a row, and the body's yaw left out: then it is 0.
    data = json.loads(path.read_bytes())
    for row in data["set_target_data"]:
        row["head"] = np.ravel(row["head"]).tolist()
        del row["body_yaw"]
    path.write_text(json.dumps(data))
    flat = read_move(path)
    np.testing.assert_allclose(head_of_pose(flat.pose, 0.0 * TIME), head_of_pose(move.pose, move.body_yaw), atol=1e-14)


def test_cranks_and_body_are_where_the_makers_kinematics_has_them(tmp_path):
    robot, solver, path = load_robot("reachy_mini"), makers(), tmp_path / "wave.json"
    turned = waving()
    # The head goes to 1.5 rad, and the body is told to stay: it must help.
    head = head_of_pose(turned.pose, 1.5 * np.linspace(0.0, 1.0, 51))
    rows = [{"head": each.tolist(), "antennas": [0, 0], "body_yaw": 0.1} for each in head]
    path.write_text(json.dumps({"description": "", "time": TIME.tolist(), "set_target_data": rows}))
    move = read_move(path)
    head[:, 2, 3] += HEAD_HEIGHT
    for pose, yaw, matrix in zip(move.pose, move.body_yaw, head, strict=True):
        theirs = solver.inverse_kinematics_safe(
            matrix.tolist(), body_yaw=0.1, max_relative_yaw=np.radians(65.0), max_body_yaw=np.radians(160.0)
        )
        np.testing.assert_allclose(yaw, theirs[0], atol=0.002)  # theirs is a little inside of 65 deg
        exact = solver.inverse_kinematics(matrix.tolist(), yaw)
        np.testing.assert_allclose(inverse_kinematics(robot, pose), exact, atol=1e-9)
    assert move.body_yaw[0] == 0.1
    assert move.body_yaw.max() > 0.15
    np.testing.assert_allclose(pose_of_head(head_of_pose(move.pose, move.body_yaw), move.body_yaw), move.pose)


GOOD = {"head": np.eye(4).tolist(), "antennas": [0, 0], "body_yaw": 0.0}
WRONG = {
    "no JSON": ("{", "Expecting"),
    "a list": ("[1]", "TypeError"),
    "no times": ({"set_target_data": [GOOD] * 4}, "KeyError: 'time'"),
    "fewer times": ({"time": [0, 1], "set_target_data": [GOOD] * 4}, "cannot reshape"),
    "three rows": ({"time": [0, 1, 2], "set_target_data": [GOOD] * 3}, "at least 4 rows"),
    "no rows": ({"time": [], "set_target_data": []}, "at least 4 rows"),
    "back in time": ({"time": [0, 1, 0, 2], "set_target_data": [GOOD] * 4}, r"ascend.*0 s after 1 s in time\[2\]"),
    "too long": ({"time": [0, 1, 2, 1e7], "set_target_data": [GOOD] * 4}, r"at most 600 s.*1e\+07 s"),
    "no time": ({"time": [0, 1, np.nan, 3], "set_target_data": [GOOD] * 4}, r"finite numbers.*time\[2\]"),
    "no head": ({"time": [0, 1, 2, 3], "set_target_data": [{"antennas": [0, 0]}] * 4}, "KeyError: 'head'"),
    "a small head": ({"time": [0, 1, 2, 3], "set_target_data": [{**GOOD, "head": [1, 2]}] * 4}, "cannot reshape"),
    "no rotation": ({"time": [0, 1, 2, 3], "set_target_data": [{**GOOD, "head": [[2] * 4] * 4}] * 4}, "a rotation"),
    "not finite": (
        {"time": [0, 1, 2, 3], "set_target_data": [*[GOOD] * 3, {**GOOD, "body_yaw": np.nan}]},
        r"\[3\]\.body",
    ),
    "words": ({"time": [0, 1, 2, 3], "set_target_data": [{**GOOD, "antennas": ["up", 0]}] * 4}, "could not convert"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_file_that_is_no_move_is_refused_in_a_line(tmp_path, name):
    content, said = WRONG[name]
    path = tmp_path / "move.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(ConfigurationError, match=said) as caught:
        read_move(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_rows_at_the_same_time_count_once(tmp_path):
    path = tmp_path / "move.json"
    rows = [GOOD | {"head": [[1, 0, 0, x], *np.eye(4)[1:].tolist()]} for x in (0.0, 0.001, 5.0, 0.002, 0.003)]
    path.write_text(json.dumps({"time": [0, 1, 1, 2, 3], "set_target_data": rows}))
    pose = RecordedReference(motion_file=str(path)).evaluate(np.array([1.0, 1.5, 2.0]))[0]
    np.testing.assert_allclose(pose[:, 3], [0.001, 0.0015, 0.002], atol=1e-12)


def test_a_move_of_ten_minutes_is_not_too_long(tmp_path):
    path = tmp_path / "move.json"
    path.write_text(json.dumps({"time": [5, 6, 7, 605], "set_target_data": [GOOD] * 4}))
    assert read_move(path).time[-1] == 605.0


def test_a_folder_without_moves_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"end in \.json"):
        moves_of(str(tmp_path))
