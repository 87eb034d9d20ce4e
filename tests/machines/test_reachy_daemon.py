"""The client against the maker's own daemon and its simulation: set REACHY_DAEMON to the folder that
docs/scripts/reachy_daemon.py has installed, or may install it in; without that it is skipped."""

import os
import socket
import time
from pathlib import Path

import numpy as np
import pytest
from made_machines import SERVOS, docs_module, go_on

from stewart_drake.machines.machine import MachineError, open_machine
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics

FOLDER = os.environ.get("REACHY_DAEMON")
pytestmark = [
    pytest.mark.long,
    pytest.mark.xdist_group("reachy_daemon"),  # which is installed once
    pytest.mark.skipif(not FOLDER, reason="needs REACHY_DAEMON, a folder for the daemon"),
]


@pytest.fixture(scope="module")
def port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    process = docs_module("scripts/reachy_daemon").start(Path(FOLDER), port)
    deadline = time.monotonic() + 120.0
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            break
        except OSError:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.5)
    yield port
    process.terminate()
    process.wait()


def test_it_goes_home_and_nods(port):
    robot = SERVOS.robot
    machine = open_machine(f"reachy://127.0.0.1:{port}", SERVOS)
    machine.connect()
    start, home = machine.read().angles, inverse_kinematics(robot, robot.home_pose)
    assert np.abs(start - home).max() > 0.2  # Asleep.
    for k in range(150):
        machine.read()
        machine.command(start + min(k / 100, 1.0) * (home - start))
    reading = machine.read()
    np.testing.assert_allclose(reading.angles, home, atol=0.02)
    assert not reading.holding
    numbers, errors = [], []
    for k in range(100):
        nod = robot.home_pose + np.array([0.0, 0.26 * np.sin(2.0 * np.pi * k * machine.period), 0.0, 0.0, 0.0, 0.0])
        machine.command(inverse_kinematics(robot, nod))
        reading = machine.read()
        numbers.append(reading.number)
        if reading.pose is not None:
            errors.append(reading.pose - forward_kinematics(robot, reading.angles, robot.home_pose))
    assert numbers[-1] - numbers[0] >= 99
    assert len(errors) > 90
    # The pose is 2 ms older, of a head that turns with up to 90 deg/s.
    assert np.abs(errors).max(axis=0)[:3] == pytest.approx(0.0, abs=0.006)
    assert np.abs(errors).max(axis=0)[3:] == pytest.approx(0.0, abs=2e-4)
    machine.disconnect()


def test_another_client_is_served_too_and_a_killed_daemon_is_a_lost_machine(port):
    first, second = (open_machine(f"reachy://127.0.0.1:{port}", SERVOS) for _ in range(2))
    first.connect()
    second.connect()
    np.testing.assert_allclose(first.read().angles, second.read().angles, atol=0.01)
    first.disconnect()
    second._socket.close()
    with pytest.raises(MachineError, match="the connection is lost"):
        go_on(second)
    second.disconnect()
