import numpy as np
import pyarrow as pa
import pytest

from stewart_drake import ConfigurationError, Scenario, SimulationLog
from stewart_drake.base.errors import RunFailure
from stewart_drake.base.tables import to_parquet, with_about
from stewart_drake.references import SineBurstsReference
from stewart_drake.training import paper_network
from stewart_drake.training.paper_network import (
    BURST,
    COLUMNS,
    FREQUENCIES,
    collect_dataset,
    dataset_from_logs,
    load_dataset,
)

SAMPLES, WINDOW = 60, 9
SMALL = SineBurstsReference(
    frequency=FREQUENCIES,
    amplitude=((0.05, 0.05, 0.05, 0.01, 0.01, 0.01),) * 5,
    phase=tuple(np.pi / 3.0 * np.arange(6)),
    burst_duration=BURST,
)


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


def log_of(rows, status="completed", pair=(1.0, 1.0), seed=3):
    rng = np.random.default_rng(seed)
    scenario = Scenario.from_dict({"tuner": {"kind": "fixed", "omega_q": pair[0], "omega_r": pair[1]}})
    signals = {name: rng.normal(size=(rows, 6)) for name in ("error", "torque")}
    signals |= {"time": 0.005 * np.arange(rows), "weights": np.tile(pair, (rows, 1))}
    return SimulationLog(scenario, signals, status=status, end_time=0.005 * rows, message="crank of leg 2")


@pytest.mark.parametrize("changes", [{"status": "failed"}, {"rows": 29}])
def test_an_experiment_that_ended_early_stops_the_collection_and_is_named(changes):
    logs = log_of(31), log_of(**{"rows": 31, "pair": (0.1, 10.0), **changes})
    with pytest.raises(RunFailure, match=r"experiment 1 \(omega_Q 0.1, omega_R 10\).*crank of leg 2"):
        dataset_from_logs(logs, 30, "magnitude", 4, {})


def test_a_collected_dataset_comes_back_whole(tmp_path, monkeypatch):
    # Nine short experiments on a small motion; the search for the largest feasible one is tested apart.
    monkeypatch.setattr(paper_network, "experiment_reference", lambda _: SMALL)
    base = Scenario.from_dict({"controller": {"solver": "split"}, "tuner": {"kind": "paper", "window": WINDOW}})
    dataset = collect_dataset(base, lambda _: None, SAMPLES)
    dataset.save(tmp_path / "data.parquet")
    loaded = load_dataset(tmp_path / "data.parquet")
    for name in ("inputs", "outputs", "run", "time"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(dataset, name))
    assert loaded.metadata == dataset.metadata
    assert loaded.digest() == dataset.digest()
    assert loaded.run.dtype.kind == "i"


@pytest.mark.parametrize(
    ("about", "changed", "words"),
    [
        ({"version": 1}, {}, "of version 2, written by `collect`"),
        ({"version": 2}, {"run": None}, "run"),
        ({"version": 2}, {"density_11": [1.0] * 7 + [np.nan] + [1.0] * 4}, "finite"),
    ],
    ids=range(3),
)
def test_what_is_no_dataset_is_refused_by_its_name(tmp_path, about, changed, words):
    path = tmp_path / "data.parquet"
    columns = {name: np.linspace(0.1, 1.0, 12) for name in COLUMNS} | changed
    table = pa.table({name: values for name, values in columns.items() if values is not None})
    path.write_bytes(to_parquet(with_about(table, "dataset", about)))
    with pytest.raises(ConfigurationError, match=words) as caught:
        load_dataset(path)
    assert str(path) in caught.value.key
