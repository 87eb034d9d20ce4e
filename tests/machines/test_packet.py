"""The packet and its frames: what goes in comes out, and nothing else gets through; the same in Python and C."""

import ctypes
import random
import re
import shutil
import subprocess
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_machines import ROOT, docs_module

from stewart_drake.machines import packet as wire
from stewart_drake.machines.packet import Packet, decode, encode, from_frame, rounded_inside, split_frames, to_frame
from stewart_drake.machines.simulated import RobotSide

FLAGS = st.sampled_from([bits | takes << 2 for bits in (0, 1, 2, 3, 16, 19) for takes in (0, 1, 2, 3)])
VALUES = st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), min_size=6, max_size=6)
PACKETS = st.builds(
    Packet,
    FLAGS,
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1),
    st.integers(0, 2**64 - 1),
    VALUES.map(np.array),
    st.none(),
)


def same(one, other):
    return one[:4] == other[:4] and np.array_equal(one.values, other.values)


@given(PACKETS)
def test_a_packet_comes_back_and_through_a_frame(packet):
    data = encode(packet)
    assert len(data) == wire.SIZE
    assert same(decode(data), packet)
    frame = to_frame(data)
    assert len(frame) == wire.SIZE + 2
    assert frame.index(0) == len(frame) - 1
    assert same(decode(from_frame(frame[:-1])), packet)


@given(st.binary(max_size=254))
def test_any_bytes_come_back_from_a_frame(data):
    assert from_frame(to_frame(data)[:-1]) == data


@given(st.binary(max_size=100))
def test_any_bytes_are_refused_without_an_error(data):
    assert decode(data) is None
    from_frame(data)
    buffer = bytearray(data)
    split_frames(buffer)
    assert len(buffer) <= wire.LONGEST_FRAME


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_refused_whatever_its_checksum(value):
    assert decode(encode(Packet(2, 1, 0, 0, np.array([0, 0, 0, value, 0, 0])))) is None


def mutated(data, chance):
    """Bytes changed, cut, repeated; in half of all cases with a checksum that fits again."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        changed[chance.randrange(len(changed))] = chance.randrange(256)
    if chance.random() < 0.5:
        changed[-4:] = crc32(changed[:-4]).to_bytes(4, "little")
    if chance.random() < 0.1:
        del changed[chance.randrange(len(changed)) :]
    return bytes(changed * 2 if chance.random() < 0.05 else changed)


def test_100000_mutated_packets_never_give_a_command_outside_limits():
    chance = random.Random(1)
    limits = np.array([[-1.0] * 6, [0.5] * 6])
    side = RobotSide("angle", limits)
    followed = 0
    for k in range(100_000):
        packet = Packet(wire.ACTIVE, k, 0, k, np.array([chance.uniform(-1.0, 0.5) for _ in range(6)]))
        if side.take(mutated(encode(packet), chance), "peer", k * 0.001):
            followed += 1
            assert np.isfinite(side.values).all()
            assert (side.values >= limits[0]).all()
            assert (side.values <= limits[1]).all()
    assert 1000 < followed < 60_000
    assert side.counts["range"] > 300
    assert side.counts["garbage"] > 40_000


def test_what_the_robots_side_takes_and_when_it_holds():
    side = RobotSide("torque", np.array([[-1.0] * 6, [1.0] * 6]))

    def told(number, now, peer="a", flags=wire.ACTIVE | 4, value=0.5):
        return side.take(encode(Packet(flags, number, 0, 0, np.full(6, value))), peer, now)

    assert side.holds(0.0)
    assert not told(1, 0.0, flags=0)  # Only asks, whatever it takes the motors for.
    assert side.holds(0.0)
    assert told(2, 0.01)
    assert not side.holds(0.1)
    assert side.holds(0.12)
    assert not told(2, 0.02)
    assert not told(1, 0.02)
    assert told(7, 0.03)
    assert not told(8, 0.04, peer="b")
    assert not told(8, 0.04, flags=wire.ACTIVE)  # Angles.
    assert not told(8, 0.04, value=1.1)
    assert not told(8, 0.04, flags=wire.ACTIVE | wire.READING | 4)
    assert side.counts == {"accepted": 3, "old": 2, "missing": 4, "foreign": 1, "garbage": 2, "range": 1, "late": 2}
    assert not told(9, 0.05, flags=4)
    assert side.holds(0.05)
    assert told(1, 1.2, peer="b")  # After a second of silence anybody, with any number.
    assert told(2**32 - 1, 3.0, peer="b")
    assert told(0, 3.01, peer="b")
    assert side.reading(np.zeros(6), 0.0, 4.5) == b""


@pytest.mark.parametrize("takes", ["angle", "torque", "current"])
def test_a_command_at_a_limit_is_within_it_as_a_number_of_the_wire(takes):
    high = np.array([0.1, 0.3, 0.7, 1.1, 1.3963264015955, 5.0])
    limits = np.stack([-high, high])
    side, inside = RobotSide(takes, limits), rounded_inside(limits)
    assert (np.abs(inside - limits) < 1e-7 * high).all()
    np.testing.assert_array_equal(inside, inside.astype(np.float32))
    for number, values in enumerate(inside, start=1):
        assert side.take(encode(Packet(wire.flags_of(takes, wire.ACTIVE), number, 0, 0, values)), "a", 0.0)
    # The limit of 0.7 is itself rounded beyond.
    assert not side.take(encode(Packet(wire.flags_of(takes, wire.ACTIVE), 3, 0, 0, high)), "a", 0.0)


def test_a_robot_ticks_on_its_period_however_late_it_wakes():
    next_tick, due, ticks = docs_module("robot_side").next_tick, 0.0, []
    for _ in range(1000):
        due = next_tick(due, due + 0.004, 0.02)
        ticks.append(due)
    np.testing.assert_allclose(ticks, 0.02 * np.arange(1, 1001))
    assert next_tick(1.0, 1.07, 0.02) == pytest.approx(1.08)


class CPacket(ctypes.Structure):
    _fields_ = [
        ("flags", ctypes.c_uint8), ("number", ctypes.c_uint32), ("answers", ctypes.c_uint32),
        ("microseconds", ctypes.c_uint64), ("values", ctypes.c_float * 6),
    ]  # fmt: skip


class CSide(ctypes.Structure):
    _fields_ = [
        ("takes", ctypes.c_uint8), ("poses", ctypes.c_uint8), ("measured", ctypes.c_uint8),
        ("low", ctypes.c_float * 6), ("high", ctypes.c_float * 6), ("values", ctypes.c_float * 6),
        ("kind", ctypes.c_uint8), ("following", ctypes.c_uint8), ("heard", ctypes.c_uint8),
        ("last", ctypes.c_uint32), ("number", ctypes.c_uint32), ("heard_us", ctypes.c_uint64),
        ("active_us", ctypes.c_uint64),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def in_c(tmp_path_factory):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    library = tmp_path_factory.mktemp("c") / "robot_side.so"
    warned = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-std=c99"]
    source = ROOT / "stewart_drake" / "export" / "templates" / "robot_side.c"
    subprocess.run([compiler, *warned, "-shared", "-fPIC", source, "-o", library], check=True)
    loaded = ctypes.CDLL(str(library))
    for name in ("sd_to_frame", "sd_from_frame", "sd_reading", "sd_inertial_reading"):
        getattr(loaded, name).restype = ctypes.c_size_t
    return loaded


def c_decode(in_c, data):
    packet = CPacket()
    if not in_c.sd_decode(data, ctypes.c_size_t(len(data)), ctypes.byref(packet)):
        return None
    return Packet(packet.flags, packet.number, packet.answers, packet.microseconds, np.array(packet.values[:]))


@given(packet=PACKETS, data=st.binary(max_size=48))
def test_c_writes_the_same_bytes(in_c, packet, data):
    out, frame = ctypes.create_string_buffer(wire.SIZE), ctypes.create_string_buffer(wire.SIZE + 2)
    values = (ctypes.c_float * 6)(*packet.values)
    in_c.sd_encode(ctypes.byref(CPacket(*packet[:4], values)), out)
    assert out.raw == encode(packet)
    assert same(c_decode(in_c, out.raw), packet)
    size = in_c.sd_to_frame(out, ctypes.c_size_t(wire.SIZE), frame)
    assert frame.raw[:size] == to_frame(out.raw)
    bare = to_frame(data)[:-1]
    for given_frame in (bare, data):
        size = in_c.sd_from_frame(given_frame, ctypes.c_size_t(len(given_frame)), frame)
        assert frame.raw[:size] == (from_frame(given_frame) or b"")


def test_c_decides_as_python_does(in_c):
    chance = random.Random(2)
    side, clock = RobotSide("angle", np.array([[-1.0] * 6, [0.5] * 6])), 0
    other = CSide(takes=0, low=(ctypes.c_float * 6)(*[-1.0] * 6), high=(ctypes.c_float * 6)(*[0.5] * 6))
    for k in range(3000):
        clock += chance.choice([1000, 1000, 1000, 90_000, 120_000, 1_100_000]) + chance.randint(1, 99)
        numbers = np.array([chance.uniform(-1.0, 0.501) for _ in range(6)])
        data = encode(Packet(chance.choice([2, 2, 2, 0, 6, 3, 14]), k + chance.randint(-2, 2), 0, 0, numbers))
        data = mutated(data, chance) if chance.random() < 0.3 else data
        packet = c_decode(in_c, data)
        assert (packet is None) == (decode(data) is None)
        accepted = side.counts["accepted"]
        side.take(data, "peer", clock * 1e-6)
        if packet is not None:
            values = (ctypes.c_float * 6)(*packet.values)
            taken = in_c.sd_take(
                ctypes.byref(other), ctypes.byref(CPacket(*packet[:4], values)), ctypes.c_uint64(clock)
            )
            assert taken == side.counts["accepted"] - accepted
        now = clock + chance.choice([500, 98_000, 102_000]) + chance.randint(1, 99)
        assert bool(in_c.sd_holds(ctypes.byref(other), ctypes.c_uint64(now))) == side.holds(now * 1e-6)
    frame = ctypes.create_string_buffer(wire.SIZE + 2)
    size = in_c.sd_reading(ctypes.byref(other), (ctypes.c_float * 6)(*range(6)), ctypes.c_uint64(clock), frame)
    reading = decode(from_frame(frame.raw[: size - 1]))
    assert reading.flags & (wire.READING | wire.MEASURED) == wire.READING
    assert reading.values.tolist() == list(range(6))
    inertial, numbers = ctypes.create_string_buffer(wire.LONGEST_FRAME), (ctypes.c_float * 6)(*range(6))
    size = in_c.sd_inertial_reading(ctypes.byref(other), numbers, numbers, ctypes.c_uint64(clock), inertial)
    again = decode(from_frame(inertial.raw[: size - 1]))
    assert again.number == reading.number + 1
    assert again.values.tolist() == again.imu.tolist() == list(range(6))
    pose = CPacket(
        flags=wire.flags_of("pose", wire.ACTIVE), number=other.last + 1, values=(ctypes.c_float * 6)(*[9.0] * 6)
    )
    for takes in (0, 1):
        other.poses = other.measured = takes
        assert in_c.sd_take(ctypes.byref(other), ctypes.byref(pose), ctypes.c_uint64(clock)) == takes
    size = in_c.sd_reading(ctypes.byref(other), (ctypes.c_float * 6)(), ctypes.c_uint64(clock), frame)
    assert decode(from_frame(frame.raw[: size - 1])).flags == wire.flags_of(
        "angle", wire.READING, wire.MEASURED, wire.ACTIVE
    )


@given(PACKETS)
def test_plain_python_writes_the_same_bytes(packet):
    example = docs_module("robot_side")
    data = example.encode(packet.flags, packet.number, packet.answers, packet.microseconds, packet.values)
    assert data == encode(packet)
    if packet.flags in (0, 4, 8, wire.ACTIVE):
        assert example.decode(data)[2] == packet.values.tolist()


def test_the_example_bytes_of_the_page_are_those_of_the_packet():
    text = (ROOT / "docs" / "wire.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```text\n(.*?)```", text, re.DOTALL)
    packet = Packet(wire.ACTIVE, 258, 257, 1_000_000, np.array([0.5, -0.25, 0.0, 1.0, -1.0, 0.1]))
    shown = [bytes.fromhex(re.sub(r"\s", "", block)) for block in blocks]
    assert shown == [encode(packet), to_frame(encode(packet))]


INERTIAL = st.lists(st.floats(width=32, allow_infinity=False), min_size=6, max_size=6)


@given(PACKETS, INERTIAL.map(np.array))
def test_a_packet_with_inertial_readings_comes_back_and_one_without_is_as_before(packet, imu):
    data = encode(packet._replace(imu=imu))
    example = docs_module("robot_side")
    assert data == example.encode(packet.flags, packet.number, packet.answers, packet.microseconds, packet.values, imu)
    assert (len(data), data[2], encode(packet)[2]) == (wire.LONGEST, 2, 1)
    frame = to_frame(data)
    assert len(frame) <= wire.LONGEST_FRAME
    found = decode(from_frame(frame[:-1]))
    assert same(found, packet)
    np.testing.assert_array_equal(found.imu, imu)  # NaN: no new reading
    assert decode(encode(packet)).imu is None
    for version in (0, 1, 3):
        other = bytearray(data)
        other[2] = version
        other[-4:] = crc32(other[:-4]).to_bytes(4, "little")
        assert decode(bytes(other)) is None
