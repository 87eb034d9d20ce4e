"""A machine on the network: one packet in each datagram."""

from __future__ import annotations

import socket
from contextlib import suppress

from stewart_drake.machines.packet import SIZE
from stewart_drake.machines.packet_machine import PacketMachine
from stewart_drake.scenario.scenario import Scenario

MOST = 1000  # Datagrams that are looked at at a time, however many come.


class UdpMachine(PacketMachine):
    """What answers at a host and a port; datagrams from anywhere else never get here."""

    def __init__(self, scenario: Scenario, host: str, port: int) -> None:
        super().__init__(scenario, f"udp://{host}:{port}")
        self._address = host, port

    def _open(self) -> socket.socket:
        family, kind, protocol, _, address = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
        line = socket.socket(family, kind, protocol)
        # From now on the system itself turns away what comes from elsewhere.
        line.connect(address)
        return line

    def _send(self, line: socket.socket, packet: bytes) -> None:
        with suppress(BlockingIOError):
            line.send(packet)

    def _receive(self, line: socket.socket, timeout: float) -> list[bytes]:
        data: list[bytes] = []
        line.settimeout(timeout)
        with suppress(TimeoutError, BlockingIOError):
            while len(data) < MOST:
                # One byte more than a packet has, so that a longer one is not taken for one.
                data.append(line.recv(SIZE + 1))
                line.settimeout(0.0)
        return data
