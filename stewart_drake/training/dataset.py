"""The tuner's training data as one table of samples in one file."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.config import Window, check_value
from stewart_drake.control.network import DensityKind
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.tables import parquet_about, read_columns, to_parquet, with_about
from stewart_drake.files.whole import write_atomically

_INPUTS = tuple(f"density_{i}" for i in range(12))
_VERSION = 2
MAX_BYTES = 500_000_000
MAX_ROWS = 10_000_000


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
        """Writes the samples as a Parquet file: time, run, density_0..11, omega_q, omega_r; and metadata.

        Raises:
            ConfigurationError: The folder is missing or not writable.
            ValueError, TypeError: The metadata are no plain values with finite numbers.
        """
        import pyarrow as pa

        columns = {"time": self.time, "run": self.run}
        columns |= dict(zip(_INPUTS, self.inputs.T, strict=True))
        columns |= {"omega_q": self.outputs[:, 0], "omega_r": self.outputs[:, 1]}
        about = {"version": _VERSION, **self.metadata}
        write_atomically(Path(path), to_parquet(with_about(pa.table(columns), "dataset", about)))


def load_dataset(path: str | Path) -> Dataset:
    """Reads a dataset.

    Raises:
        ConfigurationError: Missing, unreadable or another file; another version, missing
            columns, numbers that are not finite, weights that are not positive, runs that are no whole numbers, a kind
            of density or a window that no network can have, no samples.
    """
    key = f"dataset {path}"
    document = parquet_about(path, key, "dataset", MAX_BYTES, "`collect`")
    table = read_columns(path, key, lambda names: {name: (name, 1.0) for name in names}, MAX_BYTES, MAX_ROWS)
    version = document.pop("version", None)
    if version != _VERSION:
        found = "another format" if version is None else f"version {version}"
        raise ConfigurationError(key, found, f"a dataset of version {_VERSION}, written by `collect`")
    for name, default, kind in (("density", "magnitude", DensityKind), ("window", 1, Window)):
        try:
            check_value(name, document.get(name, default), kind)
        except ConfigurationError as error:
            raise error.within(f"{key}: ") from None
    columns = ("time", "run", *_INPUTS, "omega_q", "omega_r")
    missing = [name for name in columns if name not in table]
    rows = len(next(iter(table.values()), ()))
    if missing or not rows:
        raise ConfigurationError(key, f"{rows} rows, missing {missing}", "samples in all columns")
    try:
        data = {name: table[name].astype(float) for name in columns}
    except (TypeError, ValueError) as error:
        raise ConfigurationError(key, str(error), "columns of numbers") from None
    for name, values in data.items():
        unusable = ~np.isfinite(values) | (name.startswith("omega") & (values <= 0.0))
        if name == "run":
            unusable |= ~((values >= 0.0) & (values < 2.0**53) & (values == np.floor(values)))
        if unusable.any():
            bad = int(unusable.argmax())
            raise ConfigurationError(
                f"{key}: {name}", f"{values[bad]} in row {bad}", "finite numbers; weights positive, runs counted from 0"
            )
    return Dataset(
        np.stack([data[name] for name in _INPUTS], axis=-1),
        np.stack([data["omega_q"], data["omega_r"]], axis=-1),
        data["run"].astype(int),
        data["time"],
        document,
    )
