"""A machine on a serial line: the packet in frames of COBS."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from stewart_drake.base.errors import installed_with
from stewart_drake.machines.packet import from_frame, split_frames, to_frame
from stewart_drake.machines.packet_machine import PacketMachine
from stewart_drake.scenario.scenario import Scenario

WRITE_TIMEOUT = 0.005  # [s] A packet that the line does not take in this time is dropped: the loop must not wait.


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
            line.write(to_frame(packet))

    def _receive(self, line: Any, timeout: float) -> list[bytes]:
        line.timeout = timeout
        self._buffer += line.read(1)
        line.timeout = 0.0
        self._buffer += line.read(1 << 16)
        return [from_frame(frame) or b"" for frame in split_frames(self._buffer)]
