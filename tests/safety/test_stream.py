"""References of kind stream: targets from outside, kept within the limits."""

import re
import socket

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lagging_servos import Servos
from random_robots import random_robot
from scipy.spatial.transform import Rotation

from stewart_drake import ConfigurationError, Controller, Reach, Scenario, load_robot, load_scenario
from stewart_drake.runs.drive import Drive, connected
from stewart_drake.scenario.limits import limit_margins

ROBOTS = [load_robot(name) for name in ("paper", "reachy_mini", "servo_hexapod")] + [random_robot(3)]
STREAMS = [Scenario(robot=robot, reference={"kind": "stream"}) for robot in ROBOTS]
FILE = "time_s,roll_deg,pitch_deg,yaw_deg,x_mm,y_mm,z_mm\n0,0,0,0,0,0,177\n0.1,0,0,70,0,0,190\n0.4,30,0,0,0,40,190\n"
FILE += "0.6,0,80,0,0,40,190\n0.9,0,0,0,0,0,177\n"
NUMBER = st.one_of(st.floats(-2.0, 2.0), st.sampled_from([0.0, np.nan, np.inf, 1e9, -1e300]))
MINI = STREAMS[1]
SERVOS = load_scenario("reachy_nod").replace(
    {
        "motors": {"kind": "position", "preset": "xl330_m288"},
        "controller": {"kind": "feedforward", "feedforward": "none", "period": 0.02},
        **{"estimator": "difference", "tuner": "fixed", "safety": None, "duration": 1.5},
        "model": {"friction": None, "motors": {"kind": "position", "preset": "xl330_m288", "damping": 0.0}},
        "reference": {"kind": "stream", "udp": "127.0.0.1:0", "relative": True},
    }
)


def playing(scenario, targets, seconds):
    """The motion by targets, one every `seconds`."""
    return scenario.reference.live(lambda time: targets[min(int(time / seconds), len(targets) - 1)])


def assert_allowed(scenario, motion, time):
    options, (pose, rate, acceleration) = scenario.reference, motion.evaluate(time)
    margins = limit_margins(scenario.robot, scenario.limits, pose, rate, acceleration, scenario.gravity)
    assert all((values >= 0.0).all() for values in margins.values())
    for values, turn, shift in (
        (rate, options.turn_speed, options.speed),
        (acceleration, options.turn_acceleration, options.acceleration),
    ):
        assert np.linalg.norm(values[:, :3], axis=1).max() <= turn * (1.0 + 1e-9)
        assert np.linalg.norm(values[:, 3:], axis=1).max() <= shift * (1.0 + 1e-9)
    # Rates and accelerations are those of the poses.
    step = time[1] - time[0]
    np.testing.assert_allclose(np.diff(pose, axis=0), 0.5 * step * (rate[1:] + rate[:-1]), atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(STREAMS), st.lists(st.lists(NUMBER, min_size=6, max_size=6), min_size=1, max_size=8), st.data())
def test_no_stream_leaves_the_limits_the_speed_or_the_acceleration(scenario, offsets, data):
    seconds = data.draw(st.sampled_from([0.02, 0.1, 0.4]))
    scale = np.repeat([1.0, scenario.robot.characteristic_length], 3)
    targets = [scenario.robot.home_pose + scale * offset for offset in offsets]
    motion = playing(scenario, targets, seconds)
    assert_allowed(scenario, motion, np.arange(0.0, seconds * len(targets) + 0.6, 0.004))


@pytest.mark.parametrize("scenario", STREAMS[:3], ids=["paper", "reachy_mini", "servo_hexapod"])
def test_it_rests_at_the_target_or_near_the_nearest_pose(scenario):
    reach, home = Reach(scenario.robot, scenario.limits, scenario.gravity), scenario.robot.home_pose
    length = scenario.robot.characteristic_length
    near = reach.nearest(home + [0.05, 0.0, -0.05, 0.0, 0.0, 0.02 * length]).pose
    motion = playing(scenario, [near], 1.0)
    np.testing.assert_allclose(motion.evaluate(2.0)[0], near, atol=1e-9)
    np.testing.assert_allclose(motion.evaluate(2.0)[1], np.zeros(6), atol=1e-9)
    for seed in range(5):
        offset = np.random.default_rng(seed).uniform(-1.0, 1.0, 6) * np.repeat([1.0, length], 3)
        pose, rate, _ = playing(scenario, [home + offset], 1.0).evaluate(6.0)
        best = reach.nearest(home + offset)
        end = reach.nearest(home + offset, pose)
        assert np.abs(rate).max() < 1e-3
        assert end.distance <= best.distance * 1.1 + 1e-9
        assert np.linalg.norm((pose - end.pose) * np.repeat([length, 1.0], 3)) < 0.1 * length


@pytest.mark.parametrize("offset", [[0.0, 0.0, 0.0, 0.0, 0.045, 0.0], [0.6, -0.5, 0.6, 0.01, 0.0, 0.03]])
def test_it_stays_in_the_workspace_of_the_safety_layer(offset):
    safe = {"workspace": [0.2, 0.012]}
    scenario = Scenario(robot="reachy_mini", reference={"kind": "stream"}, safety=safe)
    home = scenario.robot.home_pose
    pose = playing(scenario, [home + offset], 1.0).evaluate(np.arange(0.0, 4.0, 0.02))[0]
    turns = [Rotation.from_euler("xyz", row[:3]).magnitude() for row in pose]
    shifts = np.linalg.norm(pose[:, 3:] - home[3:], axis=1)
    assert max(turns) < 0.18 * 1.01
    assert max(shifts) < 0.0108 * 1.01
    assert max(turns[-1] / 0.2, shifts[-1] / 0.012) > 0.8


def test_silence_and_what_is_no_pose_hold_the_last_target():
    target = MINI.robot.home_pose + [0.1, 0.0, 0.2, 0.0, 0.0, 0.002]
    nothing = np.full(6, np.nan)
    for stream in ([target], [target, nothing, nothing], [target, np.full(6, np.inf)]):
        np.testing.assert_allclose(playing(MINI, stream, 0.5).evaluate(3.0)[0], target, atol=1e-9)
    np.testing.assert_array_equal(playing(MINI, [nothing], 0.5).evaluate(1.0)[0], MINI.robot.home_pose)


def test_a_simulation_plays_the_file_and_a_controller_takes_targets_from_python(tmp_path):
    (tmp_path / "targets.csv").write_text(FILE)
    for delay in (0, 1):
        file = {"kind": "stream", "motion_file": str(tmp_path / "targets.csv")}
        scenario = SERVOS.replace({"reference": file, "command_delay": delay})
        assert scenario.preview > 0.02 * delay
        time, out, same = np.arange(75) * 0.02, np.empty(6), []
        motion = np.concatenate(scenario.reference.evaluate(time), axis=1)
        assert_allowed(scenario, scenario.reference, time)
        assert np.ptp(motion[:, 2]) > 0.3

        def target(now, at=scenario):
            return at.reference.targets(np.array([now + at.preview]))[0]

        controller = Controller(scenario, {"target": target})
        for now in time.tolist():
            controller.step(np.zeros(6), now, out)
            same.append(controller.signal("reference").copy())
        # A target may come a period of the filter later or sooner.
        turn = scenario.reference.turn_speed * scenario.reference.period
        np.testing.assert_allclose(np.array(same)[:, :6], motion[:, :6], atol=1.01 * turn)
        np.testing.assert_allclose(same[-1], motion[-1], atol=1e-6)
    held = Scenario(reference={"kind": "stream"}).reference.evaluate(np.arange(3.0))[0]
    np.testing.assert_array_equal(held, np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.3], (3, 1)))


@pytest.mark.parametrize(
    "options", [{}, {"columns": ["x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg", "a"]}]
)
def test_lines_are_read_by_their_columns(options):
    reference = Scenario(reference={"kind": "stream", "relative": True, **options}).reference
    words = "1 2 3 10 20 30 7" if options else " 10; 20,0;30;1;2;3;\r\n"
    target = reference.home + [*np.radians([10.0, 20.0, 30.0]), 0.001, 0.002, 0.003]
    np.testing.assert_allclose(reference.target_of(words.encode()), target)
    wrong_lines = [b"", b"1,2,3", b"a,b,c,d,e,f", b"\xff\x00", b"1,2,3,4,5,", b"1,,2,3,4,5,6", b"10,20;30,1 2 3"]
    wrong_lines += [b"nan,0,0,0,0,0", b"1 2 3 4 5 6 7 8", b"1,2,3,4,5,6" if options else b"0,10,5,20,0,0,5"]
    for wrong in wrong_lines:
        assert np.isnan(reference.target_of(wrong)).all()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"udp": "4444"}, "reference.udp: expected HOST:PORT"),
        ({"udp": "127.0.0.1:70000"}, "reference.udp: expected HOST:PORT"),
        ({"columns": ["roll_deg", "x_mm"]}, "reference.columns: column of pose_pitch"),
        ({"speed": 0.0}, "reference.speed"),
        ({"reserve": 0.09}, "reference.reserve: expected less than the least relative margin of the robot at home"),
        ({"motion_file": "no.csv"}, "no.csv"),
    ],
)
def test_bad_options_are_one_line(options, text):
    with pytest.raises(ConfigurationError) as caught:
        Scenario(robot="servo_hexapod", reference={"kind": "stream", **options}).reference.evaluate(1.0)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_port_in_use_is_one_line():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        reference = Scenario(reference={"kind": "stream", "udp": f"127.0.0.1:{other.getsockname()[1]}"}).reference
        with pytest.raises(ConfigurationError, match="expected an address of this computer with a free"):
            reference.live()


def test_a_drive_follows_targets_over_udp_at_50_hz():
    rows = [b"0,0,20,0,0,5", b"garbage", b"nan,0,0,0,0,0", b"0,90,0,0,0,5", b"0,0,0,0,0,0"]

    class Sender(Servos):
        def command(self, values):
            super().command(values)
            if len(self.commands) > 60 and len(self.commands) % 12 == 0:
                line.sendto(rows[(len(self.commands) // 12) % len(rows)], ("127.0.0.1", port))

    machine = Sender()
    start = connected(SERVOS, machine)
    source = start.motion.source
    port = int(source.address.split(":")[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        log = Drive(SERVOS, machine, start).run()
    assert log.status == "completed"
    (warning,) = log.warnings
    assert re.fullmatch(
        r"\d+ of \d+ datagrams are not 6 finite numbers and were dropped, the last '(garbage|nan,0,0,0,0,0)'",
        warning["text"],
    )
    assert np.ptp(log["reference"][:, 2]) > 0.1
    assert np.ptp(log["reference"][:, 1]) > 0.1
    pose, still = log["reference"], np.zeros_like(log["reference"])
    margins = limit_margins(SERVOS.robot, SERVOS.limits, pose, still, still, SERVOS.gravity)
    assert all((values >= 0.0).all() for values in margins.values())
    with pytest.raises(OSError, match="Bad file descriptor"):
        source._line.getsockname()


def test_a_stream_that_nobody_sends_is_a_warning():
    log = Drive(SERVOS, machine := Servos(), connected(SERVOS, machine, 0.2)).run()
    assert log.status == "completed"
    assert [warning["name"] for warning in log.warnings] == ["targets"]
    assert log.warnings[0]["text"].startswith("no target came at 127.0.0.1:")


def test_a_drive_follows_targets_from_python():
    targets = iter([np.full(6, np.nan)] * 5 + [SERVOS.robot.home_pose + [0.2, 0.0, 0.0, 0.0, 0.0, 0.0]] * 1000)
    start = connected(SERVOS, machine := Servos(), targets=lambda _: next(targets))
    log = Drive(SERVOS, machine, start).run()
    assert log.status == "completed"
    assert log["reference"][:, 0].max() == pytest.approx(0.2, abs=1e-6)
