"""Back-propagation for the 12-10-2 tuner, section III.D."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Fraction, Positive, Section, Seed, Window
from stewart_drake.control.network import HIDDEN, INPUTS, OUTPUTS, TunerNetwork
from stewart_drake.errors import ConfigurationError, installed_with
from stewart_drake.training.collect import Dataset, r_squared

with installed_with("stewart-drake[train]", "everything but the training of the paper's network works without it"):
    import torch

Split = Literal["samples", "runs"]


class TrainingOptions(Section, key="training"):
    seed: Seed = 0
    """Seed of the split and of the initial weights."""
    epochs: Window = 2000
    """Steps of Adam over the whole training set."""
    learning_rate: Annotated[Positive, Field(lt=10.0)] = 0.01
    training_share: Fraction = 0.7
    """Share of the samples (or runs) for training; the rest validates. 0.7 in the paper."""
    split: Split = "samples"
    """samples: at random, as in the paper; neighbours in time leak into each other. runs: whole experiments."""


@dataclass(frozen=True)
class TrainingResult:
    """A trained network, (epochs,) mean squared errors of log10 omega, and R^2 by side and target."""

    network: TunerNetwork
    training_loss: np.ndarray
    validation_loss: np.ndarray
    scores: dict[str, float]


def split_samples(dataset: Dataset, options: TrainingOptions) -> np.ndarray:
    """(n,) mask of the training samples."""
    rng = np.random.default_rng(options.seed)
    group_of = np.arange(len(dataset.run)) if options.split == "samples" else dataset.run
    groups = rng.permutation(np.unique(group_of))
    training = np.isin(group_of, groups[: round(options.training_share * len(groups))])
    if training.all() or not training.any():
        raise ConfigurationError(
            "training.training_share",
            options.training_share,
            "a share that leaves samples for both training and validation",
        )
    return training


def train_network(
    dataset: Dataset, options: TrainingOptions | None = None, progress: Callable[[float], None] = lambda _: None
) -> TrainingResult:
    """Trains the tuner; the same data, options and torch give the same network to the last bit."""
    options = TrainingOptions() if options is None else options
    training = split_samples(dataset, options)
    target = np.log10(dataset.outputs)
    mean, scale = dataset.inputs[training].mean(axis=0), dataset.inputs[training].std(axis=0)
    scale = np.where(scale > 1e-9, scale, 1.0)
    # One thread and double precision: sums are then taken in one order, and the result repeats to the bit.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        inputs = (dataset.inputs - mean) / scale
        (hidden, hidden_bias, output, output_bias), losses = _descend(inputs, target, training, options, progress)
    finally:
        torch.set_num_threads(threads)
    network = TunerNetwork(
        mean,
        scale,
        hidden,
        hidden_bias,
        output,
        output_bias,
        omega_min=dataset.outputs.min(axis=0),
        omega_max=dataset.outputs.max(axis=0),
        density=dataset.metadata.get("density", "magnitude"),
        window=dataset.metadata.get("window", 49),
    )
    predicted = network.log_weights(dataset.inputs)
    scores = {
        f"{side} R^2 of log {name}": r_squared(target[rows] @ mix, predicted[rows] @ mix)
        for side, rows in (("training", training), ("validation", ~training))
        for name, mix in (("omega_Q", (1, 0)), ("omega_R", (0, 1)), ("ratio", (1, -1)))
    }
    network.provenance.update(
        {
            "made_by": "stewart-drake collect, stewart-drake train",
            "dataset_sha256": dataset.digest(),
            "samples": len(dataset.run),
            "options": options.to_dict(),
            "torch": torch.__version__,
            "numpy": np.__version__,
            # JSON has no NaN, which is the score of a target that does not vary.
            "scores": {name: score if np.isfinite(score) else None for name, score in scores.items()},
            "data": {k: v for k, v in dataset.metadata.items() if k != "scenario"},
        }
    )
    return TrainingResult(network, losses[:, 0], losses[:, 1], scores)


def _descend(
    inputs: np.ndarray,
    target: np.ndarray,
    training: np.ndarray,
    options: TrainingOptions,
    progress: Callable[[float], None],
) -> tuple[list[np.ndarray], np.ndarray]:
    """Weights and biases of both layers after so many epochs of Adam, and losses (epochs, 2) of both sides."""
    generator = torch.Generator().manual_seed(options.seed)
    hidden = torch.nn.Linear(INPUTS, HIDDEN, dtype=torch.float64)
    output = torch.nn.Linear(HIDDEN, OUTPUTS, dtype=torch.float64)
    network = torch.nn.Sequential(hidden, torch.nn.Tanh(), output)
    with torch.no_grad():
        for layer in (hidden, output):
            bound = layer.in_features**-0.5
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.uniform_(-bound, bound, generator=generator)
    given, wanted, mask = (torch.from_numpy(each) for each in (inputs, target, training))
    optimiser = torch.optim.Adam(network.parameters(), lr=options.learning_rate)
    losses = np.empty((options.epochs, 2))
    for epoch in range(options.epochs):
        optimiser.zero_grad()
        squared = (network(given) - wanted) ** 2
        loss = squared[mask].mean()
        loss.backward()
        optimiser.step()
        losses[epoch] = loss.item(), squared[~mask].mean().item()
        if epoch % 50 == 49 or epoch == options.epochs - 1:
            progress(epoch + 1.0)
    return [each.detach().numpy().copy() for each in network.parameters()], losses
