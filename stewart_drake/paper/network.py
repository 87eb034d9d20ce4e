"""III.D: the data of the nine experiments, and the fit of a 12-10-2 network to it."""

from __future__ import annotations

import itertools
from functools import partial
from typing import get_args

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.control.features import DensityKind
from stewart_drake.paper.nine_experiments import distinct
from stewart_drake.paper.reproduce import PAIRS, Claim, Reproduction, Result, followed
from stewart_drake.plotting.style import chart
from stewart_drake.training.paper_network import (
    SAMPLES_PER_RUN,
    Dataset,
    Split,
    TrainingOptions,
    dataset_from_logs,
    dataset_metadata,
    experiment_reference,
    experiment_scenarios,
    feasible_amplitudes,
    r_squared,
    train_network,
)

PAPER_AMPLITUDE = (np.pi / 6.0,) * 3 + (0.3,) * 3
"""[rad, m] of section III.D, for every frequency from 1 to 5 Hz."""
PAPER_SAMPLES = 14_400
SAME_DATA = 1e-6  # [-] difference of densities below which two runs count as one set of data
LEARNT = 0.7
TARGETS = ("omega_Q", "omega_R", "ratio")
SIDES = ("training", "validation")
Scores = dict[str, float | None]


def run_distances(dataset: Dataset) -> np.ndarray:
    """Largest difference (runs, runs) [-] of a density between two runs."""
    inputs = [dataset.inputs[dataset.run == run] for run in np.unique(dataset.run)]
    return np.array([[np.abs(a - b).max() for b in inputs] for a in inputs])


def best_possible_scores() -> Scores:
    """R^2 over the nine pairs of an estimator of the ratio alone: equal ratios give equal data."""
    labels = np.log10(PAIRS)
    _, group = np.unique(np.round(labels[:, 0] - labels[:, 1], 9), return_inverse=True)
    targets = (*labels.T, labels[:, 0] - labels[:, 1])
    means = [(np.bincount(group, target) / np.bincount(group))[group] for target in targets]
    return {name: r_squared(target, mean) for name, target, mean in zip(TARGETS, targets, means, strict=True)}


def reproduce(study: Reproduction) -> Result:
    base, density, window = study.base, study.base.tuner.density, study.base.tuner.window
    scenarios = experiment_scenarios(base, study.pick(SAMPLES_PER_RUN, 640))
    logs = list(study.run(dict(enumerate(scenarios))).values())
    rows, about = round(scenarios[0].duration / base.lqi.period), dataset_metadata(base, experiment_reference(base))
    data = {k: dataset_from_logs(logs, rows, k, window, about | {"density": k}) for k in get_args(DensityKind)}
    options = TrainingOptions(epochs=study.pick(2000, 300))
    trainings = itertools.product(get_args(DensityKind), get_args(Split))
    results = {(kind, split): train_network(data[kind], options.replace(split=split)) for kind, split in trainings}
    if study.folder is not None:
        study.tuner_file = study.folder / "tuner.json"
        results[density, "samples"].network.save(study.tuner_file)
    largest = np.array(feasible_amplitudes(base.robot, base.limits, base.gravity_in_base)[0])
    scores: dict[str, Document] = {}
    for (kind, split), result in results.items():
        of_sides = {side: {name: result.scores[f"{side} R^2 of log {name}"] for name in TARGETS} for side in SIDES}
        # None if the target is constant.
        scores[f"{kind} {split}"] = {
            side: {name: score if np.isfinite(score) else None for name, score in row.items()}
            for side, row in of_sides.items()
        }
    numbers = {
        "largest_amplitude": largest.tolist(),
        "amplitude": [list(row) for row in experiment_reference(base).amplitude],
        "scores": scores,
        "best_possible": best_possible_scores(),
    }
    samples, sets = len(data[density].run), distinct(run_distances(data[density]), SAME_DATA)
    kept, feasible = followed(logs), int(np.sum(largest >= PAPER_AMPLITUDE))
    learnt = scores[f"{density} samples"]["validation"]
    claims = [
        Claim("III.D: samples", f"{PAPER_SAMPLES}", samples, "", None),
        Claim("III.D: experiments whose motion is followed", "9", kept, "of 9", kept == 9),
        Claim("III.D: amplitudes that are feasible, 1 to 5 Hz", "all", feasible, "of 30", feasible == 30),
        Claim("III.D: different sets of data of nine experiments", "9", sets, "", sets == 9),
    ]
    for name, value in learnt.items():
        claims.append(Claim(f"III.D: the network learns {name}, R^2", "learnt", value, "", value >= LEARNT))
    losses = {
        f"{kind} densities, split by {split}, {side}": (np.arange(options.epochs), loss)
        for (kind, split), result in results.items()
        for side, loss in zip(SIDES, (result.training_loss, result.validation_loss), strict=True)
    }
    draw = partial(chart, "Training of the network", "epoch", "squared error of log10 weights", losses, "-", "xy")
    return Result(numbers, claims, {"network": draw})
