"""The program of a board with hobby servos: on a fake board by the test's clock, as a process, and for real boards."""

import ctypes
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from compiled import CHECKED, STRICT, compiled, compiler

from stewart_drake import inverse_kinematics, load_log, load_robot
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.export.sketch import BOARDS, export_sketch, wiring_of
from stewart_drake.machines.machine import command_limits
from stewart_drake.machines.packet import ACTIVE, MEASURED, Packet, decode, encode, flags_of, from_frame, to_frame
from stewart_drake.mechanics.kinematics import forward_kinematics
from stewart_drake.runs.drive import drive_controller
from stewart_drake.scenario.scenario import load_driven

HERE = Path(__file__).parent
DIRECTION, OFFSET = np.array([1, -1, 1, -1, 1, -1]), np.array([0.05, 0.0, -0.1, 0.02, 0.0, 0.03])
SERVOS = {"direction": DIRECTION.tolist()}
ROBOT = load_robot("servo_hexapod")
HOME = inverse_kinematics(ROBOT, ROBOT.home_pose)
MIDDLES = (HOME + OFFSET).tolist()
LIMITED = ROBOT.given() | {"legs": [{"crank_angle_range": [-0.8, 1.4], "servo_middle": middle} for middle in MIDDLES]}
CHANGES = {
    "adaptation": None,
    "model": {"robot": LIMITED, "motors": {"kind": "position", "preset": "mg996r"}, "servos": SERVOS},
    "controller.feedforward": "none",
}
HOBBY = load_driven("hobby_servos").replace({**CHANGES, "robot": LIMITED, "motors": CHANGES["model"]["motors"]})
TICK = 20_000  # [us]


def turned(pulses):
    """Angles of the cranks at pulses [us], by the data sheet of the MG996R."""
    return HOME + OFFSET + DIRECTION * (np.array(pulses) - 1500.0) * (np.pi / 2000.0)


class Board:
    """The sketch on a board with a clock, a line and servos of the test."""

    def __init__(self, library, told=-1, positions=None):
        self.library = ctypes.CDLL(str(library))
        self.library.hexapod_angle.restype = ctypes.c_double
        self.number = 0
        self._set("told", told, ctypes.c_int)
        for k in range(0 if positions is None else 6):
            (ctypes.c_uint16 * 6).in_dll(self.library, "fake_positions")[k] = positions[k]
        self.library.hexapod_begin()

    def _set(self, name, value, kind=ctypes.c_uint32):
        kind.in_dll(self.library, f"fake_{name}").value = value

    def get(self, name):
        return ctypes.c_uint.in_dll(self.library, f"fake_{name}").value

    @property
    def pulses(self):
        return np.array((ctypes.c_uint16 * 6).in_dll(self.library, "fake_commands"))

    def command(self, leg, angle):
        return self.library.hexapod_command(leg, ctypes.c_double(angle))

    def arrive(self, data):
        (ctypes.c_uint8 * 512).in_dll(self.library, "fake_in")[: len(data)] = data
        self._set("read", 0)
        self._set("arrived", len(data))

    def send(self, values, kind="angle", active=True):
        self.number += 1
        flags = flags_of(kind, ACTIVE if active else 0)
        self.arrive(to_frame(encode(Packet(flags, self.number, 0, 0, np.array(values)))))

    def ticks(self, count=1):
        """Pulses (count, 6) of so many ticks; the reading of the last one, if there was one."""
        rows, self.reading = [], None
        for _ in range(count):
            self._set("sent", 0)
            self._set("clock", (ctypes.c_uint32.in_dll(self.library, "fake_clock").value + TICK) % 2**32)
            self.library.hexapod_poll()
            rows.append(self.pulses)
            size = self.get("sent")
            out = bytes((ctypes.c_uint8 * 512).in_dll(self.library, "fake_out"))[: size - 1 if size else 0]
            self.reading = decode(from_frame(out)) if out else None
        return np.array(rows)


def built(options, folder):
    compiler()
    export_sketch(options, "hobby", folder, "computer")
    sources = ("hexapod.c", "pose.c", "robot_side.c", HERE / "fake_board.c")
    return compiled(folder, *sources, flags=("-O0", "-I."))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return built(HOBBY, tmp_path_factory.mktemp("sketch")).parent


@pytest.fixture
def board(folder, tmp_path):
    return Board(shutil.copy(folder / "it.so", tmp_path))  # a copy has memory of its own


def follow(board, values, kind="angle", ticks=60):
    rows = []
    for _ in range(ticks):
        board.send(values, kind)
        rows.append(board.ticks()[0])
    return np.array(rows)


def test_pulses_are_those_of_python_and_never_beyond_the_limits(board):
    wiring = wiring_of(HOBBY, "computer")
    rng = np.random.default_rng(1)
    for angle in [*rng.uniform(-2.0, 2.0, 300), 1e300, -1e300, np.inf, -np.inf]:
        given = [board.command(leg, angle) for leg in range(6)]
        assert given == wiring.commands(np.full(6, angle)).tolist()
        assert (np.abs(turned(given) - 0.3) <= 1.1 + 1e-9).all()
        wanted, share = np.clip(angle, -0.8, 1.4), 0.5 if -0.8 < angle < 1.4 else 1.0  # of a pulse; inwards at a stop
        assert (np.abs(turned(given) - wanted) < share * np.pi / 2000.0 + 1e-9).all()
    assert all(500 <= board.command(leg, np.nan) <= 2500 for leg in range(6))
    assert turned([board.command(leg, 0.3) for leg in range(6)]) == pytest.approx(0.3, abs=1e-3)
    assert [board.library.hexapod_angle(leg, 1700) for leg in range(6)] == pytest.approx(turned([1700] * 6).tolist())


def test_it_starts_at_home_goes_slowly_and_then_follows(board):
    wanted = turned(board.pulses)
    assert wanted == pytest.approx(HOME, abs=1e-3)
    assert (board.ticks(200) == board.pulses).all()
    assert board.reading is None
    goal = HOME + np.array([0.3, -0.2, 0.1, 0.25, -0.3, 0.0])
    way = turned(follow(board, goal))
    steps = np.abs(np.diff(way, axis=0)).max(axis=1)
    assert steps[0] < 0.012  # 0.5 rad/s, and a microsecond
    assert way[-1] == pytest.approx(goal, abs=1e-3)
    assert np.abs(np.cross(goal[:3] - HOME[:3], way[10, :3] - HOME[:3])).max() < 1e-3  # a straight line
    moved = turned(follow(board, goal + 0.1, ticks=2))
    assert moved[-1] == pytest.approx(goal + 0.1, abs=1e-3)
    assert board.reading.flags == flags_of("angle", 1, ACTIVE)  # no encoders, and it says so
    assert board.reading.values == pytest.approx(goal + 0.1, abs=1e-6)


def test_without_packets_it_holds_and_then_goes_home_slowly(board):
    goal = HOME + 0.3
    follow(board, goal)
    assert (board.ticks(5) == board.pulses).all()
    held = board.ticks(46)
    assert turned(held[0]) == pytest.approx(goal, abs=1e-3)
    assert np.ptp(held, axis=0).max() == 0
    assert board.reading is None
    assert np.ptp(board.ticks(195), axis=0).max() == 0
    home = turned(board.ticks(60))
    assert np.abs(np.diff(home, axis=0)).max() < 0.012
    assert home[-1] == pytest.approx(HOME, abs=1e-3)
    board.number += 2**31  # whoever comes next may count anew
    way = turned(follow(board, goal, ticks=2))
    assert np.abs(way - HOME).max() < 0.025


def test_packets_that_only_ask_hold_and_get_readings(board):
    follow(board, HOME + 0.2, ticks=3)
    for _ in range(400):
        board.send(np.zeros(6), active=False)
        rows = board.ticks()
        assert board.reading.flags == flags_of("angle", 1)
    assert np.ptp(np.concatenate([rows, board.ticks(40)]), axis=0).max() == 0


def test_no_bytes_whatever_move_a_servo_beyond_its_limits(board):
    rng = np.random.default_rng(2)
    wiring = wiring_of(HOBBY, "computer")
    for _ in range(3000):
        if rng.random() < 0.3:
            board.arrive(rng.bytes(rng.integers(0, 300)))
        else:
            scale = 10.0 ** rng.integers(-2, 30)
            board.send(rng.normal(0.0, scale, 6).astype(np.float32), rng.choice(["angle", "pose", "torque", "current"]))
        pulses = board.ticks()[0]
        assert (pulses >= wiring.within[0]).all()
        assert (pulses <= wiring.within[1]).all()
    follow(board, HOME, ticks=100)
    follow(board, np.append(HOME[:5], 1.401), ticks=60)  # beyond a stop: not accepted
    assert turned(board.pulses) == pytest.approx(HOME, abs=1e-3)


def test_poses_become_the_angles_of_the_inverse_kinematics(board):
    rng = np.random.default_rng(3)
    for _ in range(20):
        pose = ROBOT.home_pose + rng.uniform(-1, 1, 6) * [0.1, 0.1, 0.1, 0.008, 0.008, 0.008]
        follow(board, pose, "pose", ticks=80)
        asked = pose.astype(np.float32).astype(float)
        assert turned(board.pulses) == pytest.approx(inverse_kinematics(ROBOT, asked), abs=0.9e-3)
        reached = forward_kinematics(ROBOT, turned(board.pulses), pose)
        assert np.abs(reached - pose)[:3].max() < np.radians(0.15)
        assert np.abs(reached - pose)[3:].max() < 1e-4
    before = board.pulses
    follow(board, ROBOT.home_pose + [0, 0, 0, 0, 0, 0.5], "pose")  # out of reach
    assert (board.pulses == before).all()
    follow(board, ROBOT.home_pose, "pose")
    assert turned(board.pulses) == pytest.approx(HOME, abs=1e-3)


def test_servos_that_tell_where_they_are_start_there(folder, tmp_path):
    there = [1600, 1400, 1550, 1450, 1500, 1620]
    board = Board(shutil.copy(folder / "it.so", tmp_path), 1, there)
    assert board.pulses.tolist() == there
    board.send(HOME)
    board.ticks()
    assert board.reading.flags & MEASURED
    assert board.reading.values == pytest.approx(turned(there), abs=1e-6)
    board._set("told", 0, ctypes.c_int)
    board.send(HOME)
    board.ticks()
    assert board.reading is None  # and not an invented one


def test_calibrated_gains_and_zeros_correct_the_angles_of_a_pose(tmp_path):
    gains, zeros = np.array([1.02, 0.97, 1.0, 1.03, 0.98, 1.01]), np.array([0.02, 0.0, -0.03, 0.01, 0.0, -0.02])
    legs = [{"crank_angle_range": [-0.7, 1.2], "servo_gain": gain} for gain in gains.tolist()]
    robot = load_robot("servo_hexapod").given() | {"legs": legs}
    model = {"robot": robot, "home": zeros.tolist(), "motors": CHANGES["model"]["motors"], "servos": {}}
    board = Board(built(HOBBY.replace({"robot": robot, "model": model}), tmp_path))
    pose = ROBOT.home_pose + [0.05, -0.04, 0.03, 0.004, -0.003, 0.005]
    follow(board, pose, "pose", ticks=80)
    told = (HOME - zeros) / gains + (board.pulses - 1500.0) * (np.pi / 2000.0)
    reached = forward_kinematics(ROBOT, gains * told + zeros, pose)
    assert np.abs(reached - pose)[:3].max() < np.radians(0.15)
    assert np.abs(reached - pose)[3:].max() < 1e-4


def test_the_weight_is_in_the_angles_of_a_pose(tmp_path):
    heavy, pose, out = HOBBY.replace({"controller.feedforward": "full"}), ROBOT.home_pose, np.empty(6)
    board = Board(built(heavy, tmp_path))
    follow(board, pose, "pose")
    drive_controller(heavy, pose).step(HOME, 1.0, out)
    assert np.abs(out - HOME).min() > 0.003
    assert turned(board.pulses) == pytest.approx(out, abs=0.9e-3)


@pytest.mark.long
def test_clean_under_sanitizers(folder, tmp_path):
    place = shutil.copytree(folder, tmp_path / "it")
    (place / "main.c").write_text(
        '#include "hexapod.h"\n#include <stdlib.h>\nextern uint32_t fake_clock;\nextern uint8_t fake_in[512];\n'
        "extern unsigned fake_arrived, fake_read;\nint main(void)\n{\n    hexapod_begin();\n"
        "    for (int n = 0; n < 20000; n++) {\n        fake_arrived = (unsigned)(rand() % 512), fake_read = 0;\n"
        "        for (unsigned k = 0; k < fake_arrived; k++) {\n            fake_in[k] = (uint8_t)rand();\n        }\n"
        "        fake_clock += 7000;\n        hexapod_poll();\n    }\n    return 0;\n}\n"
    )
    sources = ("main.c", "hexapod.c", "pose.c", "robot_side.c", HERE / "fake_board.c")
    program = compiled(place, *sources, flags=(*CHECKED, "-I."), output="it")
    assert subprocess.run([program], check=False).returncode == 0


# --- bus servos ---


def bus(tmp_path, board, preset):
    changes = {"motors.preset": preset, "model.motors.preset": preset, "model.servos": {}}
    export_sketch(HOBBY.replace(changes), "bus", tmp_path / board, board)
    return ctypes.CDLL(str(compiled(tmp_path / board, "bus.c")))


def written(function, *arguments):
    out = ctypes.create_string_buffer(96)
    size = function(*arguments, out)
    return out.raw[:size]


def answers(library, data):
    positions = (ctypes.c_uint16 * 6)()
    return list(positions) if library.bus_positions(data, len(data), positions) else None


def test_packets_of_feetech(tmp_path):
    library = bus(tmp_path, "sts", "sts3215")

    def ended(text):
        data = bytes.fromhex(text)
        return data + bytes([~sum(data[2:]) & 0xFF])

    # The manual's example: servo 1 is asked for two bytes at 0x38, FF FF 01 04 02 38 02 BE.
    assert ended("ffff0104023802") == bytes.fromhex("ffff0104023802be")
    assert written(library.bus_ask) == ended("fffffe0a823802010203040506")
    goals = (ctypes.c_uint16 * 6)(2048, 0, 4095, 1, 2, 3)
    expected = ended("fffffe1683" + "2a02" + "010008" + "020000" + "03ff0f" + "040100" + "050200" + "060300")
    assert written(library.bus_goals, goals) == expected
    assert written(library.bus_torque) == ended("fffffe108328" + "01" + "010102010301040105010601")
    told = [ended(f"ffff{leg:02x}0400{leg:02x}08") for leg in (2, 1, 3, 4, 6, 5)]
    assert answers(library, b"".join(told)) == [0x801, 0x802, 0x803, 0x804, 0x805, 0x806]
    assert answers(library, b"\xff" + b"".join(told) + b"\x00") is not None
    assert answers(library, b"".join(told[:5])) is None
    assert answers(library, b"".join(told)[:-1] + b"\x00") is None


def test_packets_of_dynamixel(tmp_path):
    library = bus(tmp_path, "dynamixel", "xl330_m288")

    def ended(text):
        crc, data = 0, bytes.fromhex(text)
        for byte in data:
            crc ^= byte << 8
            for _ in range(8):
                crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
        return data + crc.to_bytes(2, "little")

    # The examples of the e-Manual, protocol 2.0: present position of servo 1 is read, and is 166.
    assert ended("fffffd0001070002840004 00") == bytes.fromhex("fffffd00010700028400040 01d15".replace(" ", ""))
    assert ended("fffffd0001080055 00a6000000") == bytes.fromhex("fffffd00010800 5500a60000008cc0")
    assert written(library.bus_ask) == ended("fffffd00fe0d00 82 84000400 010203040506")
    goals = (ctypes.c_uint16 * 6)(2048, 0, 4095, 1, 2, 3)
    rows = "".join(f"{leg + 1:02x}" + int(goal).to_bytes(4, "little").hex() for leg, goal in enumerate(goals))
    assert written(library.bus_goals, goals) == ended("fffffd00fe2500 83 74000400" + rows)
    assert written(library.bus_torque) == ended("fffffd00fe1300 83 40000100 010102010301040105010601")
    told = [ended(f"fffffd00{leg:02x}0800550 0a6{leg:02x}0000".replace(" ", "")) for leg in range(1, 7)]
    assert answers(library, b"".join(told)) == [0xA6 + 256 * leg for leg in range(1, 7)]
    spoilt = b"".join(told).replace(b"\x55\x00", b"\x55\x04", 1)
    assert answers(library, spoilt) is None


# --- compilers of boards ---


# Processors of an RP2040, an ESP32-C3 and an Uno. The compiler of older ESP32, xtensa-esp32-elf-gcc, is in no package.
PROCESSORS = {
    "cortex-m0+, gcc": ("arm-none-eabi-gcc", "-mcpu=cortex-m0plus", "-mthumb"),
    "cortex-m0+, clang": ("ziglang", "-target", "thumb-linux-musleabi", "-mcpu=cortex_m0plus"),
    "riscv32, clang": ("ziglang", "-target", "riscv32-linux-musl"),
    "atmega328p, gcc": ("avr-gcc", "-mmcu=atmega328p"),
}


@pytest.mark.slow
@pytest.mark.parametrize("processor", PROCESSORS)
def test_it_compiles_for_boards(processor, tmp_path):
    name, *flags = PROCESSORS[processor]
    if name == "ziglang":
        pytest.importorskip(name)
        cc = [sys.executable, "-m", name, "cc"]
    else:
        cc = [compiler(name)]
    for board, preset in (("pca9685", "mg996r"), ("sts", "sts3215"), ("dynamixel", "xl330_m288")):
        changes = {"motors.preset": preset, "model.motors.preset": preset, "model.servos": {}}
        export_sketch(HOBBY.replace(changes), "hobby", tmp_path / board, board)
        rc = ["hexapod.c", "pose.c", "robot_side.c"]
        command = [*cc, *STRICT, *flags, "-Os", "-c", *(rc if board == "pca9685" else ["bus.c", "hexapod.c"])]
        done = subprocess.run(command, cwd=tmp_path / board, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[:4000]


@pytest.mark.parametrize("board", sorted(set(BOARDS) - {"computer"}))
def test_the_hardware_is_one_short_file(board, tmp_path):
    preset = {"sts": "sts3215", "dynamixel": "xl330_m288"}.get(board, "mg90s")
    changes = {"motors.preset": preset, "model.motors.preset": preset, "model.servos": {}}
    export_sketch(HOBBY.replace(changes), "hobby", tmp_path / "mine", board)
    sketch = tmp_path / "mine" / "mine.ino"
    assert len(sketch.read_text().splitlines()) <= 40
    command = [compiler("g++"), "-std=c++17", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-include", "Arduino.h"]
    command += [f"-I{HERE / 'arduino'}", "-x", "c++", str(sketch)]
    done = subprocess.run(command, cwd=sketch.parent, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:4000]


# What the sketch sends over I2C: a place, then bytes from there on.
WIRE = """
Line Serial;
TwoWire Wire;
extern "C" { uint8_t sent[64]; unsigned used; }
void Line::begin(unsigned long) {}
int Line::read() { return -1; }
size_t Line::write(const uint8_t *, size_t) { return 0; }
unsigned long micros() { return 0; }
void TwoWire::begin() {}
void TwoWire::setClock(uint32_t) {}
void TwoWire::beginTransmission(uint8_t) { used = 0; }
size_t TwoWire::write(uint8_t byte) { sent[used++] = byte; return 1; }
size_t TwoWire::write(const uint8_t *bytes, size_t size) {
  for (size_t k = 0; k < size; k++) write(bytes[k]);
  return size;
}
uint8_t TwoWire::endTransmission() { return 0; }
"""


def test_a_pca9685_has_coarse_steps_and_rounds_them_inwards_at_a_stop(tmp_path):
    export_sketch(HOBBY, "hobby", tmp_path / "mine", "pca9685")
    (tmp_path / "mine" / "all.cpp").write_text(f'#include "Arduino.h"\n#include "mine.ino"\n{WIRE}')
    command = [compiler("g++"), "-shared", "-fPIC", f"-I{HERE / 'arduino'}", "-o", "it.so", "all.cpp"]
    command += ["-x", "c", "hexapod.c", "pose.c", "robot_side.c", "-lm"]
    subprocess.run(command, cwd=tmp_path / "mine", check=True)
    board, wiring = ctypes.CDLL(str(tmp_path / "mine" / "it.so")), wiring_of(HOBBY, "pca9685")
    board.board_begin(0, TICK)
    step = 122 / 25.0  # [us] of a count
    for pulses in [*wiring.within, *np.linspace(*wiring.within, 200).astype(int)]:
        board.board_servos((ctypes.c_uint16 * 6)(*pulses.astype(int)))
        sent = np.array((ctypes.c_uint8 * 64).in_dll(board, "sent"), dtype=int)[1:25].reshape(6, 4)
        widths = (sent[:, 2] + 256 * sent[:, 3]) * step
        assert (widths >= wiring.within[0]).all()
        assert (widths <= wiring.within[1]).all()
        at_stop = np.abs(np.array(wiring.within) - pulses).min(axis=0) < step
        assert (np.abs(widths - pulses) < np.where(at_stop, step, 0.5 * step) + 1e-3).all()


PRESETS = {"mg996r": "pca9685", "ds3218": "rp2040", "mg90s": "pca9685", "sts3215": "sts", "xl330_m288": "dynamixel"}


@pytest.mark.parametrize("preset", PRESETS)
def test_servos_that_people_buy(preset):
    changes = {"motors.preset": preset, "model.motors.preset": preset, "model.servos": None}
    scenario = HOBBY.replace({**changes, "model.robot": "servo_hexapod"})
    wiring, motors = wiring_of(scenario, PRESETS[preset]), scenario.motors
    assert wiring.commands(HOME) == pytest.approx(1500 if wiring.kind == "rc" else 2047.5, abs=1)
    assert wiring.commands(HOME + 0.5) - wiring.commands(HOME) == pytest.approx(0.5 * wiring.per_rad, abs=1)
    assert motors.part(ROBOT, 0.001).name == "motors"
    assert motors.available(ROBOT, np.full(6, motors.no_load_speed)).max() <= 1e-9
    assert motors.torque_limit / motors.stiffness < 0.6  # [rad] of an error at full torque


# --- what does not fit ---


FAR_OFF = ROBOT.given() | {"legs": [{"servo_middle": 2.0 if leg == 3 else None} for leg in range(6)]}


@pytest.mark.parametrize(
    ("changes", "board", "message"),
    [
        ({"motors": "torque", "model.motors": None}, "pca9685", r"motors.kind: expected position: .*preset: mg996r"),
        ({}, "uno", r"--board: expected computer, pca9685, rp2040, sts or dynamixel"),
        ({}, "sts", r"--board: expected computer or pca9685 or rp2040, for servos that take microseconds"),
        ({"model.servos.travel": 1.5}, "pca9685", r"robot.legs.0.crank_angle_range: .* -0\.7.* to 0\.7.* rad"),
        ({"model.robot": FAR_OFF}, "rp2040", r"robot.legs.3.servo_middle: expected within 1.571 rad of .*, got 2.0"),
        ({"model.servos.direction": 0}, "rp2040", r"model.servos.direction: expected 1 or -1, or a list"),
        ({"controller.period": 0.01}, "pca9685", r"controller.period: expected 0.02 to 0.04 s between two commands"),
        ({"model.motors": {"kind": "position"}}, "pca9685", r"model.servos: expected commands .us. and .* mg996r"),
    ],
)  # fmt: skip
def test_what_a_board_cannot_do_is_one_line(changes, board, message, tmp_path):
    with pytest.raises(ConfigurationError, match=message) as caught:
        export_sketch(HOBBY.replace(changes), "hobby", tmp_path / "sketch", board)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "sketch").exists()


@pytest.mark.parametrize("key", ["offset", "gain"])
def test_former_keys_of_the_trim_name_the_ones_of_the_legs(key):
    with pytest.raises(ConfigurationError, match=rf"servos.{key}: .*it is now servo_.* of the robot's legs"):
        HOBBY.replace({f"model.servos.{key}": [0.0] * 6})


def test_a_controller_that_needs_readings_leaves_poses_to_the_computer(tmp_path, call):
    status, output, error = call(
        "export", "hobby_servos", "--set", "adaptation=regression", "--sketch", str(tmp_path / "it"), "--board", "sts"
    )
    assert status == 0
    assert "no poses: its controller learns" in output
    home = np.degrees(inverse_kinematics(load_robot("servo_hexapod"), load_robot("servo_hexapod").home_pose))
    assert all(f" {angle + 0.0:.1f} " in output for angle in home)
    assert "warning: the robot has no stops at legs 0, 1, 2, 3, 4, 5" in error
    assert not (tmp_path / "it" / "pose.c").exists()
    assert "SERVOS_POSES 0 /* whether" in (tmp_path / "it" / "servos.h").read_text()


def test_a_computer_sends_nothing_beyond_the_limits_of_the_servos():
    assert command_limits(HOBBY) == pytest.approx(np.array([[-0.8] * 6, [1.4] * 6]))
    free = HOBBY.replace({"model.robot": "servo_hexapod"})
    assert command_limits(free)[0] == pytest.approx(HOME - np.pi / 2)


@pytest.mark.slow
def test_drive_moves_a_simulated_platform_through_the_board(tmp_path, call, start):
    """`drive`, a pseudo terminal, the compiled sketch, its pulses, simulated servos and platform; and back again."""
    hobby, folder = HOBBY.replace({"model.servos.rest_after": None}), tmp_path / "trial"
    export_sketch(hobby, "hobby", folder, "computer")
    subprocess.run(["make", "-C", folder, "CFLAGS=-D_GNU_SOURCE -O0"], check=True, capture_output=True)
    Path("hobby.yaml").write_text(hobby.to_yaml())
    robot = start("hobby.yaml", "--port", "0", code="from stewart_drake.machines.simulated import main; main()")
    port = robot.stdout.readline().strip()
    assert port.isdigit(), robot.stderr.read()
    board = subprocess.Popen([folder / "board", "hexapod", "pulses.csv", port], stdout=subprocess.PIPE)
    try:
        assert b"serial:hexapod" in board.stdout.readline()
        status, output, error = call(
            "drive", "hobby.yaml", "--machine", "serial:hexapod", "--for", "1.5", "--out", "driven"
        )
    finally:
        for process in (board, robot):
            process.kill()
            process.communicate()
    assert status == 0, (output, error)
    log = load_log("driven")
    assert log.status == "completed"
    rows = np.loadtxt("pulses.csv", delimiter=",")
    times, commands = 1e-6 * (rows[:, 0] - rows[0, 0]), turned(rows[:, 1:])
    assert np.median(np.diff(times)) == pytest.approx(0.02, abs=0.002)
    # The pulses, by the servos' own numbers, are the asked pose; and the simulated platform is there.
    asked = log["reference"][-1, :6]
    assert np.abs(asked - ROBOT.home_pose)[:3].max() > np.radians(3.0)
    assert forward_kinematics(ROBOT, commands[-1], asked) == pytest.approx(asked, abs=2e-3)
    error = forward_kinematics(ROBOT, log["reading"][-1], asked) - asked
    assert np.abs(error)[:3].max() < np.radians(0.3), error  # the weight bends the servos, and they rub
    assert np.abs(error)[3:].max() < 0.6e-3, error
