import dataclasses
import itertools
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import sealed

from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.logs.log import SimulationLog
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.references import SineBurstsReference
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario
from stewart_drake.training import collect
from stewart_drake.training.collect import (
    BURST,
    FREQUENCIES,
    OMEGAS,
    SHARE,
    collect_dataset,
    dataset_from_logs,
    experiment_reference,
    experiment_scenarios,
)
from stewart_drake.training.dataset import Dataset, load_dataset

SAMPLES, WINDOW = 60, 9
SMALL = SineBurstsReference(
    frequency=FREQUENCIES,
    amplitude=((0.05, 0.05, 0.05, 0.01, 0.01, 0.01),) * 5,
    phase=tuple(np.pi / 3.0 * np.arange(6)),
    burst_duration=BURST,
)
PAIRS = list(itertools.product(OMEGAS, OMEGAS))


def base():
    # A fast controller: six 3-state problems, and a short window that fills within the few samples.
    return Scenario.from_dict({"controller": {"solver": "split"}, "tuner": {"kind": "paper", "window": WINDOW}})


@pytest.fixture(scope="module")
def collected():
    """Nine short experiments on a small motion; the search for the largest feasible one is tested apart."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collect, "experiment_reference", lambda _: SMALL)
        done = []
        dataset = collect_dataset(base(), done.append, SAMPLES)
        scenarios = experiment_scenarios(base(), SAMPLES)
    assert done == [float(k) for k in range(1, 10)]
    return dataset, scenarios


def made_up(n=12, seed=0):
    rng = np.random.default_rng(seed)
    run_index = np.repeat(np.arange(3), n // 3)
    outputs = rng.choice(OMEGAS, (n, 2))
    return Dataset(rng.uniform(0, 3, (n, 12)), outputs, run_index, 0.005 * np.arange(n), {"window": 4, "text": "ä"})


# --- collecting ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_nine_experiments_in_order_each_with_its_own_pair_of_weights(collected):
    dataset, _ = collected
    assert dataset.inputs.shape == (9 * SAMPLES, 12)
    assert dataset.outputs.shape == (9 * SAMPLES, 2)
    np.testing.assert_array_equal(dataset.run, np.repeat(np.arange(9), SAMPLES))
    np.testing.assert_array_equal(dataset.outputs, np.repeat(PAIRS, SAMPLES, axis=0))
    np.testing.assert_allclose(dataset.time, np.tile(0.005 * np.arange(SAMPLES), 9), atol=1e-12)


@pytest.mark.parametrize("kind", ["magnitude", "signed"])
def test_densities_are_35_and_36_of_the_logged_errors_and_torques(kind):
    logs = [log_of(SAMPLES + 1), log_of(SAMPLES + 5, seed=4)]
    dataset = dataset_from_logs(logs, SAMPLES, kind, WINDOW, {})
    for index, log in enumerate(logs):
        signals = np.concatenate([log["error"], log["torque"]], axis=1)
        for k, row in enumerate(dataset.inputs[dataset.run == index]):
            window = signals[max(0, k - WINDOW) : k + 1]
            part = np.abs(window) if kind == "magnitude" else window
            limit = len(window)
            expected = np.clip([limit * x[-1] / sum(x) for x in part.T], -limit, limit)
            np.testing.assert_allclose(row, expected, rtol=1e-6)


def test_densities_are_those_that_the_diagram_computes_while_it_runs(collected):
    dataset, scenarios = collected
    for index in (0, 5):
        log = run(scenarios[index])
        mine = dataset.inputs[dataset.run == index]
        np.testing.assert_allclose(mine, log["density"][:SAMPLES], rtol=1e-12)
        # And a run repeats to the bit.
        np.testing.assert_array_equal(mine, dataset_from_logs([log], SAMPLES, "magnitude", WINDOW, {}).inputs)
        np.testing.assert_array_equal(dataset.outputs[dataset.run == index], log["weights"][:SAMPLES])


def test_experiments_that_differ_in_the_ratio_give_different_data_and_others_the_same(collected):
    # Only omega_Q / omega_R matters: three of the nine labels belong to one and the same data.
    dataset, _ = collected
    part = {pair: dataset.inputs[dataset.run == index] for index, pair in enumerate(PAIRS)}
    np.testing.assert_allclose(part[0.1, 0.1], part[1.0, 1.0], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(part[10.0, 10.0], part[1.0, 1.0], rtol=1e-4, atol=1e-4)
    assert np.abs(part[0.1, 1.0] - part[1.0, 1.0]).max() > 0.05


def test_the_metadata_says_how_the_data_was_made(collected):
    dataset, _ = collected
    assert dataset.metadata["sample_time"] == 0.005
    assert dataset.metadata["density"] == "magnitude"
    assert dataset.metadata["window"] == WINDOW
    assert dataset.metadata["frequency"] == list(FREQUENCIES)
    np.testing.assert_array_equal(dataset.metadata["amplitude"], SMALL.amplitude)
    assert dataset.metadata["gravity"] == 9.81
    assert dataset.metadata["feedforward"] == "gravity"
    assert Scenario.from_dict(dataset.metadata["scenario"]) == base()
    json.dumps(dataset.metadata, allow_nan=False)


def test_what_the_base_says_reaches_every_experiment(monkeypatch):
    monkeypatch.setattr(collect, "experiment_reference", lambda _: SMALL)
    keys = {
        "gravity": 3.7,
        "robot": {"platform_mass": 1.2},
        "model_robot": {"platform_mass": 0.9},
        "plant": {"motor_damping": 0.01},
        "controller": {"period": 0.002, "feedforward": "platform", "force_map": "statics"},
        "limits": {"clearance": None},
        "tuner": {"kind": "paper", "density": "signed", "window": 7},
    }
    given = Scenario.from_dict(keys)
    scenarios = experiment_scenarios(given, 100)
    assert len(scenarios) == 9
    for scenario, (omega_q, omega_r) in zip(scenarios, PAIRS, strict=True):
        for name in ("gravity", "robot", "model_robot", "plant", "controller", "limits"):
            assert getattr(scenario, name) == getattr(given, name)
        tuner = scenario.tuner
        assert (tuner.kind, tuner.omega_q, tuner.omega_r) == ("fixed", omega_q, omega_r)
        assert (tuner.density, tuner.window) == ("signed", 7)
        assert scenario.reference == SMALL
        assert scenario.duration == pytest.approx(0.2)


def log_of(rows, status="completed", pair=(1.0, 1.0), seed=3):
    rng = np.random.default_rng(seed)
    scenario = Scenario.from_dict({"tuner": {"kind": "fixed", "omega_q": pair[0], "omega_r": pair[1]}})
    signals = {
        "time": 0.005 * np.arange(rows),
        "error": rng.normal(size=(rows, 6)),
        "torque": rng.normal(size=(rows, 6)),
        "weights": np.tile(pair, (rows, 1)),
    }
    return SimulationLog(scenario, signals, status=status, end_time=0.005 * rows, message="crank of leg 2")


@pytest.mark.parametrize("changes", [{"status": "failed"}, {"status": "interrupted"}, {"rows": 29}])
def test_an_experiment_that_ended_early_stops_the_collection_and_is_named(changes):
    good, bad = log_of(31), log_of(**{"rows": 31, "pair": (0.1, 10.0), **changes})
    dataset_from_logs([good], 30, "magnitude", 4, {})
    with pytest.raises(RunFailure, match=r"experiment 1 \(omega_Q 0.1, omega_R 10\).*crank of leg 2"):
        dataset_from_logs([good, bad], 30, "magnitude", 4, {})


@pytest.mark.slow
def test_the_motion_is_feasible_and_the_share_is_of_the_largest_that_is():
    # Without the clearance of links, which takes most of the search's time and changes nothing of its logic.
    given = Scenario.from_dict({"limits": {"clearance": None}})
    reference = experiment_reference(given)
    assert reference.frequency == FREQUENCIES
    assert check_reference(given.robot, given.limits, reference, 8.0, given.gravity).feasible
    amplitude = np.array(reference.amplitude)
    assert np.all(amplitude > 0.0)
    assert np.all(np.diff(amplitude, axis=0) <= 1e-12)  # never larger at a higher frequency
    for frequency, vector in zip(reference.frequency, amplitude / SHARE, strict=True):
        for scale, feasible in ((0.99, True), (1.02, False)):
            burst = SineBurstsReference(
                frequency=(frequency,),
                amplitude=(tuple(scale * vector),),
                phase=reference.phase,
                burst_duration=BURST,
            )
            report = check_reference(given.robot, given.limits, burst, BURST, given.gravity)
            assert report.feasible == feasible


# --- the file ------------------------------------------------------------------------------------------------------


def assert_equal(one, other):
    for name in ("inputs", "outputs", "run", "time"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.metadata == other.metadata


def test_a_collected_dataset_comes_back_whole(tmp_path, collected):
    dataset, _ = collected
    dataset.save(tmp_path / "data.parquet")
    loaded = load_dataset(tmp_path / "data.parquet")
    assert_equal(loaded, dataset)
    assert loaded.digest() == dataset.digest()
    assert loaded.run.dtype.kind == "i"


def test_the_file_has_named_columns_and_the_same_bytes_each_time(tmp_path):
    for name in ("a.parquet", "b.parquet"):
        made_up().save(tmp_path / name)
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    table = pq.read_table(tmp_path / "a.parquet")
    assert table.column_names == ["time", "run", *[f"density_{i}" for i in range(12)], "omega_q", "omega_r"]


@given(st.sampled_from(["inputs", "outputs", "run", "time"]), st.integers(0, 11))
def test_the_digest_changes_with_every_sample(name, row):
    dataset = made_up()
    array = getattr(dataset, name).astype(float)
    array[row] = np.nextafter(array[row], np.inf)
    assert dataclasses.replace(dataset, **{name: array}).digest() != dataset.digest()
    assert made_up().digest() == dataset.digest()


def rewritten(path, columns=None, metadata=None):
    """The file of `made_up` with columns replaced (None drops one) or other schema metadata."""
    made_up().save(path)
    table = pq.read_table(path)
    kept = {name: table.column(name) for name in table.column_names}
    kept.update(columns or {})
    kept = {name: values for name, values in kept.items() if values is not None}
    if metadata is not None:
        pq.write_table(pa.table(kept).replace_schema_metadata(metadata), path)
        return path
    path.write_bytes(sealed(KEY, pa.table(kept), json.loads(pq.read_metadata(path).metadata[KEY])))
    return path


def resealed(path, about, rows=12):
    path.write_bytes(sealed(KEY, pq.read_table(rewritten(path)).slice(0, rows), about))
    return path


KEY = b"stewart_drake.dataset"


# Torn and flipped files, and others: see attacked_files.py.
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: path.with_name("nowhere"), "a file from `collect`"),
        (lambda path: rewritten(path, metadata={b"other": b"{}"}), "a file from `collect`|written by"),
        (lambda path: rewritten(path, metadata={KEY: b'{"version": 2}'}), "checksum"),
        (lambda path: resealed(path, {}), "of version 2, written by `collect`"),
        (lambda path: resealed(path, {"version": 1}), "of version 2, written by `collect`"),
        (lambda path: resealed(path, [2]), "of version 2, written by `collect`"),
        (lambda path: resealed(path, {"version": 2}, rows=0), "0 rows"),
    ],
    ids=range(7),
)
def test_what_is_no_dataset_is_refused_by_its_name(tmp_path, make, words):
    path = make(tmp_path / "data.parquet")
    with pytest.raises(ConfigurationError, match=words) as caught:
        load_dataset(path)
    assert str(path) in caught.value.key


@pytest.mark.parametrize("name", ["time", "run", "density_0", "density_11", "omega_q", "omega_r"])
def test_a_missing_column_and_a_number_that_means_nothing_are_named_with_their_row(tmp_path, name):
    bad = [None, np.nan, np.inf] + [0.0, -1.0] * name.startswith("omega")
    for values in (None, ["a"] * 12, *([1.0] * 7 + [each] + [1.0] * 4 for each in bad)):
        with pytest.raises(ConfigurationError, match=name if values is None else None) as caught:
            load_dataset(rewritten(tmp_path / "data.parquet", {name: values}))
        if values is not None and values[0] == 1.0:
            assert caught.value.key.endswith(name)
            assert "row 7" in str(caught.value)
