"""A machine that is reached by the packet of `packet`, whatever carries it."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from contextlib import suppress
from typing import Any

import numpy as np

from stewart_drake.machines import machine
from stewart_drake.machines import packet as wire
from stewart_drake.machines.machine import MachineError, Reading, Takes
from stewart_drake.scenario.scenario import Scenario

ASK_EVERY, ANSWER_WITHIN, COUNTED = 0.05, 3.0, 20
"""[s] between two requests while a connection opens, and until it is given up; readings that give the period."""
_DROPPED = {
    "garbage": "no packets",
    "foreign": "commands",
    "range": f"beyond {machine.LARGEST_ANGLE:.3g} rad: are they in rad, and is model.home right?",
    "old": "older than the one before",
}
KEPT = 1024  # Commands that are kept, with the time of sending.


class PacketMachine(ABC):
    """What is the same for every carrier of packets.

    Attributes:
        dropped: Packets that were not used, by reason: `garbage`, `foreign`, `range`, `old`.
    """

    period: float | None = None
    reads = True
    paced = True
    after = "its own side keeps the angles, or brakes"
    _looked = _listening = _arrived = _answered = 0.0
    _sent = np.zeros(KEPT)

    def __init__(self, scenario: Scenario, name: str) -> None:
        self._scenario, self.name = scenario, name
        self._limits = wire.rounded_inside(machine.command_limits(scenario))
        self.takes: Takes = scenario.belief.motors.takes  # type: ignore[assignment]
        self.dropped, self._line = Counter[str](), None  # type: Counter[str], Any
        self._forget()

    @abstractmethod
    def _open(self) -> Any:
        """Opens what carries the packets; it has a method `close`."""

    @abstractmethod
    def _send(self, line: Any, packet: bytes) -> None:
        """Sends one, or loses it where there is no room."""

    @abstractmethod
    def _receive(self, line: Any, timeout: float) -> list[bytes]:
        """What has arrived, in order; waits for something for at most some time [s]."""

    def connect(self) -> None:
        """Asks for readings until enough have come to know the period."""
        self.disconnect()
        try:
            with machine.line_errors(self.name):
                self._line = self._open()
            self._greet()
        except BaseException:
            self.disconnect()
            raise

    def _greet(self) -> None:
        begun, asked, first = time.monotonic(), 0, None
        while first is None or self._counted < COUNTED:
            waited = time.monotonic() - begun
            if waited > ANSWER_WITHIN:
                raise MachineError(self.name, f"sends no readings: {self._heard()}")
            if waited >= asked * ASK_EVERY:
                asked += 1
                self._tell(np.zeros(6), False)
            self._wait(ASK_EVERY)
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
        if begun - self._looked > wire.HOLD_AFTER:
            # Nobody has looked for a while; what the machine was silent about meanwhile says nothing.
            self._listening = begun
        if begun - self._sent[self._number % KEPT] > wire.HOLD_AFTER:
            # It holds anyway, and would soon send no more.
            self._tell(np.zeros(6), False)
        end = begun + machine.PATIENCE * (self.period or ASK_EVERY)
        while self._counted == counted and (left := end - time.monotonic()) > 0.0:
            self._wait(left)
        self._looked = now = time.monotonic()
        last, silent = self._last or last, now - max(self._arrived, self._listening)
        if silent > machine.LOST:
            raise MachineError(self.name, f"has sent no reading for {silent:.1f} s")
        held, ages = not last.flags & wire.ACTIVE, (now - self._arrived, now - self._answered)
        return Reading(
            last.values.copy(), last.microseconds * 1e-6, ages[0], self._total, ages[1], held, arrived=self._taken
        )

    def command(self, values: np.ndarray) -> None:
        """Sends commands (6,) that are to be followed."""
        self._connected()
        self._tell(machine.within_limits(values, self._limits, self.name), True)

    def disconnect(self) -> None:
        """Tells the machine to hold, and closes."""
        if self._line is not None:
            with suppress(MachineError):
                self._tell(np.zeros(6), False)
            with suppress(OSError):
                self._line.close()
        self._line = None
        self._forget()

    def _heard(self) -> str:
        told = [f"{count} that are {_DROPPED[why]}" for why, count in self.dropped.items()]
        return ", ".join(told) or "nothing has come"

    def _forget(self) -> None:
        self._last: wire.Packet | None = None
        now = time.monotonic()
        self._number, self._counted, self._sent = 0, 0, np.full(KEPT, now)
        self._values: list[np.ndarray | None] = [None] * KEPT  # None where a packet was no command.
        self._taken: np.ndarray | None = None
        self._total: int = 0
        self._looked = self._listening = self._arrived = self._answered = now

    def _connected(self) -> wire.Packet:
        if self._last is None:
            raise MachineError(self.name, "not connected; call connect first")
        return self._last

    def _tell(self, values: np.ndarray, active: bool) -> None:
        self._number, now = self._number + 1, time.monotonic()
        self._sent[self._number % KEPT] = now
        self._values[self._number % KEPT] = values if active else None
        answers, flags = 0 if self._last is None else self._last.number, wire.ACTIVE if active else 0
        packet = wire.Packet(wire.flags_of(self.takes, flags), self._number, answers, int(now * 1e6), values)
        with machine.line_errors(self.name):
            self._send(self._line, wire.encode(packet))

    def _wait(self, timeout: float) -> None:
        """Takes what arrives in some time [s], at once where something is there; the newest reading is kept."""
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
                # Numbers of the wire begin again after 2^32 - 1, those of readings do not.
                self._total += 1 if self._last is None else (packet.number - self._last.number) % 2**32
                self._last, self._arrived, self._counted = packet, time.monotonic(), self._counted + 1
                if packet.answers > 0 and (self._number - packet.answers) % 2**32 < KEPT:
                    self._answered = float(self._sent[packet.answers % KEPT])
                    self._taken = self._values[packet.answers % KEPT]


def _follows(packet: wire.Packet, last: wire.Packet) -> bool:
    return wire.newer(packet.number, last.number) and packet.microseconds >= last.microseconds
