"""`log.save("run.mcap")`, read with the reader of the package mcap."""

import json
import re
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from stewart_drake import load_scenario, run
from stewart_drake.mechanics.kinematics import rotation_matrix


@pytest.fixture(scope="module")
def log():
    made = run(load_scenario("exact_fig7", ["plant.kind=closed_form", "duration=0.2", "safety={}"]))
    numbers = {"lateness": 1e-4 * made.time, "reading_age": 2e-3 + 0.0 * made.time}
    return replace(made, signals={**made.signals, **numbers})


@pytest.fixture
def topics(log, tmp_path):
    return read(log, tmp_path)


def read(log, tmp_path):
    log.save(tmp_path / "run.mcap")
    made = defaultdict(list)
    with (tmp_path / "run.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            is_json = channel.message_encoding == "json"
            assert not is_json or json.loads(schema.data)["title"] == schema.name
            content = json.loads(message.data) if is_json else ros(schema, message.data)
            made[channel.topic].append((schema.name, message.log_time, content))
    return made


def ros(schema, data):
    """A message of ROS 2 as its schema has it: numbers by name; of a pose, its frame, time and seven numbers."""
    assert data[:4] == b"\0\1\0\0"
    if schema.name == "geometry_msgs/msg/PoseStamped":
        seconds, nanoseconds, size = np.frombuffer(data[4:16], "<u4").tolist()
        assert len(data) == 4 + 24 + 56
        numbers = np.frombuffer(data[28:], "<f8")
        return data[16 : 15 + size].decode(), seconds + 1e-9 * nanoseconds, numbers
    names = [line.removeprefix("float64 ") for line in schema.data.decode().splitlines()]
    assert re.fullmatch("stewart_drake/msg/[A-Z][A-Za-z0-9]*", schema.name)
    assert all(re.fullmatch("(?!.*__)(?!.*_$)[a-z][a-z0-9_]*", name) for name in names)
    return dict(zip(names, np.frombuffer(data[4:], "<f8").tolist(), strict=True))


def test_every_signal_has_a_topic_with_all_its_rows(log, topics):
    assert {f"/{name}" for name in log} - {"/time"} <= set(topics)
    for name in set(log) - {"time", "plant_state"}:
        values = np.array([list(message.values()) for _, _, message in topics[f"/{name}"]])
        np.testing.assert_array_equal(values, log[name].reshape(len(log.time), -1))
    assert topics["/lateness"][-1][2] == {"value": log["lateness"][-1]}
    times = [time for _, time, _ in topics["/pose"]]
    np.testing.assert_allclose(1e-9 * np.array(times), log.time, atol=1e-9)


def test_poses_and_joints_are_messages_that_viewers_know(log, topics):
    row = len(log.time) // 2
    _, _, (frame, time, numbers) = topics["/pose_in_base"][row]
    assert (frame, time) == ("base", pytest.approx(log.time[row], abs=1e-9))
    np.testing.assert_array_equal(numbers[:3], log["pose"][row, 3:])
    w, v = numbers[6], numbers[3:6]
    across = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    turned = np.eye(3) + 2.0 * w * across + 2.0 * across @ across
    np.testing.assert_allclose(turned, rotation_matrix(log["pose"][row, :3]), atol=1e-12)
    joints = topics["/joint_states"][row][2]["joints"]
    assert [each["position"] for each in joints] == log["crank_angle"][row].tolist()
    assert [each["effort"] for each in joints] == log["torque_applied"][row].tolist()


def test_a_reading_that_is_missing_is_no_message(log, tmp_path):
    signals = {**log.signals, "reading": log["crank_angle"].copy()}
    del signals["crank_angle"]
    signals["reading"][1::2, 3] = np.nan
    sent = read(replace(log, signals=signals), tmp_path)["/joint_states"]
    assert [time for _, time, _ in sent] == [round(1e9 * time) for time in log.time[::2]]


def test_the_scene_has_cranks_and_rods_of_their_lengths(log, topics):
    robot = log.scenario.robot
    assert len(topics["/scene"]) == pytest.approx(30 * 0.2, abs=1)
    for _, _, message in topics["/scene"]:
        cranks, rods, platform = (
            np.array([[point[axis] for axis in "xyz"] for point in line["points"]])
            for line in message["entities"][0]["lines"]
        )
        for lines, lengths in ((cranks, robot.crank_lengths), (rods, robot.rod_lengths)):
            np.testing.assert_allclose(np.linalg.norm(lines[1::2] - lines[::2], axis=1), lengths, rtol=1e-9)
        np.testing.assert_array_equal(rods[1::2], platform)


def test_a_log_of_a_table_without_poses_has_no_scene(log, tmp_path):
    bare = replace(log, signals={name: log[name] for name in ("time", "torque")})
    assert set(read(bare, tmp_path)) == {"/torque"}
