"""A machine that is reached by the packets of `packet`, over UDP or a serial line."""

from __future__ import annotations

import socket
import time
from abc import ABC, abstractmethod
from collections import Counter
from contextlib import suppress
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from stewart_drake.base.errors import installed_with
from stewart_drake.machines import machine
from stewart_drake.machines import packet as wire
from stewart_drake.machines.machine import MachineError, Reading, Takes
from stewart_drake.scenario.scenario import Scenario

REQUEST_PERIOD = 0.05  # [s] between two requests while a connection opens.
CONNECT_TIMEOUT = 3.0  # [s]
PERIOD_READINGS = 20  # Readings from which the period is measured.
_DROPPED = {
    "garbage": "no packets",
    "foreign": "commands",
    "range": f"beyond {machine.LARGEST_ANGLE:.3g} rad: are they in rad, and is model.home right?",
    "old": "older than the one before",
}
MAX_DATAGRAMS = 1000  # Read at a time, however many arrive.
WRITE_TIMEOUT = 0.005  # [s] A packet that the line does not take in this time is dropped: the loop must not wait.
HISTORY = 1024  # Commands that are remembered until they are acknowledged.


class Line(Protocol):
    """A socket or a serial line."""

    def close(self) -> None:
        """Closes it."""


_Line = TypeVar("_Line", bound=Line)


class PacketMachine(ABC, Generic[_Line]):
    """Base of machines that exchange packets.

    Attributes:
        dropped: Count of dropped packets by reason: `garbage`, `foreign`, `range`, `old`.
    """

    period: float | None = None
    reads = True
    paced = True
    after = "its own side keeps the angles, or brakes"
    _read_at = _silent_since = _arrived_at = _acknowledged_at = 0.0
    _sent, _given = np.zeros(HISTORY), 0

    def __init__(self, scenario: Scenario, name: str) -> None:
        self._scenario, self.name = scenario, name
        self._limits = wire.rounded_inside(machine.command_limits(scenario))
        self.takes: Takes = scenario.controller_model.motors.command_quantity  # type: ignore[assignment]
        self.dropped: Counter[str] = Counter()
        self._line: _Line | None = None
        self._reset()

    @abstractmethod
    def _open(self) -> _Line:
        """Opens the connection."""

    @abstractmethod
    def _send(self, line: _Line, packet: bytes) -> None:
        """Sends a packet, or drops it if there is no room."""

    @abstractmethod
    def _receive(self, line: _Line, timeout: float) -> list[bytes]:
        """Packets that have arrived, in order; waits at most `timeout` [s] for the first."""

    def connect(self) -> None:
        """Opens the connection, and requests readings until the period is known."""
        self.disconnect()
        try:
            with machine.line_errors(self.name):
                self._line = self._open()
            self._measure_period()
        except BaseException:
            self.disconnect()
            raise

    def _measure_period(self) -> None:
        begun, asked, first = time.monotonic(), 0, None
        while first is None or self._counted < PERIOD_READINGS:
            waited = time.monotonic() - begun
            if waited > CONNECT_TIMEOUT:
                raise MachineError(self.name, f"sends no readings: {self._dropped_text()}")
            if waited >= asked * REQUEST_PERIOD:
                asked += 1
                self._send_command(np.zeros(6), False)
            self._wait(REQUEST_PERIOD)
            if first is None and self._last is not None:
                first, self._counted = self._last, 0
        last = self._last or first
        machine.check_takes(self._scenario, last.takes, self.name)
        self.reads = bool(last.flags & wire.MEASURED)
        microseconds = (last.microseconds - first.microseconds) / ((last.number - first.number) % 2**32)
        self.period = round(microseconds) / 1e6
        if self.period <= 0.0:
            raise MachineError(self.name, "its clock stands still")

    def read(self) -> Reading:
        """The next reading, or the last one again."""
        last, begun, counted = self._connected(), time.monotonic(), self._counted
        if begun - self._read_at > wire.HOLD_AFTER:
            # `read` was not called for a while, so silence in that time is no sign of a lost machine.
            self._silent_since = begun
        if begun - self._sent[self._number % HISTORY] > wire.HOLD_AFTER:
            # It holds by now, and would soon stop to send.
            self._send_command(np.zeros(6), False)
        end = begun + machine.PERIODS_TO_WAIT * (self.period or REQUEST_PERIOD)
        while self._counted == counted and (left := end - time.monotonic()) > 0.0:
            self._wait(left)
        self._read_at = now = time.monotonic()
        last, silent = self._last or last, now - max(self._arrived_at, self._silent_since)
        if silent > machine.LOST_AFTER:
            raise MachineError(self.name, f"has sent no reading for {silent:.1f} s")
        held, ages = not last.flags & wire.ACTIVE, (now - self._arrived_at, now - self._acknowledged_at)
        imu = last.imu if self._total > self._given else None
        self._given = self._total
        return Reading(
            last.values.copy(),
            last.microseconds * 1e-6,
            ages[0],
            self._total,
            ages[1],
            held,
            arrived=self._acknowledged,
            imu=imu,
        )

    def command(self, values: np.ndarray) -> None:
        """Sends commands (6,) to be followed."""
        self._connected()
        self._send_command(machine.within_limits(values, self._limits, self.name), True)

    def disconnect(self) -> None:
        """Tells the machine to hold, and closes."""
        if self._line is not None:
            with suppress(MachineError):
                self._send_command(np.zeros(6), False)
            with suppress(OSError):
                self._line.close()
        self._line = None
        self._reset()

    def _dropped_text(self) -> str:
        counts = [f"{count} that are {_DROPPED[why]}" for why, count in self.dropped.items()]
        return ", ".join(counts) or "nothing has come"

    def _reset(self) -> None:
        self._last: wire.Packet | None = None
        now = time.monotonic()
        self._number, self._counted, self._sent = 0, 0, np.full(HISTORY, now)
        self._values: list[np.ndarray | None] = [None] * HISTORY  # None where a packet was no command.
        self._acknowledged: np.ndarray | None = None
        self._total: int = 0
        self._given = 0  # `_total` at the last `read`.
        self._read_at = self._silent_since = self._arrived_at = self._acknowledged_at = now

    def _connected(self) -> wire.Packet:
        if self._last is None:
            raise MachineError(self.name, "not connected; call connect first")
        return self._last

    def _send_command(self, values: np.ndarray, active: bool) -> None:
        self._number, now = self._number + 1, time.monotonic()
        self._sent[self._number % HISTORY] = now
        self._values[self._number % HISTORY] = values if active else None
        answers, flags = 0 if self._last is None else self._last.number, wire.ACTIVE if active else 0
        packet = wire.Packet(wire.flags_of(self.takes, flags), self._number, answers, int(now * 1e6), values)
        assert self._line is not None
        with machine.line_errors(self.name):
            self._send(self._line, wire.encode(packet))

    def _wait(self, timeout: float) -> None:
        """Receives packets, waiting at most `timeout` [s] for the first; keeps the newest reading."""
        assert self._line is not None
        with machine.line_errors(self.name):
            arrived = self._receive(self._line, timeout)
        for packet in map(wire.decode, arrived):
            if packet is None:
                self.dropped["garbage"] += 1
            elif not packet.flags & wire.READING:
                self.dropped["foreign"] += 1
            elif np.abs(packet.values).max() > machine.LARGEST_ANGLE:
                self.dropped["range"] += 1
            elif self._last is not None and not _follows(packet, self._last):
                self.dropped["old"] += 1
            else:
                # Numbers of packets wrap at 2^32; the count of readings does not.
                self._total += 1 if self._last is None else (packet.number - self._last.number) % 2**32
                self._last, self._arrived_at, self._counted = packet, time.monotonic(), self._counted + 1
                if packet.answers > 0 and (self._number - packet.answers) % 2**32 < HISTORY:
                    self._acknowledged_at = float(self._sent[packet.answers % HISTORY])
                    self._acknowledged = self._values[packet.answers % HISTORY]


class UdpMachine(PacketMachine[socket.socket]):
    """A machine at a host and a port; datagrams from elsewhere are dropped by the system."""

    def __init__(self, scenario: Scenario, host: str, port: int) -> None:
        super().__init__(scenario, f"udp://{host}:{port}")
        self._address = host, port

    def _open(self) -> socket.socket:
        family, kind, protocol, _, address = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
        line = socket.socket(family, kind, protocol)
        # The system now drops datagrams from elsewhere.
        line.connect(address)
        return line

    def _send(self, line: socket.socket, packet: bytes) -> None:
        with suppress(BlockingIOError):
            line.send(packet)

    def _receive(self, line: socket.socket, timeout: float) -> list[bytes]:
        data: list[bytes] = []
        line.settimeout(timeout)
        with suppress(TimeoutError, BlockingIOError):
            while len(data) < MAX_DATAGRAMS:
                # One byte more than a packet, so that a longer datagram is not taken for one.
                data.append(line.recv(wire.LONGEST + 1))
                line.settimeout(0.0)
        return data


class SerialMachine(PacketMachine[Any]):
    """A machine at a serial device, at a rate [baud]; USB lines ignore the rate."""

    def __init__(self, scenario: Scenario, device: str, baud: int) -> None:
        super().__init__(scenario, f"serial:{device}")
        self._device, self._baud, self._buffer = device, baud, bytearray()

    def _open(self) -> Any:
        with installed_with("stewart-drake[machines]"):
            import serial
        self._buffer.clear()
        self._full = serial.SerialTimeoutException
        line = serial.Serial(self._device, self._baud, timeout=0.0, write_timeout=WRITE_TIMEOUT)
        line.reset_input_buffer()
        return line

    def _send(self, line: Any, packet: bytes) -> None:
        with suppress(self._full):
            line.write(wire.to_frame(packet))

    def _receive(self, line: Any, timeout: float) -> list[bytes]:
        line.timeout = timeout
        self._buffer += line.read(1)
        line.timeout = 0.0
        self._buffer += line.read(1 << 16)
        return [wire.from_frame(frame) or b"" for frame in wire.split_frames(self._buffer)]


def _follows(packet: wire.Packet, last: wire.Packet) -> bool:
    return wire.newer(packet.number, last.number) and packet.microseconds >= last.microseconds
