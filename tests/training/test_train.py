import numpy as np
import pytest

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.training.paper_network import Dataset, TrainingOptions, import_torch, r_squared, train_network

pytestmark = pytest.mark.torch
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


def test_it_finds_the_weights_that_can_be_read_from_the_densities():
    dataset = made_up()
    network = train_network(dataset, options(epochs=600)).network
    for column in (0, 1):
        assert r_squared(np.log10(dataset.outputs[:, column]), network.log_weights(dataset.inputs)[:, column]) > 0.7


def test_the_same_data_options_and_seed_give_the_same_file_to_the_byte_and_others_another():
    def network(of=0, seed=0):
        import_torch().rand(7)  # nobody else's random numbers
        return train_network(made_up(seed=of), options(seed=seed)).network.to_bytes()

    assert network() == network()
    assert len({network(), network(of=1), network(seed=1)}) == 3


def test_a_side_without_samples_is_refused():
    with pytest.raises(ConfigurationError) as caught:
        train_network(made_up(1, 1), options())
    assert caught.value.key == "training.training_share"
