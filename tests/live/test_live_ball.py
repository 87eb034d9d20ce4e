"""A ball that a person holds, throws and aims on the live page."""

import json

import numpy as np
import pytest

from stewart_drake import load_scenario, run
from stewart_drake.live.ball import AWAY
from stewart_drake.live.session import LiveSession
from stewart_drake.runs.scene import ball_links


@pytest.fixture(scope="module")
def session():
    return LiveSession(load_scenario("ball").replace({"ball.throws": []}))


@pytest.fixture(autouse=True)
def fresh(session):
    do(session, {"do": "reset"})


def do(session, command):
    session.put(command)
    session.obey()
    return session.message


def test_a_throw_moves_the_ball_and_the_loop_brings_it_back(session):
    session.loop.advance(1500)
    assert do(session, {"do": "throw", "velocity": [0.2, -0.1]}) == ""
    session.loop.advance(10)
    np.testing.assert_allclose(session.loop.ball_motion[2:4], [0.2, -0.1], atol=0.02)
    session.loop.advance(3000)
    assert session.row()["ball"]["away_m"] < 0.003


def test_a_held_ball_is_where_the_hand_is_and_keeps_its_velocity(session):
    do(session, {"do": "hold", "place": [0.0, 0.0]})
    session.loop.advance(500)
    for step in range(20):  # 0.25 m/s
        do(session, {"do": "hold", "place": [0.005 * step, 0.0]})
        session.loop.advance(20)
    assert session.loop.ball_motion[0] == pytest.approx(0.095, abs=0.02)
    do(session, {"do": "let_go"})
    assert session.loop.ball_motion[2] == pytest.approx(0.25, abs=0.05)
    assert do(session, {"do": "hold", "place": [5.0, 0.0]}) == ""
    session.loop.advance(1000)
    assert np.linalg.norm(session.loop.ball_motion[:2]) < 0.15


def test_a_ball_that_falls_is_put_back(session):
    session.loop.advance(100)
    do(session, {"do": "throw", "velocity": [2.0, 0.0]})
    session.loop.advance(200)
    row = session.row()
    assert (row["ended"], row["ball"]) == ("", None)
    assert row["hand"] == f"the ball fell off; it is put back after {AWAY:g} s"
    session.loop.advance(1200)
    row = session.row()
    assert (row["ended"], row["hand"]) == ("", "")
    assert np.linalg.norm(row["ball"]["place"]) < 0.1
    assert np.isfinite(json.loads(json.dumps(row["links"].tolist()))).all()


def test_a_click_moves_the_target_and_the_path_comes_back(session):
    do(session, {"do": "ball_target", "place": [0.03, -0.04]})
    session.loop.advance(2500)
    np.testing.assert_allclose(session.loop.ball_motion[:2], [0.03, -0.04], atol=0.003)
    # The pose follows the tilted reference, which is what the page compares it with.
    assert session.row()["rotation_deg"] < 0.01
    do(session, {"do": "ball_target", "place": None})
    assert session.loop.scenario.ball_control == session._initial.ball_control


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ({"do": "throw", "velocity": [50.0, 0.0]}, "speed of a throw: expected at most 5 m/s, got 50.0"),
        ({"do": "throw", "velocity": [np.nan, 0.0]}, "not understood: "),
        ({"do": "throw", "velocity": "far"}, "not understood: "),
        ({"do": "throw"}, "not understood: "),
        ({"do": "hold", "place": [0.0, 0.0, 0.0]}, "not understood: "),
        ({"do": "hold", "place": {}}, "not understood: "),
        (
            {"do": "ball_target", "place": [1.0, 0.0]},
            "target: expected a place on the plate, of 0.15 m, got [1.0",
        ),
        ({"do": "ball_target", "place": [0.0]}, "not understood: "),
        ({"do": "ball_target"}, "not understood: "),
    ],
)
def test_bad_commands_are_one_line_and_change_nothing(session, command, said):
    scenario = session.loop.scenario
    message = do(session, command)
    assert message.startswith(said)
    assert "\n" not in message
    assert session.loop.scenario == scenario
    assert session.loop.ball.held is None


def test_without_a_ball_a_throw_is_refused_and_nothing_is_drawn_of_it():
    session = LiveSession(load_scenario("hold").replace({"plant.kind": "closed_form"}))
    assert do(session, {"do": "throw", "velocity": [0.1, 0.0]}).startswith("ball: expected a section: this")
    assert do(session, {"do": "ball_target", "place": None}).startswith("ball_control: expected a section: nothing")
    row = session.row()
    assert (row["ball"], len(row["links"])) == (None, 7 * 14)


def test_a_saved_scenario_repeats_the_throws(session, tmp_path):
    session.loop.advance(200)
    do(session, {"do": "throw", "velocity": [0.1, 0.0]})
    session.loop.advance(300)
    session.loop.record.save(tmp_path, session.loop.scenario)
    log = run(load_scenario(tmp_path / "scenario.yaml"))
    np.testing.assert_allclose(log["ball"][-1], session.loop.ball_motion[:2], atol=2e-3)


def test_a_drawn_ball_rolls():
    """A way of a quarter of its circumference along x turns it by 90 deg about y."""
    ball, ways = load_scenario("ball").ball, np.linspace(0.0, 0.5 * np.pi * 0.02, 5)
    places, poses = np.column_stack([ways, np.zeros(5)]), np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.3], (5, 1))
    links = ball_links(ball, poses, places)
    np.testing.assert_allclose(links[-1, 0, 3:], [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)], atol=1e-9)
    np.testing.assert_allclose(links[-1, 0, :3], [ways[-1], 0.0, 0.32], atol=1e-9)
