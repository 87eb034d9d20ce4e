"""Collecting and reading training data where something is wrong with the motion, a run, a file or a split."""

import dataclasses
import itertools

import numpy as np
import pytest
from made_logs import made_log

from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.runs import simulation
from stewart_drake.scenario import Scenario
from stewart_drake.training import collect
from stewart_drake.training.collect import FREQUENCIES, OMEGAS, collect_dataset, experiment_reference
from stewart_drake.training.dataset import Dataset, load_dataset
from stewart_drake.training.train import TrainingOptions, split_samples, train_network

BASE = Scenario()
LARGEST = tuple(tuple(np.array([0.6, 0.5, 0.4, 0.1, 0.1, 0.05]) / f) for f in FREQUENCIES)


def made_up(rows=20):
    inputs = np.random.default_rng(0).uniform(0.5, 1.5, (9 * rows, 12))
    outputs = np.repeat(list(itertools.product(OMEGAS, OMEGAS)), rows, axis=0)
    metadata = {"density": "magnitude", "window": 9}
    return Dataset(inputs, outputs, np.repeat(np.arange(9), rows), 0.005 * np.arange(9 * rows), metadata)


def test_limits_that_leave_no_motion_are_refused():
    still = BASE.replace({"limits.transmission": 0.99, "limits.clearance": None})
    with pytest.raises(ConfigurationError, match="can move from its home pose"):
        experiment_reference(still)


@pytest.mark.parametrize(
    ("status", "error", "words"),
    [("interrupted", KeyboardInterrupt, None), ("failed", RunFailure, r"experiment 1 \(omega_Q 0.1, omega_R 1\)")],
)
def test_ctrl_c_or_an_experiment_that_breaks_ends_the_collection_at_once(monkeypatch, status, error, words):
    started = []

    def run(scenario):
        started.append(scenario.name)
        rows = round(scenario.duration / scenario.controller.period) + 1
        log = made_log(rows=rows, step=scenario.controller.period, status=status if len(started) == 2 else "completed")
        return dataclasses.replace(log, scenario=scenario, message="crank of leg 2")

    monkeypatch.setattr(simulation, "run", run)
    monkeypatch.setattr(collect, "feasible_amplitudes", lambda *_: (LARGEST, LARGEST))
    with pytest.raises(error, match=words):
        collect_dataset(BASE, samples=20)
    assert started == ["experiment 0", "experiment 1"]


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


@pytest.mark.parametrize(("split", "share"), [("runs", 0.7), ("samples", 0.05)])
def test_a_split_that_leaves_a_weight_without_training_samples_is_refused_before_training(split, share):
    dataset, found, steps = made_up(10), {}, []
    for seed in range(500):
        options = TrainingOptions(seed=seed, split=split, training_share=share, epochs=1)
        outputs = dataset.outputs[split_samples(dataset, options)]
        found.setdefault(all(len(np.unique(column)) == 3 for column in outputs.T), options)
    words = rf"split by {split} leaves training samples of omega_[QR] = "
    with pytest.raises(ConfigurationError, match=words) as caught:
        train_network(dataset, found[False], steps.append)
    assert (caught.value.key, caught.value.value) == ("training.seed", found[False].seed)
    assert steps == []
    train_network(dataset, found[True], steps.append)
    assert steps == [1.0]
