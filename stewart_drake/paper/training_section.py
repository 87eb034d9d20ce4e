"""Training of the 12-10-2 network, section III.D: what it can learn and what nothing could."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from stewart_drake.control.density import DensityKind
from stewart_drake.control.network import TunerNetwork
from stewart_drake.paper.dataset_section import dataset_of, label_spread, run_experiments
from stewart_drake.paper.report import Section, holds
from stewart_drake.paper.study import SEED, Study
from stewart_drake.training.collect import OMEGAS
from stewart_drake.training.dataset import Dataset
from stewart_drake.training.train import Split, TrainingOptions, TrainingResult, split_samples, train_network

_CLAIM = (
    "One hidden layer of ten nodes, trained by back-propagation on 70 % of the samples and validated on the other 30 "
    "%, estimates omega_Q and omega_R from the densities (section III.D, Fig. 5)."
)
LEARNT = 0.7
"""[-] validation R^2 from which on we call a quantity learnt."""
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


def rounding_of_inference(network: TunerNetwork, densities: np.ndarray) -> float:
    """Largest relative change of the answers when every sum of the network is taken in the opposite order."""
    turned = replace(
        network,
        input_mean=network.input_mean[::-1],
        input_scale=network.input_scale[::-1],
        hidden_weights=network.hidden_weights[::-1, ::-1],
        hidden_bias=network.hidden_bias[::-1],
        output_weights=network.output_weights[:, ::-1],
    )
    return float(np.abs(turned.weights(densities[:, ::-1]) / network.weights(densities) - 1.0).max())


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
    from stewart_drake.paper.plots.training_plots import plot_learning_curves, plot_predictions

    section = Section("training", "The network", _CLAIM)
    scenarios, logs = run_experiments(replace(study, progress=lambda s: study.progress(0.2 * s)))
    options = TrainingOptions(epochs=study.pick(2000, 300))
    kinds: tuple[DensityKind, ...] = ("magnitude", "signed")
    data = {kind: dataset_of(study, scenarios, logs, kind) for kind in kinds}
    cells: list[tuple[DensityKind, Split]] = list(itertools.product(kinds, ("samples", "runs")))
    results: dict[tuple[DensityKind, Split], TrainingResult] = {}
    for index, (kind, split) in enumerate(cells):
        results[kind, split] = train_network(data[kind], replace(options, split=split))
        study.progress(0.2 + 0.6 * (index + 1) / len(cells))
    own = study.base.tuner.density
    network = results[own, "samples"].network
    file = study.name("tuner", ".json")
    network.save(study.folder / file)
    section.files.append(file)

    twice = [train_network(data[own], replace(options, epochs=50)).network.to_bytes() for _ in range(2)]
    by_runs = split_samples(data[own], replace(options, split="runs"))
    section.numbers = {
        "scores": {
            f"{kind} {split}": {side: scores_of(result, side) for side in _SIDES}
            for (kind, split), result in results.items()
        },
        "best_possible": best_possible_scores(),
        "equal_ratio_spread": label_spread(data[own]),
        "labels_apart": list(labels_apart(data[own], by_runs)),
        "repeatable": twice[0] == twice[1],
        "rounding_of_inference": rounding_of_inference(network, data[own].inputs),
        "rounding_of_training": rounding_of_training(data[own], options, network),
        "validation": scores_of(results[own, "samples"], "validation"),
    }
    _add_scores(section, results, data, options)
    _add_limits(section, study, own)
    section.figure(
        "Learning curves: loss of each epoch, by kind of density and split",
        study.save_figure(plot_learning_curves(results), "learning_curves"),
    )
    section.figure(
        "What the network answers for the data of each experiment (points: medians, bars: 5 to 95 %) against the "
        "label. Experiments of one label stand side by side; on the dotted line the answer would be right.",
        study.save_figure(plot_predictions(network, data[own]), "predictions"),
    )
    _add_repeatability(section, options)
    section.verdict = verdict(section.numbers)
    study.progress(1.0)
    return section


def _add_scores(
    section: Section,
    results: Mapping[tuple[DensityKind, Split], TrainingResult],
    data: Mapping[DensityKind, Dataset],
    options: TrainingOptions,
) -> None:
    rows = []
    for (kind, split), result in results.items():
        training = split_samples(data[kind], replace(options, split=split))
        for side, mask in zip(_SIDES, (training, ~training), strict=True):
            scores, bound = scores_of(result, side), best_possible_scores(data[kind].outputs[mask])
            rows.append(
                (kind, split, side, *(v for name in _TARGETS[:2] for v in (scores[name], bound[name])), scores["ratio"])
            )
    section.table(
        "R^2 of log10 of the weights from the densities (35), (36); split by random samples as in the paper, and by "
        "whole runs. The bound is that of an estimator that knows the ratio of each of these samples",
        ("density", "split", "side", "omega_Q", "bound", "omega_R", "bound", "ratio"),
        rows,
    )


def _add_limits(section: Section, study: Study, own: DensityKind) -> None:
    n = section.numbers
    best, scores = n["best_possible"], n["scores"]
    runs, apart = n["labels_apart"]
    section.text(
        "### What cannot be learnt\n\n"
        "Only the ratio of the weights (27) acts on the robot, so pairs with one ratio leave the same data under "
        f"different labels: here the densities of such runs differ by {n['equal_ratio_spread']:.1e} at most. Over the "
        "nine pairs even an estimator that knew the ratio exactly could reach no more than "
        f"R^2 = {best['omega_Q']:.2f} for omega_Q and {best['omega_R']:.2f} for omega_R; only the ratio has a bound of "
        f"{best['ratio']:.2g}. A random split puts neighbours in time, {1e3 * study.base.lqi.period:g} ms "
        f"apart, on both sides; a split by whole runs does not, but {apart} of its {runs} validation runs have data "
        "that training saw under other labels alone. With the tuner's own densities the ratio's validation R^2 is "
        f"{_short(scores[f'{own} samples']['validation']['ratio'])} by samples and "
        f"{_short(scores[f'{own} runs']['validation']['ratio'])} by runs."
    )


def _add_repeatability(section: Section, options: TrainingOptions) -> None:
    n = section.numbers
    same = "the same weights file to the byte" if n["repeatable"] else "different weights files"
    section.text(
        "### Repeatability\n\n"
        f"Two trainings with one seed gave {same} (double precision, one thread). Another machine may round sums "
        "differently. With one weights file and every sum of the network taken in the opposite order the answers "
        f"change by {n['rounding_of_inference']:.1e} relative at most. Trained again for {options.epochs} epochs, from "
        f"inputs that differ in their last bit, log10 of the answers comes out up to {n['rounding_of_training']:.1e} "
        "apart: that much may lie between the networks that two machines train."
    )


def verdict(numbers: dict[str, Any]) -> str:
    """What was learnt and what was not, from the section's numbers."""
    scores, best = numbers["validation"], numbers["best_possible"]
    learnt = [name for name in _TARGETS if scores[name] is not None and scores[name] >= LEARNT]
    return (
        f"{holds(name in learnt for name in _TARGETS[:2])}: on the validation samples R^2 is "
        f"{_short(scores['omega_Q'])} for omega_Q, {_short(scores['omega_R'])} for omega_R and "
        f"{_short(scores['ratio'])} for their ratio, of at most {_short(best['omega_Q'])}, {_short(best['omega_R'])} "
        f"and {_short(best['ratio'])}. Learnt (R^2 of {LEARNT:g} or more): "
        f"{' and '.join(learnt) if learnt else 'nothing'}."
    )


def _short(score: float | None) -> str:
    return "-" if score is None else f"{score:.2g}"
