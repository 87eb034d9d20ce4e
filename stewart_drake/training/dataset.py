"""The nine experiments of section III.D as one table of samples."""

from __future__ import annotations

import hashlib
import io
import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.feasibility import amplitude_table, largest_scale
from stewart_drake.files import write_atomically
from stewart_drake.references import SineBurstsReference
from stewart_drake.scenario import FixedTuner, Scenario

OMEGAS = (0.1, 1.0, 10.0)
"""Values of omega_Q and of omega_R; their nine pairs are the experiments."""
FREQUENCIES = (1.0, 2.0, 3.0, 4.0, 5.0)
"""[Hz] one burst each, in every experiment."""
PHASES = tuple(np.pi / 3.0 * k for k in range(6))
"""[rad] of the six axes: sixty degrees apart, so that they do not peak together."""
SHARE = 0.8
"""Share of the largest feasible amplitudes that is used: at the whole of it the weaker of the nine pairs overshoot into a
crank's dead centre."""
SAMPLES_PER_RUN = 1600
BURST = 1.6
"""[s] of each frequency: 320 samples of 5 ms."""

_INPUTS = tuple(f"density_{i}" for i in range(12))
_FORMAT_KEY = b"stewart_drake.dataset"
_VERSION = 1


@dataclass(frozen=True)
class Dataset:
    """Samples for the tuner.

    Attributes:
        inputs: (n, 12) [-] densities, six of the errors, six of the torques.
        outputs: (n, 2) omega_Q, omega_R that were in force.
        run: (n,) index of the experiment, 0 to 8.
        time: (n,) [s] within the experiment.
        metadata: How it was made: scenario, sample time, window, kind of density, amplitudes per frequency.
    """

    inputs: np.ndarray
    outputs: np.ndarray
    run: np.ndarray
    time: np.ndarray
    metadata: dict[str, Any] = field(default_factory=dict)

    def digest(self) -> str:
        """SHA-256 of the samples, for provenance."""
        content = hashlib.sha256()
        for array in (self.inputs, self.outputs, self.run, self.time):
            content.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return content.hexdigest()

    def save(self, path: str | Path) -> None:
        """Writes the samples as a Parquet file: time, run, density_0..11, omega_q, omega_r; metadata in its schema.

        Raises:
            ConfigurationError: The folder is missing or not writable.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {"time": self.time, "run": self.run}
        columns |= dict(zip(_INPUTS, self.inputs.T, strict=True))
        columns |= {"omega_q": self.outputs[:, 0], "omega_r": self.outputs[:, 1]}
        document = {"version": _VERSION, **self.metadata}
        table = pa.table(columns).replace_schema_metadata({_FORMAT_KEY: json.dumps(document).encode()})
        stream = io.BytesIO()
        pq.write_table(table, stream, compression="zstd")
        write_atomically(Path(path), stream.getvalue())


def load_dataset(path: str | Path) -> Dataset:
    """Reads a dataset.

    Raises:
        ConfigurationError: Missing file, another format or version, missing columns, numbers that are not finite, weights that are not
            positive, no samples.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    key = f"dataset {path}"
    try:
        table = pq.read_table(path)
    except OSError as error:
        raise ConfigurationError(key, error.strerror or str(error), "a readable file; `collect` makes one") from None
    except pa.ArrowException as error:
        raise ConfigurationError(key, " ".join(str(error).split()), "a Parquet file") from None
    document = json.loads((table.schema.metadata or {}).get(_FORMAT_KEY, b"{}"))
    if document.pop("version", None) != _VERSION:
        raise ConfigurationError(key, "another format", f"a dataset of version {_VERSION}, written by `collect`")
    columns = ("time", "run", *_INPUTS, "omega_q", "omega_r")
    missing = [name for name in columns if name not in table.column_names]
    if missing or not table.num_rows:
        raise ConfigurationError(key, f"{table.num_rows} rows, missing {missing}", "samples in all columns")
    try:
        data = {name: table.column(name).to_numpy().astype(float) for name in columns}
    except (TypeError, ValueError) as error:
        raise ConfigurationError(key, str(error), "columns of numbers") from None
    for name, values in data.items():
        if not np.isfinite(values).all() or (name.startswith("omega") and (values <= 0.0).any()):
            bad = int(np.flatnonzero(~np.isfinite(values) | (values <= 0.0))[0])
            raise ConfigurationError(f"{key}: {name}", f"{values[bad]} in row {bad}", "finite (weights: positive) numbers")
    return Dataset(
        np.stack([data[name] for name in _INPUTS], axis=-1),
        np.stack([data["omega_q"], data["omega_r"]], axis=-1),
        data["run"].astype(int),
        data["time"],
        document,
    )


def experiment_reference(base: Scenario) -> SineBurstsReference:
    """The motion of every experiment: 1 to 5 Hz on all six axes, as large as the limits of `base` allow.

    Deviation: the paper's pi/6 and 0.3 m at up to 5 Hz cannot be reached together (0.3 m at 5 Hz is 296 m/s^2). Each axis alone has
    a largest feasible amplitude per frequency; all six move at once with the largest common share of these, times `SHARE`.
    """
    alone = amplitude_table(base.robot, base.limits, np.array(FREQUENCIES), base.gravity)
    amplitudes = []
    for frequency, single in zip(FREQUENCIES, alone, strict=True):

        def burst(scale: float, frequency: float = frequency, single: np.ndarray = single) -> SineBurstsReference:
            return SineBurstsReference(
                frequency=(frequency,), amplitude=(_six(scale * single),), phase=_six(PHASES), burst_duration=BURST
            )

        scale = largest_scale(base.robot, base.limits, burst, BURST, base.gravity)
        amplitudes.append(_six(SHARE * scale * single))
    return SineBurstsReference(
        frequency=FREQUENCIES, amplitude=tuple(amplitudes), phase=_six(PHASES), burst_duration=BURST
    )


def collect_dataset(
    base: Scenario | None = None, progress: Callable[[float], None] | None = None, samples: int = SAMPLES_PER_RUN
) -> Dataset:
    """Runs the nine experiments in the Diagram and gathers their densities.

    Args:
        base: Robot, plant, controller, limits and density settings; None takes the defaults (gravity on, `feedforward:
            gravity`, 5 ms).
        progress: Called with the number of experiments done.
        samples: Samples per experiment.

    Raises:
        RunFailure: An experiment ended early; it says which.
    """
    from stewart_drake.simulation import run

    base = Scenario() if base is None else base
    tuner = base.tuner
    if isinstance(tuner, FixedTuner):
        raise ConfigurationError("tuner.kind", "fixed", "ann: its density and window settings are those of the data")
    reference = experiment_reference(base)
    period = base.controller.period
    inputs, outputs, runs, times = [], [], [], []
    for index, (omega_q, omega_r) in enumerate(itertools.product(OMEGAS, OMEGAS)):
        scenario = Scenario(
            name=f"experiment {index}",
            duration=samples * period,
            gravity=base.gravity,
            robot=base.robot,
            plant=base.plant,
            reference=reference,
            controller=base.controller,
            tuner=FixedTuner(omega_q=omega_q, omega_r=omega_r, density=tuner.density, window=tuner.window),
            limits=base.limits,
        )
        log = run(scenario)
        if log.status != "completed":
            raise RunFailure(
                f"experiment {index} (omega_Q {omega_q:g}, omega_R {omega_r:g}) ended at {log.end_time:.3f} s: {log.message}"
            )
        inputs.append(log["density"][:samples])
        outputs.append(np.broadcast_to([omega_q, omega_r], (samples, 2)))
        runs.append(np.full(samples, index))
        times.append(log.time[:samples])
        if progress is not None:
            progress(index + 1.0)
    metadata = {
        "sample_time": period,
        "density": tuner.density,
        "window": tuner.window,
        "frequency": list(FREQUENCIES),
        "amplitude": [list(row) for row in reference.amplitude],
        "phase": list(reference.phase),
        "gravity": base.gravity,
        "feedforward": base.controller.feedforward,
        "force_map": base.controller.force_map,
        "omegas": list(OMEGAS),
        "scenario": base.to_dict(),
    }
    return Dataset(np.concatenate(inputs), np.concatenate(outputs), np.concatenate(runs), np.concatenate(times), metadata)


def _six(values: Any) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = (float(v) for v in values)
    return a, b, c, d, e, f
