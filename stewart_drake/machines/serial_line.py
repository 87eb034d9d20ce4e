"""A machine on a serial line: the packet in frames of COBS."""

from __future__ import annotations

from typing import Any

from stewart_drake.base.errors import installed_with
from stewart_drake.machines.machine import MachineError
from stewart_drake.machines.packet import from_frame, split_frames, to_frame
from stewart_drake.machines.packet_machine import PacketMachine
from stewart_drake.scenario.scenario import Scenario

WRITTEN_WITHIN = 0.005
"""[s] after which a packet that the line does not take is given up."""


class SerialMachine(PacketMachine):
    """What answers at a serial device, at a rate [baud]; USB lines ignore the rate."""

    def __init__(self, scenario: Scenario, device: str, baud: int) -> None:
        super().__init__(scenario, f"serial:{device}")
        self._device, self._baud, self._line, self._buffer = device, baud, None, bytearray()

    def _open(self) -> None:
        with installed_with("stewart-drake[machines]"):
            import serial
        self._buffer.clear()
        try:
            # A line that is full must not stop the loop: a command is lost then, and the age of commands tells.
            self._line = serial.Serial(self._device, self._baud, timeout=0.0, write_timeout=WRITTEN_WITHIN)
            self._line.reset_input_buffer()
        except (OSError, ValueError) as error:
            raise self._lost(error) from None

    def _send(self, packet: bytes) -> None:
        line = self._opened()
        try:
            line.write(to_frame(packet))
        except OSError as error:
            # One of pyserial's, of a line that is full, is an OSError too.
            if type(error).__name__ != "SerialTimeoutException":
                raise self._lost(error) from None

    def _receive(self, timeout: float) -> list[bytes]:
        line = self._opened()
        try:
            line.timeout = max(timeout, 0.0)
            self._buffer += line.read(1)
            line.timeout = 0.0
            self._buffer += line.read(1 << 16)
        except (OSError, TypeError) as error:  # TypeError: pyserial's, of a line that is closed meanwhile
            raise self._lost(error) from None
        return [from_frame(frame) or b"" for frame in split_frames(self._buffer)]

    def _close(self) -> None:
        try:
            if self._line is not None:
                self._line.close()
        except OSError:
            pass
        self._line = None

    def _opened(self) -> Any:
        if self._line is None:
            raise MachineError(f"{self.name} is not connected; call connect first")
        return self._line

    def _lost(self, error: Exception) -> MachineError:
        return MachineError(f"{self.name}: {' '.join(str(error).split())}")
