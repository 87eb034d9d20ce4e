"""The training data of section III.D: nine experiments, feasible amplitudes, 14,400 samples."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from stewart_drake.density import DensityKind
from stewart_drake.experiments.report import Section
from stewart_drake.experiments.reproduction.study import Study
from stewart_drake.feasibility import check_reference
from stewart_drake.log import AXES, SimulationLog
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
    samples = round(scenarios[0].duration / study.base.controller.period)
    return dataset_from_logs(logs, samples, kind, tuner.window, metadata)


def binding_limits(base: Scenario, amplitude: np.ndarray) -> list[list[str]]:
    """Which limit breaks first where each amplitude of a (n_f, 6) table is exceeded by 1 %."""
    names: list[list[str]] = []
    for frequency, row in zip(FREQUENCIES, amplitude, strict=True):
        names.append([])
        for axis in range(6):
            reference = SineReference(
                amplitude=six(1.01 * row * (np.arange(6) == axis)),
                angular_frequency=six(np.full(6, 2.0 * np.pi * frequency)),
            )
            report = check_reference(base.robot, base.limits, reference, 1.0 / frequency, base.gravity, 2000.0)
            names[-1].append(report.first_violation.limit if report.first_violation else "none")
    return names


def label_spread(dataset: Dataset) -> float:
    """Largest difference between the inputs of runs whose weights have one ratio."""
    log_ratio = np.round(np.log10(dataset.outputs[:, 0] / dataset.outputs[:, 1]), 6)
    runs = {int(r): dataset.inputs[dataset.run == r] for r in np.unique(dataset.run)}
    ratio_of = {r: float(log_ratio[dataset.run == r][0]) for r in runs}
    return max(
        (
            float(np.abs(runs[a] - runs[b]).max())
            for a, b in itertools.combinations(runs, 2)
            if ratio_of[a] == ratio_of[b]
        ),
        default=0.0,
    )


def make(study: Study) -> Section:
    """The section; see the module."""
    from stewart_drake.plotting_training import plot_densities

    section = Section("dataset", "The data", _CLAIM)
    base = study.base
    largest = np.array(feasible_amplitudes(base.robot, base.limits, base.gravity)[0])
    binding = binding_limits(base, largest)
    scenarios, logs = run_experiments(study)
    data = dataset_of(study, scenarios, logs, base.tuner.density)
    data.save(study.folder / "dataset.parquet")

    reference = scenarios[0].reference
    assert isinstance(reference, SineBurstsReference)
    rows = []
    for f, frequency in enumerate(FREQUENCIES):
        alone = [_amplitude(a, largest[f, a]) + f" ({binding[f][a]})" for a in range(6)]
        rows.append((f"{frequency:g} Hz, each axis alone", *alone))
        rows.append((f"{frequency:g} Hz, as run", *(_amplitude(a, reference.amplitude[f][a]) for a in range(6))))
    rows.append(("paper, 1 to 5 Hz", *(_amplitude(a, PAPER_AMPLITUDE[a]) for a in range(6))))
    section.text(
        "### Amplitudes\n\n"
        "The paper's amplitudes cannot be reached at its frequencies: 0.3 m at 5 Hz alone is 296 m/s^2. The largest "
        "feasible amplitude of each axis alone keeps to reach, transmission, conditioning, joint swing, clearance, "
        "crank speed and motor torque (the limit that binds stands in brackets). In the runs all six axes move at "
        f"once, 60 deg apart in phase, with {SHARE:g} of the largest common share of these amplitudes that is "
        "feasible: at the whole of it the weaker pairs overshoot into a dead centre."
    )
    section.table("Amplitude by axis", ("motion", *AXES), rows)

    spread = label_spread(data)
    section.text(
        "### Samples\n\n"
        f"{len(data.run)} samples: {len(scenarios)} runs of {len(data.run) // len(scenarios)} ticks of "
        f"{1e3 * base.controller.period:g} ms, window m = {base.tuner.window}, gravity {base.gravity:g} m/s^2, "
        f"feedforward `{base.controller.feedforward}`. The file (`dataset.parquet`) carries sample time, window, "
        "amplitudes, phases and the whole scenario in its metadata. Runs with one ratio of weights give the same "
        f"densities to {spread:.1e}: their labels differ, their data does not."
    )
    section.figure(
        "Densities of the nine experiments by ratio of weights: medians and 5 to 95 % bands",
        study.save_figure(plot_densities(data), "densities"),
    )
    fraction = float(np.mean(largest >= np.array(PAPER_AMPLITUDE)))
    section.numbers = {
        "samples": len(data.run),
        "largest_amplitude": largest.tolist(),
        "binding_limit": binding,
        "amplitude": [list(row) for row in reference.amplitude],
        "equal_ratio_spread": spread,
        "share_of_paper_amplitudes_feasible": fraction,
        "sha256": data.digest(),
    }
    section.verdict = (
        f"{len(data.run)} samples collected. Of the 30 combinations of axis and frequency the paper's amplitude is "
        f"feasible in {round(30 * fraction)}; we use the largest feasible ones. The nine runs hold five distinct sets "
        "of data."
    )
    return section


def _amplitude(axis: int, value: float) -> str:
    return f"{np.degrees(value):.1f} deg" if axis < 3 else f"{1e3 * value:.1f} mm"
