"""`sim:`, a scenario's plant and motors in real time, in a process of its own, behind the packet of a real machine.

`python -m stewart_drake.machines.simulated SCENARIO --port N` starts one by hand, for `udp://127.0.0.1:N`.

It is also the example of what a robot's side has to do: it takes commands of one peer alone, in order, of the right
kind, finite and within limits; it sends a reading in each tick while somebody asks; and 0.1 s after the last active
command it holds by itself: motors that take angles keep the last one, those that take torques or currents close their
brakes, which stop the robot where it is. So it stands at home until the first command comes.
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
from typing import Any

import numpy as np

from stewart_drake.base.sampling import steps_per
from stewart_drake.control.friction_compensation import standing_torque
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.motors import delay_part
from stewart_drake.loop.part import LoopRunner
from stewart_drake.machines.machine import LOCALHOST, MachineError, command_limits
from stewart_drake.machines.packet import (
    ACTIVE,
    HOLD_AFTER,
    MEASURED,
    QUIET_AFTER,
    READING,
    SIZE,
    Packet,
    decode,
    encode,
    flags_of,
    newer,
)
from stewart_drake.machines.udp import UdpMachine
from stewart_drake.plant.plant_options import ANGLES, CRANK_RATES, POSE, RATE
from stewart_drake.scenario.assembly import context_of, sensor_parts
from stewart_drake.scenario.scenario import Scenario, load_scenario

STARTS_WITHIN = 300.0
"""[s] for a process to compile what it needs, the first time."""
MOST_LATE = 50
"""Datagrams that are looked at in a tick that is late."""
LATEST = 0.5
"""[s] behind the clock from which on the simulation gives up catching up; its own clock then stands still."""


class SimulatedMachine(UdpMachine):
    """A process that simulates a robot, ended by `disconnect` or with this one.

    Args:
        scenario: What is driven.
        other: File or shipped name of the scenario that is simulated; empty for the same.
    """

    def __init__(self, scenario: Scenario, other: str = "") -> None:
        super().__init__(scenario, LOCALHOST, 0)
        self._scenario = load_scenario(other) if other else scenario
        self._process: subprocess.Popen[bytes] | None = None
        self.name, self.counts = f"sim:{other}", dict[str, Any]()

    def _open(self) -> None:
        self._close()
        command = [sys.executable, "-m", "stewart_drake.machines.simulated", "-", "--port", "0"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            pickle.dump(self._scenario, self._process.stdin)
            self._process.stdin.flush()
            ready = select.select([self._process.stdout], [], [], STARTS_WITHIN)[0]
            port = self._process.stdout.readline() if ready else b""
        except BrokenPipeError:
            port = b""
        if not port.strip().isdigit():
            raise MachineError(f"{self.name}: the process of the simulation did not start")
        self._address = LOCALHOST, int(port)
        super()._open()

    def _close(self) -> None:
        """Ends the process, which then says what it has counted."""
        super()._close()
        if self._process is None:
            return
        process, self._process = self._process, None
        try:
            said = process.communicate(timeout=2.0)[0].strip()
        except subprocess.TimeoutExpired:
            process.kill()
            said = process.communicate()[0].strip()
        self.counts = json.loads(said) if said.startswith(b"{") else {}


class SimulatedRobot:
    """Plant, motors and sensors of a scenario, with their delays; at home, at rest, with the brakes closed."""

    def __init__(self, scenario: Scenario) -> None:
        robot, step = scenario.robot, scenario.plant.time_step
        self.period, self.steps = scenario.reading_period, steps_per("period", scenario.reading_period, step)
        home, rest = robot.home_pose, np.zeros(6)
        torque = standing_torque(robot, home, scenario.gravity)
        context = context_of(scenario, True)._replace(pose=home, pose_rate=rest, initial_torque=torque)
        first = scenario.belief.motors.initial_command(context)
        late = round((scenario.command_delay * scenario.controller.period + scenario.motors.dead_time) / step)
        way = [delay_part(late, first)._replace(period=step).connected(value="command").named(value="arrived")]
        way.append(scenario.motors.part(robot, step).connected(command="arrived" if late else "command"))
        inside = {"plant_pose": slice(POSE.start, RATE.stop), "crank_state": slice(ANGLES.start, CRANK_RATES.stop)}
        parts = [*sensor_parts(scenario), *(way if late else way[1:])]
        self._runner = LoopRunner(parts, {"measured": 24, "command": 6}, inside, self.period, step)
        self._plant, self._measured = scenario.plant.make(robot, scenario.gravity), self._runner.signal("measured")
        self.command, self._torque = self._runner.signal("command"), self._runner.signal("torque")
        angles = scenario.sensors.reading == "angles"
        self.reading = self._runner.signal("reading") if angles else self._measured[ANGLES]
        self._measured[:] = self._plant.initial(home, rest)
        self.command[:], self._step, self.now, self._pushes = first, step, 0, scenario.disturbances

    def advance(self, braked: bool) -> None:
        """One step of the plant; with closed brakes the robot stands."""
        self._runner.time[0] = time = self.now * self._step
        self._runner.run(self.now)
        wrench = total_wrench(self._pushes, time) if self._pushes else np.zeros(6)
        if braked:
            self._measured[:] = self._plant.initial(self._measured[POSE].copy(), np.zeros(6))
        else:
            self._measured[:] = self._plant.step(self._torque, wrench)
        self.now += 1


class RobotSide:
    """What a robot does with packets: whom it listens to, what it follows, when it holds.

    Attributes:
        counts: accepted, and dropped by reason, `missing` in the sequence, `late` by more than 1 ms after the reading.
    """

    def __init__(self, takes: str, limits: np.ndarray) -> None:
        self.takes, self.counts = takes, Counter[str]()
        # In the numbers of the wire, or a limit itself would be beyond it.
        self._low, self._high = limits.astype(np.float32).astype(float)
        self.peer: Any = None
        self.values: np.ndarray | None = None
        self._number = self._heard_number = 0
        self._heard = self._active = -np.inf
        self._sent = 0.0

    def holds(self, now: float) -> bool:
        """Whether there is no command, at a time [s], that is to be followed."""
        return self.values is None or now - self._active > HOLD_AFTER

    def take(self, data: bytes, peer: Any, now: float) -> bool:
        """Looks at what a peer has sent; whether it is a command to be followed."""
        packet, quiet = decode(data), now - self._heard > QUIET_AFTER
        active = packet is not None and bool(packet.flags & ACTIVE)
        if packet is None or packet.flags & READING or (active and packet.takes != self.takes):
            reason = "garbage"
        elif peer != self.peer and not quiet:
            reason = "foreign"
        elif peer == self.peer and not quiet and not newer(packet.number, self._heard_number):
            reason = "old"
        elif active and not ((packet.values >= self._low) & (packet.values <= self._high)).all():
            reason = "range"
        else:
            reason = "accepted"
            if peer == self.peer and not quiet:
                self.counts["missing"] += (packet.number - self._heard_number) % 2**32 - 1
            self.peer, self._heard, self._heard_number = peer, now, packet.number
            self.values, self._active = (packet.values, now) if active else (None, -np.inf)
            self.counts["late"] += active and now - self._sent > 0.001
        self.counts[reason] += 1
        return reason == "accepted" and active

    def reading(self, angles: np.ndarray, time: float, now: float) -> bytes:
        """The packet of a reading (6,) [rad] at a time [s] of the robot's clock; nothing where nobody asks."""
        if now - self._heard > QUIET_AFTER:
            return b""
        self._number, self._sent = self._number + 1, now
        flags = flags_of(self.takes, READING, MEASURED, 0 if self.holds(now) else ACTIVE)
        return encode(Packet(flags, self._number, self._heard_number, round(time * 1e6), angles))


def serve(scenario: Scenario, opened: socket.socket, counts: dict[str, Any]) -> None:
    """Simulates a scenario behind a socket, for ever."""
    robot, side = SimulatedRobot(scenario), RobotSide(scenario.motors.takes, command_limits(scenario))
    # Everything is compiled before anybody waits.
    SimulatedRobot(scenario).advance(False)
    print(opened.getsockname()[1], flush=True)
    opened.setblocking(False)
    brakes, step = scenario.motors.takes != "angle", robot.period / robot.steps
    begun = time.monotonic()
    counts["counts"] = side.counts
    while True:
        due = begun + robot.now * step
        # A step is simulated when it is over, with the commands that have come until then.
        packet = side.reading(robot.reading, robot.now * step, time.monotonic())
        if packet:
            try:
                opened.sendto(packet, side.peer)
            except OSError:
                side.counts["unsent"] += 1
        arrived: deque[tuple[float, np.ndarray]] = deque()
        end = due + robot.period
        looked = 0
        while (left := end - time.monotonic()) > 0.0 or looked < MOST_LATE:
            if not select.select([opened], [], [], max(left, 0.0))[0]:
                break
            looked += 1
            try:
                data, peer = opened.recvfrom(SIZE + 1)
            except OSError:
                continue
            now = time.monotonic()
            if side.take(data, peer, now) and side.values is not None:
                arrived.append((now, side.values))
        for k in range(robot.steps):
            while arrived and arrived[0][0] < due + (k + 1) * step:
                robot.command[:] = arrived.popleft()[1]
            robot.advance(brakes and side.holds(due + k * step))
        if time.monotonic() - (begun + robot.now * step) > LATEST:
            begun = time.monotonic() - robot.now * step


def main() -> None:
    """The process: a scenario by its name or file, or `-` for one that comes pickled on standard input."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("--host", default=LOCALHOST)
    parser.add_argument("--port", type=int, required=True)
    arguments, counts = parser.parse_args(), dict[str, Any]()
    child = arguments.scenario == "-"
    scenario = pickle.load(sys.stdin.buffer) if child else load_scenario(arguments.scenario)

    def end_with_parent() -> None:
        sys.stdin.buffer.read()
        with suppress(OSError):
            print(json.dumps(counts.get("counts", {})), flush=True)
        os._exit(0)

    if child:
        threading.Thread(target=end_with_parent, daemon=True).start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind((arguments.host, arguments.port))
        try:
            serve(scenario, opened, counts)
        except KeyboardInterrupt:
            print(json.dumps(counts.get("counts", {})))


if __name__ == "__main__":
    main()
