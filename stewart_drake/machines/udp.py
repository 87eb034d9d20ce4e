"""A machine on the network: one packet in each datagram."""

from __future__ import annotations

import socket

from stewart_drake.machines.machine import MachineError
from stewart_drake.machines.packet import SIZE
from stewart_drake.machines.packet_machine import MOST_PACKETS, PacketMachine
from stewart_drake.scenario.scenario import Scenario


class UdpMachine(PacketMachine):
    """What answers at a host and a port; datagrams from anywhere else never get here."""

    def __init__(self, scenario: Scenario, host: str, port: int) -> None:
        super().__init__(scenario, f"udp://{host}:{port}")
        self._address, self._socket = (host, port), None

    def _open(self) -> None:
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(*self._address, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, kind, protocol)
            # From now on the system itself turns away what comes from elsewhere.
            self._socket.connect(address)
        except OSError as error:
            raise self._lost(error) from None

    def _send(self, packet: bytes) -> None:
        try:
            self._opened().send(packet)
        except BlockingIOError:
            pass  # A full buffer: one command is lost, the next one will do.
        except OSError as error:
            raise self._lost(error) from None

    def _receive(self, timeout: float) -> list[bytes]:
        opened, data = self._opened(), []
        opened.settimeout(max(timeout, 0.0))
        try:
            while len(data) < MOST_PACKETS:
                # One byte more than a packet has, so that a longer one is not taken for one.
                data.append(opened.recv(SIZE + 1))
                opened.settimeout(0.0)
        except (TimeoutError, BlockingIOError):
            pass
        except OSError as error:
            raise self._lost(error) from None
        return data

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise MachineError(f"{self.name} is not connected; call connect first")
        return self._socket

    def _lost(self, error: OSError) -> MachineError:
        reason = "nobody listens there" if isinstance(error, ConnectionRefusedError) else error.strerror or str(error)
        return MachineError(f"{self.name}: {reason}")
