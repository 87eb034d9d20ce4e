"""The example for a microcontroller speaks the packets of docs/wire.md, and answers as `Controller` does."""

import ctypes

import numpy as np
import pytest
from compiled import compiled

from stewart_drake import Controller, load_controller, load_scenario
from stewart_drake.base.sampling import on_grid
from stewart_drake.export.controller_c import export_controller
from stewart_drake.machines.packet import (
    ACTIVE,
    MEASURED,
    READING,
    Packet,
    decode,
    encode,
    flags_of,
    from_frame,
    to_frame,
)


def built(scenario, name, folder):
    export_controller(scenario, name, folder)
    return ctypes.CDLL(str(compiled(folder, "board.c", f"{name}.c", f"{name}_reference.c", flags=("-O1",))))


@pytest.fixture
def board(tmp_path):
    return built(load_scenario("reachy_nod"), "reachy_nod", tmp_path)


def answered(board, data):
    out = ctypes.create_string_buffer(48)
    return out.raw if board.board_answer(data, len(data), ctypes.c_uint64(5), out) else None


def test_it_answers_each_reading_with_the_command_of_the_controller(board, tmp_path):
    asked = ctypes.create_string_buffer(48)
    board.board_ask(ctypes.c_uint64(1), asked)
    assert decode(asked.raw).flags == flags_of("torque")
    controller, out = Controller(load_scenario("reachy_nod")), np.empty(6)
    rows = np.loadtxt(tmp_path / "replay.csv", delimiter=",")[:50, :6].astype(np.float32)
    for k, row in enumerate(rows):
        reading = encode(Packet(flags_of("torque", READING, ACTIVE, MEASURED), k + 7, k, 10_000 * k, row))
        controller.step(row.astype(float), k * on_grid(0.01), out)
        answer = decode(answered(board, reading))
        assert (answer.flags, answer.answers, answer.number) == (flags_of("torque", ACTIVE), k + 7, k + 2)
        np.testing.assert_array_equal(answer.values, out.astype(np.float32))
        assert answered(board, reading) is None  # once only
    unmeasured = encode(Packet(flags_of("torque", READING, ACTIVE), 1000, 50, 10**6, row))
    for wrong in (unmeasured, reading[:-1], b"X" + reading[1:], reading[:20] + b"\x01" + reading[21:], asked.raw):
        assert answered(board, wrong) is None


def test_a_controller_without_feedback_answers_a_robot_without_encoders(tmp_path):
    board = built(load_controller("hobby_servos").replace({"adaptation": None}), "hobby", tmp_path)
    answer = decode(answered(board, encode(Packet(flags_of("angle", READING, ACTIVE), 1, 0, 0, np.zeros(6)))))
    assert answer.flags == flags_of("angle", ACTIVE)
    assert np.abs(answer.values).max() > 0.0


def test_a_reading_may_have_the_numbers_of_an_inertial_sensor(tmp_path):
    sensors = {"kind": "encoders", "imu": {}}
    scenario = load_scenario("reachy_nod").replace({"sensors": sensors, "estimator": "observer"})
    board, controller, out = built(scenario, "nod", tmp_path), Controller(scenario), np.empty(6)
    rows = np.loadtxt(tmp_path / "replay.csv", delimiter=",")[:20, :12].astype(np.float32)
    for k, row in enumerate(rows):
        imu = row[6:] if k % 3 else None
        flags = flags_of("torque", READING, ACTIVE, MEASURED)
        reading = encode(Packet(flags, k + 7, k, 10_000 * k, row[:6], imu))
        controller.step(row[:6].astype(float), k * on_grid(0.01), out, imu=None if imu is None else imu.astype(float))
        np.testing.assert_allclose(decode(answered(board, reading)).values, out.astype(np.float32), rtol=1e-6)
    broken = bytearray(reading)
    broken[50] ^= 1
    assert answered(board, bytes(broken)) is None


def test_it_takes_and_sends_angles_of_the_machine(tmp_path):
    plain = load_controller("hobby_servos").replace({"adaptation": None})
    gains, home = np.array([1.05, 0.95, 1.04, 0.96, 1.0, 1.02]), [0.3, -0.2, 0.1, 0.05, -0.4, 0.6]
    legs = [{"servo_gain": gain} for gain in gains.tolist()]
    sent = []
    for name, options in (("plain", plain), ("own", plain.replace({"model.robot.legs": legs, "model.home": home}))):
        (tmp_path / name).mkdir()
        board = built(options, name, tmp_path / name)
        sent.append(decode(answered(board, encode(Packet(flags_of("angle", READING), 1, 0, 0, np.zeros(6))))).values)
    np.testing.assert_allclose(sent[1], (sent[0] - home) / gains, atol=1e-6)


def test_frames_of_a_serial_line(board):
    data, frame, back = (
        encode(Packet(flags_of("torque"), 258, 257, 10**6, np.zeros(6))),
        *(ctypes.create_string_buffer(50) for _ in "ab"),
    )
    size = board.board_to_frame(data, frame)
    assert frame.raw[:size] == to_frame(data)
    assert from_frame(frame.raw[: size - 1]) == data
    assert board.board_from_frame(frame, size - 1, back) == 48
    assert back.raw[:48] == data
    assert board.board_from_frame(b"\x09\x01", 2, back) == 0
