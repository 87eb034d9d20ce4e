import dataclasses
import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from strategies import ROBOT, poses

from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.runs.simulation import run
from stewart_drake.safety import MONITORS
from stewart_drake.studies import runs, workers
from stewart_drake.studies.faults import (
    COLUMNS,
    DURATION,
    FAULTS,
    MOTIONS,
    ONSET,
    FaultStudy,
    base,
    holdable_load,
    measure_fault,
    sheet,
)
from stewart_drake.studies.runs import execute

IN_TURN = [(fault, tuple(MOTIONS)[number % len(MOTIONS)]) for number, fault in enumerate(FAULTS.values())]
"""Each fault in one motion; `stewart-drake faults` makes the whole table."""


def fault_row(fault, motion):
    study = FaultStudy(base(), [(fault, motion)], name="faults", indices=[0])
    (row,) = study.tables([execute(study.task(0))])["faults"][1]
    return {column.name: row.get(column.name) for column in COLUMNS}


def bad_ending(fault, row):
    """What of a row is not as the catalogue says; None where all is."""
    if row["reaction"] not in fault.expected:
        return f"{row['reaction']}, not {fault.expected}: {row['message']}"
    if row["safety_monitor"] is None:
        return None
    if row["safety_monitor"] not in fault.monitors:
        return f"{row['safety_monitor']}, not {fault.monitors}"
    if not row["latency_ms"] >= -1e-6:
        return f"tripped {row['latency_ms']} ms before the fault"
    late = fault.within is not None and row["latency_ms"] > 1e3 * fault.within + 1e-6
    return f"{row['latency_ms']} ms, not within {fault.within} s" if late else None


@pytest.mark.long
@pytest.mark.parametrize(("fault", "motion"), IN_TURN, ids=lambda v: getattr(v, "name", v))
def test_a_fault_ends_as_the_catalogue_says(fault, motion):
    row = fault_row(fault, motion)
    assert bad_ending(fault, row) is None
    if row["reaction"] == "refused":
        assert row["status"] == "rejected"
        return
    assert row["peak_torque"] <= base().robot.effort_limit
    assert math.isfinite(row["peak_torque"])
    # A fault that trips in its own tick leaves no time to be in charge of.
    assert row["peak_error_mm"] is not None or row["latency_ms"] == pytest.approx(0.0, abs=1e-6)
    assert all(math.isfinite(x) for x in (row["peak_error_deg"], row["peak_error_mm"]) if x is not None)
    if row["reaction"] in ("ridden through", "held"):
        assert (row["status"], row["end_time"], row["travel_mm"]) == ("completed", DURATION, None)
    elif row["reaction"] == "unnoticed":
        # Nobody was told, but the outcome is.
        assert row["status"] in ("completed", "lost")
        assert row["end_time"] == DURATION
    else:
        assert row["status"] == ("stopped" if row["reaction"] == "ramped" else "failed")
        # A crank that has lost its rod may spin up until the solver gives up.
        assert row["reason"] == row["safety_monitor"] or (fault.name, row["reason"]) == ("broken_rod_2", "drake_check")
    if row["reaction"] == "ridden through":
        # It would have tripped otherwise.
        assert row["peak_error_deg"] < np.degrees(0.1)
        assert row["peak_error_mm"] < 20.0
    assert (row["holds_weight"] is None) == ("dead_motor" not in fault.name)


def test_the_catalogue_has_58_faults_and_its_monitors_exist():
    assert len(FAULTS) == 58
    assert {monitor for fault in FAULTS.values() for monitor in fault.monitors} <= set(MONITORS)
    # What is stated of a latency is stated of a reaction, in every motion.
    for fault in FAULTS.values():
        if fault.within is not None:
            assert set(fault.expected) <= {"held", "ramped", "ended"}


@pytest.mark.slow
def test_without_a_fault_nothing_trips_and_the_error_is_that_of_the_controller():
    row = fault_row(dataclasses.replace(FAULTS["push_5N"], name="none", changes={"duration": 1.0}), "paper")
    assert (row["reaction"], row["safety_monitor"]) == ("ridden through", None)
    assert row["peak_error_mm"] < 0.05


NEEDED = {
    "measurement_not_finite": ("pose_nan", {"finite": False, "failures": False}),
    "sensor_failed": ("encoder_nan_20ms", {"failures": False}),
    "command_not_finite": ("command_nan", {"finite": False}),
    "deadline": ("controller_hangs", {"deadline": None}),
    "workspace": ("out_of_workspace", {"workspace": None}),
    "serial_singularity": ("to_dead_centre", {"transmission": None}),
    "parallel_singularity": ("to_parallel", {"conditioning": None}),
    "crank_speed": ("too_fast", {"crank_speed": None}),
    "following_error": ("dead_motor_0", {"following_error": None}),
    "torque_rate": ("command_chatter", {"torque_rate": None}),
}


@pytest.mark.slow
@pytest.mark.parametrize("monitor", NEEDED)
def test_a_monitor_that_is_switched_off_fails_its_row(monitor):
    name, mutation = NEEDED[monitor]
    fault = FAULTS[name]
    changes = {**fault.changes, **{f"safety.{key}": value for key, value in mutation.items()}}
    mutant = dataclasses.replace(fault, changes=changes)
    broken = fault_row(mutant, "hold")
    assert broken["reaction"] != "refused"
    assert broken["safety_monitor"] != monitor
    assert bad_ending(fault, broken) is not None


@pytest.mark.slow
def test_a_rows_figures_are_those_of_its_log():
    fault = FAULTS["command_nan"]
    log = run(base().replace(fault.in_motion("paper", base())))
    row = measure_fault(log, fault)
    after, taken = log.time >= ONSET - 1e-9, log["safety"][:, 0] >= 2
    error = np.linalg.norm(log["pose"][:, 3:] - log["reference"][:, 3:], axis=1)
    assert row["peak_error_mm"] == pytest.approx(1e3 * error[after & ~taken].max())
    moved = np.linalg.norm(log["pose"][taken][:, 3:] - log["pose"][taken][0, 3:], axis=1)
    assert row["travel_mm"] == pytest.approx(1e3 * moved.max())
    assert row["peak_torque"] == np.abs(log["torque_applied"][after]).max()
    assert row["latency_ms"] == pytest.approx(1e3 * (log.safety["time"] - ONSET))
    assert (row["latency_ms"], row["reaction"], row["safety_leg"]) == (pytest.approx(0.0, abs=1e-6), "ramped", 3)


def instantly(task):
    """A row without a run."""
    figures = {"safety_monitor": "deadline", "safety_leg": 2, "latency_ms": 3.0, "peak_error_mm": 1.25}
    return {**task.row("completed", None, None), "reaction": "held", "peak_torque": 0.5, **figures}


def test_the_command_writes_a_row_a_run_and_a_line_a_fault_quick_that_of_the_held_platform_alone(
    call, tmp_path, monkeypatch
):
    here = workers.Workers(0)
    monkeypatch.setattr(workers, "Workers", lambda *_: here)
    monkeypatch.setattr(runs, "execute", instantly)
    for options, motions in ((["--quick"], ["hold"]), (["--restart"], MOTIONS)):
        status, out, err = call("faults", "--out", "out", *options)
        assert status == 0, err
        assert "push_5N" in out
        table = pq.read_table(tmp_path / "out" / "faults.parquet")
        assert table.column_names == [column.name for column in COLUMNS]
        pairs = [(name, motion) for name in FAULTS for motion in motions]
        assert [(row["fault"], row["motion"]) for row in table.to_pylist()] == pairs
        text = (tmp_path / "out" / "faults.md").read_text()
        assert all(f"| {name} | held (deadline" in text and fault.text in text for name, fault in FAULTS.items())
        assert "1.25 mm" in text
    assert call("faults", "--out", "out", "--quiet")[:2] == (0, "")


def test_a_line_has_an_end_for_each_motion_and_the_worst_figures():
    def made(fault, motion, reaction, **figures):
        return {
            "fault": fault,
            "motion": motion,
            "reaction": reaction,
            "status": "failed",
            "safety_leg": None,
            **figures,
        }

    late = {"safety_monitor": "following_error", "latency_ms": 81.0, "peak_error_mm": 9.0, "warnings": "loop_gap"}
    rows = [
        made("dead_motor_0", "hold", "ended", **late),
        made("dead_motor_0", "paper", "ended", **{**late, "safety_leg": 0, "latency_ms": 74.4, "peak_error_mm": 9.125}),
        # There from the start: a time of its trip is no latency.
        made("dropped_10_percent", "hold", "held", safety_monitor="deadline", latency_ms=1181.0, peak_torque=0.5),
        made("reference_refused", "paper", "refused"),
    ]
    first = "ended (following_error, 81 ms): failed, loop gap"
    assert sheet(rows).rows == [
        ("dead_motor_0", first, "ended (following_error, 74 ms, leg 0): failed, loop gap", "9.12 mm", "-", "-"),
        ("dropped_10_percent", "held (deadline): failed", "-", "-", "-", "0.50 N m"),
        ("reference_refused", "-", "refused", "-", "-", "-"),
    ]


# --- what five motors hold ---


def largest_along(weight, per_load, limit, dead, direction):
    """Largest force along a direction of a given plane, by linear programming: an independent way."""
    bounds_row = np.concatenate([per_load, -per_load])
    room = np.concatenate([limit - weight, limit + weight])
    equal, wanted = per_load[[dead]], [-weight[dead]]
    done = linprog(-direction, A_ub=bounds_row, b_ub=room, A_eq=equal, b_eq=wanted, bounds=[(None, None)] * 3)
    return done.x if done.status == 0 else None


@given(poses(0.7), st.integers(0, 5))
def test_with_gravity_no_five_motors_hold_even_the_weight_but_for_chance(pose, dead):
    weight, jacobian = static_torque(ROBOT, pose), twist_jacobian(ROBOT, pose)
    weight_held, support, force, moment = holdable_load(weight, jacobian, ROBOT.effort_limit, dead)
    assert (weight_held, force, moment) == (False, None, None)
    # The support makes it possible and nothing smaller does: it is the distance of the plane of T_dead = 0.
    per_force = -np.linalg.inv(jacobian.T)[:, 3:]
    normal = per_force[dead]
    distance = abs(weight[dead]) / np.linalg.norm(normal)
    assert support >= distance * (1.0 - 1e-9)
    nearest = -weight[dead] * normal / (normal @ normal)
    if np.abs(weight + per_force @ nearest).max() <= ROBOT.effort_limit:
        assert support == pytest.approx(distance)


@pytest.mark.slow
@given(poses(0.5), st.integers(0, 5), st.integers(0, 1000))
def test_without_weight_the_largest_force_is_a_corner_that_no_direction_surpasses(pose, dead, seed):
    jacobian = twist_jacobian(ROBOT, pose)
    *held, force, moment = holdable_load(np.zeros(6), jacobian, ROBOT.effort_limit, dead)
    assert held == [True, 0.0]
    for columns, largest in ((slice(3, 6), force), (slice(0, 3), moment)):
        per_load = -np.linalg.inv(jacobian.T)[:, columns]
        direction = np.random.default_rng(seed).normal(size=3)
        corner = largest_along(np.zeros(6), per_load, ROBOT.effort_limit, dead, direction)
        assert np.linalg.norm(corner) <= largest * (1.0 + 1e-6)
