"""The paper's tuner, section III.D: training data from nine experiments, and training of the network with torch."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stewart_drake.analysis.feasibility import amplitude_table, largest_scale
from stewart_drake.base.atomic_files import Document, write_atomically
from stewart_drake.base.config import Fraction, Positive, Section, Seed, Vector6, Window
from stewart_drake.base.errors import ConfigurationError, RunFailure, installed_with
from stewart_drake.base.tables import parquet_about, read_columns, to_parquet, with_about
from stewart_drake.control.features import DensityKind, density
from stewart_drake.control.network import HIDDEN, INPUTS, OUTPUTS, TunerNetwork
from stewart_drake.control.tuners import FixedTuner
from stewart_drake.logs.log import SimulationLog
from stewart_drake.references import SineBurstsReference
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.scenario.limits import ReferenceLimits
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.studies.runs import simulate
from stewart_drake.studies.workers import Workers, run_all

OMEGAS = (0.1, 1.0, 10.0)
FREQUENCIES = (1.0, 2.0, 3.0, 4.0, 5.0)  # [Hz] of the bursts in every experiment
PHASES = tuple(np.pi / 3.0 * k for k in range(6))
"""[rad] of the six axes: 60 degrees apart, so that their peaks are not simultaneous."""
SHARE = 0.8
"""Share of the largest feasible amplitudes; with all of it the weaker of the nine pairs overshoot into a crank's dead
centre."""
SAMPLES_PER_RUN = 1600
BURST = 1.6  # [s] per frequency: 320 samples of 5 ms
COLUMNS = ("time", "run", *(f"density_{i}" for i in range(12)), "omega_q", "omega_r")
_VERSION = 2
_MOST_BYTES, _MOST_ROWS = 500_000_000, 10_000_000


@dataclass(frozen=True)
class Dataset:
    """Training data of n ticks."""

    inputs: np.ndarray  # (n, 12) [-] densities of errors and torques.
    outputs: np.ndarray  # (n, 2) weights omega_Q, omega_R.
    run: np.ndarray  # (n,) experiment.
    time: np.ndarray  # (n,) [s] within the experiment.
    metadata: Document = field(default_factory=dict)  # Metadata of the experiments, see `dataset_metadata`.

    def digest(self) -> str:
        content = hashlib.sha256()
        for array in (self.inputs, self.outputs, self.run, self.time):
            content.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return content.hexdigest()

    def save(self, path: str | Path) -> None:
        import pyarrow as pa

        values = [self.time, self.run, *self.inputs.T, *self.outputs.T]
        table = pa.table(dict(zip(COLUMNS, values, strict=True)))
        about = {"version": _VERSION, **self.metadata}
        write_atomically(Path(path), to_parquet(with_about(table, "dataset", about)))


def load_dataset(path: str | Path) -> Dataset:
    key = f"dataset {path}"
    metadata = parquet_about(path, key, "dataset", _MOST_BYTES, "`collect`")
    if metadata.pop("version", None) != _VERSION:
        raise ConfigurationError(key, "another format", f"a dataset of version {_VERSION}, written by `collect`")
    columns = read_columns(path, key, lambda _: {name: (name, 1.0) for name in COLUMNS}, _MOST_BYTES, _MOST_ROWS)
    if not all(len(values) and np.isfinite(values).all() for values in columns.values()):
        raise ConfigurationError(key, "values that are not finite numbers", "a dataset written by `collect`")
    time, run, *inputs, omega_q, omega_r = columns.values()
    outputs = np.stack([omega_q, omega_r], axis=-1)
    return Dataset(np.stack(inputs, axis=-1), outputs, run.astype(int), time, metadata)


@lru_cache(maxsize=4)
def feasible_amplitudes(
    robot: RobotParameters, limits: ReferenceLimits, gravity: Gravity
) -> tuple[tuple[Vector6, ...], tuple[Vector6, ...]]:
    """Largest feasible amplitudes (n_f, 6) [rad, m] at `FREQUENCIES`: of single axes, and of all axes at once."""
    alone = tuple(six(row) for row in amplitude_table(robot, limits, FREQUENCIES, gravity))
    together = []
    for frequency, single in zip(FREQUENCIES, alone, strict=True):

        def burst(scale: float, frequency: float = frequency, single: Vector6 = single) -> SineBurstsReference:
            return _bursts(robot, (frequency,), (six(scale * np.array(single)),))

        together.append(six(largest_scale(robot, limits, burst, BURST, gravity) * np.array(single)))
    return alone, tuple(together)


def experiment_reference(base: Scenario) -> SineBurstsReference:
    """The motion of every experiment: 1 to 5 Hz on all six axes, `SHARE` of what the limits of `base` allow.

    Deviation: the paper's pi/6 and 0.3 m at up to 5 Hz cannot be reached together (0.3 m at 5 Hz is 296 m/s^2).
    """
    _, together = feasible_amplitudes(base.robot, base.limits, base.gravity_in_base)
    if not np.all(np.array(together) > 0.0):
        raise ConfigurationError("limits", base.limits, "limits within which the robot can move from its home pose")
    # Rounded down to whole microradians and micrometres, so that rounding errors of the search do not change the data.
    amplitude = tuple(six(np.floor(1e6 * SHARE * np.array(row)) / 1e6) for row in together)
    return _bursts(base.robot, FREQUENCIES, amplitude)


def _bursts(
    robot: RobotParameters, frequency: tuple[float, ...], amplitude: tuple[Vector6, ...]
) -> SineBurstsReference:
    return SineBurstsReference(
        frequency=frequency, amplitude=amplitude, center=six(robot.home_pose), phase=six(PHASES), burst_duration=BURST
    )


def experiment_scenarios(base: Scenario, samples: int = SAMPLES_PER_RUN) -> list[Scenario]:
    """The nine experiments: every pair of `OMEGAS`, held fixed, on `experiment_reference`."""
    kept = {name: getattr(base, name) for name in ("gravity", "robot", "model", "plant", "limits")}
    kept |= {"reference": experiment_reference(base), "controller": base.lqi, "duration": samples * base.lqi.period}
    kind, window = base.tuner.density, base.tuner.window
    tuners = [FixedTuner(omega_q=q, omega_r=r, density=kind, window=window) for q in OMEGAS for r in OMEGAS]
    return [Scenario(name=f"experiment {index}", tuner=tuner, **kept) for index, tuner in enumerate(tuners)]


def dataset_from_logs(
    logs: Sequence[SimulationLog], samples: int, kind: DensityKind, window: int, metadata: dict[str, object]
) -> Dataset:
    """Densities of logged errors and torques, one row per tick; a RunFailure if a log is too short."""
    inputs, outputs = [], []
    for index, log in enumerate(logs):
        if not log.reached_end or len(log.time) < samples:
            omega_q, omega_r = log.scenario.tuner.weights
            name = f"experiment {index} (omega_Q {omega_q:g}, omega_R {omega_r:g})"
            raise RunFailure(f"{name} ended at {log.end_time:.3f} s: {log.message}")
        signals = np.concatenate([log["error"], log["torque"]], axis=1)[:samples]
        inputs.append([density(signals[max(0, k - window) : k + 1], kind) for k in range(samples)])
        outputs.append(log["weights"][:samples])
    run = np.repeat(np.arange(len(logs)), samples)
    times = np.concatenate([log.time[:samples] for log in logs])
    return Dataset(np.concatenate(inputs), np.concatenate(outputs), run, times, metadata)


def dataset_metadata(base: Scenario, reference: SineBurstsReference) -> dict[str, object]:
    return {
        "sample_time": base.lqi.period,
        "density": base.tuner.density,
        "window": base.tuner.window,
        "frequency": list(reference.frequency),
        "amplitude": [list(row) for row in reference.amplitude],
        "phase": list(reference.phase),
        "gravity": base.gravity_in_base,
        "feedforward": base.lqi.feedforward,
        "force_map": base.lqi.force_map,
        "omegas": list(OMEGAS),
        "scenario": base.to_dict(),
    }


def collect_dataset(
    base: Scenario | None = None,
    progress: Callable[[float], None] = lambda _: None,
    samples: int = SAMPLES_PER_RUN,
    workers: Workers | None = None,
) -> Dataset:
    """Runs the nine experiments with the density and window of `base`; `progress` gets the number done."""
    base = Scenario() if base is None else base
    scenarios = experiment_scenarios(base, samples)
    logs = run_all(simulate, [(scenario,) for scenario in scenarios], workers or Workers(0), progress)
    metadata = dataset_metadata(base, experiment_reference(base))
    return dataset_from_logs(logs, samples, base.tuner.density, base.tuner.window, metadata)


def six(values: Iterable[float]) -> Vector6:
    a, b, c, d, e, f = (float(v) for v in values)
    return a, b, c, d, e, f


def r_squared(target: np.ndarray, predicted: np.ndarray) -> float:
    """1 - residual / total sum of squares; NaN if the target is constant."""
    total = float(np.sum((target - target.mean()) ** 2))
    return 1.0 - float(np.sum((target - predicted) ** 2)) / total if total > 0.0 else float("nan")


# --- training ---------------------------------------------------------------------------------------------------------

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
    """samples: at random, as in the paper; neighbours in time are then in both sets. runs: whole experiments."""


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


def import_torch() -> ModuleType:
    """torch, or an error of one line if it is not installed."""
    with installed_with("stewart-drake[train]", "everything but the training of the paper's network works without it"):
        import torch
    return torch


def train_network(
    dataset: Dataset, options: TrainingOptions | None = None, progress: Callable[[float], None] = lambda _: None
) -> TrainingResult:
    """Trains the tuner; the same data, options and torch give the same network, bit by bit."""
    torch, options = import_torch(), TrainingOptions() if options is None else options
    training = split_samples(dataset, options)
    target = np.log10(dataset.outputs)
    mean, scale = dataset.inputs[training].mean(axis=0), dataset.inputs[training].std(axis=0)
    scale = np.where(scale > 1e-9, scale, 1.0)
    # One thread and double precision give one order of summation, and so reproducible results.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        inputs = (dataset.inputs - mean) / scale
        (hidden, hidden_bias, output, output_bias), losses = _descend(
            torch, inputs, target, training, options, progress
        )
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
            # JSON has no NaN, the score of a constant target.
            "scores": {name: score if np.isfinite(score) else None for name, score in scores.items()},
            "data": {k: v for k, v in dataset.metadata.items() if k != "scenario"},
        }
    )
    return TrainingResult(network, losses[:, 0], losses[:, 1], scores)


def _descend(
    torch: ModuleType,
    inputs: np.ndarray,
    target: np.ndarray,
    training: np.ndarray,
    options: TrainingOptions,
    progress: Callable[[float], None],
) -> tuple[list[np.ndarray], np.ndarray]:
    """Weights and biases of both layers after training with Adam, and losses (epochs, 2) in training and validation."""
    generator = torch.Generator().manual_seed(options.seed)
    hidden = torch.nn.Linear(INPUTS, HIDDEN, dtype=torch.float64)
    output = torch.nn.Linear(HIDDEN, OUTPUTS, dtype=torch.float64)
    network = torch.nn.Sequential(hidden, torch.nn.Tanh(), output)
    with torch.no_grad():
        for layer in (hidden, output):
            bound = layer.in_features**-0.5
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.uniform_(-bound, bound, generator=generator)
    features, targets, mask = (torch.from_numpy(array) for array in (inputs, target, training))
    optimiser = torch.optim.Adam(network.parameters(), lr=options.learning_rate)
    losses = np.empty((options.epochs, 2))
    for epoch in range(options.epochs):
        optimiser.zero_grad()
        squared = (network(features) - targets) ** 2
        loss = squared[mask].mean()
        loss.backward()
        optimiser.step()
        losses[epoch] = loss.item(), squared[~mask].mean().item()
        if epoch % 50 == 49 or epoch == options.epochs - 1:
            progress(epoch + 1.0)
    return [layer.detach().numpy().copy() for layer in network.parameters()], losses
