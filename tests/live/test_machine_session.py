"""`live --machine`: the page steers a robot, here one in the same process with servos that lag."""

import json
import time

import numpy as np
import pytest
from lagging_servos import Servos

from stewart_drake import forward_kinematics, load_scenario
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.cli.view_commands import _steer
from stewart_drake.live.machine_session import MachineSession
from stewart_drake.live.start import start_machine
from stewart_drake.live.steering import HandReference
from stewart_drake.machines.machine import MachineError
from stewart_drake.runs.drive import connected
from stewart_drake.scenario.scenario import load_driven

SCENARIO = load_scenario(
    "reachy_nod",
    [
        "motors={kind: position, preset: xl330_m288}",
        "controller={kind: feedforward, feedforward: none, period: 0.02}",
        "model={friction: null}",
        "safety=null",
        "duration=4",
    ],
)
ROBOT, HOME = SCENARIO.robot, SCENARIO.reference.evaluate(0.0)[0]


class Timed(Servos):
    """Twenty times as fast as the clock; `asked`: tick -> what happens then."""

    def __init__(self, asked):
        super().__init__()
        self.asked = asked

    def read(self):
        time.sleep(0.001)
        self.asked.get(self.count + 1, lambda: None)()
        return super().read()


def steered(**at):
    """A session, its machine, and why it ended; `at`: tick -> what the page asks for, or raises."""
    asked = {}
    machine = Timed(asked)
    session = MachineSession(SCENARIO, machine, connected(SCENARIO, machine))
    for tick, command in at.items():
        asked[int(tick[1:])] = command if callable(command) else lambda command=command: session.put(command)
    why = session.run()
    return session, machine, why


def interrupted():
    raise KeyboardInterrupt


def test_a_slider_moves_the_robot_slowly_and_the_motion_ends_with_what_was_checked():
    wanted = HOME + [0.0, 0.0, 0.1, 0.003, 0.0, 0.005]
    session, machine, why = steered(_10={"do": "aim", "pose": wanted.tolist()}, _700={"do": "stop"})
    assert isinstance(why, KeyboardInterrupt)
    np.testing.assert_allclose(forward_kinematics(ROBOT, machine.angles), wanted, atol=2e-3)
    speeds = np.abs(np.diff(machine.commands, axis=0)) / 0.02
    assert speeds.max() < 5.0
    assert speeds[-5:].max() < 1e-3
    row = json.loads(session.rows_after(0, 0.0)[1][-1])
    assert (row["ended"], row["motion"], len(row["links"])) == ("stopped", False, 7 * (14 + 13))
    np.testing.assert_allclose(row["links"][7 * 12 : 7 * 12 + 3], row["links"][7 * 26 : 7 * 26 + 3], atol=2e-3)


def test_what_breaks_the_picture_does_not_break_the_stop(monkeypatch):
    monkeypatch.setattr(HandReference, "govern", lambda *_: 1 / 0)
    session, machine, why = steered(_60={"do": "stop"}, _900=interrupted)
    assert isinstance(why, KeyboardInterrupt)
    assert machine.count < 300
    assert session.message == "ZeroDivisionError: division by zero"


def test_it_goes_as_far_as_the_robot_can_and_names_the_limit():
    session, machine, _ = steered(
        _10={"do": "aim", "pose": (HOME + [0, 0, 0, 0, 0, 0.2]).tolist()}, _500={"do": "stop"}
    )
    rows = [json.loads(row) for row in session.rows_after(0, 0.0)[1]]
    assert any(row["message"].startswith("as far as it goes: ") for row in rows)
    low, high = ROBOT.crank_angle_ranges.T
    assert (np.array(machine.commands) >= low - 1e-9).all()
    assert (np.array(machine.commands) <= high + 1e-9).all()


def test_a_lost_machine_ends_the_session_with_a_message():
    def lost():
        raise MachineError("robot", "lost")

    session, _, why = steered(_100=lost)
    assert isinstance(why, RunFailure)
    assert json.loads(session.rows_after(0, 0.0)[1][-1])["ended"] == "robot: lost"


def test_a_motion_is_played_again_when_it_is_switched_on_again_and_all_is_logged():
    session, machine, why = steered(
        _120={"do": "push", "wrench": [0] * 6}, _550={"do": "move", "on": True}, _900={"do": "stop"}
    )
    log = session.log(why)
    assert log.status == "interrupted"
    assert len(log.time) == len(machine.commands)
    assert log.scenario.duration == log.end_time

    def moved(first, last):
        return np.ptp(log["reading"][first:last], axis=0).max()

    # The motion lasts 4 s, after an approach, and 2 s of slowing down; what the page may not ask for did nothing.
    again = moved(560, 740)
    assert again == pytest.approx(moved(60, 250), rel=0.3)
    assert moved(450, 550) < 0.02 * again
    assert moved(860, 900) < 0.02 * again


def test_the_page_shows_the_machine():
    machine = Timed({})
    session, server = start_machine(SCENARIO, machine, connected(SCENARIO, machine), "mine.py:Servos")
    server.close()
    about = server._server.RequestHandlerClass.about
    assert about["machine"] == "mine.py:Servos"
    assert list(about["scene"]["links"])[14] == "ghost of crank_0"
    assert len(about["scene"]["links"]) == len(session.row()["links"]) // 7


@pytest.mark.parametrize("change", ["hand", "share"])
def test_a_hand_s_motion_goes_on_where_a_target_changes(change):
    motion, step, rows = HandReference(SCENARIO.reference, 3.0), 0.002, []
    for k in range(1000):
        if k == 300:
            value = getattr(motion, change)
            value.target = value.target + 0.01
        motion.advance(k * step)
        ahead = np.array([k * step, (k + 1) * step])
        (pose, _), (rate, _), (acceleration, _) = motion.evaluate(ahead)
        np.testing.assert_allclose(motion.evaluate(k * step)[0], pose, atol=1e-12)
        rows.append(np.concatenate([pose, rate, acceleration]))
    rows = np.array(rows)
    for low in (0, 6):
        slope = np.gradient(rows[:, low : low + 6], step, axis=0)
        np.testing.assert_allclose(slope[2:-2], rows[2:-2, low + 6 : low + 12], atol=2e-2)


@pytest.mark.parametrize(
    "command",
    [{}, [], None, {"do": "dance"}, {"do": "aim"}, {"do": "aim", "pose": []}, {"do": "aim", "pose": [np.nan] * 6},
     {"do": "aim", "pose": [1e300] * 6}, {"do": "aim", "pose": [10**400] * 6}, {"do": "move"},
     {"do": "knob", "key": "plant.motor_friction", "value": 0.1}, {"do": "save"}],
)  # fmt: skip
def test_bad_commands_to_a_machine_change_nothing(machine_session, command):
    target = machine_session.row()["target"]
    machine_session.put(command)
    machine_session.obey()
    assert machine_session.message.startswith("not understood: ")
    assert machine_session.row()["target"] == target


@pytest.fixture(scope="module")
def machine_session():
    machine = Timed({})
    return MachineSession(SCENARIO, machine, connected(SCENARIO, machine))


def test_a_stream_is_refused_as_the_page_steers():
    stream = {"kind": "stream", "udp": "127.0.0.1:0"}
    with pytest.raises(ConfigurationError, match=r"reference.udp: expected null: here the page steers"):
        _steer(load_driven("reachy_servos", [f"reference={json.dumps(stream)}"]), "sim:", None, False, False)
