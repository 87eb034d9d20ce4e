"""Robots' sides for tests: a thread that behaves as docs/wire.md says, and worse where a test asks for it."""

import importlib.util
import select
import socket
import threading
import time
from pathlib import Path

import numpy as np

from stewart_drake.machines.machine import command_limits
from stewart_drake.machines.simulated import RobotSide
from stewart_drake.scenario.scenario import load_scenario

ROOT = Path(__file__).parents[2]
SERVOS = load_scenario("reachy_nod", ["plant={kind: closed_form}", "motors.kind=position", "model={}", "safety=null"])
TORQUES = load_scenario("exact_fig7", ["plant.kind=closed_form", "sensors.kind=encoders"])


def docs_module(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def go_on(machine):
    """Until it is lost."""
    for _ in range(1000):
        machine.command(np.zeros(6))
        machine.read()


class Robot(threading.Thread):
    """Sends a reading in each tick, of the last command; `mischief` makes of each packet those that are sent."""

    def __init__(self, scenario=SERVOS, period=0.004, takes=None):
        super().__init__(daemon=True)
        self.side = RobotSide(takes or scenario.motors.command_quantity, command_limits(scenario))
        self.period, self.mischief, self.followed = period, lambda data: [data], []
        self.ended = threading.Event()
        self.angles, self.imu = np.zeros(6), None

    def run(self):
        begun, tick = time.monotonic(), 0
        while not self.ended.is_set():
            tick += 1
            while (left := begun + tick * self.period - time.monotonic()) > 0.0:
                for data, peer in self.receive(left):
                    if self.side.take(data, peer, time.monotonic()):
                        self.angles = self.side.values
                        self.followed.append(self.angles)
            now = time.monotonic()
            packet = self.side.reading(self.angles, now - begun, now, self.imu)
            for data in self.mischief(packet) if packet else []:
                self.send(data)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.ended.set()
        self.join()
        self.close()


class UdpRobot(Robot):
    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]

    def receive(self, timeout):
        if select.select([self.socket], [], [], timeout)[0]:
            yield self.socket.recvfrom(64)

    def send(self, data):
        self.socket.sendto(data, self.side.peer)

    def close(self):
        self.socket.close()
