import dataclasses
import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from stewart_drake.studies import executors, plan
from stewart_drake.studies import fault_table as table_module
from stewart_drake.studies.workers import Given, SerialExecutor
from stewart_drake.studies.faults import DURATION, FAULTS, MOTIONS, ONSET, base
from stewart_drake.studies.faults import (
    all_rows,
    fault_row,
    holdable_lines,
    make_table,
    markdown_table,
    measure_fault,
    table_columns,
    terse_rows,
)
from stewart_drake.cli.app import cli
from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.simulation import run
from stewart_drake.safety import MONITORS

BY_NAME = {fault.name: fault for fault in FAULTS}
IN_TURN = [(fault, tuple(MOTIONS)[number % len(MOTIONS)]) for number, fault in enumerate(FAULTS)]
"""Each fault in one motion; `stewart-drake faults` makes the whole table."""


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


@pytest.mark.slow
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


def test_the_catalogue_is_large_enough_and_its_names_are_stable_and_its_monitors_exist():
    assert len(FAULTS) >= 25
    assert len(BY_NAME) == len(FAULTS)
    assert set(MOTIONS) == {"hold", "breathing", "paper"}
    assert {monitor for fault in FAULTS for monitor in fault.monitors} <= set(MONITORS)
    assert len(all_rows()) == 3 * len(FAULTS)
    # What is stated of a latency is stated of a reaction, in every motion.
    for fault in FAULTS:
        if fault.within is not None:
            assert set(fault.expected) <= {"held", "ramped", "ended"}
    assert {"dead_motor_0", "broken_rod_2", "encoder_frozen", "encoder_nan", "payload_0.3kg"} <= set(BY_NAME)


@pytest.mark.slow
def test_without_a_fault_nothing_trips_and_the_error_is_that_of_the_controller():
    for motion in MOTIONS:
        none = dataclasses.replace(BY_NAME["push_5N"], name="none", changes={"duration": 1.0})
        row = fault_row(none, motion)
        assert (row["reaction"], row["safety_monitor"]) == ("ridden through", None)
        assert row["peak_error_mm"] < 0.05


# --- each monitor is needed -----------------------------------------------------------------------------------------

NEEDED = {
    "measurement_not_finite": ("pose_nan", {"finite": False, "failures": False}),
    "sensor_failed": ("encoder_nan_20ms", {"failures": False}),
    "controller_failed": ("controller_breaks", {"failures": False}),
    "command_not_finite": ("command_nan", {"finite": False}),
    "deadline": ("controller_hangs", {"deadline": None}),
    "workspace": ("out_of_workspace", {"workspace": None}),
    "serial_singularity": ("to_dead_centre", {"transmission": None}),
    "parallel_singularity": ("to_parallel", {"conditioning": None}),
    "crank_speed": ("too_fast", {"crank_speed": None}),
    "following_error": ("dead_motor_0", {"following_error": None}),
    "torque_limit": ("command_stays_full", {"torque_limit_time": 1e6}),
    "torque_rate": ("command_chatter", {"torque_rate": None}),
    "innovation": ("dead_motor_observed", {"innovation": None}),
    "reading_stuck": ("pose_frozen_on_the_way", {"frozen_pose": None}),
}
# Monitors that no row of the table needs alone.
OTHERS = {
    "dead_motor_observed": dataclasses.replace(
        BY_NAME["dead_motor_0"],
        name="dead_motor_observed",
        changes={**BY_NAME["dead_motor_0"].changes, "estimator": {"kind": "observer"}},
        monitors=("innovation",),
    ),
    "pose_frozen_on_the_way": dataclasses.replace(
        BY_NAME["pose_frozen"],
        name="pose_frozen_on_the_way",
        drift=(0.0, 0.0, 0.0, 0.05, 0.0, 0.0),
        expected=("ended",),
    ),
    "controller_breaks": dataclasses.replace(
        BY_NAME["to_dead_centre"],
        name="controller_breaks",
        changes={"controller.min_transmission": 0.6},
        monitors=("controller_failed",),
    ),
    "command_stays_full": dataclasses.replace(
        BY_NAME["command_full"],
        name="command_stays_full",
        changes={
            **BY_NAME["command_full"].changes,
            "safety.crank_speed": None,
            "safety.following_error": None,
            "safety.torque_rate": None,
            "safety.workspace": None,
            "safety.transmission": None,
            "safety.conditioning": None,
            "safety.runaway": 1e6,
        },
        monitors=("torque_limit",),
    ),
}


def test_every_monitor_has_a_mutation():
    assert set(NEEDED) == set(MONITORS) - {"none"}


@pytest.mark.slow
@pytest.mark.parametrize("monitor", NEEDED)
def test_a_monitor_that_is_switched_off_fails_its_row(monitor):
    name, mutation = NEEDED[monitor]
    fault = BY_NAME.get(name) or OTHERS[name]
    row = fault_row(fault, "hold")
    assert row["safety_monitor"] == monitor
    assert bad_ending(fault, row) is None
    changes = {**fault.changes, **{f"safety.{key}": value for key, value in mutation.items()}}
    mutant = dataclasses.replace(fault, changes=changes)
    broken = fault_row(mutant, "hold")
    assert broken["reaction"] != "refused"
    assert broken["safety_monitor"] != monitor
    assert bad_ending(fault, broken) is not None


# --- rows and files -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_rows_figures_are_those_of_its_log():
    fault = BY_NAME["command_nan"]
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


@pytest.mark.slow
def test_a_run_that_breaks_without_the_layer_is_told_apart():
    fault = BY_NAME["command_nan"]
    log = run(base().replace({**fault.in_motion("hold", base()), "safety": None}))
    assert measure_fault(log, fault)["reaction"] == "broke"


def made_row(fault, motion, reaction="held", **figures):
    return {"fault": fault, "motion": motion, "reaction": reaction, **figures}


def told(_, task):
    """A row without a run."""
    figures = {"safety_monitor": "deadline", "safety_leg": 2, "latency_ms": 3.0, "peak_error_mm": 1.25}
    return {**plan.empty_row(task, "completed", None, None), "reaction": "held", "peak_torque": 0.5, **figures}


@pytest.fixture
def instant(monkeypatch):
    """Rows without runs, in this process."""
    monkeypatch.setattr(executors, "LocalProcesses", lambda *_: Given(SerialExecutor()))
    monkeypatch.setattr(plan, "execute", told)


@pytest.mark.usefixtures("instant")
def test_the_table_has_a_row_a_run_and_a_line_a_fault(tmp_path):
    seen = []
    table = make_table(tmp_path / "new", progress=seen.append)
    assert [(row["fault"], row["motion"]) for row in table.rows] == [(f.name, motion) for f, motion in all_rows()]
    assert seen[-1] == len(all_rows())
    read = pq.read_table(table.path)
    assert read.num_rows == len(all_rows())
    assert read.column_names == [column.name for column in table_columns()]
    assert read.column("safety_leg").to_pylist() == [2] * len(all_rows())
    text = table.path.with_suffix(".md").read_text()
    for fault in FAULTS:
        assert f"| {fault.name} | held (deadline" in text
        assert fault.text in text
    assert "1.25 mm" in text


@pytest.mark.usefixtures("instant")
def test_an_interrupted_table_goes_on_where_it_was(tmp_path, monkeypatch):
    def stop(done):
        if done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_table(tmp_path, progress=stop)
    assert not (tmp_path / "faults.md").exists()
    ran = []
    monkeypatch.setattr(plan, "execute", lambda _, task: ran.append(task.index) or told(_, task))
    table = make_table(tmp_path)
    assert len(ran) == len(all_rows()) - 7
    assert table.rows == make_table(tmp_path / "whole").rows
    ran.clear()
    seen = []
    assert make_table(tmp_path, progress=seen.append).rows == table.rows
    assert ran == []
    assert seen == [len(all_rows())]
    make_table(tmp_path, restart=True)
    assert len(ran) == len(all_rows())


@pytest.mark.usefixtures("instant")
def test_rows_of_other_faults_are_not_mixed_in(tmp_path, monkeypatch):
    make_table(tmp_path)
    monkeypatch.setattr(table_module, "all_rows", lambda: list(reversed([(f, m) for f in FAULTS for m in MOTIONS])))
    with pytest.raises(ConfigurationError, match="differs in faults"):
        make_table(tmp_path)


@pytest.mark.usefixtures("instant")
def test_the_command_prints_the_short_table_quick_that_of_the_held_platform_alone(tmp_path):
    done = CliRunner().invoke(cli, ["faults", "--out", str(tmp_path), "--quick"])
    assert done.exit_code == 0, done.output
    assert "push_5N" in done.output.replace("\n", "")
    tables = {"faults.parquet", "faults.csv", "faults.md"}
    assert {path.name for path in tmp_path.iterdir()} == tables | {"rows.jsonl", "sweep.json"}
    read = pq.read_table(tmp_path / "faults.parquet").select(["fault", "motion"]).to_pylist()
    assert read == [{"fault": fault.name, "motion": "hold"} for fault in FAULTS]
    quiet = CliRunner().invoke(cli, ["faults", "--out", str(tmp_path), "--quick", "--quiet"])
    assert (quiet.exit_code, quiet.stdout) == (0, "")


def test_a_terse_line_sets_side_by_side_what_differs():
    rows = [
        made_row("dead_motor_0", "hold", "ended", safety_monitor="following_error", latency_ms=81.0, peak_error_mm=9.0),
        made_row(
            "dead_motor_0", "paper", "ended", safety_monitor="following_error", latency_ms=74.4, peak_error_mm=9.125
        ),
        made_row("encoder_frozen", "hold", "unnoticed", status="lost"),
        made_row("encoder_frozen", "paper", "ended", safety_monitor="reading_stuck", latency_ms=54.0, status="failed"),
        # There from the start: a time of its trip is no latency.
        made_row(
            "dropped_10_percent", "hold", "held", safety_monitor="deadline", latency_ms=1181.0, status="completed"
        ),
    ]
    assert terse_rows(rows) == [
        ("dead_motor_0", "ended", "-", "following_error", "74-81", "-", "9.12", "-"),
        ("encoder_frozen", "unnoticed / ended", "lost / failed", "- / reading_stuck", "54", "-", "-", "-"),
        ("dropped_10_percent", "held", "completed", "deadline", "-", "-", "-", "-"),
    ]


def test_what_five_motors_hold_is_told_in_words():
    rows = [
        made_row("dead_motor_0", "hold", "ended", holds_weight=False, support_newton=4.72),
        made_row(
            "dead_motor_0",
            "paper",
            "ended",
            holds_weight=True,
            support_newton=0.0,
            force_newton=50.2,
            moment_newton_metre=3.1,
        ),
        made_row("push_5N", "hold", "ridden through"),
    ]
    assert holdable_lines(rows) == [
        "dead_motor_0, hold: none: not even the weight; the smallest outside force with which it stands: 4.7 N",
        "dead_motor_0, paper: 50 N or 3.1 N m",
    ]
    assert "4.7 N" in markdown_table(rows)
