import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import ROBOT, poses

from stewart_drake.cli import study_commands
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.safety import MONITORS
from stewart_drake.studies import runs
from stewart_drake.studies.faults import COLUMNS, DURATION, FAULTS, MOTIONS, base, fault_study, holdable_load
from stewart_drake.studies.runs import execute
from stewart_drake.studies.workers import Workers

IN_TURN = [(fault, tuple(MOTIONS)[number % len(MOTIONS)]) for number, fault in enumerate(FAULTS.values())]


def test_the_sizes_of_faults_of_another_robot_are_told():
    row = {"fault": "push_150N", "motion": "hold", "reaction": "refused", "status": "rejected", "message": "x"}
    size = fault_study(robot="reachy_mini").sheet([row]).notes[-1]
    assert size == "push_150N on this robot: disturbances[0].wrench[3] 57.2"
    assert fault_study().sheet([row]).notes == ["1 rejected: x"]


WITH_IMU = ("sensors.kind=encoders", "sensors.imu.preset=bmi088", "command_delay=1", "estimator.kind=observer")


def fault_row(fault, motion, overrides=()):
    study = fault_study(pairs=[(fault, motion)], overrides=overrides)
    (row,) = study.tables([run_here(study.trials[0])])["faults"][1]
    return {column.name: row.get(column.name) for column in COLUMNS}


def run_here(trial):
    return {**trial.labels, **execute(trial)}


def bad_ending(fault, row):
    monitor, latency = row["safety_monitor"], row["latency_ms"]
    if row["reaction"] not in fault.expected:
        return f"{row['reaction']}, not {fault.expected}: {row['message']}"
    if monitor is not None and monitor not in fault.monitors:
        return f"{monitor}, not {fault.monitors}"
    within = math.inf if fault.within is None else 1e3 * fault.within
    if monitor is not None and not -1e-6 <= latency <= within + 1e-6:
        return f"{latency} ms, not within {within} ms"
    return None


@pytest.mark.long
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("name", ["encoder_frozen", "encoder_drifts_far"])
def test_with_an_inertial_sensor_no_wrong_encoder_is_unnoticed(name, motion):
    row = fault_row(FAULTS[name], motion, WITH_IMU)
    assert (row["reaction"], row["safety_leg"]) == ("ramped", 1)
    assert row["travel_deg"] < 2.0
    assert row["travel_mm"] < 3.0


@pytest.mark.long
@pytest.mark.parametrize(("fault", "motion"), IN_TURN, ids=lambda v: getattr(v, "name", v))
def test_a_fault_ends_as_the_catalogue_says(fault, motion):
    row = fault_row(fault, motion, () if fault.imu is None else WITH_IMU)
    assert bad_ending(fault, row) is None
    statuses = {"refused": "rejected", "ramped": "stopped", "ended": "failed", "unnoticed": "completed or lost"}
    assert row["status"] in statuses.get(row["reaction"], "completed")
    if row["reaction"] == "refused":
        return
    assert row["peak_torque"] <= base().robot.effort_limit
    if row["reaction"] in ("ramped", "ended"):
        # A crank that has lost its rod may spin up until the solver gives up.
        assert row["reason"] == row["safety_monitor"] or (fault.name, row["reason"]) == ("broken_rod_2", "drake_check")
    else:
        assert row["end_time"] == fault.changes.get("duration", DURATION)


def test_the_catalogue_has_68_faults_and_its_monitors_exist():
    assert len(FAULTS) == 68
    assert {monitor for fault in FAULTS.values() for monitor in fault.monitors} <= set(MONITORS)


def instantly(_):
    figures = {"safety_monitor": "deadline", "safety_leg": 2, "latency_ms": 3.0, "travel_mm": 1.25}
    return {**runs.ending("completed", None, None), "reaction": "held", "peak_torque": 0.5, **figures}


def test_the_command_writes_a_row_a_run_and_a_line_a_fault_quick_that_of_the_held_platform_alone(
    call, tmp_path, monkeypatch
):
    here = Workers(0)
    monkeypatch.setattr(study_commands, "Workers", lambda *_: here)
    monkeypatch.setattr(runs, "execute", instantly)
    for options, motions in ((["--quick"], ["hold"]), (["--restart"], MOTIONS)):
        status, out, err = call("faults", "--out", "out", *options)
        assert status == 0, err
        assert "push_5N" in out
        table = pq.read_table(tmp_path / "out" / "faults.parquet")
        without = {name: fault for name, fault in FAULTS.items() if fault.imu is None}
        pairs = [(name, motion) for name in without for motion in motions]
        assert [(row["fault"], row["motion"]) for row in table.to_pylist()] == pairs
        text = (tmp_path / "out" / "faults.md").read_text()
        assert all(f"| {name} | held (deadline" in text and fault.text in text for name, fault in without.items())


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
