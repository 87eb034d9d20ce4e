"""A machine on the network: one packet per datagram."""

from __future__ import annotations

import socket
from contextlib import suppress

from stewart_drake.machines.packet import LONGEST
from stewart_drake.machines.packet_machine import PacketMachine
from stewart_drake.scenario.scenario import Scenario

MAX_DATAGRAMS = 1000  # Read at a time, however many arrive.


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
                data.append(line.recv(LONGEST + 1))
                line.settimeout(0.0)
        return data
