"""A robot on UDP and on a serial line that loses, repeats, reorders and spoils packets, and one that ends."""

import os
import random
import select
import shlex
import socket
import subprocess
import sys
import time
import tty

import numpy as np
import pytest
from made_machines import ROOT, SERVOS, TORQUES, Robot, UdpRobot, go_on

from stewart_drake import load_log, run_metrics
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.machines.machine import MachineError, command_limits, open_machine
from stewart_drake.machines.packet import ACTIVE, READING, Packet, decode, encode, from_frame, split_frames, to_frame

FLOOD = """
import socket
line = socket.socket(type=socket.SOCK_DGRAM)
while True:
    line.sendto(b"x" * 48, ("127.0.0.1", %d))
"""


class SerialRobot(Robot):
    """At the other end of a pair of pseudo-terminals."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.end, self.line = os.openpty()
        tty.setraw(self.line)
        self.device, self.buffer = os.ttyname(self.line), bytearray()

    def receive(self, timeout):
        if select.select([self.end], [], [], timeout)[0]:
            self.buffer += os.read(self.end, 4096)
            for frame in split_frames(self.buffer):
                yield from_frame(frame) or b"", "line"

    def send(self, data):
        os.write(self.end, to_frame(data))

    def close(self):
        os.close(self.end)
        os.close(self.line)


def machine_of(robot, scenario=SERVOS):
    return open_machine(
        f"serial:{robot.device}" if isinstance(robot, SerialRobot) else f"udp://127.0.0.1:{robot.port}", scenario
    )


@pytest.fixture(params=[UdpRobot, SerialRobot])
def robot(request):
    with request.param() as made:
        yield made


@pytest.fixture
def machine(robot):
    opened = machine_of(robot)
    opened.connect()
    yield opened
    opened.disconnect()


def test_readings_and_commands_go_both_ways_at_the_robots_pace(robot, machine):
    assert (machine.takes, machine.reads, machine.paced) == ("angle", True, True)
    assert machine.period == pytest.approx(robot.period, rel=0.2)
    assert machine.read().holding
    wanted = np.array([0.1, -0.2, 0.3, -0.1, 0.2, 0.25])
    before = machine.read()
    for _ in range(50):
        reading = machine.read()
        machine.command(wanted)
    assert reading.number - before.number >= 50
    assert reading.time - before.time == pytest.approx((reading.number - before.number) * robot.period, rel=0.3)
    np.testing.assert_allclose(reading.angles, wanted, atol=1e-7)
    np.testing.assert_array_equal(reading.arrived, wanted)
    assert not reading.holding
    assert 0.0 <= reading.age < 0.1
    assert reading.age <= reading.command_age < 0.2
    machine.disconnect()
    time.sleep(0.02)
    assert robot.side.holds(time.monotonic())
    machine.disconnect()


def test_commands_are_cut_to_the_limits_and_numbers_are_needed(robot, machine):
    _, high = command_limits(SERVOS)
    machine.command(np.full(6, 9.0))
    for _ in range(5):
        reading = machine.read()
    np.testing.assert_allclose(reading.angles, high, atol=1e-6)
    assert (reading.angles <= high).all()
    assert robot.side.counts["range"] == 0
    for bad in (np.full(6, np.nan), np.zeros(5), np.array([0, 0, 0, 0, 0, -np.inf])):
        with pytest.raises(MachineError, match="six finite numbers"):
            machine.command(bad)


def test_a_pause_is_no_loss(machine):
    machine.command(np.zeros(6))
    time.sleep(1.3)  # Longer than the robot sends without being asked.
    for _ in range(30):
        reading = machine.read()
    assert reading.age < 0.1
    assert reading.holding


def test_it_opens_again_and_numbers_begin_anew(machine):
    machine.command(np.full(6, 0.1))
    machine.read()
    machine.connect()  # The robot takes others only once it has heard nothing for a second.
    for _ in range(5):
        machine.command(np.full(6, 0.2))
        reading = machine.read()
    assert reading.angles == pytest.approx(0.2)
    assert reading.command_age < 0.1


@pytest.mark.slow
def test_drops_repetitions_disorder_and_garbage_stop_nothing(robot, machine):
    chance, late = random.Random(3), []

    def mischief(data):
        sent = [] if chance.random() < 0.2 else [data]
        if chance.random() < 0.2:
            late.append(data)
        if late and chance.random() < 0.2:
            sent.append(late.pop(0))
        if chance.random() < 0.2:
            sent *= 2
        if chance.random() < 0.2:
            sent.append(chance.randbytes(chance.randint(1, 60)))
        if chance.random() < 0.2:
            spoilt = bytearray(data)
            spoilt[chance.randrange(48)] ^= 1 << chance.randrange(8)
            sent.append(bytes(spoilt))
        packet = decode(data)
        strange = [Packet(READING, packet.number + 1, 0, 0, np.full(6, 1e9)), packet._replace(flags=ACTIVE)]
        return [*sent, *(encode(each) for each in strange if chance.random() < 0.1)]

    robot.mischief = mischief
    numbers, times = [], []
    for k in range(400):
        reading = machine.read()
        machine.command(np.full(6, 1e-4 * k))
        numbers.append(reading.number)
        times.append(reading.time)
        assert np.abs(reading.angles).max() <= 0.04 + 1e-6
        assert reading.age < 0.5
    assert (np.diff(numbers) >= 0).all()
    assert (np.diff(times) >= 0).all()
    assert numbers[-1] - numbers[0] > 300
    assert {reason for reason in machine.dropped if machine.dropped[reason]} == {"old", "garbage", "range", "foreign"}


def test_a_reading_that_is_missing_is_given_again_older(robot, machine):
    machine.read()
    robot.mischief = lambda _: []
    machine.read()
    old, older = machine.read(), machine.read()
    assert old.number == older.number
    assert old.age < older.age
    with pytest.raises(MachineError, match=r"has sent no reading for 1\.\d s"):
        go_on(machine)


def test_commands_that_no_longer_arrive_show_in_their_age(robot, machine):
    for angle in (0.1, 0.2):
        machine.command(np.full(6, angle))
        machine.read()
    robot.side.take = lambda *_: False
    robot.side.reading = lambda *given, send=robot.side.reading: send(*given)
    for _ in range(20):
        machine.command(np.zeros(6))
        reading = machine.read()
    assert reading.command_age > 15 * robot.period
    assert reading.arrived.max() in (0.1, 0.2)
    assert reading.age < 0.1


def test_a_robot_that_takes_something_else_is_refused(robot):
    machine = machine_of(robot, TORQUES)
    with pytest.raises(ConfigurationError, match=r"model.motors: expected motors that take angle, as .* does"):
        machine.connect()
    assert robot.followed == []


@pytest.mark.parametrize(
    ("clock", "message"), [(lambda _: 5, "its clock stands still"), (lambda k: 10**9 - k, "no readings")]
)
def test_a_clock_that_does_not_go_on_is_one_line(robot, clock, message):
    robot.mischief = lambda data: [encode((packet := decode(data))._replace(microseconds=clock(packet.number)))]
    machine = machine_of(robot)
    with pytest.raises(MachineError, match=message):
        machine.connect()


def test_a_silent_robot_is_one_line():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mute:
        mute.bind(("127.0.0.1", 0))
        with pytest.raises(MachineError, match="sends no readings: nothing has come"):
            open_machine(f"udp://127.0.0.1:{mute.getsockname()[1]}", SERVOS).connect()


def test_nobody_there_is_one_line():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    machine = open_machine(f"udp://127.0.0.1:{port}", SERVOS)
    with pytest.raises(MachineError, match=f"udp://127.0.0.1:{port}: nobody listens there"):
        machine.connect()
    machine.disconnect()
    with pytest.raises(MachineError, match="not connected"):
        machine.read()
    with pytest.raises(MachineError, match=r"serial:/dev/nowhere: .*No such file"):
        open_machine("serial:/dev/nowhere", SERVOS).connect()


def test_a_line_that_is_unplugged_is_lost():
    robot = SerialRobot()
    with robot:
        machine = machine_of(robot)
        machine.connect()
    with pytest.raises(MachineError, match="serial:"):
        go_on(machine)
    machine.disconnect()


def test_a_full_line_does_not_stop_the_loop():
    robot = SerialRobot()
    with robot:
        machine = machine_of(robot)
        machine.connect()
        robot.receive = lambda timeout: time.sleep(timeout) or []
        began = time.monotonic()
        for _ in range(500):
            machine.command(np.zeros(6))
        assert time.monotonic() - began < 6.0
        machine.disconnect()


@pytest.mark.slow
def test_a_flood_from_elsewhere_and_from_the_robot_stops_neither_side():
    with UdpRobot() as robot:
        machine = machine_of(robot)
        machine.connect()
        own = machine._line.getsockname()[1]
        flooding = [subprocess.Popen([sys.executable, "-c", FLOOD % port]) for port in (robot.port, own)]
        robot.mischief = lambda data: [b"y" * 48] * 50 + [data]
        try:
            began = machine.read()
            for k in range(200):
                machine.command(np.full(6, 1e-4 * k))
                reading = machine.read()
        finally:
            for each in flooding:
                each.kill()
                each.wait()
        machine.disconnect()
    assert reading.number - began.number > 100
    assert len(robot.followed) > 20
    assert all(0.0 <= angles.min() <= angles.max() < 0.0201 for angles in robot.followed)
    assert robot.side.counts["garbage"] > 100


@pytest.mark.slow
def test_the_example_in_plain_python_is_a_robot():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    robot = subprocess.Popen([sys.executable, ROOT / "docs" / "robot_side.py", str(port)])
    try:
        machine = open_machine(f"udp://127.0.0.1:{port}", SERVOS)
        for _ in range(100):
            try:
                machine.connect()
                break
            except MachineError:
                time.sleep(0.05)
        for k in range(50):
            machine.command(np.full(6, 0.01 * k))
            reading = machine.read()
        assert reading.angles[0] > 0.3
        robot.kill()
        robot.wait()
        with pytest.raises(MachineError, match="nobody listens there"):
            go_on(machine)
        machine.disconnect()
    finally:
        robot.kill()
        robot.wait()


@pytest.mark.long
@pytest.mark.parametrize("controller", ["hobby_servos", "reachy_servos", "reachy_daemon"])
def test_the_shipped_controllers_of_servos_drive_the_example(controller, call):
    """At its period, by the command of docs/wire.md."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    page = (ROOT / "docs" / "wire.md").read_text(encoding="utf-8").replace("\\\n", " ")
    ((_, _, *command),) = [shlex.split(line) for line in page.splitlines() if line.startswith("stewart-drake drive")]
    robot = subprocess.Popen([sys.executable, ROOT / "docs" / "robot_side.py", str(port)])
    try:
        given = [word.replace("9000", str(port)) for word in command[1:]]
        status, _, err = call("drive", controller, *given, "--out", "there")
        assert status == 0, err
        assert run_metrics(load_log("there"))["worst_half_rmse_norm_deg"] < 1.0
    finally:
        robot.kill()
        robot.wait()


@pytest.mark.parametrize(
    "url",
    ["", "udp", "udp:", "udp://", "udp://h", "udp://h:0", "udp://h:99999", "udp://h:x", "udp://h:9/path", "udp:h:9",
     "serial:", "serial", "reachy:", "reachy:8000", "ftp://h:9", "mine.py", "mine.py:", "udp://a@h:9", "udp://[h:9"],
)  # fmt: skip
def test_a_url_that_names_no_machine_is_one_line(url):
    with pytest.raises(ConfigurationError) as caught:
        open_machine(url, SERVOS)
    assert str(caught.value).startswith("machine: expected ")
    assert "\n" not in str(caught.value)


def test_urls():
    assert open_machine("udp://:9", SERVOS).name == "udp://127.0.0.1:9"
    assert open_machine("udp://robot.local:9000", SERVOS)._address == ("robot.local", 9000)
    assert open_machine("serial:/dev/ttyACM0", SERVOS)._baud == 1_000_000
    assert open_machine("serial:COM3:115200", SERVOS)._baud == 115200
    assert open_machine("reachy://", SERVOS)._url == "ws://127.0.0.1:8000/ws/sdk"
    with pytest.raises(ConfigurationError, match=r"model.motors: expected motors that take angle, as reachy does"):
        open_machine("reachy://", TORQUES)


def test_inertial_readings_come_once_each_and_those_of_old_robots_are_none(robot):
    machine = machine_of(robot)
    machine.connect()
    assert machine.read().imu is None
    robot.imu = np.array([0.1, np.nan, 0.3, 0.0, 0.0, 9.81])
    deadline = time.monotonic() + 5.0
    while (imu := machine.read().imu) is None:
        assert time.monotonic() < deadline
    np.testing.assert_allclose(imu, robot.imu, rtol=1e-6)
    machine.disconnect()
