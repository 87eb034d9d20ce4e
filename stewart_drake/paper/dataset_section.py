"""The training data of section III.D: nine experiments, feasible amplitudes, 14,400 samples."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from stewart_drake.control.density import DensityKind
from stewart_drake.logs.log import SimulationLog
from stewart_drake.paper.nine_experiments_section import distinct
from stewart_drake.paper.plots.training_plots import plot_densities
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.planning.limits import limit_bounds
from stewart_drake.plotting.panels import COORDINATES
from stewart_drake.references import SineBurstsReference, SineReference
from stewart_drake.scenario import Scenario
from stewart_drake.training.collect import (
    FREQUENCIES,
    SAMPLES_PER_RUN,
    SHARE,
    dataset_from_logs,
    dataset_metadata,
    experiment_scenarios,
    feasible_amplitudes,
    six,
)
from stewart_drake.training.dataset import Dataset

PAPER_AMPLITUDE = (np.pi / 6.0,) * 3 + (0.3,) * 3
"""[rad, m] what section III.D names, for every frequency from 1 to 5 Hz."""

PAPER_SAMPLES = 14_400
SAME_DATA = 1e-6
"""[-] difference of densities below which two runs count as one set of data."""


def run_experiments(study: Study) -> tuple[list[Scenario], list[SimulationLog]]:
    """The nine experiments; logs come from the study's store if they are there."""
    scenarios = experiment_scenarios(study.base, study.pick(SAMPLES_PER_RUN, 640))
    return scenarios, study.store.run_all(scenarios, study.progress)


def dataset_of(
    study: Study, scenarios: Sequence[Scenario], logs: Sequence[SimulationLog], kind: DensityKind
) -> Dataset:
    """The samples of the nine logs under one kind of density."""
    tuner = study.base.tuner
    reference = scenarios[0].reference
    assert isinstance(reference, SineBurstsReference)
    metadata = dataset_metadata(study.base, reference) | {"density": kind}
    samples = round(scenarios[0].duration / study.base.lqi.period)
    return dataset_from_logs(logs, samples, kind, tuner.window, metadata)


def binding_limits(base: Scenario, amplitude: np.ndarray) -> list[list[str]]:
    """Which limit breaks first where each amplitude of a (n_f, 6) table is exceeded by 1 %."""
    names: list[list[str]] = []
    for frequency, row in zip(FREQUENCIES, amplitude, strict=True):
        names.append([])
        for axis in range(6):
            reference = SineReference(
                center=six(base.robot.home_pose),
                amplitude=six(1.01 * row * (np.arange(6) == axis)),
                angular_frequency=six(np.full(6, 2.0 * np.pi * frequency)),
            )
            report = check_reference(base.robot, base.limits, reference, 1.0 / frequency, base.gravity, 2000.0)
            names[-1].append(report.first_violation.limit if report.first_violation else "none")
    return names


def run_distances(dataset: Dataset) -> np.ndarray:
    """Largest difference of a density between two runs, tick by tick; (runs, runs) [-]."""
    inputs = [dataset.inputs[dataset.run == run] for run in np.unique(dataset.run)]
    return np.array([[np.abs(a - b).max() for b in inputs] for a in inputs])


def same_ratio(dataset: Dataset) -> np.ndarray:
    """Whether two runs have one ratio omega_Q / omega_R; (runs, runs) bool."""
    _, first = np.unique(dataset.run, return_index=True)
    ratio = dataset.outputs[first, 0] / dataset.outputs[first, 1]
    return np.isclose(ratio[:, None], ratio)


def label_spread(dataset: Dataset) -> float:
    """Largest difference between the densities of runs whose weights have one ratio."""
    return float(run_distances(dataset)[same_ratio(dataset)].max())


def make(study: Study) -> Section:
    """The section; see the module."""
    base = study.base
    largest = np.array(feasible_amplitudes(base.robot, base.limits, base.gravity)[0])
    binding = binding_limits(base, largest)
    scenarios, logs = run_experiments(study)
    data = dataset_of(study, scenarios, logs, base.tuner.density)
    file = study.name("dataset", ".parquet")
    data.save(study.folder / file)
    reference = scenarios[0].reference
    assert isinstance(reference, SineBurstsReference)
    distances = run_distances(data)
    feasible = largest >= np.array(PAPER_AMPLITUDE)
    numbers = {
        "samples": len(data.run),
        "largest_amplitude": largest.tolist(),
        "binding_limit": binding,
        "amplitude": [list(row) for row in reference.amplitude],
        "bursts": min(len(FREQUENCIES), math.ceil(scenarios[0].duration / reference.burst_duration - 1e-9)),
        "equal_ratio_spread": label_spread(data),
        "next_ratio_spread": float(distances[~same_ratio(data)].min()),
        "distinct": distinct(distances, SAME_DATA),
        "share_of_paper_amplitudes_feasible": float(np.mean(feasible)),
        "sha256": data.digest(),
    }
    section = study.section(
        "dataset",
        numbers,
        {"densities": plot_densities(data)},
        file=file,
        runs=len(scenarios),
        feasible=int(feasible.sum()),
        cells=feasible.size,
        paper_samples=PAPER_SAMPLES,
        paper_amplitude=PAPER_AMPLITUDE,
        peak=(2.0 * np.pi * FREQUENCIES[-1]) ** 2 * PAPER_AMPLITUDE[-1],
        limits=list(limit_bounds(base.robot, base.limits)),
        share=SHARE,
        frequencies=FREQUENCIES,
        axes=[name for name, _ in COORDINATES],
    )
    section.files.append(file)
    return section
