"""The tuner's training data as one table of samples in one Parquet file."""

from __future__ import annotations

import hashlib
import io
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import open_checked, write_atomically

_INPUTS = tuple(f"density_{i}" for i in range(12))
_KEY = b"stewart_drake.dataset"
_VERSION = 2
MAX_BYTES, MAX_ROWS = 500_000_000, 10_000_000


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
        """Writes the samples as a Parquet file: time, run, density_0..11, omega_q, omega_r; and the metadata."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {"time": self.time, "run": self.run} | dict(zip(_INPUTS, self.inputs.T, strict=True))
        columns |= {"omega_q": self.outputs[:, 0], "omega_r": self.outputs[:, 1]}
        about = json.dumps({"version": _VERSION, **self.metadata}, allow_nan=False)
        stream = io.BytesIO()
        pq.write_table(pa.table(columns).replace_schema_metadata({_KEY: about}), stream, compression="zstd")
        write_atomically(Path(path), stream.getvalue())


def load_dataset(path: str | Path) -> Dataset:
    """Reads a dataset.

    Raises:
        ConfigurationError: Missing, too large or unreadable; another version, missing columns, numbers that are not
            finite, weights that are not positive, runs that are no whole numbers, no samples.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    key, names = f"dataset {path}", ("time", "run", *_INPUTS, "omega_q", "omega_r")
    with open_checked(path, key, MAX_BYTES, "a file from `collect`") as stream:
        try:
            file = pq.ParquetFile(stream)
            about = json.loads((file.metadata.metadata or {}).get(_KEY, b"{}"))
            version = about.pop("version", None)
            if version != _VERSION or file.metadata.num_rows > MAX_ROWS:
                given = f"version {version}, {file.metadata.num_rows} rows"
                raise ConfigurationError(key, given, f"a dataset of version {_VERSION}, written by `collect`")
            table = file.read(list(names))
            data = {name: table[name].to_numpy().astype(float) for name in names}
        except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError, pa.ArrowException) as error:
            raise ConfigurationError(key, " ".join(str(error).split()), "a file from `collect` that is whole") from None
    if not len(table):
        raise ConfigurationError(key, "no rows", "samples")
    for name, values in data.items():
        unusable = ~np.isfinite(values) | (name.startswith("omega") & (values <= 0.0))
        if name == "run":
            unusable |= ~((values >= 0.0) & (values < 2.0**53) & (values == np.floor(values)))
        if unusable.any():
            bad = int(unusable.argmax())
            allowed = "finite numbers; weights positive, runs counted from 0"
            raise ConfigurationError(f"{key}: {name}", f"{values[bad]} in row {bad}", allowed)
    inputs = np.stack([data[name] for name in _INPUTS], axis=-1)
    return Dataset(
        inputs, np.stack([data["omega_q"], data["omega_r"]], axis=-1), data["run"].astype(int), data["time"], about
    )
