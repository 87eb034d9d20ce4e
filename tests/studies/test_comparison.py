import numpy as np
import pyarrow.parquet as pq
import pytest

from stewart_drake.analysis.response import sine_response
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.markdown import number
from stewart_drake.runs.simulation import run
from stewart_drake.studies.comparison import Comparison, _rank, load_comparison
from stewart_drake.studies.experiment import MAX_REASONS, pivot, refusals, run_experiment
from stewart_drake.studies.runs import settling_time
from stewart_drake.studies.workers import Workers

SMALL = {
    "name": "small",
    "scenario": "paper_fig7",
    "set": {"duration": 0.1, "controller.solver": "split"},
    "controllers": {
        "soft": {"tuner": {"kind": "fixed", "omega_q": 0.1, "omega_r": 10.0}},
        "stiff": {"tuner": {"kind": "fixed", "omega_q": 10.0, "omega_r": 0.1}},
        "pid": {"controller": {"kind": "pid"}},
        "paper": {"controller.feedforward": "none", "tuner": {"kind": "fixed"}},
    },
    "references": {"sine": {}, "hold": {"reference": {"kind": "hold"}}, "long": {"duration": 0.5}},
    "conditions": {"nominal": {}, "noise": {"sensors": {"kind": "encoders", "noise": 1e-5, "noise_seed": "{seed}"}}},
    "best_of": {"best": {"of": ["soft", "stiff"]}},
    "seeds": [3, 4],
    "runs": [
        {"controllers": ["best", "pid"], "references": ["sine", "hold"], "conditions": ["nominal"]},
        {"controllers": ["stiff"], "references": ["sine"], "conditions": ["noise"]},
        {"controllers": ["paper"], "references": ["long"], "conditions": ["nominal"]},
    ],
    "bands": {
        "controllers": ["pid"], "condition": "nominal", "axes": ["Z"], "frequencies": [20.0], "transient": 0.05,
    },
}  # fmt: skip


def small(**changes):
    return Comparison.from_dict({**SMALL, **changes})


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("comparison")
    comparison = small()
    return comparison, run_experiment(comparison, folder, Workers(0)), folder


def test_controllers_of_a_comparison_may_change_the_kind_of_motors():
    comparison = load_comparison("reachy", trust_code=True)
    # Of each controller the first motion and condition.
    motors = [comparison.scenario(k).motors.kind for k in range(0, comparison.runs, 12)]
    assert motors == ["position"] * 10 + ["torque"] * 3


def test_below_a_table_is_why_runs_were_refused_a_line_for_each_reason():
    rows = [{"status": "rejected", "message": "no model"}] * 3 + [{"status": "completed", "message": None}] * 9
    rows += [{"status": "rejected", "message": f"got {letter}"} for letter in "abcdefghijk"[: MAX_REASONS + 2]]
    rows += [{"status": "rejected", "message": f"leg {leg}, got {-1.5e-7 * leg}"} for leg in range(4)]
    lines = refusals(rows)
    # Reasons of random runs differ in their numbers alone.
    assert lines[:2] == ["4 rejected: leg 0, got -0.0", "3 rejected: no model"]
    assert lines[-1] == "4 more for other reasons: see the column `message`"
    assert len(lines) == MAX_REASONS + 1
    named = [{**row, "a": "x", "b": str(number)} for number, row in enumerate(rows[:2])]
    text = pivot("title", named, "a", "b", lambda _: "-").markdown()
    assert text.endswith("| x | - | - |\n\n- 2 rejected: no model\n")


@pytest.mark.slow
def test_the_table_has_the_figures_and_failures_of_the_runs(done):
    comparison, result, folder = done
    by_run = {(r["controller"], r["reference"], r["condition"], r["seed"]): r for r in result.rows["comparison"]}
    log = run(comparison.scenario(4))  # pid, sine
    error = (log["pose"] - log["reference"])[log.time >= 0.05 - 1e-9]
    row = by_run["pid", "sine", "nominal", 3]
    assert row["rmse_norm_mm"] == pytest.approx(1e3 * np.sqrt(np.mean(np.sum(error[:, 3:] ** 2, axis=1))))
    assert row["peak_norm_deg"] == pytest.approx(np.degrees(np.linalg.norm(error[:, :3], axis=1).max()))
    failed = by_run["paper", "long", "nominal", 3]
    assert (failed["status"], failed["reason"]) == ("failed", "crank_dead_centre")
    assert failed["settling_s"] is None
    assert by_run["stiff", "sine", "noise", 3]["rmse_norm_mm"] != by_run["stiff", "sine", "noise", 4]["rmse_norm_mm"]
    table = pq.read_table(folder / "comparison.parquet")
    names = [column.name for column in comparison.columns]
    assert table.to_pylist() == [{name: row.get(name) for name in names} for row in result.rows["comparison"]]
    (band,) = result.rows["bands"]
    assert (band["controller"], band["reference"], band["frequency_hz"]) == ("pid", "Z", 20.0)
    assert 0.9 < band["ratio"] < 1.3
    assert -60.0 < band["phase_deg"] < -20.0


def test_the_markdown_is_a_table_with_failures_and_the_chosen_one(done):
    comparison, result, folder = done
    text = (folder / "comparison.md").read_text()
    assert "best (stiff)" in text or "best (soft)" in text
    assert "failed, crank_dead_centre at t = 0.2" in text
    sheets = comparison.sheets(result.rows)
    assert all(sheet.markdown() in text for sheet in sheets)
    for named in ("ripple [deg/s]", "ripple [mm/s]", "torque peak [N m]", "speed peak [deg/s]"):
        assert named in sheets[0].header
    # Noise: one line for both seeds, with the worse of them.
    (noisy,) = [row for row in sheets[0].rows if row[2] == "noise"]
    both = [row["rmse_norm_mm"] for row in result.rows["comparison"] if row["condition"] == "noise"]
    assert noisy[4] == number(max(both))
    grid = small(layout="grid").sheets(result.rows)
    assert [sheet.header[1] for sheet in grid] == ["sine", "sine", "20 Hz"]
    (pid,) = [row for row in grid[0].rows if row[0] == "pid"]
    here = {row["reference"]: row for row in result.rows["comparison"] if row["controller"] == "pid"}
    assert pid[1] == f"{number(here['sine']['rmse_norm_deg'])}° {number(here['sine']['rmse_norm_mm'])} mm"
    (paper,) = [row for row in grid[0].rows if row[0] == "paper"]
    assert paper[1:4] == ("-", "-", "failed, crank_dead_centre at t = 0.260 s")


def test_the_best_has_the_smallest_error_and_where_all_have_failed_got_furthest():
    rows = [
        {"status": "completed", "pose_rmse_mm": 0.2},
        {"status": "completed", "pose_rmse_mm": 0.3},
        {"status": "failed", "pose_rmse_mm": 0.1, "end_time": 4.0},
        {"status": "completed", "pose_rmse_mm": None, "end_time": 2.0},
        {"status": "lost", "end_time": None},
    ]
    mixed = [rows[place] for place in (3, 0, 4, 2, 1)]
    assert sorted(mixed, key=_rank) == rows


def test_settling_of_an_exponential_decay_is_known_and_counts_the_last_time_outside_the_band():
    time = 0.001 * np.arange(12001)
    assert settling_time(time, np.exp(-0.5 * time), 0.05) == pytest.approx(np.log(20.0) / 0.5, abs=2e-3)
    time = np.arange(6.0)
    for error, settled in (([5, 0, 5, 0, 0, 0], 3.0), ([0] * 6, 0.0), ([0, 0, 0, 0, 0, 5], None), ([np.nan] * 6, None)):
        assert settling_time(time, np.array(error, dtype=float), 1.0) == settled


@pytest.mark.parametrize(("ratio", "lag"), [(0.25, 2.0), (1.3, -0.4)])
def test_the_response_to_a_sine_is_found_in_spite_of_offset_and_harmonics(ratio, lag):
    time = 0.001 * np.arange(2000)
    angle = 2.0 * np.pi * 5.0 * time
    reference = 0.3 + 0.01 * np.sin(angle + 0.7)
    response = 0.31 + 0.01 * ratio * (np.sin(angle + 0.7 - lag) + 0.1 * np.sin(3.0 * angle))
    got, rest = sine_response(time, reference, response, 5.0)
    assert abs(got) == pytest.approx(ratio, rel=1e-9)
    assert np.angle(got) == pytest.approx(-lag, abs=1e-9)
    assert rest == pytest.approx(0.1, rel=1e-9)


CONTROLLER = {"controllers": {"a": {"controller.perod": 1.0}}, "best_of": {}, "runs": None, "bands": None}


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"references": {}}, "references"),
        (CONTROLLER, "controller"),
        ({"runs": [{**SMALL["runs"][0], "controllers": ["x"]}]}, "runs.0.controllers"),
        ({"best_of": {"b": {"of": ["none"]}}}, "best_of.b.of"),
    ],
)
def test_bad_files_name_the_key(changes, key):
    with pytest.raises(ConfigurationError) as caught:
        small(**changes)
    assert key in caught.value.key
