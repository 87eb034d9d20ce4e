import dataclasses
import itertools

import numpy as np
import pyarrow.parquet as pq
import pytest
from made_logs import made_log

from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.paper import dataset_section as section_module
from stewart_drake.paper.dataset_section import (
    PAPER_AMPLITUDE,
    PAPER_SAMPLES,
    binding_limits,
    dataset_of,
    label_spread,
    make,
    run_distances,
    run_experiments,
    same_ratio,
)
from stewart_drake.paper.plots.training_plots import plot_densities
from stewart_drake.paper.rendering import render
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.references import SineReference
from stewart_drake.scenario import Scenario
from stewart_drake.training import collect
from stewart_drake.training.collect import BURST, FREQUENCIES, OMEGAS, SAMPLES_PER_RUN, collect_dataset
from stewart_drake.training.dataset import Dataset, load_dataset

BASE = Scenario()
PAIRS = list(itertools.product(OMEGAS, OMEGAS))
LARGEST = tuple(tuple(np.array([0.6, 0.5, 0.4, 0.1, 0.1, 0.05]) / f) for f in FREQUENCIES)


def made_up(ratio_only=True, runs=9, rows=20, seed=0):
    """Densities that depend on the ratio of the weights alone, or on each run."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(0.5, 1.5, (5, rows, 12)) if ratio_only else rng.uniform(0.5, 1.5, (runs, rows, 12))
    index = [round(np.log10(q / r)) + 2 for q, r in PAIRS] if ratio_only else list(range(runs))
    inputs = np.concatenate([noise[index[k]] for k in range(runs)])
    return Dataset(
        inputs, np.repeat(PAIRS[:runs], rows, axis=0), np.repeat(np.arange(runs), rows), 0.005 * np.arange(runs * rows)
    )


# --- sizes ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch, runs_by):
    """In place of searches, fixed amplitudes; in place of simulations, logs that depend on the ratio alone."""

    def rule(scenario):
        rows = round(scenario.duration / scenario.controller.period) + 1
        rng = np.random.default_rng(round(1000 + 10 * np.log10(scenario.tuner.omega_q / scenario.tuner.omega_r)))
        signals = {name: rng.normal(size=(rows, 6)) for name in ("error", "torque")}
        weights = np.tile([scenario.tuner.omega_q, scenario.tuner.omega_r], (rows, 1))
        return made_log(rows=rows, step=scenario.controller.period, weights=weights, **signals)

    monkeypatch.setattr(collect, "feasible_amplitudes", lambda *_: (LARGEST, LARGEST))
    monkeypatch.setattr(section_module, "feasible_amplitudes", lambda *_: (LARGEST, LARGEST))
    return runs_by(rule)


def test_the_whole_study_has_the_paper_s_number_of_samples_and_all_five_bursts(tmp_path, asked):
    run_experiments(Study(tmp_path, base=BASE))
    (wanted,) = asked
    samples = [round(s.duration / s.controller.period) for s in wanted]
    assert samples == [SAMPLES_PER_RUN] * 9
    assert sum(samples) == PAPER_SAMPLES == 14_400
    assert wanted[0].duration == pytest.approx(BURST * len(FREQUENCIES))
    assert [(s.tuner.omega_q, s.tuner.omega_r) for s in wanted] == PAIRS


def test_the_data_has_the_density_that_is_asked_for(tmp_path, asked):
    study = Study(tmp_path, quick=True, base=BASE.replace({"tuner.window": 9}))
    scenarios, logs = run_experiments(study)
    assert len(asked) == 1
    data = {kind: dataset_of(study, scenarios, logs, kind) for kind in ("magnitude", "signed")}
    for kind, made in data.items():
        assert (made.metadata["density"], made.metadata["window"]) == (kind, 9)
        signals = np.concatenate([logs[4]["error"], logs[4]["torque"]], axis=1)
        rows = made.inputs[made.run == 4]
        assert len(rows) == 640
        for k in (0, 3, 9, 200):
            # (35), (36): m + 1 times the sample over the sum of the last m + 1; within +-(m + 1).
            window = signals[max(0, k - 9) : k + 1]
            window = np.abs(window) if kind == "magnitude" else window
            expected = np.clip(len(window) * window[-1] / window.sum(axis=0), -len(window), len(window))
            np.testing.assert_allclose(rows[k], expected, rtol=1e-12)
    assert np.all(data["magnitude"].inputs >= 0.0)
    assert np.any(data["signed"].inputs < 0.0)


# --- what depends on the ratio -------------------------------------------------------------------------------------


def test_distances_between_runs_are_the_largest_difference_of_any_density_at_any_tick():
    data = made_up()
    data.inputs[3 * 20 + 7, 5] += 4.0
    distances = run_distances(data)
    assert distances.shape == (9, 9)
    np.testing.assert_array_equal(distances, distances.T)
    for a, b in itertools.combinations(range(9), 2):
        expected = max(
            abs(x - y) for x, y in zip(data.inputs[data.run == a].flat, data.inputs[data.run == b].flat, strict=True)
        )
        assert distances[a, b] == expected


def test_runs_of_one_ratio_are_told_from_others():
    equal = same_ratio(made_up())
    for a, b in itertools.product(range(9), range(9)):
        assert equal[a, b] == (PAIRS[a][0] * PAIRS[b][1] == pytest.approx(PAIRS[b][0] * PAIRS[a][1]))
    assert equal.sum() == 9 + 4 * 1 + 6


def test_the_spread_counts_runs_of_one_ratio_alone():
    data = made_up()
    assert label_spread(data) == 0.0
    lonely = PAIRS.index((0.1, 10.0))  # no other run has this ratio
    data.inputs[data.run == lonely] += 5.0
    assert label_spread(data) == 0.0
    data.inputs[20 * PAIRS.index((1.0, 1.0)) + 3, 11] += 0.25
    assert label_spread(data) == pytest.approx(0.25)
    assert label_spread(made_up(runs=1)) == 0.0


# --- amplitudes ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_each_largest_amplitude_is_feasible_and_one_per_cent_more_breaks_the_limit_that_is_named():
    # Without the clearance of links, which takes most of the time and binds nowhere here.
    base = Scenario.from_dict({"limits": {"clearance": None}})
    largest = np.array(collect.feasible_amplitudes(base.robot, base.limits, base.gravity)[0])
    names = binding_limits(base, largest)
    center = base.robot.home_pose
    for (f, frequency), axis in itertools.product(enumerate(FREQUENCIES), range(6)):

        def report(scale, f=f, frequency=frequency, axis=axis):
            amplitude = scale * largest[f, axis] * (np.arange(6) == axis)
            motion = SineReference(
                center=tuple(center), amplitude=tuple(amplitude), angular_frequency=(2 * np.pi * frequency,) * 6
            )
            return check_reference(base.robot, base.limits, motion, 1.0 / frequency, base.gravity, 5000.0)

        assert report(0.9999).feasible
        assert report(1.01).smallest[names[f][axis]].margin < 0.0


def test_the_limit_that_binds_is_found_around_the_robot_s_own_home():
    base = Scenario.from_dict({"limits": {"clearance": None}})
    high = base.replace({"robot.home_height": 0.32})
    amplitude = np.full((5, 6), 1e-6)
    assert binding_limits(base, amplitude) == binding_limits(high, amplitude) == [["none"] * 6] * 5
    slow = base.replace({"limits.crank_speed": 1e-6})
    assert binding_limits(slow, amplitude) == [["crank_speed"] * 6] * 5
    # At 0.3 m this robot stands far from its home, which is out of its limits; at home it is within them.
    tight = high.replace({"limits.joint_swing": 0.02})
    assert binding_limits(tight, amplitude) == [["none"] * 6] * 5


def test_the_motion_is_around_the_robot_s_own_home(monkeypatch):
    monkeypatch.setattr(collect, "feasible_amplitudes", lambda *_: (LARGEST, LARGEST))
    high = BASE.replace({"robot.home_height": 0.32})
    assert collect.experiment_reference(high).center == (0.0, 0.0, 0.0, 0.0, 0.0, 0.32)
    assert collect.experiment_reference(BASE).center == (0.0, 0.0, 0.0, 0.0, 0.0, 0.3)


def test_limits_that_leave_no_motion_are_refused():
    still = BASE.replace({"limits.transmission": 0.99, "limits.clearance": None})
    with pytest.raises(ConfigurationError, match="can move from its home pose"):
        collect.experiment_reference(still)


# --- the section ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("quick", "bursts"), [(True, 2), (False, 5)])
def test_the_section_s_numbers_are_those_of_the_file_that_it_leaves(tmp_path, asked, quick, bursts):
    shares = []
    section = make(Study(tmp_path, quick, BASE, shares.append))
    assert len(asked) == 1
    n = section.numbers
    file = "dataset-quick.parquet" if quick else "dataset.parquet"
    assert section.files == [f"figures/densities{'-quick' if quick else ''}.png", file]
    data = load_dataset(tmp_path / file)
    assert data.digest() == n["sha256"]
    assert n["samples"] == len(data.run) == 9 * (640 if quick else 1600)
    assert data.metadata["density"] == BASE.tuner.density
    assert n["largest_amplitude"] == [list(row) for row in LARGEST]
    np.testing.assert_allclose(n["amplitude"], 0.8 * np.array(LARGEST), atol=1e-6)
    np.testing.assert_allclose(data.metadata["amplitude"], n["amplitude"])
    assert n["equal_ratio_spread"] == 0.0
    assert n["next_ratio_spread"] > 1.0
    assert n["distinct"] == 5
    feasible = sum(LARGEST[f][a] >= PAPER_AMPLITUDE[a] for f in range(5) for a in range(6))
    assert n["share_of_paper_amplitudes_feasible"] == pytest.approx(feasible / 30)
    assert Section.from_json(section.to_json()) == section
    # Only bursts that were run are listed as run.
    rows = {line.split(" | ")[0][2:]: line for line in section.body.split("\n") if line.startswith("| ")}
    assert [name for name in rows if name.endswith("as run")] == [f"{f:g} Hz, as run" for f in FREQUENCIES[:bursts]]
    assert [name for name in rows if name.endswith("alone")] == [f"{f:g} Hz, each axis alone" for f in FREQUENCIES]
    assert rows["1 Hz, as run"].endswith("| 27.5 deg | 22.9 deg | 18.3 deg | 80.0 mm | 80.0 mm | 40.0 mm |")
    assert "| 50.0 mm (" in rows["2 Hz, each axis alone"]
    assert rows["paper, 1 to 5 Hz"].endswith("| 30.0 deg | 30.0 deg | 30.0 deg | 300.0 mm | 300.0 mm | 300.0 mm |")
    assert f"the bursts of 1 to {bursts} Hz" in section.body
    assert "0.3 m at 5 Hz alone is 296 m/s^2" in section.body


def test_only_the_limits_that_are_on_are_named(tmp_path, asked):
    section = make(Study(tmp_path, True, BASE.replace({"limits.clearance": None, "limits.euler_pitch": None})))
    assert len(asked) == 1
    assert "reach, conditioning, transmission, joint swing, crank speed, torque;" in section.body


@pytest.mark.parametrize(
    ("feasible", "distinct", "words"), [(11, 5, "Holds in part"), (30, 9, "Holds"), (0, 5, "Does not hold")]
)
def test_the_verdict_follows_from_the_numbers(feasible, distinct, words):
    numbers = {"samples": 14400, "distinct": distinct}
    told = render("dataset", "verdict", n=numbers, feasible=feasible, cells=30, runs=9, paper_samples=PAPER_SAMPLES)
    assert told.startswith(f"{words}: 14400 samples collected (the paper: 14400). The paper's amplitude is feasible in")
    assert f"in {feasible} of 30 combinations" in told
    assert told.endswith(f"The 9 runs hold {distinct} distinct sets of data.")


def test_the_runs_of_the_report_hold_five_sets_of_data(report):
    n = report.sections["dataset"].numbers
    assert (n["distinct"], n["samples"]) == (5, 9 * 640)
    assert n["equal_ratio_spread"] < 1e-6 < 1e-2 < n["next_ratio_spread"]
    assert load_dataset(report.folder / "dataset-quick.parquet").digest() == n["sha256"]


def test_the_figure_shows_each_density_by_ratio_with_labelled_axes():
    data = made_up()
    (axes,) = plot_densities(data).axes
    assert axes.get_ylabel() == "density [-]"
    names = [label.get_text() for label in axes.get_xticklabels()]
    assert names == [f"error {a}" for a in ("roll", "pitch", "yaw", "X", "Y", "Z")] + [f"torque {i}" for i in range(6)]
    medians = {line.get_label(): line.get_ydata() for line in axes.lines if not line.get_label().startswith("_")}
    assert list(medians) == ["0.01", "0.1", "1", "10", "100"]
    one = np.isclose(data.outputs[:, 0], data.outputs[:, 1])
    np.testing.assert_allclose(medians["1"], np.median(data.inputs[one], axis=0))


# --- collecting and reading: bad input -----------------------------------------------------------------------------


def short_runs(monkeypatch, status):
    started = []

    def run(scenario):
        started.append(scenario.name)
        rows = round(scenario.duration / scenario.controller.period) + 1
        log = made_log(rows=rows, step=scenario.controller.period, status=status if len(started) == 2 else "completed")
        return dataclasses.replace(log, scenario=scenario, message="crank of leg 2")

    from stewart_drake.runs import simulation

    monkeypatch.setattr(simulation, "run", run)
    monkeypatch.setattr(collect, "feasible_amplitudes", lambda *_: (LARGEST, LARGEST))
    return started


def test_ctrl_c_ends_the_collection_and_not_one_experiment_of_nine(monkeypatch):
    started = short_runs(monkeypatch, "interrupted")
    with pytest.raises(KeyboardInterrupt):
        collect_dataset(BASE, samples=20)
    assert started == ["experiment 0", "experiment 1"]


def test_an_experiment_that_breaks_ends_the_collection_at_once(monkeypatch):
    started = short_runs(monkeypatch, "failed")
    with pytest.raises(RunFailure, match=r"experiment 1 \(omega_Q 0.1, omega_R 1\)"):
        collect_dataset(BASE, samples=20)
    assert started == ["experiment 0", "experiment 1"]


def test_a_file_in_a_folder_named_like_a_column_reads_the_same(tmp_path):
    data = made_up()
    for name in ("run=3", "time=7"):
        (tmp_path / name).mkdir()
        data.save(tmp_path / name / "data.parquet")
        np.testing.assert_array_equal(load_dataset(tmp_path / name / "data.parquet").run, data.run)


def test_a_folder_is_no_dataset(tmp_path):
    made_up().save(tmp_path / "data.parquet")
    with pytest.raises(ConfigurationError, match="a folder"):
        load_dataset(tmp_path)


@pytest.mark.parametrize("value", [0.5, -1.0, 1e300])
def test_runs_that_are_no_whole_numbers_are_refused(tmp_path, value):
    data = made_up()
    run = data.run.astype(float)
    run[4] = value
    dataclasses.replace(data, run=run).save(tmp_path / "data.parquet")
    with pytest.raises(ConfigurationError, match=r"in row 4.*runs counted from 0") as caught:
        load_dataset(tmp_path / "data.parquet")
    assert caught.value.key.endswith("run")


@pytest.mark.parametrize(
    "metadata",
    [{"density": "both"}, {"density": None}, {"density": ["signed"]}, {"window": 0}, {"window": 4.0}, {"window": True}],
    ids=str,
)
def test_settings_that_no_network_can_have_are_refused_before_training(tmp_path, metadata):
    dataclasses.replace(made_up(), metadata=metadata).save(tmp_path / "data.parquet")
    with pytest.raises(ConfigurationError, match=next(iter(metadata))):
        load_dataset(tmp_path / "data.parquet")
    dataclasses.replace(made_up(), metadata={"density": "signed", "window": 1}).save(tmp_path / "data.parquet")
    assert load_dataset(tmp_path / "data.parquet").metadata == {"density": "signed", "window": 1}
    assert "density_0" in pq.read_schema(tmp_path / "data.parquet").names
