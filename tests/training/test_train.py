import json
import math

import numpy as np
import pytest
import torch

from stewart_drake.control.network import load_network
from stewart_drake.errors import ConfigurationError
from stewart_drake.training.collect import Dataset
from stewart_drake.training.train import TrainingOptions, split_samples, train_network

METADATA = {"density": "signed", "window": 7, "sample_time": 0.005, "scenario": {"name": "left out"}}


def made_up(rows_per_run=40, runs=9, seed=0):
    """Samples from which omega_Q and omega_R can be read: the first densities lean towards their logarithms."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), rows_per_run)
    logs = np.stack([run % 3 - 1.0, run // 3 - 1.0], axis=-1)
    inputs = rng.uniform(0.5, 1.5, (len(run), 12))
    inputs[:, 0] += 0.8 * logs[:, 0]
    inputs[:, 6] -= 0.8 * logs[:, 1]
    time = 0.005 * np.tile(np.arange(rows_per_run), runs)
    return Dataset(inputs, 10.0**logs, run, time, dict(METADATA))


def options(**changes):
    return TrainingOptions(**{"epochs": 60, **changes})


def mean_squared_error(network, dataset, rows):
    return np.mean((network.log_weights(dataset.inputs[rows]) - np.log10(dataset.outputs[rows])) ** 2)


# --- back-propagation ----------------------------------------------------------------------------------------------


def test_the_first_step_goes_down_the_gradient_by_finite_differences():
    # Adam's first step is the learning rate against the sign of each derivative, whatever its size.
    dataset, rate = made_up(10), 1e-3
    start = train_network(dataset, options(epochs=1, learning_rate=1e-13)).network
    stepped = train_network(dataset, options(epochs=1, learning_rate=rate)).network
    mask, h, checked = split_samples(dataset, options()), 1e-6, 0
    for name in ("hidden_weights", "hidden_bias", "output_weights", "output_bias"):
        values = getattr(start, name)
        for index in np.ndindex(values.shape):
            kept, losses = values[index], []
            for offset in (h, -h):
                values[index] = kept + offset
                losses.append(mean_squared_error(start, dataset, mask))
            values[index] = kept
            slope = (losses[0] - losses[1]) / (2.0 * h)
            if abs(slope) > 1e-5:
                step = getattr(stepped, name)[index] - kept
                assert step == pytest.approx(-rate * np.sign(slope), rel=2e-3)
                checked += 1
    assert checked > 120


# --- scores --------------------------------------------------------------------------------------------------------


def test_scores_are_those_of_the_network_on_each_side():
    dataset = made_up()
    result = train_network(dataset, options())
    mask = split_samples(dataset, options())
    predicted, target = result.network.log_weights(dataset.inputs), np.log10(dataset.outputs)
    for side, rows in (("training", mask), ("validation", ~mask)):
        for name, mix in (("omega_Q", [1.0, 0.0]), ("omega_R", [0.0, 1.0]), ("ratio", [1.0, -1.0])):
            t, p = target[rows] @ mix, predicted[rows] @ mix
            expected = 1.0 - np.var(t - p) / np.var(t) - np.mean(t - p) ** 2 / np.var(t)
            assert result.scores[f"{side} R^2 of log {name}"] == pytest.approx(expected)
    assert len(result.scores) == 6


def test_a_target_that_does_not_vary_has_no_score_and_the_file_stays_json(tmp_path):
    dataset = made_up()
    dataset.outputs[:, 1] = 1.0
    result = train_network(dataset, options())
    assert math.isnan(result.scores["training R^2 of log omega_R"])
    result.network.save(tmp_path / "net.json")
    document = json.loads((tmp_path / "net.json").read_text(), parse_constant=pytest.fail)
    assert document["provenance"]["scores"]["training R^2 of log omega_R"] is None
    weights = load_network(tmp_path / "net.json").weights(np.full((3, 12), 2.0))
    np.testing.assert_array_equal(weights[:, 1], 1.0)


# --- repeatability -------------------------------------------------------------------------------------------------


def test_the_same_data_options_and_seed_give_the_same_file_to_the_byte_and_others_another():
    def network(of=0, seed=0):
        return train_network(made_up(seed=of), options(seed=seed)).network.to_bytes()

    first = network()
    # After other random numbers, and with another number of threads.
    torch.rand(7)
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        assert network() == first
        assert torch.get_num_threads() == 2  # left as it was
    finally:
        torch.set_num_threads(threads)
    assert len({first, network(of=1), network(seed=1)}) == 3


@pytest.mark.parametrize(
    ("dataset", "changes"),
    [(made_up(40, 1), {"split": "runs"}), (made_up(1, 1), {}), (made_up(1, 3), {"training_share": 0.1})],
)
def test_a_side_without_samples_is_refused(dataset, changes):
    with pytest.raises(ConfigurationError) as caught:
        train_network(dataset, options(**changes))
    assert caught.value.key == "training.training_share"


@pytest.mark.parametrize(("split", "share"), [("runs", 0.7), ("samples", 0.05)])
def test_a_split_that_leaves_a_weight_without_training_samples_is_refused_before_training(split, share):
    dataset, masks, errors = made_up(10), [], []
    for seed in range(500):
        try:
            masks.append(split_samples(dataset, options(seed=seed, split=split, training_share=share)))
        except ConfigurationError as error:
            errors.append(error)
    assert all(len(np.unique(column)) == 3 for mask in masks for column in dataset.outputs[mask].T)
    assert {error.key for error in errors} == {"training.seed"}
    words = f"split by {split} leaves training samples of omega_"
    assert all(words in str(error) for error in errors)
    assert masks
