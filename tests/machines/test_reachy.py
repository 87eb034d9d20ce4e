"""The client of Reachy Mini's daemon against a stand-in that sends what the daemon sent, and against the daemon."""

import json
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from made_machines import SERVOS, go_on

from stewart_drake.base.errors import MissingPackageError
from stewart_drake.machines.machine import MachineError, open_machine
from stewart_drake.mechanics.kinematics import forward_kinematics
from stewart_drake.reachy.machine import PERIOD_TICKS

websockets = pytest.importorskip("websockets")
STATUS, *MESSAGES = (Path(__file__).parent / "reachy_messages.jsonl").read_text(encoding="utf-8").splitlines()
TICKS = list(zip(MESSAGES[::2], MESSAGES[1::2], strict=False))


class Daemon:
    """Sends angles, then the pose, in each tick, and the status at times; obeys as the maker's does."""

    def __init__(self, speed=4.0):
        from websockets.sync.server import serve

        self.commands, self.extra, self.silent, self.tick, self.status = [], [], False, 0.02 / speed, STATUS
        self.server = serve(self.attend, "127.0.0.1", 0)
        self.thread = threading.Thread(target=self.server.serve_forever, daemon=True)
        self.port = self.server.socket.getsockname()[1]

    def attend(self, connection):
        from websockets.exceptions import ConnectionClosed

        assert connection.request.path == "/ws/sdk"
        self.connection = connection
        with suppress(ConnectionClosed):
            for k in range(10_000):
                if not self.silent:
                    for message in [*self.extra, *TICKS[k % len(TICKS)], *([self.status] if k % 20 == 0 else [])]:
                        connection.send(message)
                end = time.monotonic() + self.tick
                while (left := end - time.monotonic()) > 0.0:
                    with suppress(TimeoutError):
                        self.commands.append(json.loads(connection.recv(timeout=left)))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.server.shutdown()
        self.thread.join()


@pytest.fixture
def daemon():
    with Daemon() as started:
        yield started


@pytest.fixture
def machine(daemon):
    opened = open_machine(f"reachy://127.0.0.1:{daemon.port}", SERVOS)
    opened.connect()
    yield opened
    opened.disconnect()


def test_it_counts_the_ticks_and_measures_how_long_one_is(machine):
    readings = [machine.read() for _ in range(60)]
    numbers = np.array([reading.number for reading in readings])
    assert (np.diff(numbers) >= 1).all()
    assert (np.diff([reading.time for reading in readings]) > 0.0).all()
    # The stand-in waits for 5 ms between its messages.
    assert 0.005 <= machine.period < 0.015
    sent = [json.loads(angles)["head_joint_positions"][1:] for angles, _ in TICKS]
    for reading in readings:
        assert reading.angles.tolist() == sent[reading.number % len(sent)]
        assert 0.0 <= reading.age < 0.1
        assert not reading.holding
    assert (machine.takes, machine.reads, machine.paced) == ("angle", True, True)


def test_the_pose_of_a_tick_is_that_of_its_angles_in_the_base_frame(machine):
    # It is 2 ms older, the head turned at up to 72 deg/s, and the body stands at 0.3 rad.
    told = 0
    for _ in range(30):
        reading = machine.read()
        if reading.pose is not None:
            told += 1
            pose = forward_kinematics(SERVOS.robot, reading.angles, SERVOS.robot.home_pose)
            np.testing.assert_allclose(reading.pose[:3], pose[:3], atol=0.006)
            np.testing.assert_allclose(reading.pose[3:], pose[3:], atol=1e-4)
    assert told > 20


def test_a_command_has_seven_numbers_with_the_yaw_that_the_body_has(daemon, machine):
    angles = np.array([0.5, -0.6, 0.5, -0.5, 0.6, -0.7])
    machine.command(angles)
    machine.command(np.full(6, 9.0))
    for _ in range(5):
        machine.read()
    yaw = json.loads(TICKS[0][0])["head_joint_positions"][0]
    _, high = SERVOS.robot.crank_angle_ranges.T
    assert daemon.commands == [
        {"type": "set_head_joints", "joints": [yaw, *angles.tolist()]},
        {"type": "set_head_joints", "joints": [yaw, *high.tolist()]},
    ]
    with pytest.raises(MachineError, match="six finite numbers"):
        machine.command(np.full(6, np.nan))


def test_inertial_data_of_the_wireless_version_come_with_the_angles(daemon, machine):
    assert machine.read().imu is None
    daemon.extra = [
        '{"type": "imu_data", "accelerometer": [0.1, -0.2, 9.8], "gyroscope": [0.01, 0.02, -0.03],'
        ' "quaternion": [1, 0, 0, 0], "temperature": 31.5}'
    ]
    told = [imu.tolist() for _ in range(30) if (imu := machine.read().imu) is not None]
    assert len(told) > 15
    assert told[0] == [0.01, 0.02, -0.03, 0.1, -0.2, 9.8]


def test_other_messages_are_passed_over(daemon, machine):
    daemon.extra = [
        '{"type": "imu_data", "quaternion": [1, 0, 0, 0]}', "[1, 2]", "null", "no json", "5",
        '{"type": "joint_positions", "head_joint_positions": [1, 2, 3]}',
        '{"type": "joint_positions", "head_joint_positions": [1, 2, 3, 4, 5, 6, NaN]}',
        '{"type": "joint_positions", "head_joint_positions": [0, 0, 0, 0, 0, 0, 99]}',
        '{"type": "joint_positions"}', '{"type": "head_pose", "head_pose": "up"}', '{"type": "daemon_status"}',
        '{"type": "daemon_status", "backend_status": "broken"}', "[" * 200_000, '{"type": []}', b"\xff",
        f'{{"type": "joint_positions", "head_joint_positions": [{"9" * 400}, 2, 3, 4, 5, 6, 7]}}',
        f'{{"type": "head_pose", "head_pose": {[0] * 16}}}',
    ]  # fmt: skip
    numbers = [machine.read().number for _ in range(30)]
    assert 29 <= numbers[-1] - numbers[0] <= 60


def test_motors_that_are_off_are_reported(daemon, machine):
    daemon.status = STATUS.replace('"enabled"', '"disabled"')
    assert daemon.status != STATUS
    deadline = time.monotonic() + 5.0
    while not machine.read().holding:
        assert time.monotonic() < deadline


def test_a_daemon_that_sends_only_other_messages_is_lost_and_they_are_named(daemon, machine):
    daemon.silent = True
    daemon.connection.send('{"type": "joint_positions", "head_joint_positions": "all"}')
    with pytest.raises(MachineError, match=r"no angles for .* s; it sent '\{\"type\": \"joint_p"):
        go_on(machine)


def test_silence_is_an_older_reading_and_then_a_lost_machine(daemon, machine):
    daemon.silent = True
    machine.read()
    old = machine.read()
    older = machine.read()
    assert older.number == old.number
    assert 0.05 < older.age - old.age < 0.2
    with pytest.raises(MachineError, match=r"has sent no angles for 1\.\d s"):
        go_on(machine)


def test_a_closed_socket_is_a_lost_machine_in_one_line(daemon, machine):
    daemon.connection.close()
    with pytest.raises(MachineError, match=r"reachy://.*: the connection is lost") as caught:
        go_on(machine)
    assert "\n" not in str(caught.value)
    machine.disconnect()
    with pytest.raises(MachineError, match="not connected"):
        machine.read()


def test_without_a_daemon_it_says_so_in_one_line():
    with Daemon() as gone:
        pass
    with pytest.raises(
        MachineError, match=r"reachy://127.*: no daemon of Reachy Mini answers there; does it run"
    ) as caught:
        open_machine(f"reachy://127.0.0.1:{gone.port}", SERVOS).connect()
    assert "\n" not in str(caught.value)


def test_it_opens_again(machine):
    for _ in range(3):
        machine.disconnect()
        machine.connect()
        assert machine.read().number < PERIOD_TICKS + 5


@pytest.mark.parametrize(("url", "package"), [("reachy://", "websockets"), ("serial:/dev/ttyACM0", "serial")])
def test_a_missing_package_is_named_with_the_extra(url, package, monkeypatch):
    for name in (package, f"{package}.exceptions", f"{package}.sync.client"):
        monkeypatch.setitem(__import__("sys").modules, name, None)
    with pytest.raises(MissingPackageError, match=r"is not installed: pip install 'stewart-drake\[machines\]'"):
        open_machine(url, SERVOS).connect()
