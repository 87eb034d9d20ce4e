"""Moves of Reachy Mini made possible, and shaped for its servos."""

import importlib.util

import numpy as np
import pytest
from lagging_servos import Servos

from stewart_drake import ConfigurationError, Scenario, inverse_kinematics, load_robot, load_scenario, run
from stewart_drake.reachy.moves import HEAD_HEIGHT, STEP, Move, move_json, moves_of, read_move
from stewart_drake.reachy.possible_moves import (
    SMOOTHEST,
    TORQUE,
    averaged,
    check_move,
    fix_move,
    motion_of,
    shaped_move,
)
from stewart_drake.runs.checks import check_scenario
from stewart_drake.runs.drive import connected
from stewart_drake.scenario.scenario import load_driven

ROBOT = load_robot("reachy_mini")
SERVO = ["motors={kind: position, preset: xl330_m288, delay: 0.01}", "controller={kind: feedforward}", "safety=null"]


def moving(axis, values, step=STEP):
    values = np.asarray(values)
    pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, HEAD_HEIGHT], (len(values), 1))
    pose[:, axis] += values
    time = step * np.arange(len(values))
    return Move("made up", time, pose, np.column_stack([time, -time]), 0.1 * time)


def test_averaging_leaves_lines_and_makes_waves_smaller_as_a_gaussian_does():
    time, width = STEP * np.arange(200), 0.04
    wave = np.sin(2.0 * np.pi * 3.0 * time)
    made = averaged(np.column_stack([time, wave, 0 * wave, wave, wave, wave]), np.full(200, width))[30:-30]
    np.testing.assert_allclose(made[:, 0], time[30:-30], atol=1e-4)
    np.testing.assert_allclose(made[:, 1], np.exp(-0.5 * (6.0 * np.pi * width) ** 2) * wave[30:-30], atol=1e-3)
    assert (averaged(made, np.zeros(140)) == made).all()


def test_a_move_that_can_be_done_stays_as_it_is():
    move = moving(1, 0.2 * np.sin(STEP * np.arange(200)))
    fixed, changes = fix_move(ROBOT, move)
    np.testing.assert_allclose(fixed.pose, move.pose, atol=1e-5)
    assert (changes["least size %"], changes["averaged ms"], changes["longer %"]) == (100.0, 0.0, 0.0)
    assert changes["change deg"] < 1e-3


def test_a_jump_is_averaged_around_it_and_nowhere_else():
    move = moving(0, np.where(np.arange(300) < 150, 0.0, 0.2))
    report, unreachable = check_move(ROBOT, move)
    assert not report.feasible
    assert unreachable == 0.0
    fixed, changes = fix_move(ROBOT, move)
    report, _ = check_move(ROBOT, fixed)
    assert report.feasible
    assert report.smallest["torque"].value <= TORQUE
    away = np.abs(move.time - 1.5) > 0.3
    np.testing.assert_allclose(fixed.pose[away], move.pose[away], atol=1e-5)
    assert changes["longer %"] == 0.0
    assert np.degrees(0.05) < changes["change deg"] <= np.degrees(0.1) + 1e-6


def test_a_pose_out_of_reach_comes_nearer_to_home_and_no_more_than_a_step_too_near():
    move = moving(5, 0.06 * np.sin(np.pi * np.arange(300) / 299.0) ** 2)
    assert check_move(ROBOT, move)[1] > 0.1
    fixed, changes = fix_move(ROBOT, move)
    report, unreachable = check_move(ROBOT, fixed)
    assert report.feasible
    assert unreachable == 0.0
    # At the top of what is allowed, to 3 % of the way.
    higher = fixed._replace(pose=fixed.pose + 0.03 * (fixed.pose - ROBOT.home_pose))
    assert not check_move(ROBOT, higher)[0].feasible
    np.testing.assert_allclose(fixed.pose[:20], move.pose[:20], atol=1e-5)
    assert changes["change mm"] == pytest.approx(1e3 * np.abs(fixed.pose - move.pose).max(), rel=0.01)


NOD_TIME = STEP * np.arange(300)


def recorded_nod(noise=0.0, jitter=0.0):
    """Nod of 9 deg from rest to rest, its rows with noise [-] of 0.02 deg and 0.05 mm, and stamps that jitter [s]."""
    rng = np.random.default_rng(7)
    fade = np.clip(np.minimum(NOD_TIME, NOD_TIME[-1] - NOD_TIME), 0.0, 1.0)
    move = moving(1, np.radians(9.0) * fade**2 * (3.0 - 2.0 * fade) * np.sin(1.6 * np.pi * NOD_TIME))
    pose = move.pose + noise * rng.standard_normal((300, 6)) * [*[np.radians(0.02)] * 3, *[5e-5] * 3]
    return move._replace(pose=pose, time=np.maximum.accumulate(NOD_TIME + jitter * rng.uniform(-1.0, 1.0, 300)))


def played(path, move):
    """A scenario that plays a move through the head's servos."""
    path.write_bytes(move_json(move))
    data = {
        "robot": "reachy_mini",
        "motors": {"kind": "position", "preset": "xl330_m288", "delay": 0.02},
        "plant": {"kind": "closed_form", "friction": {"coulomb": 0.0128, "viscous": 0.0037}},
        "reference": {"kind": "recorded", "motion_file": str(path)},
        "controller": {"kind": "feedforward", "period": 0.02},
        "tuner": "fixed",
        "estimator": "difference",
        "safety": None,
    }
    return Scenario.from_dict(data)


@pytest.mark.parametrize(
    ("noise", "jitter", "deg", "mm"), [(0, 0, 0.03, 0.02), (1, 0, 0.08, 0.08), (0, 0.003, 0.04, 0.02)]
)
def test_noise_and_jitter_of_a_recording_are_not_followed(tmp_path, noise, jitter, deg, mm):
    move, clean = recorded_nod(noise, jitter), recorded_nod()
    needed = [check_move(ROBOT, each)[0].smallest["torque"].value for each in (move, clean)]
    # A quarter of a servo's count of noise, differentiated twice, is 0.62 N m, and jitter 0.41 N m, for 0.05.
    assert needed[0] < needed[1] + (0.04 if noise else 1e-3)
    log = run(played(tmp_path / "nod.json", move))
    after = log.time > 0.5
    off = (log["pose"] - motion_of(clean).evaluate(log.time)[0])[after]
    turned, moved = np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)
    assert np.degrees(np.sqrt(np.mean(turned**2))) < deg
    assert 1e3 * np.sqrt(np.mean(moved**2)) < mm


RISING = moving(5, 0.0215 * (STEP * np.arange(201) / 2.0) ** 3)
"""Ends near the end of the reach while it rises at 32 mm/s."""
JUMPING = moving(0, np.where(np.arange(200) < 100, 0.0, 0.2))


@pytest.mark.parametrize("move", [RISING, JUMPING, recorded_nod(1.0, 0.003)], ids=["rising", "jump", "nod"])
def test_what_fix_passes_check_run_and_drive_pass(tmp_path, move):
    fixed, _ = fix_move(ROBOT, move)
    assert check_move(ROBOT, fixed)[0].feasible
    scenario = played(tmp_path / "fixed.json", fixed)
    for duration in (0.7, fixed.time[-1], scenario.reference.end, fixed.time[-1] + 1.0):
        check_scenario(scenario.replace({"duration": duration}))
    planned = connected(scenario, Servos())
    assert planned.duration > scenario.reference.end
    np.testing.assert_allclose(scenario.reference.evaluate(99.0)[0], fixed.pose[-1], atol=2e-4)


def test_what_averaging_cannot_help_is_slowed_with_antennas_and_body():
    # A nod of 30 deg with a period of 0.14 s, shown in slow motion by nothing but the time.
    move = moving(1, 0.45 * np.sign(np.sin(2.0 * np.pi * np.arange(120) / 60.0)))
    short = move._replace(time=0.3 * move.time)
    fixed, changes = fix_move(ROBOT, short)
    assert check_move(ROBOT, fixed)[0].feasible
    assert changes["averaged ms"] <= 1e3 * SMOOTHEST
    assert changes["longer %"] > 5.0
    slowdown = 1.0 + 0.01 * changes["longer %"]
    assert fixed.time[-1] == pytest.approx(slowdown * short.time[-1], abs=2.0 * STEP)
    np.testing.assert_allclose(fixed.antennas[-1], short.antennas[-1], atol=0.05)


def test_a_move_shorter_than_a_few_rows_is_refused():
    with pytest.raises(ConfigurationError, match=r"at least 0\.03 s"):
        fix_move(ROBOT, moving(0, np.zeros(4), step=0.001))


@pytest.mark.skipif(importlib.util.find_spec("reachy_mini_dances_library") is None, reason="needs the maker's dances")
@pytest.mark.slow
def test_all_twenty_dances_can_be_done_and_none_takes_longer(tmp_path):
    dances = moves_of("dances")
    assert len(dances) == 20
    assert sum(not check_move(ROBOT, move)[0].feasible for move in dances.values()) == 7
    for name, move in dances.items():
        fixed, changes = fix_move(ROBOT, move)
        path = tmp_path / f"{name}.json"
        path.write_bytes(move_json(fixed))
        report, unreachable = check_move(ROBOT, read_move(path))
        assert (report.feasible, unreachable, changes["longer %"]) == (True, 0.0, 0.0), name
        assert report.smallest["torque"].value <= 0.5
        assert report.smallest["crank_speed"].value <= np.radians(618.0)


def test_an_ordinary_player_of_a_shaped_move_sends_what_the_exact_model_sends(tmp_path):
    move = moving(1, 0.2 * np.sin(2.0 * np.pi * STEP * np.arange(150)))
    (tmp_path / "nod.json").write_bytes(move_json(move))
    scenario = load_scenario("reachy_nod", [*SERVO, "plant={kind: closed_form}"])
    shaped, shares = shaped_move(scenario, move)
    assert (shares == 1.0).all()
    (tmp_path / "shaped.json").write_bytes(move_json(shaped))
    back = read_move(tmp_path / "shaped.json")
    # The nod alone, as the angles of its inverse kinematics, is not what the servos need.
    assert np.abs(back.pose - motion_of(move).evaluate(back.time)[0])[:, 1].max() > 0.02
    reference = {"kind": "recorded", "motion_file": str(tmp_path / "nod.json")}
    log = run(scenario.replace({"reference": reference, "duration": 1.4}), check=False)
    sent = np.array([log["commanded_angle"][np.searchsorted(log.time, time - 1e-6)] for time in back.time[:60]])
    np.testing.assert_allclose(inverse_kinematics(ROBOT, back.pose[:60]), sent, atol=1e-6)


TOOL = {"position": [0.02, 0.0, 0.1], "orientation": [0.2, -0.1, 0.3]}


def test_a_tool_on_the_head_changes_nothing_of_a_move():
    jump, robot = moving(0, np.where(np.arange(100) < 50, 0.0, 0.2)), ROBOT.replace(tool=TOOL)
    assert check_move(robot, jump) == check_move(ROBOT, jump)
    np.testing.assert_array_equal(fix_move(robot, jump)[0].pose, fix_move(ROBOT, jump)[0].pose)
    nod, scenario = moving(1, 0.2 * np.sin(STEP * np.arange(50))), load_scenario("reachy_nod", SERVO)
    plain = shaped_move(scenario, nod)[0].pose
    np.testing.assert_array_equal(shaped_move(scenario.replace({"robot.tool": TOOL}), nod)[0].pose, plain)
    driven = load_driven("reachy_daemon"), load_driven("reachy_daemon", ["model.robot.tool={position: [0, 0, 0.1]}"])
    plain, told = (shaped_move(each, nod)[0].pose for each in driven)
    np.testing.assert_array_equal(told, plain)


def test_a_scenario_with_a_tool_refuses_a_move_in_a_line(tmp_path):
    (tmp_path / "nod.json").write_bytes(move_json(moving(1, 0.1 * np.sin(STEP * np.arange(50)))))
    recorded = {"kind": "recorded", "motion_file": str(tmp_path / "nod.json")}
    for reference, place in ((recorded, ""), ({"kind": "adjusted", "motion": recorded}, r"\.motion")):
        with pytest.raises(ConfigurationError, match=rf"reference{place}\.motion_file.*robot\.tool null") as caught:
            load_scenario("reachy_nod").replace({"reference": reference, "robot.tool": TOOL})
        assert "\n" not in str(caught.value)
