"""A machine of the user's own: what it may be, and what is said of one that is not as it should be."""

import threading

import numpy as np
import pytest
from made_machines import SERVOS, TORQUES

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.machines.machine import MachineError, open_machine

MINE = """
import sys
import time

import numpy as np

from stewart_drake.machines.machine import Reading


class MyMachine:
    period = 0.02

    def connect(self):
        self.angles = np.zeros(6)

    def read(self):
        return self.angles

    def command(self, values):
        self.angles = values

    def disconnect(self):
        pass


class WithClock(MyMachine):
    paced, reads, takes = True, False, "angle"

    def __init__(self, robot, scenario):
        self.robot, self.clock, self.period = robot, 0.0, scenario.controller.period

    def read(self):
        self.clock += self.period
        return self.angles.tolist(), self.clock


class Now(MyMachine):
    def read(self):
        return {answer}


class Counts(MyMachine):
    def read(self):
        return Reading(self.angles, time.monotonic(), 0.0, 7)

    def disconnect(self):
        sys.exit("gone")


class NoCommand:
    connect = read = disconnect = print


class Asks:
    def __init__(self, port):
        pass
"""


@pytest.fixture
def mine(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def opened(name, answer="None", scenario=SERVOS, trust=True):
        (tmp_path / "mine.py").write_text(MINE.replace("{answer}", answer), encoding="utf-8")
        return open_machine(f"mine.py:{name}", scenario, trust)

    return opened


def test_four_methods_are_enough(mine):
    machine = mine("MyMachine")
    assert (machine.period, machine.takes, machine.reads, machine.paced) == (0.02, "angle", True, False)
    machine.connect()
    wanted = np.full(6, 0.2)
    machine.command(wanted)
    wanted[:] = 9.0
    first, second = machine.read(), machine.read()
    assert first.angles.tolist() == [0.2] * 6
    assert second.number == first.number + 1
    assert second.time > first.time
    assert 0.0 <= second.age < 0.1
    machine.command(np.full(6, 9.0))
    assert machine.read().angles == pytest.approx(SERVOS.robot.crank_angle_ranges[:, 1])
    machine.disconnect()


def test_inertial_readings_may_be_missing_but_not_infinite(mine):
    reading = "Reading(self.angles, 0.0, 0.0, 1, imu=[0, 0, {}, 0, 0, 9.8])"
    machine = mine("Now", reading.format("float('nan')"))
    machine.connect()
    assert machine.read().imu[5] == 9.8
    with pytest.raises(MachineError, match="read gave imu"):
        mine("Now", reading.format("float('inf')")).connect()


def test_one_with_a_clock_and_attributes_of_its_own(mine):
    machine = mine("WithClock")
    assert (machine.period, machine.takes, machine.reads, machine.paced) == (0.01, "angle", False, True)
    machine.connect()
    assert machine.read().time == pytest.approx(0.02)
    with pytest.raises(ConfigurationError, match=r"model.motors: expected motors that take angle, as .*WithClock does"):
        mine("WithClock", scenario=TORQUES)


def test_its_code_has_to_be_trusted(mine):
    with pytest.raises(ConfigurationError, match=r"machine: expected code that you trust, .*--trust-code"):
        mine("MyMachine", trust=False)
    with pytest.raises(ConfigurationError, match=r"expected reachy://.*'; for class nope of module usb add --trust"):
        open_machine("usb:nope", SERVOS)


@pytest.mark.parametrize("answer", ["5", "[1, 2]", "'up'", "[float('nan')] * 6", "([0] * 6, 'now')", "self"])
def test_what_is_no_reading_is_a_line(mine, answer):
    machine = mine("Now", answer)
    with pytest.raises(MachineError, match=r"mine.py:Now: read gave") as caught:
        machine.connect()
    assert "\n" not in str(caught.value)


def test_no_new_reading_is_the_last_one_older(mine):
    machine = mine("Now", "self.angles if self.first() else None\n    seen = False\n    def first(self):\n"
                   "        self.seen, seen = True, self.seen\n        return not seen")  # fmt: skip
    machine.connect()
    first, second = machine.read(), machine.read()
    assert first.number == second.number
    assert second.age > first.age > 0.0


def test_readings_that_are_not_counted_and_an_exit_at_the_end_are_lines(mine):
    machine = mine("Counts")
    machine.connect()
    with pytest.raises(MachineError, match="a newer reading has number 7 after 7"):
        machine.read()
    machine.disconnect()
    assert machine.after == "its disconnect raised SystemExit: gone"


@pytest.mark.parametrize("name", ["read", "command"])
def test_what_blocks_is_a_machine_that_is_lost(mine, name, monkeypatch):
    machine = mine("MyMachine")
    machine.connect()
    go_on, before = threading.Event(), getattr(machine._object, name)

    def blocks(*given):
        go_on.wait()
        return before(*given)

    blocks.__name__ = name
    setattr(machine._object, name, blocks)
    monkeypatch.setattr("stewart_drake.machines.machine.LOST_AFTER", 0.02)
    with pytest.raises(MachineError, match=rf"mine\.py:MyMachine: its {name} has not returned for 0\.02 s"):
        machine.read() if name == "read" else machine.command(np.zeros(6))
    machine.disconnect()
    go_on.set()
    monkeypatch.setattr("stewart_drake.machines.machine.LOST_AFTER", 5.0)
    # An answer that comes late is not taken for that of the next call.
    machine.command(np.full(6, 0.1))
    assert machine.read().angles.tolist() == [0.1] * 6


def test_what_it_raises_is_its_own(mine):
    machine = mine("Now", "1 / 0")
    with pytest.raises(MachineError, match=r"ZeroDivisionError.*mine\.py, line"):
        machine.connect()
    machine = mine("Now", "open('/nowhere')")
    with pytest.raises(MachineError, match=r"mine.py:Now: .*No such file"):
        machine.connect()


@pytest.mark.parametrize(
    ("name", "message"), [("NoCommand", "command is missing"), ("Asks", "can be constructed"), ("Other", "a name that")]
)
def test_a_class_that_is_none_is_a_line(mine, name, message):
    with pytest.raises(ConfigurationError, match=f"machine: .*{message}"):
        mine(name)
