"""The log of one run: named signals with units and frames, in memory and as a Parquet, CSV, MCAP or MATLAB file."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stewart_drake.base import tables
from stewart_drake.base.atomic_files import Document, write_atomically
from stewart_drake.base.errors import ConfigurationError, installed_with
from stewart_drake.base.keys import join_or
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.logs.journal import JOURNAL, cut_off
from stewart_drake.logs.outcomes import MissingSignal, RunRows, Status, describe_outcome, is_measured
from stewart_drake.logs.signals import SCALES, SIGNALS
from stewart_drake.scenario.scenario import Scenario

if TYPE_CHECKING:
    import pyarrow as pa

MAX_ROWS = 2_000_000
"""Largest number of rows of a run: with 140 numbers in a row 2.2 GB of memory, and 33 minutes at steps of 1 ms."""

Report = Document  # Named values as in JSON.
_VERSION = 4  # Version of the file format.
_MAX_BYTES = 10**10  # Largest size of a file.


def _columns(name: str, state_names: tuple[str, ...]) -> list[tuple[str, str]]:
    """Names and units of the columns of a signal."""
    spec = SIGNALS[name]
    if name == "plant_state":
        return [(f"{name}_{entry}", _state_unit(entry)) for entry in state_names]
    names = [f"{name}_{component}" for component in spec.components] or [name]
    return list(zip(names, spec.units, strict=True))


def _state_unit(name: str) -> str:
    """Unit of an entry of the plant's state, from the name that Drake gives it."""
    joint, _, quantity = name.rpartition("_")
    if joint == "platform" and quantity[0] != "w":
        return "1" if quantity[0] == "q" else "m/s" if quantity[0] == "v" else "m"
    return "rad/s" if quantity[0] == "w" else "rad"


@dataclass(frozen=True, eq=False, repr=False)
class SimulationLog(Mapping[str, np.ndarray]):
    """Signals of one run by name, `log["pose"]`, and how it ended.

    Attributes:
        scenario: Scenario of the run.
        signals: Name -> array, (n,) for time and (n, k) for the rest, see `SIGNALS`.
        state_names: Names of the columns of `plant_state`.
        status: See `outcomes.OUTCOMES`.
        reason: Name of the reason, or None.
        message: The reason in one line, or None.
        outcome_time: [s] time of the reason, or None.
        end_time: [s] simulated time reached.
        leg: Leg 0..5 of the reason, or None.
        warnings: See `outcomes.find_warnings`.
        safety: monitor, level, time [s], leg, cause of the first trip of the safety layer, and worst level; or None.
        wall_time: [s] duration of the simulation.
        versions: Versions of the packages.
        files: Path of a file that the scenario names -> sha256, None if unreadable.
        figures: The metrics, from all ticks and steps of the run, also those without a row; None if not computed.
            Metrics that are not finite are None and named in `not_finite`.
    """

    scenario: Scenario
    signals: Mapping[str, np.ndarray]
    state_names: tuple[str, ...] = ()
    status: Status = "completed"
    reason: str | None = None
    message: str | None = None
    outcome_time: float | None = None
    end_time: float = 0.0
    leg: int | None = None
    warnings: tuple[Report, ...] = ()
    safety: Report | None = None
    wall_time: float = 0.0
    versions: Mapping[str, str | None] = field(default_factory=dict)
    files: Mapping[str, str | None] = field(default_factory=dict)
    figures: Report | None = None

    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.signals)

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.signals:
            raise MissingSignal(name, self.signals)
        return self.signals[name]

    @property
    def reached_end(self) -> bool:
        """Whether the controller was in charge for the whole duration, its motion followed or lost."""
        return self.status in ("completed", "lost")

    @property
    def learns(self) -> bool:
        """Whether an adaptive law logs what it learns, and is not frozen."""
        logged = {"learnt", "learnt_half_width"} <= self.signals.keys()
        return logged and not getattr(self.scenario.adaptation, "frozen", False)

    @cached_property
    def rows(self) -> RunRows:
        """Rows of this log for the computation of metrics and outcome."""
        return RunRows(self.scenario, self.signals)

    @property
    def time(self) -> np.ndarray:
        """(n,) [s] times of the rows."""
        return self.signals["time"]

    @property
    def error(self) -> np.ndarray:
        """(n, 6) [rad, m] true pose minus reference; NaN if nothing was measured."""
        error = self.rows.error
        return error if is_measured(self.signals) else np.full_like(error, np.nan)

    @property
    def error_norms(self) -> tuple[np.ndarray, np.ndarray]:
        """Norms of the (roll, pitch, yaw) error (n,) [deg] and of the position error (n,) [mm]."""
        rotation, position = np.linalg.norm((SCALES * self.error).reshape(-1, 2, 3), axis=2).T
        return rotation, position

    @property
    def second_half(self) -> np.ndarray:
        """(n,) mask of the rows in the second half of the planned duration."""
        return self.rows.second_half

    def outcome(self) -> Document:
        """Attributes besides scenario and signals, as JSON values."""
        return {name: getattr(self, name) for name in _OUTCOME} | {"warnings": list(self.warnings)}

    def table(self) -> pa.Table:
        """The signals as an Arrow table, with unit and text in each field's metadata."""
        import pyarrow as pa

        arrays, named = [], []
        for signal, values in self.signals.items():
            columns = _columns(signal, self.state_names)
            for column, (name, unit) in zip(np.atleast_2d(values.T), columns, strict=True):
                about = {"unit": unit, "text": SIGNALS[signal].text}
                # pa.array would import pandas, which is slow.
                data = pa.py_buffer(np.ascontiguousarray(column))
                arrays.append(pa.Array.from_buffers(pa.float64(), len(column), [None, data]))
                named.append(pa.field(tables.column_name(name, unit), pa.float64(), nullable=False, metadata=about))
        return pa.Table.from_arrays(arrays, schema=pa.schema(named))

    def __repr__(self) -> str:
        tick, time = self.scenario.controller.period, self.signals.get("time", np.empty(0))
        row = f", every {np.median(np.diff(time)):.4g} s" if len(time) > 1 else ""
        # Only controllers with densities use the tuner.
        tuner = f", tuner {self.scenario.tuner.kind}" if "density" in self.signals else ""
        when = self.end_time if self.outcome_time is None else self.outcome_time
        lines = [
            f"SimulationLog of {self.scenario.name}: {describe_outcome(self.status, self.reason, when)}",
            *([] if self.message is None else [f"  {self.message.splitlines()[0]}"]),
            f"  controller {self.scenario.controller.kind}{tuner}, a tick every {tick:g} s",
            *(f"  {note}" for note in [getattr(self.scenario.reference, "note", "")] if note),
            f"  {len(time)} rows{row}",
            f"  signals: {', '.join(self.signals)}",
            f"  warnings: {', '.join(warning['name'] for warning in self.warnings) or 'none'}",
        ]
        return "\n".join(lines)

    def to_pandas(self) -> Any:
        """The signals as a pandas.DataFrame, a column per component."""
        with installed_with("pandas", "table() gives the same as an Arrow table"):
            import pandas  # noqa: F401 - used by pyarrow
        return self.table().to_pandas()

    def to_parquet(self) -> bytes:
        about = {"version": _VERSION, "scenario": self.scenario.to_dict(), "outcome": self.outcome()}
        return tables.to_parquet(tables.with_about(self.table(), "run", about))

    def to_csv(self) -> bytes:
        """The signals as CSV."""
        return tables.to_csv(self.table())

    def to_mcap(self) -> bytes:
        """Signals, poses and a scene, see `mcap_file`."""
        from stewart_drake.logs.mcap_file import to_mcap

        return to_mcap(self)

    def to_mat(self) -> bytes:
        """A MATLAB file: signals (n, k) by name, `units` and `columns` (structs of cells), scenario and outcome."""
        from scipy.io import savemat

        columns, units = dict[str, np.ndarray](), dict[str, np.ndarray]()
        for name in self.signals:
            columns[name], units[name] = np.array(_columns(name, self.state_names), object).T
        texts = {"scenario": to_yaml(self.scenario.to_dict()), "status": self.status, "reason": self.reason or ""}
        savemat(file := BytesIO(), {**self.signals, "columns": columns, "units": units, **texts}, oned_as="column")
        return file.getvalue()

    def save(self, path: str | Path) -> None:
        """Writes the log to a file, .parquet, .csv, .mat for MATLAB and Octave, or .mcap for Foxglove and Rerun.

        Raises:
            ConfigurationError: Another ending; the folder is missing or not writable.
        """
        formats = {".parquet": self.to_parquet, ".csv": self.to_csv, ".mcap": self.to_mcap, ".mat": self.to_mat}
        ending = Path(path).suffix
        if ending not in formats:
            raise ConfigurationError("log file", str(path), f"a name that ends in {join_or(list(formats))}")
        write_atomically(Path(path), formats[ending]())


_SIGNALS = ("scenario", "signals", "state_names")
_OUTCOME = tuple(entry.name for entry in fields(SimulationLog) if entry.name not in _SIGNALS)


def distinct_names(logs: Sequence[SimulationLog], places: Sequence[object] = ()) -> list[str]:
    """Names of the logs' scenarios; equal names are replaced by the `places` of the logs, or get numbers."""
    names = [log.scenario.name for log in logs]
    names = [str(place) if names.count(name) > 1 else name for name, place in zip(names, places or names, strict=True)]
    return [
        name if names.count(name) == 1 else f"{name} ({names[: index + 1].count(name)})"
        for index, name in enumerate(names)
    ]


def load_log(path: str | Path, scenario: Scenario | None = None) -> SimulationLog:
    """Reads a log, or a results folder, written by `SimulationLog.save` or by the commands `run` and `drive`.

    The log of a killed `drive` ends with its last row, with the reason `cut_off`.

    Args:
        path: File or folder.
        scenario: Scenario of a CSV file, which contains none; None takes the default one.

    Raises:
        ConfigurationError: The file is missing, no log of this package, or damaged.
    """
    # `Path.is_dir` may raise.
    if os.path.isdir(path):  # noqa: PTH112
        folder, path = Path(path), Path(path) / "log.parquet"
        if not path.exists() and (folder / JOURNAL).exists():
            return SimulationLog(**cut_off(folder / JOURNAL))
    path = Path(path)
    key = f"log {path}"
    if path.suffix == ".csv":
        signals, state_names = _read_signals(path, key)
        end = float(signals["time"][-1]) if len(signals["time"]) else 0.0
        message = "read from a CSV file, which does not say how the run ended"
        if scenario is None:
            message += ", nor which scenario it was: the default one is taken"
            scenario = Scenario(name=path.stem, duration=end or 1.0)
        return SimulationLog(scenario, signals, state_names, status="unknown", message=message, end_time=end)
    about = tables.parquet_about(path, key, "run", _MAX_BYTES, "this version of the package")
    if about.get("version") != _VERSION:
        raise ConfigurationError(key, f"version {about.get('version')}", f"version {_VERSION}")
    outcome = about["outcome"] | {"warnings": tuple(about["outcome"]["warnings"])}
    try:
        scenario = Scenario.from_dict(about["scenario"])
    except ConfigurationError as error:
        raise error.within(f"{key}: ") from None
    return SimulationLog(scenario, *_read_signals(path, key), **outcome)


def _read_signals(path: Path, key: str) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Signals of a table by name, and the names of the plant's states."""

    def states_in(names: Iterable[str]) -> tuple[str, ...]:
        return tuple(name.removeprefix("plant_state_") for name in names if name.startswith("plant_state_"))

    def choose(names: list[str]) -> dict[str, tuple[str, float]]:
        quantities = dict.fromkeys(tables.quantity_of(name)[0] for name in names)
        known = [column for signal in SIGNALS for column in _columns(signal, states_in(quantities))]
        given = {name.lower() for name in quantities}
        return {name: tables.column_of(names, name, unit, key) for name, unit in known if name.lower() in given}

    columns = tables.read_columns(path, key, choose, _MAX_BYTES, MAX_ROWS + 1)
    state_names = states_in(columns)
    signals: dict[str, np.ndarray] = {}
    for signal in SIGNALS:
        names = [name for name, _ in _columns(signal, state_names)]
        missing = [name for name in names if name not in columns]
        if names and not missing:
            signals[signal] = columns[signal] if names == [signal] else np.stack([columns[n] for n in names], axis=-1)
        elif signal == "time" or len(missing) < len(names):
            raise ConfigurationError(key, f"no column of {missing[0]}", "all columns of a signal, and time")
    tables.refuse_back(key, signals["time"])
    return signals, state_names
