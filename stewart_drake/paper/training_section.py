"""Training of the 12-10-2 network, section III.D: what it can learn and what nothing could."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from stewart_drake.control.density import DensityKind
from stewart_drake.control.network import TunerNetwork
from stewart_drake.paper.dataset_section import dataset_of, label_spread, run_experiments
from stewart_drake.paper.plots.training_plots import plot_learning_curves, plot_predictions
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import SEED, Study
from stewart_drake.training.collect import OMEGAS
from stewart_drake.training.dataset import Dataset
from stewart_drake.training.train import Split, TrainingOptions, TrainingResult, split_samples, train_network

_TARGETS = ("omega_Q", "omega_R", "ratio")
_SIDES = ("training", "validation")

Scores = dict[str, float | None]


def best_possible_scores(outputs: np.ndarray | None = None) -> Scores:
    """R^2 of an estimator that knows the ratio of the weights exactly, and nothing else.

    Equal ratios give equal data, so nothing better can be learnt from it; the rest of the variance is irreducible.

    Args:
        outputs: (n, 2) omega_Q, omega_R of the samples that are scored; None takes the nine pairs, once each.

    Returns:
        By omega_Q, omega_R and ratio; None where that does not vary.
    """
    labels = np.log10(np.array(list(itertools.product(OMEGAS, OMEGAS)) if outputs is None else outputs))
    _, group = np.unique(np.round(labels[:, 0] - labels[:, 1], 9), return_inverse=True)
    count = np.bincount(group)
    scores: Scores = {}
    for name, label in zip(_TARGETS, (*labels.T, labels[:, 0] - labels[:, 1]), strict=True):
        residual = label - (np.bincount(group, label) / count)[group]
        total = float(np.sum((label - label.mean()) ** 2))
        scores[name] = 1.0 - float(np.sum(residual**2)) / total if total > 0.0 else None
    return scores


def scores_of(result: TrainingResult, side: str) -> Scores:
    """R^2 of a training on one side of its split; None where the target does not vary."""
    scores = {name: result.scores[f"{side} R^2 of log {name}"] for name in _TARGETS}
    return {name: score if np.isfinite(score) else None for name, score in scores.items()}


def rounding_of_training(dataset: Dataset, options: TrainingOptions, network: TunerNetwork) -> float:
    """Largest change of log10 of the answers of `network` when it is trained again, from inputs off by the last bit."""
    up = np.random.default_rng(SEED).random(dataset.inputs.shape) < 0.5
    inputs = np.nextafter(dataset.inputs, np.where(up, np.inf, -np.inf))
    other = train_network(replace(dataset, inputs=inputs), options).network
    return float(np.abs(other.log_weights(dataset.inputs) - network.log_weights(dataset.inputs)).max())


def labels_apart(dataset: Dataset, training: np.ndarray) -> tuple[int, int]:
    """Validation runs, and how many of them have data that the training side holds under other labels alone."""
    ratio = np.round(np.log10(dataset.outputs[:, 0] / dataset.outputs[:, 1]), 9)
    seen = {run: bool(np.isin(ratio[dataset.run == run], ratio[training]).any()) for run in dataset.run[~training]}
    apart = [run for run in seen if seen[run] and not training[dataset.run == run].any()]
    return len(seen), len(apart)


def make(study: Study) -> Section:
    """The section; see the module."""
    scenarios, logs = run_experiments(replace(study, progress=lambda s: study.progress(0.2 * s)))
    options = TrainingOptions(epochs=study.pick(2000, 300))
    kinds: tuple[DensityKind, ...] = ("magnitude", "signed")
    data = {kind: dataset_of(study, scenarios, logs, kind) for kind in kinds}
    cells: list[tuple[DensityKind, Split]] = list(itertools.product(kinds, ("samples", "runs")))
    results: dict[tuple[DensityKind, Split], TrainingResult] = {}
    bounds: dict[tuple[str, str, str], Scores] = {}
    for index, (kind, split) in enumerate(cells):
        results[kind, split] = train_network(data[kind], replace(options, split=split))
        training = split_samples(data[kind], replace(options, split=split))
        for side, mask in zip(_SIDES, (training, ~training), strict=True):
            bounds[kind, split, side] = best_possible_scores(data[kind].outputs[mask])
        study.progress(0.2 + 0.6 * (index + 1) / len(cells))
    own = study.base.tuner.density
    network = results[own, "samples"].network
    file = study.name("tuner", ".json")
    network.save(study.folder / file)
    twice = [train_network(data[own], replace(options, epochs=50)).network.to_bytes() for _ in range(2)]
    by_runs = split_samples(data[own], replace(options, split="runs"))
    numbers = {
        "scores": {
            f"{kind} {split}": {side: scores_of(result, side) for side in _SIDES}
            for (kind, split), result in results.items()
        },
        "best_possible": best_possible_scores(),
        "equal_ratio_spread": label_spread(data[own]),
        "labels_apart": list(labels_apart(data[own], by_runs)),
        "repeatable": twice[0] == twice[1],
        "rounding_of_training": rounding_of_training(data[own], options, network),
        "validation": scores_of(results[own, "samples"], "validation"),
    }
    figures = {
        "learning_curves": plot_learning_curves(results),
        "predictions": plot_predictions(network, data[own]),
    }
    section = study.section("training", numbers, figures, bounds=bounds, epochs=options.epochs)
    section.files.append(file)
    study.progress(1.0)
    return section
