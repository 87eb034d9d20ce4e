"""Cranks that stand while the reference moves, by the one law of `run`, `live`, `Controller` and `drive`."""

import numpy as np
import pytest

from stewart_drake import Controller, inverse_kinematics, load_robot, load_scenario, run
from stewart_drake.safety import Stillness, first_standstill
from stewart_drake.studies.faults import travel
from stewart_drake.studies.runs import simulate_unchecked

ROBOT = load_robot("reachy_mini")
COUNT = 2.0 * np.pi / 4096


def nod(seconds, degrees=10.0, hertz=0.5, period=0.02):
    """References (n, 6) and their cranks' angles."""
    time = np.arange(round(seconds / period)) * period
    poses = np.tile(ROBOT.home_pose, (len(time), 1))
    poses[:, 1] += np.radians(degrees) * np.sin(2.0 * np.pi * hertz * time)
    return poses, inverse_kinematics(ROBOT, poses)


def late(angles, ticks):
    return np.concatenate([np.tile(angles[:1], (ticks, 1)), angles[: len(angles) - ticks]])


def found(angles, poses, period=0.02):
    """When [s] it is found, and the leg."""
    row, leg = first_standstill(ROBOT, period, angles, poses)
    return row * period, leg


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("since", [0.0, 3.0])
def test_a_crank_that_does_not_move_is_found_within_1_7_s(leg, since):
    poses, angles = nod(6.0)
    angles[round(since / 0.02) :, leg] = angles[round(since / 0.02), leg]
    when, named = found(angles, poses)
    assert named == leg
    assert since < when < since + 1.7


def test_noise_of_a_dead_leg_is_no_motion():
    poses, angles = nod(6.0)
    angles[:, 1] = angles[0, 1] + np.random.default_rng(0).choice([-COUNT, 0.0, COUNT], len(angles))
    assert found(angles, poses)[1] == 1


def test_readings_that_all_repeat_are_found_sooner():
    poses, angles = nod(6.0)
    angles[150:] = angles[150]
    when, leg = found(angles, poses)
    assert leg is None
    assert 3.0 < when < 3.5


@pytest.mark.parametrize(
    ("degrees", "hertz", "period", "lag"),
    # Rest, below a count, slow, within the play of a servo, the paper's tick, faster than a servo, and that in the
    # paper's tick: all six stand for many ticks until they have begun, and where they turn back.
    [(0, 1, 0.02, 0.1), (0.05, 1, 0.02, 0.1), (8, 0.02, 0.02, 0.1), (1.5, 2, 0.02, 0.1), (10, 0.5, 0.001, 0.1),
     (5, 3, 0.02, 0.1), (15, 1, 0.001, 0.06)],
)  # fmt: skip
def test_a_robot_that_follows_late_in_counts_and_with_play_does_not_trip(degrees, hertz, period, lag):
    poses, angles = nod(10.0, degrees, hertz, period)
    read, play = late(angles, round(lag / period)), 0.5 * 0.0175
    for row in range(1, len(read)):
        read[row] = np.clip(read[row - 1], read[row] - play, read[row] + play)
    assert first_standstill(ROBOT, period, np.round(read / COUNT) * COUNT, poses) is None


def test_ticks_without_a_reading_are_left_out():
    poses, angles = nod(6.0)
    angles[150:, 1] = angles[150, 1]
    angles[::3] = np.nan
    assert found(angles, poses)[1] == 1


def test_a_controller_without_a_safety_layer_reports_a_standstill_and_goes_on():
    loop = {"controller": {"kind": "feedforward", "period": 0.02}, "motors": "position", "estimator": "difference"}
    reference = {"kind": "sine", "amplitude": [0, 0.17, 0, 0, 0, 0], "angular_frequency": 3.14}
    scenario = load_scenario("reachy_nod").replace(
        {**loop, "reference": reference, "safety": None, "tuner": "fixed", "model": {}, "command_delay": 0}
    )
    controller, out, angles = Controller(scenario), np.empty(6), None
    told = []
    for tick in range(100):
        controller.step(np.full(6, np.nan) if angles is None else angles, 0.02 * tick, out)
        angles = np.append(out[:5], 0.63)
        told.append(controller.standstill)
    assert told[0] is None
    assert told[-1] == ("not_moving", 5)
    controller.reset()
    assert controller.standstill is None


def test_a_pose_that_is_read_counts_as_its_angles():
    poses, _ = nod(3.0)
    monitor = Stillness(ROBOT, 0.02)
    for pose in poses:
        monitor.look(np.append(pose, np.zeros(6)), pose)
        assert monitor.latest is None
    for pose in poses:
        monitor.look(np.append(poses[0], np.zeros(6)), pose)
    assert monitor.latest[0] == "reading_stuck"


@pytest.mark.parametrize("name", ["exact_fig7", "exact_heart"])
def test_six_frozen_readings_do_not_throw_the_platform(name):
    """By torque; it went 86 and 187 mm."""
    fault = {"kind": "freeze", "leg": None, "time": 0.9}
    scenario = load_scenario(name, ["plant.kind=closed_form", "sensors.kind=encoders", "safety={}", "duration=2"])
    log = simulate_unchecked(scenario.replace({"sensors.faults": [fault]}))
    assert (log.status, log.reason, log.leg) == ("stopped", "reading_stuck", None)
    assert travel(log, 0.9)[1] < 0.02


def test_a_run_without_a_bound_on_its_motion_is_not_lost_by_a_crank_that_friction_holds():
    held = "plant.friction.coulomb=[0.02, 0.02, 5, 0.02, 0.02, 0.02]"
    off = "bounds={rotation: null, position: null, error_ratio: null}"
    scenario = load_scenario("reachy_nod", ["plant={kind: closed_form}", held, "safety=null", "duration=2.5", off])
    log = run(scenario, check=False)
    assert (log.status, log.reason, log.leg) == ("lost", "not_moving", 2)
    assert run(scenario.replace({"bounds.motion_ratio": None}), check=False).status == "completed"
