import math
import re

import numpy as np
import pytest
from made_logs import made_log

from stewart_drake import ReferenceLimits, RobotParameters, inverse_kinematics, load_scenario, run, run_metrics
from stewart_drake.base.errors import NotFiniteError, SafetyStop
from stewart_drake.logs.outcomes import RunRows, assess, find_warnings
from stewart_drake.runs.checks import likely_cause
from stewart_drake.safety import LEVELS, MONITORS
from stewart_drake.scenario.limits import longest_excursion

TRIP = {"monitor": "deadline", "level": "hold", "time": 0.4, "leg": 2, "cause": None, "worst": "safe_hold"}
TAKEN = {"monitor": "crank_speed", "time": 0.5, "leg": 1}


def trip(last, worst="safe_hold"):
    return {**TRIP, "last": last, "worst": worst, "stopped": None if last in ("none", "hold") else TAKEN}


def rows_of(**changes):
    log = made_log(**changes)
    return RunRows(log.scenario, log.signals)


def verdict(trip=None, ended_by=None, **changes):
    return assess(rows_of(**changes), trip, 10.0, ended_by)


def level(values):
    rows = np.zeros((101, 3))
    rows[:, 0], rows[:, 2] = values, -1.0
    return rows


HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])
TIMES = np.linspace(0.0, 10.0, 101)


def swinging(share, reach=0.01, until=10.0):
    swing = np.zeros((101, 6))
    swing[:, 5] = reach * np.sin(0.8 * np.pi * TIMES) * (until >= TIMES)
    return {"reference": HOME + swing, "pose": HOME + share * swing}


@pytest.mark.parametrize(
    ("signal", "column", "bound", "reason"),
    [("pose", 1, math.radians(10.0), "rotation_bound"), ("pose", 4, 0.03, "position_bound")]
    + [("loop_gap", 3, 0.001, "loop_gap_bound")],
)
def test_an_error_that_leaves_its_bound_in_a_single_step_is_a_run_lost(signal, column, bound, reason):
    values = np.zeros((101, 6))
    values[37, column] = 0.999 * bound
    assert verdict(**{signal: values}).status == "completed"
    values[37, column] = 1.001 * bound
    outcome = verdict(**{signal: values})
    assert (outcome.status, outcome.reason) == ("lost", reason)
    assert outcome.outcome_time == pytest.approx(3.7)
    assert outcome.leg == (3 if signal == "loop_gap" else None)
    off = {"bounds": {reason.removesuffix("_bound"): None}}
    assert verdict(scenario=off, **{signal: values}).status == "completed"


def test_a_start_that_is_off_has_to_come_back():
    pose = np.zeros((101, 6))
    pose[:20, 3] = 0.05
    assert verdict(pose=pose).status == "completed"
    pose[60, 3] = np.nan
    assert verdict(pose=pose).outcome_time == pytest.approx(6.0)
    never = verdict(pose=np.full((101, 6), 0.05))
    assert (never.status, never.reason, never.outcome_time) == ("lost", "position_bound", 0.0)


@pytest.mark.parametrize(
    ("share", "status", "warned"),
    [(0.55, "completed", False), (0.45, "completed", True), (2.05, "lost", False), (0.24, "lost", False)],
)
def test_an_error_as_large_as_the_motion_is_a_run_lost_and_half_of_it_has_a_warning(share, status, warned):
    rows = rows_of(**swinging(share))
    assert rows.error_ratio == pytest.approx(abs(1.0 - share), rel=0.03)
    assert rows.motion_ratio == pytest.approx(abs(share), rel=1e-9)
    outcome = assess(rows, None, 10.0, None)
    assert (outcome.status, outcome.reason) == (status, "not_followed" if status == "lost" else None)
    warnings = {each["name"]: each for each in find_warnings(outcome.status, rows, None)}
    assert ("poorly_followed" in warnings) == warned
    if warned:
        assert warnings["poorly_followed"]["number"] == rows.error_ratio
    off = {"bounds": {"error_ratio": None, "motion_ratio": None}}
    assert verdict(scenario=off, **swinging(share)).status == "completed"


def test_a_motion_that_is_over_before_errors_count_is_compared_too():
    signals = swinging(-0.5, until=2.5)
    outcome = verdict(**signals)
    assert outcome.reason == "not_followed"
    assert outcome.message.startswith("from 0 to 10 s the RMS error was 1.5 times")
    # The way from the start to the reference is no error of the controller's.
    signals = swinging(1.0, until=2.5)
    signals["pose"][:, 4] = 0.02 * np.exp(-2.0 * TIMES)
    assert verdict(**signals).status == "completed"


@pytest.mark.parametrize(
    ("until", "duration", "status"), [(2.9, 10.0, "completed"), (4.5, 10.0, "lost"), (0.49, 0.49, "completed")]
)
def test_the_first_3_s_or_six_tenths_are_for_settling_and_half_a_second_has_no_time_to(until, duration, status):
    signals, time = swinging(1.0), 0.1 * duration * TIMES
    signals["pose"][until > time, 0] += 0.15
    assert verdict(duration=duration, time=time, **signals).status == status


@pytest.mark.parametrize(("reach", "status"), [(0.38e-3, "completed"), (0.49e-3, "lost")])
def test_a_motion_of_less_than_a_third_of_a_millimetre_is_judged_by_the_bounds_alone(reach, status):
    assert verdict(**swinging(0.0, reach)).status == status
    still = {"reference": np.tile(HOME, (101, 1)), "pose": np.tile(HOME + 0.01, (101, 1))}
    assert verdict(**still).status == "completed"
    assert verdict(scenario={"robot": "reachy_mini"}, **swinging(0.0, 3.0 / 11.0 * reach)).status == status


def test_what_the_safety_layer_does_is_no_error_of_the_controller():
    signals = swinging(1.0)
    signals["pose"][70:] = HOME
    held = level([0.0] * 70 + [2.0] * 31)
    assert rows_of(safety=held, **signals).error_ratio == 0.0
    assert rows_of(**signals).error_ratio > 0.9


@pytest.mark.parametrize("last", ["none", "hold", "ramp", "safe_hold"])
def test_what_the_safety_layer_holds_at_the_end_is_stopped_however_small_the_error(last):
    # Held for a while, given back, and held again from 8 s on by the monitor of that time.
    rows = level([0.0] * 20 + [1.0] * 10 + [0.0] * 50 + [float(LEVELS.index(last))] * 21)
    rows[80:, 1:] = MONITORS.index("crank_speed"), 1.0
    outcome = verdict(trip=trip(last), safety=rows)
    if last == "none":
        assert outcome.status == "completed"
    else:
        assert outcome[:2] == ("stopped", "crank_speed")
        # A hold is not for good; it counts from its first tick.
        assert (outcome.outcome_time, outcome.leg) == (pytest.approx(8.0 if last == "hold" else 0.5), 1)


def test_a_stop_that_held_is_stopped_and_one_that_could_not_hold_failed():
    held = SafetyStop("crank_speed", "crank_speed: stopped, and held for 0.5 s", 1, trip("safe_hold"))
    given_up = SafetyStop("crank_speed", "a crank turns at 40 rad/s", 1, trip("end", "end"))
    assert verdict(trip=held.trip, ended_by=held).status == "stopped"
    outcome = verdict(trip=given_up.trip, ended_by=given_up)
    assert (outcome.status, outcome.reason, outcome.leg) == ("failed", "crank_speed", 1)


def test_what_broke_failed_and_what_was_interrupted_is_that_whatever_else():
    error = NotFiniteError("torque", [1.0])
    error.time = 3.0
    far = np.full((101, 6), 9.0)
    assert verdict(pose=far, ended_by=error)[:2] == ("failed", "not_finite")
    assert verdict(pose=far, ended_by=error).outcome_time == 3.0
    assert verdict(pose=far, ended_by=KeyboardInterrupt()).status == "interrupted"


def test_warnings_name_what_a_completed_run_hides():
    torque, gap, pose = np.zeros((101, 6)), np.zeros((101, 6)), np.zeros((101, 6))
    torque[10:20, 0], gap[33, 2], pose[:, 3] = 5.5, 2e-5, 1e-4
    rows = level([0.0] * 40 + [1.0] * 5 + [0.0] * 10 + [1.0] + [0.0] * 45)
    made = rows_of(torque=torque, loop_gap=gap, pose=pose, safety=rows)
    seen = {**trip("none", "hold"), "time": 4.0}
    outcome = assess(made, seen, 10.0, None)
    assert outcome.status == "completed"
    found = {each["name"]: each for each in find_warnings(outcome.status, made, seen)}
    assert set(found) == {"safety_intervention", "saturation", "loop_gap"}
    assert (found["safety_intervention"]["time"], found["safety_intervention"]["number"]) == (4.0, 2)
    assert (found["saturation"]["time"], found["saturation"]["number"]) == pytest.approx((1.0, 10 / 606))
    assert (found["loop_gap"]["time"], found["loop_gap"]["number"]) == pytest.approx((3.3, 0.2))
    assert find_warnings("completed", rows_of(pose=pose), None) == ()


def warned(**changes):
    return {each["name"]: each for each in find_warnings("completed", rows_of(**changes), None)}


@pytest.mark.parametrize(
    ("robot", "sensors", "bound"),
    [
        ("paper", {"kind": "ideal"}, 0.33e-3),
        ("paper", {"kind": "encoders", "resolution_bits": 0, "noise": 0.01}, 0.33e-3 + 3.0 * 0.01 * 0.11),
        ("reachy_mini", {"kind": "ideal"}, None),
    ],
)
def test_a_position_that_is_not_held_has_a_warning_in_the_scale_of_robot_and_sensors(robot, sensors, bound):
    scenario = {"robot": robot, "sensors": sensors, "bounds": {"position": None}}
    length = rows_of(scenario=scenario).scenario.robot.characteristic_length
    bound = 0.003 * length if bound is None else bound
    off = np.zeros((101, 6))
    off[35:, 4] = bound
    assert "poorly_held" not in warned(scenario=scenario, pose=0.99 * off)
    found = warned(scenario=scenario, pose=1.01 * off)["poorly_held"]
    assert (found["time"], found["number"]) == (pytest.approx(5.333, abs=1e-3), pytest.approx(1.01 * bound))
    away = np.zeros((101, 6))
    away[20, 1] = 11.0 * bound / length
    found = warned(scenario=scenario, pose=away)["poorly_held"]
    assert (found["time"], found["number"]) == (pytest.approx(2.0), pytest.approx(11.0 * bound))
    away[0] = away[20]
    assert "poorly_held" not in warned(scenario=scenario, pose=away)


def test_a_motion_beyond_a_limit_has_a_warning_though_it_was_followed():
    pose = np.tile(HOME, (101, 1))
    pose[20:30, [0, 5]] = [0.56, 0.355]
    found = warned(pose=pose, reference=pose)["beyond_limits"]
    assert (found["time"], found["number"]) == pytest.approx((2.0, 10 / 101))
    assert re.match(r"joint_swing: 1\.2.* rad at 2 s, for swing .* \(universal joint of leg 2\); beyond", found["text"])
    assert run_metrics(made_log(pose=pose, reference=pose))["beyond_limits"] == pytest.approx(10 / 101)
    off = {"limits": {"joint_swing": None, "transmission": None, "conditioning": None}}
    assert "beyond_limits" not in warned(pose=pose, reference=pose, scenario=off)
    pose[20:30, [0, 5]] = [math.pi / 6.0, 0.35]  # The paper's own motion: 63.1 deg.
    assert "beyond_limits" not in warned(pose=pose, reference=pose)


@pytest.mark.parametrize(("beyond", "is_told"), [(0.009, False), (0.011, True)])
def test_a_crank_that_touches_its_stop_with_an_error_of_following_is_not_beyond_it(beyond, is_told):
    stop = float(inverse_kinematics(RobotParameters(), HOME)[0]) - beyond
    robot = RobotParameters(home_height=0.29, legs=[{"crank_angle_range": [-1.5, stop]}, *[{}] * 5])
    pose = np.tile(HOME, (3, 1))
    found = longest_excursion(robot, ReferenceLimits(), np.arange(3.0), pose, 0.0 * pose)
    assert (found is not None and found[0].limit == "crank_range") == is_told


def test_a_motion_that_ends_long_before_the_run_has_a_warning():
    rate = np.zeros((101, 6))
    rate[:31, 5] = 0.01
    found = warned(reference_rate=rate)["motion_length"]
    assert (found["time"], found["number"]) == (pytest.approx(3.0), pytest.approx(0.3))
    rate[:80, 5] = 0.01
    assert "motion_length" not in warned(reference_rate=rate)
    assert "motion_length" not in warned()


@pytest.mark.parametrize(
    ("link", "since"),
    [
        ({"stop_time": 0.0}, 0.0),
        ({"drop_probability": 1.0}, 0.0),
        ({"stop_time": 7.0}, 7.0),
        ({"stop_time": 9.95}, None),
        ({"drop_probability": 0.3}, None),
    ],
)
def test_a_run_in_which_no_command_arrives_any_more_is_not_completed(link, since):
    outcome = verdict(rows=10_001, step=0.001, scenario={"link": link})
    assert (outcome.status, outcome.reason) == (("completed", None) if since is None else ("lost", "link_silent"))
    assert outcome.outcome_time == (None if since is None else pytest.approx(since))


@pytest.mark.parametrize(
    ("scenario", "changes", "cause"),
    [
        ("exact_fig7", {"plant.payload_mass": 300.0, "duration": 0.5}, r"leg \d with payload 300 kg needs "),
        ("hold", {"plant.payload_mass": 300.0, "duration": 0.5}, r"leg \d with payload 300 kg needs "),
        (
            "paper_fig7",
            {"controller.period": 0.1, "duration": 0.6},
            "a slow loop of 10 Hz: the platform can fall 49 mm",
        ),
    ],
)
def test_what_ends_a_run_names_the_likely_cause(scenario, changes, cause):
    log = run(load_scenario(scenario).replace({"plant.kind": "closed_form", **changes}))
    assert log.status != "completed"
    assert re.search(f"^[^\n]*; likely cause: {cause}[^\n]*$", log.message)


def test_a_loop_was_too_slow_only_where_it_lost_the_robot_at_once():
    scenario = load_scenario("reachy_nod")
    assert likely_cause(scenario, 0.2).startswith("a slow loop of 100 Hz")
    assert likely_cause(scenario, 3.0) == ""


def test_figures_and_outcome_do_not_depend_on_which_rows_the_log_keeps():
    blow = {"kind": "impulse", "time": 0.25, "impulse": [0, 0, 0, 0, 2.0, 0]}
    fast = {"plant.kind": "closed_form", "plant.time_step": 0.0005, "duration": 0.6, "disturbances": [blow]}
    still = load_scenario("exact_fig7").replace({"reference": {"kind": "hold"}, **fast})
    logs = [run(still.replace({"log_period": period})) for period in (0.0005, None, 0.6, 0.007)]
    assert [len(log.time) for log in logs] == [1201, 601, 2, 86]
    figures = [{k: v for k, v in run_metrics(log).items() if k != "real_time_factor"} for log in logs]
    assert all(each == figures[0] for each in figures)
    # Peaks are those of every step of the plant.
    sizes = np.abs(logs[0]["pose"] - logs[0]["reference"])[logs[0].time >= 0.3].max(axis=0)
    np.testing.assert_allclose(figures[2]["peak_mm"], 1e3 * sizes[3:], rtol=1e-12)
    assert [log.warnings for log in logs[1:]] == [logs[0].warnings] * 3
