"""A live loop as an instrument: sliders of keys, a spring, tests, a ghost, and what is saved."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stewart_drake import load_robot, load_scenario, run
from stewart_drake.live.instrument import (
    FORCE,
    MOMENT,
    Spring,
    TestMotion,
    changes_of_slider,
    for_live_page,
    largest,
    slider_value,
    sliders_of,
    turning_spring,
)
from stewart_drake.live.loop import LiveLoop
from stewart_drake.live.session import LiveSession
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import pose_jacobian, rotation_matrix

SWAY = {"plant.kind": "closed_form"}
STILL = {**SWAY, "reference": {"kind": "hold"}}


def session(**changes):
    return LiveSession(load_scenario("sway").replace({**STILL, **changes}))


def do(live, **command):
    live.put(command)
    live.obey()
    assert not live.message.startswith("not understood")


def test_a_spring_pulls_its_point_towards_its_place_with_at_most_its_largest_force():
    pose = np.array([0.1, -0.2, 0.3, 0.01, 0.02, 0.3])
    near, far = (Spring(np.array([0.05, 0, 0]), np.array([0.05, 0.02, z]), 20.0, 0.02) for z in (0.301, 0.5))
    for spring in (near, far):
        at, force = spring.force(pose)
        assert np.allclose(at, pose[3:] + rotation_matrix(pose[:3]) @ spring.point)
        assert np.allclose(np.cross(force, spring.place - at), 0.0)
        assert np.allclose(spring.wrench(pose), [*np.cross(at - pose[3:], force), *force])
    way = np.linalg.norm(near.place - near.force(pose)[0])
    assert np.linalg.norm(near.force(pose)[1]) == pytest.approx(20.0 * min(1.0, way / 0.02))
    assert np.linalg.norm(far.force(pose)[1]) == pytest.approx(20.0)


@pytest.mark.parametrize("angle", [0.1, 0.3, 3.0])
def test_a_spring_turns_about_the_way_that_is_left_with_at_most_its_largest_moment(angle):
    robot, pose, axis = (
        load_robot("paper"),
        np.array([0.1, -0.2, 0.3, 0.01, 0.02, 0.3]),
        np.array([2.0, -1.0, 2.0]) / 3.0,
    )
    held = rotation_matrix(pose[:3])
    spring = turning_spring(robot, 9.81, held, angle * axis)
    most = 0.2 * largest(robot, 9.81, MOMENT)
    np.testing.assert_allclose(spring.wrench(pose), [*most * min(1.0, angle / 0.3) * axis, 0.0, 0.0, 0.0], atol=1e-9)
    there = Rotation.from_matrix(Rotation.from_rotvec(angle * axis).as_matrix() @ held).as_euler("xyz")
    np.testing.assert_allclose(spring.wrench(np.array([*there, 0.0, 0.0, 0.3])), 0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["paper", "reachy_mini", "servo_hexapod"])
def test_the_motors_have_room_for_the_largest_force_and_moment_along_some_axis(name):
    robot = load_robot(name)
    map_of_poses = np.linalg.inv(pose_jacobian(robot, robot.home_pose)).T
    for most, axes in ((largest(robot, 9.81, MOMENT), (0, 1, 2)), (largest(robot, 9.81, FORCE), (3, 4, 5))):
        left = [
            robot.effort_limits - abs(static_torque(robot, robot.home_pose)) - most * abs(map_of_poses[:, axis])
            for axis in axes
        ]
        assert max(each.min() for each in left) > 0.3 * robot.effort_limits.min()


def test_a_pulled_platform_gives_way_and_comes_back():
    live = session()
    live.loop.advance(200)
    do(live, do="pull", point=[0.03, 0, 0], place=[0.03, 0.02, 0.31])
    live.loop.advance(20)
    row = live.row()
    assert row["pull"]["force"] == pytest.approx(0.2 * largest(live.loop.scenario.robot, 9.81, FORCE), rel=0.01)
    assert live.loop.pose[1 + 3] > 1e-4
    do(live, do="release")
    live.loop.advance(1500)
    assert live.row()["pull"] is None
    assert live.row()["position_m"] < 1e-5
    assert not live.loop.ended


def test_a_turned_platform_gives_way_and_its_moment_stays_with_the_hand():
    live = session()
    live.loop.advance(200)
    do(live, do="turn", turn=[0, 0, 0])
    live.loop.advance(20)
    assert np.linalg.norm(live.row()["moment"]) < 1e-3
    do(live, do="turn", turn=[0, 0, 1.0])
    live.loop.advance(20)
    row = live.row()
    most = 0.2 * largest(live.loop.scenario.robot, 9.81, MOMENT)
    np.testing.assert_allclose(row["moment"], [0, 0, most], atol=0.01 * most)
    assert row["pull"] is None
    assert live.loop.pose[2] > 1e-4
    do(live, do="release")
    live.loop.advance(1500)
    assert live.row()["moment"] is None
    assert live.row()["rotation_deg"] < 1e-3
    assert not live.loop.ended


def test_a_hand_is_no_wrong_motor_until_reset():
    live = session()
    assert live.loop.scenario.safety.unexplained_torque is not None
    push = 0.25 * largest(live.loop.scenario.robot, 9.81, FORCE)
    live.loop.advance(200)
    do(live, do="push", wrench=[0, 0, 0, push, 0, 0], duration=0.1)
    live.loop.advance(1500)
    assert not live.loop.ended
    assert live.row()["position_m"] < 1e-4
    assert live.loop.scenario.safety.unexplained_torque is None
    do(live, do="release")
    assert "unexplained_torque is off until Reset" in live.row()["hand"]
    do(live, do="reset")
    assert live.row()["hand"] == ""
    assert live.loop.scenario.safety.unexplained_torque is not None


def test_the_second_robot_has_separate_errors():
    live = session()
    assert live.row()["beside"] is None
    do(live, do="ghost", controller="PID of each motor")
    do(live, do="push", wrench=[0, 0, 0, 5, 0, 0], duration=0.05)
    live._for_all(lambda loop: loop.advance(50))
    row = live.row()
    off = live.ghost.pose - live.ghost.wanted
    assert row["beside"]["position_m"] == pytest.approx(np.linalg.norm(off[3:]))
    assert row["beside"]["position_m"] > 2.0 * row["position_m"]
    assert row["beside"]["ended"] == ""


def test_sliders_start_at_the_scenario_and_stop_at_their_ends():
    scenario = for_live_page(load_scenario("exact_breathing").replace({**SWAY, "tuner": "block"}))
    knobs = {knob.key: knob for knob in sliders_of(scenario, scenario)}
    assert {"tuner.q_pose", "estimator.disturbance", "plant.motor_friction", "model.friction.coulomb"} <= set(knobs)
    for knob in knobs.values():
        assert knob.low <= slider_value(scenario, knob) <= knob.high
        for value in (knob.low - 1.0, knob.high + 1.0):
            changed = scenario.replace(changes_of_slider(scenario, knob, value))
            assert slider_value(changed, knob) == pytest.approx(min(max(value, knob.low), knob.high))


def test_a_delay_of_the_machine_alone_leaves_gains_and_belief_and_upsets_the_loop():
    live, calm = session(safety=None), session(safety=None)
    live.loop.advance(200)
    before = {row["key"]: row["value"] for row in live.row()["knobs"]}
    do(live, do="knob", key="command_delay", value=8)
    after = {row["key"]: row["value"] for row in live.row()["knobs"]}
    assert after == {**before, "command_delay": 8.0}
    do(live, do="push", wrench=[0, 0, 0, 5, 0, 0], duration=0.05)
    live.loop.advance(1500)
    assert live.loop.ended or live.row()["position_m"] > 1e-3
    do(calm, do="push", wrench=[0, 0, 0, 5, 0, 0], duration=0.05)
    calm.loop.advance(1700)
    assert calm.row()["position_m"] < 1e-5


def test_a_step_and_a_sine_give_their_figures_of_both_robots():
    live = session()
    live.loop.advance(200)
    do(live, do="ghost", controller="PID of each motor")
    do(live, do="test", kind="step", axis="Z", size=0.00114)
    assert live.row()["test"] == "step of Z, 1.14 mm: under way"
    live._for_all(lambda loop: loop.advance(2100))
    assert live.row()["test"].startswith("step of Z, 1.14 mm: rise ")
    assert "; pale, PID of each motor: rise " in live.row()["test"]
    do(live, do="test", kind="sine", axis="roll", size=0.01, frequency=2.0)
    live._for_all(lambda loop: loop.advance(2100))
    assert "sine of roll, 0.573 deg, 2 Hz: gain 1.0" in live.row()["test"].replace("gain 0.99", "gain 1.0")
    assert len(live.row()["links"]) == 7 * (14 + 13)
    do(live, do="ghost", controller=None)
    assert len(live.row()["links"]) == 7 * 14


def test_the_curves_of_a_step_are_those_of_both_robots_and_begin_with_it():
    live = session()
    assert live.curves() == {}
    live.loop.advance(200)
    do(live, do="ghost", controller="PID of each motor")
    do(live, do="test", kind="step", axis="yaw", size=0.004)
    live._for_all(lambda loop: loop.advance(2100))
    curves = live.curves()
    time, response, beside = (np.array(curves[name]) for name in ("time", "response", "beside"))
    assert curves["axis"] == 2
    assert set(curves["reference"]) == {0.004}
    assert time[0] < 0.002
    assert abs(response[0]) < 1e-4
    assert response[-1] == pytest.approx(0.004, rel=1e-2)
    assert np.abs(beside - response).max() > 1e-4


@pytest.mark.parametrize("size", [0.0, 0.5, -0.5])
def test_a_test_that_cannot_be_done_is_refused(size):
    live = session()
    do(live, do="test", kind="sine", axis="Z", size=size)
    assert live.loop.test is None
    assert live.message.startswith(("amplitude: expected a number other than 0", "amplitude: expected at most "))


def test_a_step_beyond_the_following_error_or_the_sliders_is_refused_with_the_limit():
    live = session()
    for axis, size, words in (
        ("X", 0.025, ("at most 19.8 mm here", "safety.following_error")),
        ("roll", 0.12, ("at most 5.67 deg here", "safety.following_error")),
        ("roll", 1.8, ("at most 57.3 deg here", "the range of the sliders")),
    ):
        do(live, do="test", kind="step", axis=axis, size=size)
        assert all(word in live.message for word in words)
    assert live.loop.test is None


def test_a_test_that_the_safety_layer_stops_has_no_figures():
    live = session()
    do(live, do="test", kind="sine", axis="X", size=0.01, frequency=1.0)
    live.loop.advance(100)
    do(live, do="dead", leg=2)
    live.loop.advance(5000)
    assert live.loop.ended
    assert live.row()["test"] == "sine of X, 10 mm, 1 Hz: not finished"


def test_sliders_stop_within_the_workspace_of_the_safety_layer():
    live = session(**{"safety.workspace": [1.2, 0.01]})
    home = live.loop.reference.home
    do(live, do="aim", pose=list(home + [0, 0, 0, 0.012, 0, 0]))
    assert live.message == "as far as it goes: safety.workspace"
    assert 0.009 < live.loop.reference.goal[3] - home[3] < 0.01
    live.loop.advance(2000)
    assert not live.loop.ended


def test_the_cause_of_an_end_has_its_leg_limit_and_time():
    live = session()
    live.loop.advance(500)
    assert live.row()["cause"] is None
    do(live, do="dead", leg=4)
    live.loop.advance(2000)
    cause = live.row()["cause"]
    assert (cause["reason"], cause["leg"]) == ("unexplained_torque", 4)
    assert (cause["key"], cause["limit"], cause["unit"]) == ("unexplained_torque", [0.2], "")
    assert 0.5 < cause["time"] < live.loop.time
    do(live, do="reset")
    assert live.row()["cause"] is None


def test_a_sine_of_a_loop_of_first_order_has_its_gain_and_phase():
    probe, tau = TestMotion("sine", 5, 0.001, 2.0, 0.0), 0.05
    times, value = np.arange(0.0, 2.2, 1e-4), 0.0
    for time in times:
        value += 1e-4 / tau * (probe.added(time)[5] - value)
        probe.watch(time, np.array([0, 0, 0, 0, 0, value]), 0.0)
    turn = 2.0 * np.pi * 2.0 * tau
    gain, phase = 1.0 / np.hypot(1.0, turn), -np.degrees(np.arctan(turn))
    assert probe.text.endswith(f"2 Hz: gain {gain:.3f}, phase {phase:.1f} deg")


def test_pausing_and_a_tick_move_the_clock_by_a_period():
    live = session()
    do(live, do="step")
    assert live.paused
    assert live.loop.time == pytest.approx(live.loop.scenario.controller.period)
    do(live, do="speed", value=7.0)
    assert live.speed == 2.0


def test_what_was_done_is_saved_and_runs_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    live = LiveSession(load_scenario("sway").replace(SWAY))
    live.loop.advance(100)
    do(live, do="aim", pose=[0.05, 0, 0, 0, 0, 0.305])
    live.loop.advance(300)
    do(live, do="pull", point=[0.05, 0, 0], place=[0.06, 0.01, 0.315])
    live.loop.advance(200)
    do(live, do="push", wrench=[0, 0, 0, 5, 0, 0], duration=0.05)
    live.loop.advance(100)
    do(live, do="release")
    live.loop.advance(300)
    do(live, do="dead", leg=3)
    do(live, do="save")
    do(live, do="dead", leg=None)
    assert live.message == ""
    folder = tmp_path / "runs" / "sway-by-hand"
    assert {path.name for path in folder.iterdir()} == {"log.csv", "motion.csv", "scenario.yaml"}
    done = np.genfromtxt(folder / "log.csv", delimiter=",", names=True)
    log = run(load_scenario(folder / "scenario.yaml"))
    assert log.status == "completed"
    rows = np.searchsorted(log.time, done["time_s"] - 1e-9)
    rows = rows[rows < len(log.time)]
    moved = np.ptp(done["pose_x_m"])
    assert abs(log["pose"][rows, 3] - done["pose_x_m"][: len(rows)]).max() < 0.1 * moved
    before = done["time_s"][: len(rows)] < done["time_s"][-1] - 0.14  # it slows down
    assert abs(log["reference"][rows, 5] - done["reference_z_m"][: len(rows)])[before].max() < 1e-6


def test_a_loop_beside_begins_where_the_first_one_is():
    loop = LiveLoop(load_scenario("sway").replace(SWAY))
    loop.advance(500)
    other = loop.copy_with({"controller": "pid"})
    assert np.array_equal(other.pose, loop.pose)
    other.advance(300)
    assert np.linalg.norm(other.pose - loop.pose) > 1e-3
    assert not other.ended


def test_errors_and_tests_on_a_rolling_deck_are_those_of_the_levelled_reference():
    live = LiveSession(load_scenario("rolling_deck").replace({"base.motion.fade_in": 0.2}))
    live.loop.advance(800)
    assert np.abs(live.loop.pose[:3]).max() > 0.05  # [rad]
    assert live.row()["rotation_deg"] < 0.3
    do(live, do="test", kind="step", axis="roll", size=0.02)
    live.loop.advance(2100)
    overshoot = float(live.row()["test"].partition("overshoot ")[2].partition(" %")[0])
    assert overshoot < 40.0
