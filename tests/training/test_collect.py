import itertools
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.logs.log import SimulationLog
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.references import SineBurstsReference
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario
from stewart_drake.training import collect
from stewart_drake.training.collect import (
    BURST,
    COLUMNS,
    FREQUENCIES,
    OMEGAS,
    SHARE,
    collect_dataset,
    dataset_from_logs,
    experiment_reference,
    experiment_scenarios,
    load_dataset,
)

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


# --- collecting ----------------------------------------------------------------------------------------------------


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


def test_a_collected_dataset_comes_back_whole(tmp_path, collected):
    dataset, _ = collected
    dataset.save(tmp_path / "data.parquet")
    loaded = load_dataset(tmp_path / "data.parquet")
    for name in ("inputs", "outputs", "run", "time"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(dataset, name))
    assert loaded.metadata == dataset.metadata
    assert loaded.digest() == dataset.digest()
    assert loaded.run.dtype.kind == "i"


def write(path, about=None, **changed):
    """A file of twelve samples with other columns (None drops one), and other words about it."""
    columns = {name: np.linspace(0.1, 1.0, 12) for name in COLUMNS} | changed
    about = json.dumps({"version": 2} if about is None else about)
    table = pa.table({name: values for name, values in columns.items() if values is not None})
    pq.write_table(table.replace_schema_metadata({"stewart_drake.dataset": about}), path)
    return path


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: path, "a file from `collect`"),
        (lambda path: write(path, about=[2]), "one from `collect`"),
        (lambda path: write(path, about={"version": 1}), "of version 2, written by `collect`"),
        (lambda path: write(path, **{name: [] for name in COLUMNS}), "0 rows"),
        (lambda path: write(path, run=None), "run"),
    ],
    ids=range(5),
)
def test_what_is_no_dataset_is_refused_by_its_name(tmp_path, make, words):
    path = make(tmp_path / "data.parquet")
    with pytest.raises(ConfigurationError, match=words) as caught:
        load_dataset(path)
    assert str(path) in caught.value.key


@pytest.mark.parametrize(("name", "bad"), [("density_11", np.nan), ("run", np.inf), ("omega_q", 0.0)])
def test_a_number_that_means_nothing_is_named_with_its_row(tmp_path, name, bad):
    path = write(tmp_path / "data.parquet", **{name: [1.0] * 7 + [bad] + [1.0] * 4})
    with pytest.raises(ConfigurationError, match="row 7") as caught:
        load_dataset(path)
    assert caught.value.key.endswith(name)
