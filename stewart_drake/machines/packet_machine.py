"""A machine that is reached by the packet of `packet`, whatever carries it."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from contextlib import suppress

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.machines.machine import (
    LOST,
    PATIENCE,
    MachineError,
    Reading,
    Takes,
    command_limits,
    within_limits,
)
from stewart_drake.machines.packet import ACTIVE, HOLD_AFTER, MEASURED, READING, Packet, decode, encode, flags_of, newer
from stewart_drake.scenario.scenario import Scenario

ASK_EVERY, ANSWER_WITHIN = 0.05, 3.0
"""[s] between two requests while a connection opens, and until it is given up."""
COUNTED = 20
"""Readings from which the period is measured."""
LARGEST_ANGLE = 4.0 * np.pi
"""[rad] of a reading that is believed."""
KEPT = 1024
"""Commands whose time of sending is kept."""
MOST_PACKETS = 1000
"""Packets that one `read` looks at, however many come."""


class PacketMachine(ABC):
    """What is the same for every carrier of packets.

    Attributes:
        dropped: Packets that were not used, by reason: `garbage`, `old`, `foreign`, `range`.
    """

    period: float | None = None
    reads = True
    paced = True

    def __init__(self, scenario: Scenario, name: str) -> None:
        self.takes: Takes = scenario.belief.motors.takes  # type: ignore[assignment]
        self._limits, self.name, self.dropped = command_limits(scenario), name, Counter[str]()
        self._motors = scenario.belief.motors.kind
        self._forget()

    @abstractmethod
    def _open(self) -> None:
        """Opens what carries the packets."""

    @abstractmethod
    def _send(self, packet: bytes) -> None:
        """Sends one."""

    @abstractmethod
    def _receive(self, timeout: float) -> list[bytes]:
        """What has arrived, in order; waits for something for at most some time [s]."""

    @abstractmethod
    def _close(self) -> None:
        """Closes it; may be called twice, and never raises."""

    def connect(self) -> None:
        """Asks for readings until enough have come to know the period."""
        self.disconnect()
        try:
            self._open()
            self._greet()
        except BaseException:
            self.disconnect()
            raise

    def _greet(self) -> None:
        gave_up, ask, first = time.monotonic() + ANSWER_WITHIN, 0.0, None
        while first is None or self._counted < COUNTED:
            now = time.monotonic()
            if now > gave_up:
                raise MachineError(f"{self.name} sends no readings: {dict(self.dropped) or 'nothing has come'}")
            if now >= ask:
                ask = now + ASK_EVERY
                self._tell(np.zeros(6), False)
            self._wait(ASK_EVERY)
            if first is None and self._last is not None:
                first, self._counted = self._last, 0
        assert self._last is not None
        if self._last.takes != self.takes:
            allowed = f"motors that take {self._last.takes}, as {self.name} says of its own"
            raise ConfigurationError("motors.kind", self._motors, allowed)
        counted = (self._last.number - first.number) % 2**32
        self.reads = bool(self._last.flags & MEASURED)
        self.period = (self._last.microseconds - first.microseconds) * 1e-6 / counted

    def read(self) -> Reading:
        """The next reading, or the last one again."""
        if self._last is None or self.period is None:
            raise MachineError(f"{self.name} is not connected; call connect first")
        begun, counted = time.monotonic(), self._counted
        if begun - self._looked > HOLD_AFTER:
            # Nobody has looked for a while; what the machine was silent about meanwhile says nothing.
            self._listening = begun
        if begun - self._sent[self._number % KEPT] > HOLD_AFTER:
            # It holds anyway, and would soon send no more.
            self._tell(np.zeros(6), False)
        while self._counted == counted and (left := begun + PATIENCE * self.period - time.monotonic()) > 0.0:
            self._wait(left)
        self._looked = now = time.monotonic()
        last, silent = self._last, now - max(self._arrived, self._listening)
        if silent > LOST:
            raise MachineError(f"{self.name} has sent no reading for {silent:.1f} s")
        age, held = now - self._arrived, not last.flags & ACTIVE
        return Reading(last.values.copy(), last.microseconds * 1e-6, age, last.number, now - self._answered, held)

    def command(self, values: np.ndarray) -> None:
        """Sends commands (6,) that are to be followed."""
        if self._last is None:
            raise MachineError(f"{self.name} is not connected; call connect first")
        self._tell(within_limits(values, self._limits), True)

    def disconnect(self) -> None:
        """Tells the machine to hold, and closes."""
        if self._last is not None:
            with suppress(MachineError):
                self._tell(np.zeros(6), False)
        self._close()
        self._forget()

    def _forget(self) -> None:
        self._last: Packet | None = None
        self._number = self._counted = 0
        self._looked = self._listening = self._arrived = self._answered = time.monotonic()
        self._sent = np.full(KEPT, self._looked)

    def _tell(self, values: np.ndarray, active: bool) -> None:
        self._number += 1
        now = time.monotonic()
        self._sent[self._number % KEPT] = now
        answers = 0 if self._last is None else self._last.number
        flags = flags_of(self.takes, ACTIVE if active else 0)
        self._send(encode(Packet(flags, self._number, answers, int(now * 1e6), values)))

    def _wait(self, timeout: float) -> None:
        """Takes what arrives in some time [s], at once where something is there; the newest reading is kept."""
        for data in self._receive(timeout)[-MOST_PACKETS:]:
            packet = decode(data)
            reason = self._reason_against(packet)
            if packet is None or reason:
                self.dropped[reason] += 1
                continue
            self._last, self._arrived, self._counted = packet, time.monotonic(), self._counted + 1
            behind = (self._number - packet.answers) % 2**32
            if behind < KEPT and packet.answers > 0:
                self._answered = float(self._sent[packet.answers % KEPT])

    def _reason_against(self, packet: Packet | None) -> str:
        if packet is None:
            return "garbage"
        if not packet.flags & READING:
            return "foreign"
        if np.abs(packet.values).max() > LARGEST_ANGLE:
            return "range"
        return "" if self._last is None or newer(packet.number, self._last.number) else "old"
