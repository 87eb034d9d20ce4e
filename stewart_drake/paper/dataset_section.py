"""The training data of section III.D: nine experiments, feasible amplitudes, 14,400 samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from stewart_drake.control.density import DensityKind
from stewart_drake.logs.log import AXES, SimulationLog
from stewart_drake.paper.nine_experiments_section import distinct
from stewart_drake.paper.report import Section, holds
from stewart_drake.paper.study import Study
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.planning.limits import limit_bounds
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

_CLAIM = (
    "Nine experiments, angles within pi/6 and translations of 0.3 m in each direction at 1 to 5 Hz, give 14,400 "
    "samples of densities and weights (section III.D)."
)
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
    from stewart_drake.paper.plots.training_plots import plot_densities

    section = Section("dataset", "The data", _CLAIM)
    base = study.base
    largest = np.array(feasible_amplitudes(base.robot, base.limits, base.gravity)[0])
    binding = binding_limits(base, largest)
    scenarios, logs = run_experiments(study)
    data = dataset_of(study, scenarios, logs, base.tuner.density)
    file = study.name("dataset", ".parquet")
    data.save(study.folder / file)
    section.files.append(file)
    reference = scenarios[0].reference
    assert isinstance(reference, SineBurstsReference)
    fraction = float(np.mean(largest >= np.array(PAPER_AMPLITUDE)))
    distances = run_distances(data)
    section.numbers = {
        "samples": len(data.run),
        "largest_amplitude": largest.tolist(),
        "binding_limit": binding,
        "amplitude": [list(row) for row in reference.amplitude],
        "bursts": min(len(FREQUENCIES), math.ceil(scenarios[0].duration / reference.burst_duration - 1e-9)),
        "equal_ratio_spread": label_spread(data),
        "next_ratio_spread": float(distances[~same_ratio(data)].min()),
        "distinct": distinct(distances, SAME_DATA),
        "share_of_paper_amplitudes_feasible": fraction,
        "sha256": data.digest(),
    }
    _add_amplitudes(section, base)
    _add_samples(section, base, len(scenarios), file)
    section.figure(
        "Densities (35), (36) of the nine experiments by ratio of weights: medians and 5 to 95 % bands",
        study.save_figure(plot_densities(data), "densities"),
    )
    section.verdict = verdict(section.numbers, len(scenarios))
    return section


def _add_amplitudes(section: Section, base: Scenario) -> None:
    n = section.numbers
    rows: list[tuple[str, ...]] = []
    for f, frequency in enumerate(FREQUENCIES):
        alone = [
            f"{_amplitude(a, n['largest_amplitude'][f][a])} ({_words(n['binding_limit'][f][a])})" for a in range(6)
        ]
        rows.append((f"{frequency:g} Hz, each axis alone", *alone))
        if f < n["bursts"]:
            rows.append((f"{frequency:g} Hz, as run", *(_amplitude(a, n["amplitude"][f][a]) for a in range(6))))
    rows.append(("paper, 1 to 5 Hz", *(_amplitude(a, PAPER_AMPLITUDE[a]) for a in range(6))))
    peak = (2.0 * np.pi * FREQUENCIES[-1]) ** 2 * PAPER_AMPLITUDE[-1]
    limits = ", ".join(_words(name) for name in limit_bounds(base.robot, base.limits))
    section.text(
        "### Amplitudes\n\n"
        f"{PAPER_AMPLITUDE[-1]:g} m at {FREQUENCIES[-1]:g} Hz alone is {peak:.0f} m/s^2. The table has the largest "
        f"feasible amplitude of each axis alone, within the limits on {limits}; the one that binds stands in brackets. "
        f"In the runs all six axes move at once, 60 deg apart in phase, with {SHARE:g} of the largest common share of "
        "these amplitudes that is feasible; the rest is left for the overshoot of the weaker pairs. "
        f"The runs of this report have the bursts of {FREQUENCIES[0]:g} to {FREQUENCIES[n['bursts'] - 1]:g} Hz."
    )
    section.table(
        "Amplitude by axis", ("motion", *(axis if i < 3 else axis.upper() for i, axis in enumerate(AXES))), rows
    )


def _add_samples(section: Section, base: Scenario, runs: int, file: str) -> None:
    n = section.numbers
    section.text(
        "### Samples\n\n"
        f"{n['samples']} samples: {runs} runs of {n['samples'] // runs} ticks of {1e3 * base.lqi.period:g} ms, "
        f"window m = {base.tuner.window}, gravity {base.gravity:g} m/s^2, feedforward "
        f"`{base.lqi.feedforward}`. The file (`{file}`) carries sample time, window, amplitudes, "
        "phases and the whole scenario in its metadata. Densities of runs whose weights have one ratio differ by "
        f"{n['equal_ratio_spread']:.1e} at most, of other runs by {n['next_ratio_spread']:.1e} at least."
    )


def verdict(numbers: dict[str, Any], runs: int) -> str:
    """What came of the claim, from the section's numbers."""
    cells = 6 * len(FREQUENCIES)
    feasible = round(cells * numbers["share_of_paper_amplitudes_feasible"])
    return (
        f"{holds((feasible == cells, feasible > 0))}: {numbers['samples']} samples collected (the paper: "
        f"{PAPER_SAMPLES}). The paper's amplitude is feasible in "
        f"{feasible} of {cells} combinations of axis and frequency, each axis alone; we use the largest feasible ones. "
        f"The {runs} runs hold {numbers['distinct']} distinct sets of data."
    )


def _words(limit: str) -> str:
    return "pitch of the Euler angles" if limit == "euler_pitch" else limit.replace("_", " ")


def _amplitude(axis: int, value: float) -> str:
    return f"{np.degrees(value):.1f} deg" if axis < 3 else f"{1e3 * value:.1f} mm"
