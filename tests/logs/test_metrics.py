import json
from dataclasses import replace

import numpy as np
import pytest
from made_logs import made_log

from stewart_drake.control.features import CostScales
from stewart_drake.logs.metrics import FAILED, METRICS, run_cost, run_metrics

PROMISED = {
    "rmse_deg", "rmse_mm", "peak_deg", "peak_mm", "torque_rms", "torque_peak", "saturated_fraction", "loop_gap_max_m",
    "integral_at_5s", "real_time_factor", "git_revision", "versions", "status", "reason", "message", "end_time", "leg",
}  # fmt: skip


def test_rmse_and_peak_are_of_the_second_half_alone():
    pose = np.zeros((101, 6))
    pose[:50] = 100.0  # rows before 5 s do not count
    pose[50:, 0] = 0.01
    pose[50:, 5] = 0.002 * (-1.0) ** np.arange(51)
    pose[70, 1] = -0.5
    metrics = run_metrics(made_log(pose=pose, error=np.full((101, 6), 7.0)))
    np.testing.assert_allclose(metrics["rmse_deg"], np.degrees([0.01, 0.5 / np.sqrt(51), 0.0]))
    np.testing.assert_allclose(metrics["rmse_mm"], [0.0, 0.0, 2.0])
    np.testing.assert_allclose(metrics["peak_deg"], np.degrees([0.01, 0.5, 0.0]))
    np.testing.assert_allclose(metrics["peak_mm"], [0.0, 0.0, 2.0])


def test_figures_of_the_whole_run_count_every_row_and_torques_within_the_limit_of_the_robot():
    torque, gap, pose = np.zeros((101, 6)), np.full((101, 6), 1e-9), np.zeros((101, 6))
    torque[10, 2] = -7.0  # beyond the limit of 5
    torque[60, :] = 5.0  # at the limit: nothing was cut off
    gap[3, 4] = 2e-7
    pose[:, 0], pose[:, 1], pose[:, 3], pose[:, 5] = 0.03, 0.04, 0.001, 0.002
    weights = np.column_stack([np.linspace(1.0, 3.0, 101), np.full(101, 0.5)])
    signals = {"torque": torque, "torque_applied": np.clip(torque, -5.0, 5.0), "loop_gap": gap, "weights": weights}
    log = made_log(pose=pose, wall_time=4.0, **signals)
    metrics = run_metrics(log)
    expected = {
        "torque_peak": 5.0,
        "torque_rms": 5.0 * np.sqrt(7 / 606),
        "torque_rms_second_half": 5.0 * np.sqrt(6 / 306),
        "saturated_fraction": 1 / 606,
        "loop_gap_max_m": 2e-7,
        "omega_q": 2.0,
        "omega_r": 0.5,
        "rmse_norm_deg": np.degrees(0.05),
        "rmse_norm_mm": np.sqrt(5.0),
        "real_time_factor": 2.5,
    }
    assert {name: metrics[name] for name in expected} == pytest.approx(expected)
    weak = made_log(scenario={"robot": {"effort_limit": 0.3}}, torque=np.full((101, 6), 0.4))
    assert run_metrics(weak)["saturated_fraction"] == 1.0
    assert run_metrics(made_log(wall_time=0.0))["real_time_factor"] is None


def test_peak_speed_is_that_of_the_fastest_crank_by_its_angles():
    angles = np.zeros((101, 6))
    angles[:, 1] = np.linspace(0.0, 1.0, 101)  # 0.1 rad/s
    angles[40:, 4] = -0.02  # in one step of 0.1 s
    assert run_metrics(made_log(crank_angle=angles))["crank_speed_peak_deg_s"] == pytest.approx(np.degrees(0.2))
    assert run_metrics(made_log(rows=1))["crank_speed_peak_deg_s"] is None


def test_a_table_describes_its_figures_and_their_interval():
    for metric in METRICS:
        for column in metric.columns():
            assert column.text.startswith(metric.text)
            assert ("second half" in column.text) == metric.over.startswith("second_half")


@pytest.mark.parametrize("rows", [0, 1, 50, 101])
def test_every_promised_key_is_there_however_short_the_run_and_json_can_hold_it(rows):
    log = made_log(rows=rows)
    metrics = run_metrics(log)
    assert set(metrics) >= PROMISED
    assert json.loads(json.dumps(metrics, allow_nan=False)) == metrics
    assert rows or {metrics[metric.name] for metric in METRICS} == {None}


def test_torque_change_is_taken_from_tick_to_tick_of_the_second_half_within_the_limit():
    def change(torque, **scenario):
        log = made_log(step=0.01, duration=1.0, torque=torque, scenario=scenario)
        return run_metrics(log)["torque_change_rms"]

    torque = np.zeros((101, 6))
    torque[::2] = 0.5
    torque[:50] *= 7.0
    every = {"controller": {"period": 0.01}, "plant": {"time_step": 0.01}}
    assert change(torque, **every) == pytest.approx(0.5)
    torque[::2] = 1e9
    assert change(torque, **every) == pytest.approx(5.0)
    # Two rows a tick: the torque stands still between them, and that is no tick.
    torque = np.repeat(np.arange(51.0) % 2.0, 2)[:101, None] * np.ones(6)
    assert change(torque, controller={"period": 0.02}, plant={"time_step": 0.01}, log_period=0.01) == pytest.approx(1.0)
    assert change(torque, controller={"period": 0.005}, plant={"time_step": 0.005}, log_period=0.01) is None


SCALES = CostScales(rotation=0.5, position=0.02, torque_change=0.1)


# At 20 Hz a robot that trembles with its 20 commands a second has the same velocity at all ticks.
@pytest.mark.parametrize(
    ("frequency", "counts", "period"),
    [(0.5, 0.0, 0.005), (1.1, 0.0, 0.005), (3.0, 1.0, 0.005), (17.3, 1.0, 0.005), (20.0, 1.0, 0.05)],
)
def test_ripple_is_the_velocity_error_above_two_hertz(frequency, counts, period):
    time = 0.005 * np.arange(2001)
    rate = np.zeros((len(time), 6))
    rate[:, 1], rate[:, 5] = np.radians(0.3), 2e-3
    rate *= np.sin(2.0 * np.pi * frequency * time + 0.4)[:, None]
    rate[:, 4] += 0.01 + 0.002 * time  # Drift is no ripple.
    still = np.zeros((len(time), 6))
    scenario = {"duration": 10.0, "controller": {"period": period}}
    log = made_log(len(time), scenario=scenario, time=time, pose_rate=rate, reference_rate=still)
    metrics = run_metrics(log)
    assert metrics["ripple_deg_s"] == pytest.approx(counts * 0.3 / 2**0.5, rel=0.02, abs=0.01)
    assert metrics["ripple_mm_s"] == pytest.approx(counts * 2.0 / 2**0.5, rel=0.02, abs=0.06)
    short = made_log(101, scenario={"duration": 0.5}, time=time[:101], pose_rate=rate[:101], reference_rate=still[:101])
    assert run_metrics(short)["ripple_mm_s"] is None


def test_the_change_of_torque_counts_for_a_millisecond_and_a_run_that_was_not_completed_costs_the_most():
    figures = {"rmse_norm_deg": 0.0, "rmse_norm_mm": 0.0, "torque_change_rms": 0.5}
    assert run_cost(figures, "completed", 0.001, SCALES) == pytest.approx(5.0)
    assert run_cost(figures, "completed", 0.005, SCALES) == pytest.approx(1.0)
    assert run_cost(figures, "lost", 0.001, SCALES) == FAILED
    assert run_cost({**figures, "rmse_norm_mm": 1e9}, "completed", 0.001, SCALES) == FAILED
    assert run_cost({**figures, "rmse_norm_mm": None}, "completed", 0.001, SCALES) == FAILED


def test_figures_of_signals_that_a_log_does_not_have_are_null():
    log = made_log()
    bare = run_metrics(replace(log, signals={name: log[name] for name in ("time", "torque_applied")}))
    assert bare["torque_rms"] == run_metrics(log)["torque_rms"]
    assert {bare[name] for name in ("rmse_mm", "peak_norm_deg", "motion_ratio", "omega_q")} == {None}
