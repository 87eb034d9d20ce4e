"""A loop that is changed while it runs."""

import json

import numpy as np
import pytest

from stewart_drake import ConfigurationError, Scenario, load_scenario
from stewart_drake.live.loop import LiveLoop
from stewart_drake.live.session import CONTROLLERS, LiveSession

FAST = {"plant.kind": "closed_form", "duration": 0.4}
STILL = {**FAST, "reference": "hold"}


@pytest.mark.parametrize("kind", ["closed_form", "drake"])
def test_a_payload_comes_without_a_jump_and_is_carried(kind: str) -> None:
    loop = LiveLoop(load_scenario("exact_fig7").replace({**STILL, "plant.kind": kind}))
    loop.advance(100)
    pose, torque = loop.pose, loop.torque
    loop.change({"plant.payload_mass": 0.3})
    np.testing.assert_array_equal(loop.pose, pose)
    loop.advance(3000)
    assert loop.torque.sum() > 1.05 * torque.sum()
    np.testing.assert_allclose(loop.pose, pose, atol=1e-4)


def test_a_loop_that_fails_reports_why_and_can_be_reset() -> None:
    loop = LiveLoop(load_scenario("exact_fig7").replace(STILL))
    start = loop.pose
    loop.push(np.array([0.0, 0.0, 0.0, 500.0, 0.0, 0.0]), 2.0)
    loop.advance(2000)
    assert loop.ended
    loop.reset()
    assert loop.ended == ""
    np.testing.assert_array_equal(loop.pose, start)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_of_the_panel_takes_over_without_a_jump(name):
    session = LiveSession(load_scenario("exact_fig7").replace(STILL))
    session.put({"do": "controller", "name": name})
    session.run(until=0.1)
    assert (session.message, session.loop.ended) == ("", "")
    assert np.abs(session.loop.pose - session.loop.wanted).max() < 1e-4


@pytest.mark.parametrize(
    "command",
    [
        {"do": "change", "keys": {"controller": {"kind": "mine.py:Mine"}}},
        {"do": "controller", "name": "mine.py:Mine"},
        {"do": "payload", "mass": "much"},
        {"do": "dead", "leg": [[[2]]]},
        {"do": "freeze"},
        {"do": ["aim"]},
        ["aim"],
        None,
        {"do": "aim", "pose": [1.0]},
        {"do": "aim", "pose": [np.nan] * 6},
        {"do": "push", "wrench": [0.0] * 6, "duration": np.inf},
        {"do": "dance"},
        {},
        "",
        [],
        {"do": None},
        {"do": {}},
        {"do": "knob", "key": "plant.motor_friction", "value": 10**400},
        {"do": "knob", "key": [], "value": 1.0},
        {"do": "speed", "value": np.nan},
        {"do": "speed", "value": None},
        {"do": "test", "axis": "roll", "kind": "sine", "frequency": np.nan},
        {"do": "push", "wrench": [1e308] * 6, "duration": 0.1},
        {"do": "turn", "turn": [1e300, 0.0, 0.0]},
        {"do": "turn", "turn": []},
    ],
)
def test_bad_commands_of_a_page_change_nothing(command):
    session = LiveSession(load_scenario("exact_fig7").replace(STILL))
    scenario = session.loop.scenario
    session.put(command)
    session.run(until=0.05)
    assert session.message.startswith("not understood")
    assert session.loop.scenario is scenario
    assert session.loop.time > 0.0


def test_a_slider_of_a_former_controller_and_a_save_before_a_run_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    session, messages = LiveSession(load_scenario("exact_fig7").replace(STILL)), []
    stale = {"do": "knob", "key": "tuner.q_pose", "value": 1.0}
    for command in ({"do": "save"}, {"do": "controller", "name": "PID of each motor"}, stale):
        session.put(command)
        session.obey()
        messages.append(session.message)
    assert messages[0] == "save: expected a loop that has run, got 'a loop at its start'"
    assert messages[1] == ""
    assert messages[2].startswith("slider: expected one of controller.kp, ")
    assert list(tmp_path.glob("runs/*")) == []
    session.run(until=0.05)
    assert session.loop.ended == ""


def test_friction_may_come_and_go_on_drakes_plant_and_another_kind_is_refused():
    loop = LiveLoop(load_scenario("exact_fig7").replace({**STILL, "plant.kind": "drake"}))
    for friction in (0.02, 0.0, 0.01):
        loop.advance(20)
        pose, angles = loop.pose, loop.crank_angles
        loop.change({"plant.motor_friction": friction})
        np.testing.assert_array_equal((loop.pose, loop.crank_angles), (pose, angles))
    loop.advance(20)
    assert loop.ended == ""
    with pytest.raises(ConfigurationError, match="state of a plant: expected that of a closed form"):
        loop.change({"plant": {"kind": "closed_form"}})
    loop.advance(20)
    assert (loop.ended, loop.steps) == ("", 100)


class Broken:
    """A monitor that raises once the robot has run for a while."""

    def __init__(self):
        self.looks = 0

    def look(self, _):
        self.looks += 1
        if self.looks > 10:
            raise StopIteration("no more")


def test_a_monitor_that_raises_ends_the_loop_and_not_the_page():
    session = LiveSession(load_scenario("exact_fig7").replace({**STILL, "safety": {"monitors": [Broken()]}}))
    session.run(until=0.1)
    assert session.loop.ended.startswith("the user's code raised StopIteration: no more (test_live_loop.py, line ")
    assert session.row()["ended"] == session.loop.ended


def test_a_row_has_all_that_a_panel_can_set():
    session = LiveSession(load_scenario("exact_breathing").replace(FAST))
    first = session.row()
    names = ("payload", "dead", "frozen", "controller", "motion")
    assert [first[name] for name in names] == [0.0, None, None, "as in the scenario", True]
    for command in (
        {"do": "payload", "mass": 0.2},
        {"do": "dead", "leg": 2},
        {"do": "freeze", "leg": 4},
        {"do": "controller", "name": "computed torque"},
        {"do": "move", "on": False},
    ):
        number = session.put(command)
    session.run(until=0.05)
    row = session.row()
    assert row["obeyed"] == number
    assert [row[name] for name in names] == [0.2, 2, 4, "computed torque", False]
    session.put({"do": "reset"})
    session.run(until=0.05)
    assert [session.row()[name] for name in names] == [first[name] for name in names]


def test_a_pose_that_is_not_finite_leaves_a_row_that_json_can_hold():
    session = LiveSession(load_scenario("exact_fig7").replace(STILL))
    session.loop._loop.pose[:] = np.nan
    session.publish(session.row())
    _, (row,) = session.rows_after(0, 0.0)
    assert json.loads(row, parse_constant=pytest.fail)["links"] is None


@pytest.mark.parametrize("period", [0.001, 0.002])
def test_a_controller_that_looks_ahead_by_part_of_a_step_follows_the_hand(period: float) -> None:
    servos = {"kind": "position", "stiffness": 30.0, "damping": 0.1, "resolution_bits": None}
    changes = {"motors": servos, "controller": {"kind": "feedforward", "period": period}, "plant": "closed_form"}
    loop = LiveLoop(Scenario.from_dict({"reference": "hold", "duration": 1.0, **changes}))
    loop.aim(loop.pose + [0.0, 0.0, 0.0, 0.01, 0.0, 0.0])
    off = []
    for _ in range(100):
        loop.advance(20)
        off.append(np.abs(loop.pose - loop.wanted)[3:].max())
    assert loop.ended == ""
    assert max(off) < 1e-4
