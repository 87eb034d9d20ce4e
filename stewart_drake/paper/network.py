"""III.D: the data of the nine experiments, and what a 12-10-2 network can learn from it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, get_args

import numpy as np

from stewart_drake.control.network import DensityKind
from stewart_drake.logs.log import SimulationLog
from stewart_drake.paper.nine_experiments import distinct
from stewart_drake.paper.study import PAIRS, Claim, Result, Study
from stewart_drake.plotting.panels import chart
from stewart_drake.scenario import Scenario
from stewart_drake.training.collect import (
    SAMPLES_PER_RUN,
    dataset_from_logs,
    dataset_metadata,
    experiment_reference,
    experiment_scenarios,
    feasible_amplitudes,
)
from stewart_drake.training.dataset import Dataset
from stewart_drake.training.train import Split, TrainingOptions, TrainingResult, train_network

PAPER_AMPLITUDE = (np.pi / 6.0,) * 3 + (0.3,) * 3
"""[rad, m] what section III.D names, for every frequency from 1 to 5 Hz."""
PAPER_SAMPLES = 14_400
SAME_DATA = 1e-6
"""[-] difference of densities below which two runs count as one set of data."""
LEARNT = 0.7
"""R^2 from which a label counts as learnt."""
TARGETS = ("omega_Q", "omega_R", "ratio")
SIDES = ("training", "validation")
Scores = dict[str, float | None]


def datasets(base: Scenario, logs: Sequence[SimulationLog]) -> dict[str, Dataset]:
    """The samples of the nine logs under each kind of density."""
    samples = round(logs[0].scenario.duration / base.lqi.period)
    about = dataset_metadata(base, experiment_reference(base))
    return {
        kind: dataset_from_logs(logs, samples, kind, base.tuner.window, about | {"density": kind})
        for kind in get_args(DensityKind)
    }


def run_distances(dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Largest difference (runs, runs) [-] of a density between two runs, and whether they have one ratio of weights."""
    runs, first = np.unique(dataset.run, return_index=True)
    inputs = [dataset.inputs[dataset.run == run] for run in runs]
    ratio = dataset.outputs[first, 0] / dataset.outputs[first, 1]
    return np.array([[np.abs(a - b).max() for b in inputs] for a in inputs]), np.isclose(ratio[:, None], ratio)


def best_possible_scores(outputs: np.ndarray | Sequence[tuple[float, float]] = PAIRS) -> Scores:
    """R^2 of an estimator that knows the ratio of the weights and nothing else; None where a label is constant.

    Equal ratios give equal data, so nothing better can be learnt from it. `outputs` (n, 2): omega_Q, omega_R.
    """
    labels = np.log10(np.asarray(outputs))
    _, group = np.unique(np.round(labels[:, 0] - labels[:, 1], 9), return_inverse=True)
    count = np.bincount(group)
    scores: Scores = {}
    for name, target in zip(TARGETS, (*labels.T, labels[:, 0] - labels[:, 1]), strict=True):
        residual = target - (np.bincount(group, target) / count)[group]
        total = float(np.sum((target - target.mean()) ** 2))
        scores[name] = 1.0 - float(np.sum(residual**2)) / total if total > 0.0 else None
    return scores


def scores_of(result: TrainingResult, side: str) -> Scores:
    """R^2 of a training on one side of its split; None where the target does not vary."""
    scores = {name: result.scores[f"{side} R^2 of log {name}"] for name in TARGETS}
    return {name: score if np.isfinite(score) else None for name, score in scores.items()}


def reproduce(study: Study) -> Result:
    """The nine experiments, and four trainings: two kinds of density, two kinds of split."""
    base, own = study.base, study.base.tuner.density
    scenarios = experiment_scenarios(base, study.pick(SAMPLES_PER_RUN, 640))
    logs = study.run(dict(enumerate(scenarios)))
    data = datasets(base, list(logs.values()))
    options = TrainingOptions(epochs=study.pick(2000, 300))
    trainings: list[tuple[DensityKind, Split]] = list(itertools.product(get_args(DensityKind), get_args(Split)))
    results = {(kind, split): train_network(data[kind], replace(options, split=split)) for kind, split in trainings}
    network = results[own, "samples"].network
    if study.folder is not None:
        study.tuner_file = study.folder / "tuner.json"
        network.save(study.tuner_file)
    largest = np.array(feasible_amplitudes(base.robot, base.limits, base.gravity)[0])
    distances, equal = run_distances(data[own])
    numbers = {
        "samples": len(data[own].run),
        "largest_amplitude": largest.tolist(),
        "amplitude": [list(row) for row in experiment_reference(base).amplitude],
        "equal_ratio_spread": float(distances[equal].max()),
        "next_ratio_spread": float(distances[~equal].min()),
        "distinct": distinct(distances, SAME_DATA),
        "share_of_paper_amplitudes_feasible": float(np.mean(largest >= PAPER_AMPLITUDE)),
        "scores": {
            f"{kind} {split}": {side: scores_of(result, side) for side in SIDES}
            for (kind, split), result in results.items()
        },
        "best_possible": best_possible_scores(),
        "validation": scores_of(results[own, "samples"], "validation"),
    }
    losses = {
        f"{kind} densities, split by {split}, {side}": (np.arange(options.epochs), loss)
        for (kind, split), result in results.items()
        for side, loss in zip(SIDES, (result.training_loss, result.validation_loss), strict=True)
    }
    draw = partial(chart, "Training of the network", "epoch", "squared error of log10 weights", losses, "-", "xy")
    return Result(numbers, _claims(study, numbers), {"network": draw})


def _claims(study: Study, numbers: dict[str, Any]) -> list[Claim]:
    samples, sets = numbers["samples"], numbers["distinct"]
    feasible = round(30 * numbers["share_of_paper_amplitudes_feasible"])
    scores = numbers["validation"]
    return [
        Claim("III.D: samples", f"{PAPER_SAMPLES}", samples, "", study.pick(samples == PAPER_SAMPLES, None)),
        Claim("III.D: amplitudes that are feasible, 1 to 5 Hz", "all", feasible, "of 30", feasible == 30),
        Claim("III.D: different sets of data of nine experiments", "9", sets, "", sets == 9),
        *(
            Claim(f"III.D: the network learns {name}, R^2", "learnt", scores[name], "", scores[name] >= LEARNT)
            for name in TARGETS
        ),
    ]
