"""`sim:`, a simulated machine: plant and motors of a scenario in real time, in another process, reached by packets.

`python -P -m stewart_drake.machines.simulated SCENARIO --port N` starts one by hand, for `udp://127.0.0.1:N`.

It is also an example for the robot's side of the protocol. It accepts commands of one peer only, in order, of the
right kind, finite and within limits. It sends one reading per tick while a peer sends requests. 0.1 s after the last
active command, or 20 ticks if that is sooner, it holds: motors that take angles keep the last one, motors that take
torques or currents close their brakes. It begins at home, holding.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import select
import socket
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from contextlib import suppress

import numpy as np

from stewart_drake.base.errors import StewartDrakeError, one_line
from stewart_drake.base.real_time import Pace, real_time
from stewart_drake.base.sampling import steps_per
from stewart_drake.machines import packet as wire
from stewart_drake.machines.machine import LOCALHOST, MachineError, command_limits
from stewart_drake.machines.packet_machine import UdpMachine
from stewart_drake.plant.plant_options import ANGLES
from stewart_drake.scenario.assembly import machine_side
from stewart_drake.scenario.scenario import Scenario, load_driven
from stewart_drake.scenario.stepped_loop import SteppedLoop

START_TIMEOUT = 300.0  # [s] The process may have to compile the laws first.
HOLD_TICKS = 20  # Ticks without an active command, then the robot holds: 0.1 s is too long for a fast loop.
LATE_DATAGRAMS = 50  # Datagrams that are read in a tick that is late.
MAX_LATENESS = 0.5  # [s] A simulation that is later does not catch up; the difference is lost.
Address = tuple[str, int]


class SimulatedMachine(UdpMachine):
    """A process that simulates a robot; it ends at `disconnect`, or with this process.

    Args:
        scenario: Scenario that is driven.
        other: File or shipped name of the scenario to simulate; empty for `scenario`.

    Attributes:
        counts: Counts of the robot's side, see `RobotSide`; known after `disconnect`.
    """

    after = ""

    def __init__(self, scenario: Scenario, other: str = "") -> None:
        super().__init__(scenario, LOCALHOST, 0)
        self._simulated, self.name = load_driven(other) if other else scenario, f"sim:{other}".rstrip(":")
        self._process: subprocess.Popen[bytes] | None = None
        self.counts: dict[str, int] = {}

    def _open(self) -> socket.socket:
        # -P: modules in the current folder must not hide those of Python.
        command = [sys.executable, "-P", "-m", "stewart_drake.machines.simulated", "-", "--port", "0"]
        # A new session: Ctrl-C stops the driver, which needs the robot while it slows down.
        self._process = process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(BrokenPipeError):
            process.stdin.write(pickle.dumps(self._simulated))
            process.stdin.flush()
        started = select.select([process.stdout], [], [], START_TIMEOUT)[0]
        if not (port := process.stdout.readline().strip() if started else b"").isdigit():
            raise MachineError(self.name, "the process of the simulation did not start")
        self._address = LOCALHOST, int(port)
        return super()._open()

    def disconnect(self) -> None:
        """Ends the process."""
        super().disconnect()
        process, self._process = getattr(self, "_process", None), None
        if process is not None:
            try:
                output = process.communicate(timeout=2.0)[0]
            except subprocess.TimeoutExpired:
                process.kill()
                output = process.communicate()[0]
            self.counts = json.loads(output) if output.startswith(b"{") else {}


class SimulatedRobot:
    """Plant, motors and sensors of a scenario, at rest at home; angles are those of the machine, see `Homed`.

    Attributes:
        command: (6,) of the motors, from the next step of the plant on.
        imu: (6,) reading of the inertial sensor, NaN where it is not new; None without one.
    """

    def __init__(self, scenario: Scenario) -> None:
        home = {"kind": "hold", "pose": scenario.robot.home_pose.tolist()}
        scenario = scenario.replace({"reference": home, "initial_offset": [0.0] * 6})
        self._loop = loop = SteppedLoop(scenario, parts=machine_side(scenario))
        self.step, self.period = scenario.plant.time_step, scenario.reading_period
        self.steps, self.command = steps_per("period", self.period, self.step), loop.runner.signal("command")
        reads_angles = scenario.sensors.reading == "angles"
        self._angles = loop.runner.signal("reading") if reads_angles else loop.measured[ANGLES]
        self.imu = loop.runner.signal("imu") if scenario.sensors.imu is not None else None
        self._home, self._takes_angles = np.array(scenario.controller_model.home), scenario.motors.holds
        self._gains = scenario.controller_model.robot.servo_gains
        loop.begin()
        loop.run_parts()

    @property
    def now(self) -> int:
        """Steps of the plant that are done."""
        return self._loop.now

    def reading(self) -> np.ndarray:
        """(6,) [rad] reading of the sensors."""
        return np.asarray((self._angles - self._home) / self._gains)

    def follow(self, values: np.ndarray) -> None:
        """Sets the commands (6,)."""
        self.command[:] = self._gains * values + self._home if self._takes_angles else values

    def advance(self, braked: bool) -> None:
        """One step of the plant; closed brakes keep the robot at rest."""
        loop, pose = self._loop, self._loop.pose.copy()
        loop.move()
        if braked:
            loop.measured[:] = loop.plant.initial(pose, np.zeros(6))
        loop.run_parts()


class RobotSide:
    """The robot's side of the protocol: which peer it accepts, which command it follows, when it holds.

    Attributes:
        peer: Address of the peer that is accepted.
        values: (6,) the command to follow; None to hold.
        counts: Packets `accepted`, dropped as `garbage`, `foreign`, `old` or `range`, and `missing`; commands `late`,
            more than 1 ms after the last reading.
    """

    def __init__(self, takes: str, limits: np.ndarray, hold_after: float = wire.HOLD_AFTER) -> None:
        self.takes, self.hold_after, self.counts = takes, hold_after, Counter[str]()
        self._low, self._high = limits
        self.peer: Address | None = None
        self.values: np.ndarray | None = None
        self._heard = self._active = self._sent = -np.inf
        self._number = self._heard_number = 0

    def holds(self, now: float) -> bool:
        """Whether there is no command to follow at a time [s]."""
        return self.values is None or now - self._active > self.hold_after

    def take(self, data: bytes, peer: Address, now: float) -> bool:
        """Handles a packet of a peer; True if it is a command to follow."""
        packet, quiet = wire.decode(data), now - self._heard > wire.QUIET_AFTER
        packet = None if packet is None or packet.imu is not None else packet
        active = packet is not None and bool(packet.flags & wire.ACTIVE)
        reason = "accepted"
        if (
            packet is None
            or packet.imu is not None
            or packet.flags & wire.READING
            or (active and packet.takes != self.takes)
        ):
            reason = "garbage"
        elif not quiet and peer != self.peer:
            reason = "foreign"
        elif not quiet and not wire.newer(packet.number, self._heard_number):
            reason = "old"
        elif active and not ((packet.values >= self._low) & (packet.values <= self._high)).all():
            reason = "range"
        else:
            self.counts["missing"] += 0 if quiet else (packet.number - self._heard_number) % 2**32 - 1
            self.counts["late"] += active and now - self._sent > 0.001
            self.peer, self._heard, self._heard_number, self._active = peer, now, packet.number, now
            self.values = packet.values if active else None
        self.counts[reason] += 1
        return active and reason == "accepted"

    def reading(self, angles: np.ndarray, time: float, now: float, imu: np.ndarray | None = None) -> bytes:
        """Packet of a reading (6,) [rad] at a time [s] of the robot's clock; empty if no peer sends requests.

        `imu` (6,) are inertial readings, None for a robot without.
        """
        if now - self._heard > wire.QUIET_AFTER:
            return b""
        self._number, self._sent = self._number + 1, now
        flags = wire.flags_of(self.takes, wire.READING, wire.MEASURED, 0 if self.holds(now) else wire.ACTIVE)
        return wire.encode(wire.Packet(flags, self._number, self._heard_number, round(time * 1e6), angles, imu))


def serve(scenario: Scenario, line: socket.socket, side: RobotSide) -> None:
    """Simulates a scenario behind a socket, without end; prints the port once the laws are compiled."""
    # Compiles the laws before the first tick.
    SimulatedRobot(scenario).advance(False)
    robot, brakes = SimulatedRobot(scenario), not scenario.motors.holds
    with real_time():
        print(line.getsockname()[1], flush=True)
        line.setblocking(False)
        pace = Pace(robot.period, MAX_LATENESS)
        while True:
            # A step is simulated once it is over, with the commands that arrived in it.
            due = pace.due
            if packet := side.reading(robot.reading(), robot.now * robot.step, time.monotonic(), robot.imu):
                assert side.peer is not None
                with suppress(OSError):
                    line.sendto(packet, side.peer)
            arrived: deque[tuple[float, np.ndarray]] = deque()
            read = 0
            while (left := due + robot.period - time.monotonic()) > 0.0 or read < LATE_DATAGRAMS:
                if not select.select([line], [], [], max(left, 0.0))[0]:
                    break
                read += 1
                with suppress(OSError):
                    data, peer = line.recvfrom(wire.LONGEST + 1)
                    if side.take(data, peer, now := time.monotonic()) and side.values is not None:
                        arrived.append((now, side.values))
            for k in range(robot.steps):
                while arrived and arrived[0][0] < due + (k + 1) * robot.step:
                    robot.follow(arrived.popleft()[1])
                robot.advance(brakes and side.holds(due + k * robot.step))
            pace.advance()


def main() -> None:
    """The process. Its scenario is a name or a file, or `-` for a pickled one on standard input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--host", default=LOCALHOST)
    parser.add_argument("--port", type=int, required=True)
    arguments = parser.parse_args()
    child = arguments.scenario == "-"
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
            line.bind((arguments.host, arguments.port))
            scenario = pickle.load(sys.stdin.buffer) if child else load_driven(arguments.scenario)
            _simulate(scenario, line, child)
    except (StewartDrakeError, OSError, OverflowError) as error:
        where = "" if isinstance(error, StewartDrakeError) else f"port {arguments.port}: "
        sys.exit(f"stewart-drake: simulated robot: {where}{one_line(error)}")


def _simulate(scenario: Scenario, line: socket.socket, child: bool) -> None:
    """Simulates until Ctrl-C, or until the parent of a child has ended."""
    hold_after = min(wire.HOLD_AFTER, HOLD_TICKS * scenario.reading_period)
    side = RobotSide(scenario.motors.command_quantity, command_limits(scenario), hold_after)

    def end_with_parent() -> None:
        sys.stdin.buffer.read()
        with suppress(OSError):
            print(json.dumps(side.counts), flush=True)
        os._exit(0)

    if child:
        threading.Thread(target=end_with_parent, daemon=True).start()
    try:
        serve(scenario, line, side)
    except KeyboardInterrupt:
        print(json.dumps(side.counts))


if __name__ == "__main__":
    main()
