"""`sim:`, the simulation as a machine: a process of its own, in real time; and either side killed."""

import os
import socket
import subprocess
import sys
import time

import numpy as np
import pytest
from made_machines import ROOT, SERVOS, TORQUES, go_on

from stewart_drake import Controller, inverse_kinematics
from stewart_drake.machines.machine import MachineError, open_machine
from stewart_drake.machines.packet import Packet, decode, encode
from stewart_drake.machines.simulated import RobotSide, SimulatedRobot, main
from stewart_drake.plant.plant_options import ANGLES


@pytest.mark.parametrize("scenario", [SERVOS, TORQUES], ids=["servos", "torques"])
def test_the_robot_is_held_at_home_and_stopped_by_its_brakes(scenario):
    robot = SimulatedRobot(scenario)
    for _ in range(20):
        robot.advance(True)
    home = inverse_kinematics(scenario.robot, scenario.robot.home_pose)
    np.testing.assert_allclose(robot.reading(), home, atol=2e-3)
    for _ in range(20):
        robot.command += 1e-3
        robot.advance(False)
    moving = robot.reading().copy()
    for _ in range(20):
        robot.advance(True)
    np.testing.assert_allclose(robot.reading(), moving, atol=2e-3)


def test_its_inertial_sensor_feels_gravity_and_sends_it():
    robot = SimulatedRobot(SERVOS.replace({"sensors": {"kind": "encoders", "imu": {}}}))
    side = RobotSide("angle", np.array([[-1.0] * 6, [1.0] * 6]))
    side.take(encode(Packet(0, 1, 0, 0, np.zeros(6))), ("", 0), 0.0)
    packet = decode(side.reading(robot.reading(), 0.0, 0.0, robot.imu))
    assert np.linalg.norm(packet.imu[3:]) == pytest.approx(9.81, abs=0.5)
    assert SimulatedRobot(SERVOS).imu is None
    assert not side.take(encode(Packet(2, 2, 0, 0, np.zeros(6), packet.imu)), ("", 0), 0.0)  # commands have none


def test_servos_that_get_no_command_keep_the_last_angle():
    robot = SimulatedRobot(SERVOS)
    robot.command[:] += 0.05
    for _ in range(1500):
        robot.advance(False)
    settled = robot.reading().copy()
    for _ in range(200):
        robot.advance(False)
    np.testing.assert_allclose(robot.reading(), settled, atol=2e-3)


@pytest.mark.parametrize(
    ("scenario", "port", "message"),
    [
        ("hobby_servos", None, r"^stewart-drake: simulated robot: port \d+: OSError: .*in use$"),
        ("hobby_servos", "99999", r"^stewart-drake: simulated robot: port 99999: OverflowError: .*0-65535"),
        ("nope.yaml", "0", r"^stewart-drake: simulated robot: .*nope\.yaml"),
    ],
)
def test_a_simulation_that_cannot_start_ends_in_one_line(scenario, port, message, monkeypatch):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as used:
        used.bind(("127.0.0.1", 0))
        monkeypatch.setattr(sys, "argv", ["simulated", scenario, "--port", port or str(used.getsockname()[1])])
        with pytest.raises(SystemExit, match=message) as ended:
            main()
    assert "\n" not in str(ended.value)


def drive(machine, controller, ticks, out, begun=None):
    """Some ticks of a controller on a machine."""
    done = 0
    while done < ticks:
        reading = machine.read()
        begun = reading.time - machine.period if begun is None else begun
        if reading.time - begun > controller._last:
            controller.step(reading.angles, reading.time - begun, out, reading.age)
            done += 1
        machine.command(out)
    return reading


@pytest.mark.long
@pytest.mark.slow
def test_a_controller_drives_it_in_real_time():
    scenario = TORQUES.replace({"reference": "hold"})
    controller, out = Controller(scenario), np.zeros(6)
    home = inverse_kinematics(scenario.robot, scenario.robot.home_pose)
    controller.step(home, 0.0, out)  # Compiles.
    controller.reset()
    machine = open_machine("sim:", scenario)
    machine.connect()
    assert machine.period == pytest.approx(scenario.controller.period)
    began = machine.read()
    start = time.monotonic()
    reading = drive(machine, controller, 1000, out)
    assert time.monotonic() - start == pytest.approx(reading.time - began.time, abs=0.3)
    assert not reading.holding
    np.testing.assert_allclose(reading.angles, home, atol=5e-3)
    machine.disconnect()
    assert machine.counts["accepted"] > 500
    assert machine.counts.get("garbage", 0) == machine.counts.get("range", 0) == 0


@pytest.mark.slow
def test_a_killed_simulation_is_a_lost_machine(tmp_path, monkeypatch):
    # Files of the current folder are no code that was trusted.
    monkeypatch.chdir(tmp_path)
    for module in ("argparse", "json"):
        (tmp_path / f"{module}.py").write_text("raise SystemExit", encoding="utf-8")
    machine = open_machine("sim:", SERVOS)
    machine.connect()
    assert os.getpgid(machine._process.pid) != os.getpgid(0)  # Ctrl-C is not for it.
    machine._process.kill()
    with pytest.raises(MachineError, match="sim: nobody listens there"):
        go_on(machine)
    machine.disconnect()


@pytest.mark.slow
def test_a_child_ends_with_its_parent(shell_environment):
    code = (
        "from made_machines import SERVOS\nfrom stewart_drake.machines.machine import open_machine\n"
        "machine = open_machine('sim:', SERVOS)\nmachine.connect()\nprint(machine._process.pid, flush=True)\ninput()\n"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=shell_environment
    )
    child = int(parent.stdout.readline())
    parent.kill()
    parent.communicate()
    deadline = time.monotonic() + 10.0
    while is_running(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(child)


def is_running(process):
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.fixture
def shell_environment():
    folders = ROOT, ROOT / "tests", ROOT / "tests" / "machines", os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": os.pathsep.join(str(each) for each in folders if each)}


def test_readings_and_commands_have_the_delays_of_the_scenario():
    scenario = SERVOS.replace({"sensors.delay": 0.003, "sensors.resolution_bits": 0, "command_delay": 1})
    robot, true = SimulatedRobot(scenario), []
    stride = round(scenario.controller.period / robot.step)
    for step in range(3 * robot.steps):
        true.append(robot._loop.measured[ANGLES].copy())
        if step % robot.steps == 0 and step > 3:
            np.testing.assert_array_equal(robot.reading(), true[step - 3])
        if step == 1:
            robot.follow(robot.command + 0.1)
        robot.advance(False)
    moved = np.abs(np.diff(true, axis=0)).max(axis=1)
    assert moved[: stride + 1].max() < 1e-5 < moved[stride + 1 : stride + 4].max()


def test_a_bus_that_drops_all_commands_moves_nothing():
    robot = SimulatedRobot(SERVOS.replace({"link.stop_time": 0.0}))
    before = robot.reading()
    robot.follow(robot.command + 0.1)
    for _ in range(200):
        robot.advance(False)
    np.testing.assert_allclose(robot.reading(), before, atol=2e-3)
