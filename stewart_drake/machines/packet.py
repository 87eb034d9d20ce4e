"""The packet of the protocol, the same in both directions; docs/wire.md describes every byte.

Pure functions from bytes to values and back. Invalid bytes give None; nothing raises.
"""

from __future__ import annotations

import struct
from typing import NamedTuple
from zlib import crc32

import numpy as np

MAGIC, VERSION, INERTIAL_VERSION = b"SD", 1, 2
READING, ACTIVE, MEASURED = 1, 2, 16
"""Bits of `flags`. READING: from the machine; clear in a command. ACTIVE: in a command, follow these values, clear to
hold and to be sent readings; in a reading, commands are followed, clear while it holds. MEASURED: in a reading, the
angles are measured; clear where they are the last command."""
TAKES = ("angle", "torque", "current", "pose")
"""What commands are, by bits 2 and 3 of `flags`: 0 angle [rad], 1 torque [N m], 2 current [A], 3 pose of the platform
[rad, m]: motors take the first three, and a board that computes the angles by itself the last one too."""
HOLD_AFTER = 0.1  # [s] Longest time without an active command until a machine holds.
QUIET_AFTER = 1.0
"""[s] without any command until a machine sends no more readings, and accepts a new peer."""
_BODIES = {VERSION: struct.Struct("<2sBBIIQ6f"), INERTIAL_VERSION: struct.Struct("<2sBBIIQ12f")}
_CHECK = struct.Struct("<I")
SIZE, LONGEST = (body.size + _CHECK.size for body in _BODIES.values())
"""[byte] of a packet, and of one with inertial readings."""
LONGEST_FRAME = LONGEST + 2  # [byte] A packet on a serial line.


class Packet(NamedTuple):
    """Contents of a packet.

    Attributes:
        flags: See `READING`, `ACTIVE`, `MEASURED`, `TAKES`; other bits are 0.
        number: Count of packets in this direction, modulo 2^32.
        answers: Newest `number` that has arrived from the other side; 0 for none.
        microseconds: [us] by the sender's clock; never decreases.
        values: (6,) angles [rad] of a reading, or commands; finite, sent as float32.
        imu: (6,) rates [rad/s] and specific force [m/s^2] of an inertial sensor, NaN where they are not new; None for a
            packet of version 1, which has none.
    """

    flags: int
    number: int
    answers: int
    microseconds: int
    values: np.ndarray
    imu: np.ndarray | None = None

    @property
    def takes(self) -> str:
        """Quantity of the machine's commands."""
        return TAKES[self.flags >> 2 & 3]


def flags_of(takes: str, *bits: int) -> int:
    """Flags with these bits for a machine that takes `takes`."""
    return sum(bits) | TAKES.index(takes) << 2


def rounded_inside(limits: np.ndarray) -> np.ndarray:
    """Limits (2, ...), lowest and highest, rounded to float32 inside the range."""
    near = limits.astype(np.float32)
    beyond = [near[0] < limits[0], near[1] > limits[1]]
    return np.where(beyond, np.nextafter(near, near[::-1]), near).astype(float)


def encode(packet: Packet) -> bytes:
    """The bytes of a packet, of version 2 if it has inertial readings; numbers are cut to their fields."""
    numbers = packet.number & 0xFFFFFFFF, packet.answers & 0xFFFFFFFF, packet.microseconds & (1 << 64) - 1
    version = VERSION if packet.imu is None else INERTIAL_VERSION
    values = np.append(packet.values, [] if packet.imu is None else packet.imu).astype(np.float32)
    body = _BODIES[version].pack(MAGIC, version, packet.flags, *numbers, *values.tolist())
    return body + _CHECK.pack(crc32(body))


def decode(data: bytes) -> Packet | None:
    """The packet in some bytes; None if they are no packet, or an angle or command is not finite."""
    body = _BODIES.get(data[2]) if len(data) > 2 else None
    if body is None or len(data) != body.size + _CHECK.size:
        return None
    magic, _, flags, number, answers, microseconds, *values = body.unpack_from(data)
    if crc32(data[: body.size]) != _CHECK.unpack_from(data, body.size)[0]:
        return None
    if magic != MAGIC or flags & 0xE0:
        return None
    numbers, imu = np.array(values[:6]), np.array(values[6:]) if len(values) > 6 else None
    return Packet(flags, number, answers, microseconds, numbers, imu) if np.isfinite(numbers).all() else None


def newer(number: int, last: int) -> bool:
    """Whether a number comes after another one, modulo 2^32."""
    return 0 < (number - last) % 2**32 < 2**31


# --- framing on a serial line: consistent overhead byte stuffing (COBS), a zero after each frame ---


def to_frame(data: bytes) -> bytes:
    """A frame of at most 254 bytes; its only zero is the last byte."""
    frame = bytearray()
    for block in data.split(b"\0"):
        frame.append(len(block) + 1)
        frame += block
    return bytes(frame) + b"\0"


def from_frame(frame: bytes) -> bytes | None:
    """The data of a frame without its last zero; None if it is invalid."""
    data, at = bytearray(), 0
    while at < len(frame):
        code = frame[at]
        if code == 0 or at + code > len(frame):
            return None
        data += frame[at + 1 : at + code] + b"\0"
        at += code
    return bytes(data[:-1]) if data else None


def split_frames(buffer: bytearray) -> list[bytes]:
    """Removes complete frames from the buffer and returns them; drops what is longer than any frame."""
    *frames, rest = bytes(buffer).split(b"\0")
    buffer[:] = rest if len(rest) <= LONGEST_FRAME else b""
    return [frame for frame in frames if frame]
