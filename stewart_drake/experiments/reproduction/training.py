"""Training of the 12-10-2 network, section III.D: what it can learn and what nothing could."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from stewart_drake.density import DensityKind
from stewart_drake.experiments.report import Section
from stewart_drake.experiments.reproduction.dataset import dataset_of, run_experiments
from stewart_drake.experiments.reproduction.study import Study
from stewart_drake.training.collect import OMEGAS
from stewart_drake.training.train import Split, TrainingOptions, TrainingResult, train_network

_CLAIM = (
    "One hidden layer of ten nodes, trained by back-propagation on 70 % of the samples and validated on the other 30 "
    "%, estimates omega_Q and omega_R from the densities (section III.D, Fig. 5)."
)
_SCORES = ("omega_Q", "omega_R", "ratio")


def best_possible_scores() -> dict[str, float]:
    """R^2 of an estimator that knows the ratio of the weights exactly, and nothing else, over the nine labels.

    Equal ratios give equal data, so nothing better can be learnt from it; the rest of the variance is irreducible.
    """
    labels = np.log10(np.array(list(itertools.product(OMEGAS, OMEGAS))))
    ratio = np.round(labels[:, 0] - labels[:, 1], 9)
    mean = np.array([labels[ratio == r].mean(axis=0) for r in ratio])
    residual, total = ((labels - mean) ** 2).sum(axis=0), ((labels - labels.mean(axis=0)) ** 2).sum(axis=0)
    score = 1.0 - residual / total
    return {"omega_Q": float(score[0]), "omega_R": float(score[1]), "ratio": 1.0}


def make(study: Study) -> Section:
    """The section; see the module."""
    from stewart_drake.plotting_training import plot_learning_curves, plot_predictions

    section = Section("training", "The network", _CLAIM)
    scenarios, logs = run_experiments(replace(study, progress=lambda s: study.progress(0.2 * s)))
    options = TrainingOptions(epochs=study.pick(2000, 300))
    kinds: tuple[DensityKind, ...] = ("magnitude", "signed")
    data = {kind: dataset_of(study, scenarios, logs, kind) for kind in kinds}
    cells: list[tuple[DensityKind, Split]] = list(itertools.product(kinds, ("samples", "runs")))
    results: dict[tuple[DensityKind, Split], TrainingResult] = {}
    for index, (kind, split) in enumerate(cells):
        results[kind, split] = train_network(data[kind], replace(options, split=split))
        study.progress(0.2 + 0.7 * (index + 1) / len(cells))
    chosen = results[study.base.tuner.density, "samples"]
    chosen.network.save(study.folder / "tuner.json")

    short = replace(options, epochs=50)
    twice = [train_network(data["magnitude"], short).network.to_bytes() for _ in range(2)]
    best = best_possible_scores()
    rows = [
        (kind, split, side, *(result.scores[f"{side} R^2 of log {name}"] for name in _SCORES))
        for (kind, split), result in results.items()
        for side in ("training", "validation")
    ]
    section.table(
        "R^2 of log10 of the weights; split by random samples as in the paper, and by whole runs",
        ("density", "split", "side", "omega_Q", "omega_R", "ratio"),
        [*rows, ("any", "any", "best possible", *(best[name] for name in _SCORES))],
    )
    section.text(
        "### What cannot be learnt\n\n"
        "Only the ratio of the weights acts on the robot, so pairs with one ratio leave identical data under different "
        f"labels. Even an estimator that knew the ratio exactly could reach no more than R^2 = {best['omega_Q']:.2f} "
        f"for omega_Q and {best['omega_R']:.2f} for omega_R; only the ratio has a bound of 1. A random split puts "
        "neighbours in time, 5 ms apart, on both sides, so its validation figures flatter; the split by whole runs "
        "does not, but some of its validation runs carry labels that never occur in training beside that data."
    )
    section.figure("Learning curves", study.save_figure(plot_learning_curves(results), "learning_curves"))
    section.figure(
        "What the network answers for the data of each experiment (points: medians, bars: 5 to 95 %) against the label",
        study.save_figure(plot_predictions(chosen.network, data[study.base.tuner.density]), "predictions"),
    )
    repeatable = twice[0] == twice[1]
    section.text(
        "### Repeatability\n\n"
        f"Two trainings with one seed gave {'the same weights file to the byte' if repeatable else 'different files'} "
        "(double precision, one thread). Between machines sums may round differently: then predictions of the "
        "committed network agree to 1e-12 relative, as inference is the same dozen numpy operations."
    )
    validation = {name: chosen.scores[f"validation R^2 of log {name}"] for name in _SCORES}
    section.numbers = {
        "scores": {f"{kind} {split}": result.scores for (kind, split), result in results.items()},
        "best_possible": best,
        "repeatable": repeatable,
        "validation": validation,
    }
    section.verdict = (
        f"The ratio can be estimated (validation R^2 {validation['ratio']:.2f}); the weights themselves cannot "
        f"({validation['omega_Q']:.2f} and {validation['omega_R']:.2f} of at most {best['omega_Q']:.2f}), because the "
        "data does not depend on them beyond their ratio."
    )
    return section
