"""The robot's side of docs/wire.md over UDP, with Python's standard library alone; your motors go where it says so."""

import argparse
import math
import select
import socket
import struct
import time
import zlib

BODY, CHECK = struct.Struct("<2sBBIIQ6f"), struct.Struct("<I")
READING, ACTIVE, MEASURED = 1, 2, 16
TAKES = 0  # 0: angles [rad], 1: torques [N m], 2: currents [A]
LOW, HIGH = -1.5, 1.5  # Commands beyond are not followed.
PERIOD, HOLD_AFTER, QUIET_AFTER = 0.02, 0.1, 1.0  # [s]; the first is also that of the controller


def encode(flags, number, answers, microseconds, values, imu=None):
    """The bytes of a packet, of version 2 with six numbers of an inertial sensor."""
    body = BODY.pack(b"SD", 1 if imu is None else 2, flags, number & 0xFFFFFFFF, answers, microseconds, *values)
    body += b"" if imu is None else struct.pack("<6f", *imu)
    return body + CHECK.pack(zlib.crc32(body))


def decode(data):
    """Flags, number and six values; None where it is no command for these motors."""
    if len(data) != BODY.size + CHECK.size or zlib.crc32(data[: BODY.size]) != CHECK.unpack(data[BODY.size :])[0]:
        return None
    magic, version, flags, number, _, _, *values = BODY.unpack(data[: BODY.size])
    good = (magic, version) == (b"SD", 1) and flags in (0, 4, 8, TAKES << 2 | ACTIVE)
    return (flags, number, values) if good and all(map(math.isfinite, values)) else None


def next_tick(due, now, period):
    """Ticks are a period apart on the clock, whenever this runs; those that have gone by are left out."""
    return due + period * (1 + max(0, int((now - due) / period)))


class Motors:
    """Yours: here they are at once where they are told to be."""

    angles = [0.0] * 6

    def follow(self, values):
        """Go there."""
        self.angles = values

    def hold(self):
        """Motors that take angles keep the last one; those that take torques brake."""

    def read(self):
        """Six angles."""
        return self.angles

    def imu(self):
        """Rates [rad/s] and specific force [m/s^2] of an inertial sensor, NaN where not new; None without one."""


def serve(motors, port, period=PERIOD, host="127.0.0.1"):
    """For ever."""
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.bind((host, port))
    peer, last, sent, heard, active, due = None, 0, 0, -math.inf, -math.inf, time.monotonic()
    while True:
        due = next_tick(due, time.monotonic(), period)
        while (left := due - time.monotonic()) > 0.0 and select.select([line], [], [], left)[0]:
            data, sender = line.recvfrom(64)
            now, packet = time.monotonic(), decode(data)
            quiet = now - heard > QUIET_AFTER
            if packet is None or not (quiet or (sender == peer and 0 < (packet[1] - last) % 2**32 < 2**31)):
                continue
            flags, number, values = packet
            if flags & ACTIVE and not all(LOW <= value <= HIGH for value in values):
                continue
            peer, last, heard, active = sender, number, now, now if flags & ACTIVE else -math.inf
            if flags & ACTIVE:
                motors.follow(values)
        now = time.monotonic()
        holds = now - active > HOLD_AFTER
        if holds:
            motors.hold()
        if now - heard <= QUIET_AFTER:
            sent += 1
            flags = READING | MEASURED | TAKES << 2 | (0 if holds else ACTIVE)
            line.sendto(encode(flags, sent, last, int(now * 1e6), motors.read(), motors.imu()), peer)


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("port", type=int)
    options.add_argument("period", type=float, nargs="?", default=PERIOD, help="[s], that of the controller")
    given = options.parse_args()
    serve(Motors(), given.port, given.period)
