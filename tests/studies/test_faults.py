import dataclasses
import math

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from stewart_drake.cli.app import cli
from stewart_drake.runs.simulation import run
from stewart_drake.safety import MONITORS
from stewart_drake.studies import runs, workers
from stewart_drake.studies.faults import (
    DURATION,
    FAULTS,
    MOTIONS,
    ONSET,
    all_rows,
    base,
    fault_row,
    measure_fault,
    table_columns,
    terse_rows,
)

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


def made_row(fault, motion, reaction="held", **figures):
    return {"fault": fault, "motion": motion, "reaction": reaction, **figures}


def instantly(task):
    """A row without a run."""
    figures = {"safety_monitor": "deadline", "safety_leg": 2, "latency_ms": 3.0, "peak_error_mm": 1.25}
    return {**task.row("completed", None, None), "reaction": "held", "peak_torque": 0.5, **figures}


def test_the_command_writes_a_row_a_run_and_a_line_a_fault_quick_that_of_the_held_platform_alone(tmp_path, monkeypatch):
    here = workers.Workers(0)
    monkeypatch.setattr(workers, "Workers", lambda *_: here)
    monkeypatch.setattr(runs, "execute", instantly)
    for quick, pairs in ((["--quick"], [(f, "hold") for f in FAULTS]), (["--restart"], all_rows())):
        done = CliRunner().invoke(cli, ["faults", "--out", str(tmp_path), *quick])
        assert done.exit_code == 0, done.output
        assert "push_5N" in done.output.replace("\n", "")
        table = pq.read_table(tmp_path / "faults.parquet")
        assert table.column_names == [column.name for column in table_columns()]
        assert [(row["fault"], row["motion"]) for row in table.to_pylist()] == [(f.name, each) for f, each in pairs]
        text = (tmp_path / "faults.md").read_text()
        assert all(f"| {fault.name} | held (deadline" in text and fault.text in text for fault in FAULTS)
        assert "1.25 mm" in text
    quiet = CliRunner().invoke(cli, ["faults", "--out", str(tmp_path), "--quiet"])
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
