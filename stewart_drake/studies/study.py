"""What every study is: runs of one scenario with some keys changed, each known by its index; and its tables."""

from __future__ import annotations

import dataclasses
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field

from stewart_drake.config import NAME, NAME_WORDS, Section, Text
from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.families import given_again, refuse_given, user_parts
from stewart_drake.files.code import anchored, code_is_trusted, trusting_code
from stewart_drake.files.tables import to_csv, to_parquet
from stewart_drake.files.whole import NOT_FINITE, write_atomically
from stewart_drake.logs.metric_table import Column
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.logs.outcomes import told
from stewart_drake.logs.versions import collect_versions
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.studies.runs import KeptRuns, Measure, Row, RunFunction, Task, identity, measure, simulate
from stewart_drake.studies.workers import Workers

if TYPE_CHECKING:
    import pyarrow as pa

StudyName = Annotated[Text, Field(min_length=1, max_length=80, pattern=NAME), NAME_WORDS]
INCIDENTAL = (
    Column("wall_s", "s", "wall-clock time of the run in its worker: diagram, simulation, metrics"),
    Column("simulation_s", "s", "of that, the simulation alone"),
    Column("host", "", "machine that the run was on", "text"),
    Column("worker", "", "process that the run was in", "whole"),
)
"""Last columns of a sweep: the only ones that depend on where and when it ran."""
COMPARED = ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")
"""Metrics in which Drake is set beside the reduced engine."""


class StudyFile(Section):
    """Keys that the files of sweeps and comparisons have; paths among them are absolute."""

    name: StudyName
    """Used for the output folder and titles."""
    scenario: Text
    """What is changed: a file, relative to this one, or the name of a shipped scenario."""
    set: dict[Text, Any] = Field(default_factory=dict)
    """Scenario key -> value, in every run."""

    @classmethod
    def read(cls, what: str, data: Any, folder: Path | None) -> tuple[Self, Scenario]:
        """The keys from plain values, and the scenario with `set` in it; paths are relative to `folder`.

        Raises:
            ConfigurationError: Names the key, the value and what is allowed.
        """
        folder = Path() if folder is None else folder
        if not isinstance(data, Mapping):
            raise ConfigurationError(what, data, "a mapping of keys to values")
        given = cls.from_dict(anchored(data, folder))
        relative = folder / given.scenario
        try:
            found = relative.is_file()
        except OSError:
            found = False
        try:
            loaded = load_scenario(relative if found else given.scenario)
        except ConfigurationError as error:
            raise error.within("scenario: ") from None
        try:
            return given, vary(loaded, given.set)
        except ConfigurationError as error:
            raise error.within("set.") from None


@dataclass(frozen=True, eq=False)
class Study(ABC):
    """Runs of one scenario with some keys changed, each known by its index.

    Attributes:
        base: The scenario, with everything fixed in it.
        runs: How many.
        name: For folders and titles.
        trust_code: Whether code that it names beside `base` may run.
    """

    kind: ClassVar[str]
    """Name of the first table, and key of what the tables' metadata say of the study."""
    products: ClassVar[tuple[str, ...]]
    """Names of the files that are made of the rows."""

    base: Scenario
    runs: int = field(kw_only=True)
    name: str = field(kw_only=True)
    trust_code: bool = field(kw_only=True, default_factory=code_is_trusted)

    @abstractmethod
    def draw(self, index: int) -> dict[str, Any]:
        """What tells run `index` from the others; `values` of its row."""

    @abstractmethod
    def changes(self, drawn: Mapping[str, Any]) -> Mapping[str, Any]:
        """Scenario key -> value for what `draw` gave."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """All of it in plain types."""

    @abstractmethod
    def tables(self, rows: Sequence[Row]) -> dict[str, tuple[Sequence[Column], list[Row]]]:
        """The tables that rows make, by name: columns, and flat rows."""

    def page(self, tables: Mapping[str, list[Row]]) -> str | None:  # noqa: ARG002 - here and below the same for all
        """What is read, as Markdown, given the flat rows of `tables`; None for nothing."""
        return None

    @property
    def work(self) -> Mapping[str, Any]:
        """What of `to_dict` the rows depend on."""
        return self.to_dict()

    @property
    def indices(self) -> Iterable[int]:
        """Of the runs."""
        return range(self.runs)

    def run_seed(self, index: int) -> int:  # noqa: ARG002
        """Seed of run `index`, below 2^63."""
        return 0

    def measure(self, index: int) -> Measure:  # noqa: ARG002
        """What goes into the row of run `index`."""
        return measure

    def simulation(self, index: int) -> RunFunction:  # noqa: ARG002
        """What simulates run `index`."""
        return simulate

    def variants(self) -> list[Scenario]:
        """Scenarios that together name every weights file and every class of the user's in the runs."""
        return [self.base]

    def run_name(self, index: int) -> str:
        """Name of the scenario of run `index`."""
        return f"{self.name} {index}"

    def task(self, index: int) -> Task:
        """Run `index` in plain values."""
        drawn = self.draw(index)
        # Figures are those of every tick, whatever the scenario wants in a log.
        changes = {"name": self.run_name(index), **self.changes(drawn), "log_period": None}
        how = self.measure(index), self.simulation(index), self.trust_code
        return Task(index, self.run_seed(index), self._base_values, changes, drawn, *how)

    def scenario(self, index: int) -> Scenario:
        """The scenario of run `index`; ConfigurationError where its values do not make one."""
        return self.vary({"name": self.run_name(index), **self.changes(self.draw(index))})

    def vary(self, changes: Mapping[str, Any]) -> Scenario:
        """See `vary`, of the scenario of all runs."""
        with trusting_code(self.trust_code):
            return vary(self.base, changes)

    @cached_property
    def _base_values(self) -> dict[str, Any]:
        values: dict[str, Any] = given_again(self.base)
        return values

    def identity(self, versions: Mapping[str, str | None]) -> dict[str, Any]:
        """What the rows depend on; the user's classes are loaded: one that lacks shows early.

        Raises:
            ConfigurationError: A weights file, or a class, that cannot be read; code that is not trusted.
        """
        variants = self.variants()
        for part in {part.code: part for variant in variants for part in user_parts(variant)}.values():
            part.load()
        return identity(self.work, variants, versions)


@dataclass(frozen=True, eq=False)
class StudyTable:
    """A table of a study.

    Attributes:
        table: One row a run, unit and text of each column in its metadata.
        rows: The same as plain values, with what else a row says.
        path: The Parquet file; a CSV file is beside it.
        engine: What Drake says of runs on the reduced engine, see `drake_beside`; None where there are none.
    """

    table: pa.Table
    rows: list[Row]
    path: Path
    engine: str | None = None


def run_study(
    study: Study,
    folder: Path,
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
    function: RunFunction | None = None,
) -> dict[str, StudyTable]:
    """Runs what is missing of a study and writes its tables; every run becomes a row.

    Args:
        study: What to run.
        folder: For the tables, and for the rows as they come; a second call goes on where the first ended.
        workers: Where the runs go; None for processes of this machine.
        progress: Called with the number of runs done.
        restart: Throw away what is in the folder.
        function: Simulates one scenario, in place of `study.simulation`.

    Returns:
        The tables by name.

    Raises:
        ConfigurationError: The folder holds another study, is in use or cannot be written to; a weights file or a
            class of the user's that cannot be read.
        StewartDrakeError: There are no workers (any more); rows done are kept.
        KeyboardInterrupt: Rows done are kept.
    """
    versions, indices = collect_versions(), list(study.indices)

    def task(index: int) -> Task:
        made = study.task(index)
        return made if function is None else dataclasses.replace(made, function=function)

    with KeptRuns(folder, study.identity(versions), workers, progress, restart, study.products) as kept:
        rows = kept.rows(indices, task)
        engine = drake_beside(study, dict(zip(indices, rows, strict=True)), function)
        about = {study.kind: study.to_dict(), "versions": versions, **({} if engine is None else {"engine": engine})}
        made = {}
        for name, (fields, wide) in study.tables(rows).items():
            made[name] = StudyTable(to_arrow(fields, wide, study.kind, about), wide, folder / f"{name}.parquet", engine)
            if wide:
                write_table(made[name].table, folder, name)
        page = study.page({name: each.rows for name, each in made.items()})
        if page is not None:
            text = page if engine is None else f"{page}\n{engine}\n"
            write_atomically(folder / f"{study.kind}.md", text.encode())
    return made


def vary(base: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """A scenario with some keys changed; ConfigurationError where none comes out, or with a part given in Python."""
    changed = base.replace(changes)
    refuse_given(changed)
    return changed


def drake_beside(study: Study, rows: Mapping[int, Row], function: RunFunction | None = None) -> str | None:
    """A line on runs on the reduced engine: the first completed one again, on Drake's plant; None without such runs."""
    if not any(variant.plant.engine == "reduced" for variant in study.variants()):
        return None
    line = "Engine: reduced, the exact closed form of the robot in place of Drake's plant"
    for index, row in rows.items():
        scenario = study.scenario(index) if row["status"] == "completed" else None
        if scenario is None or scenario.plant.engine != "reduced":
            continue
        try:
            log = (function or study.simulation(index))(scenario.replace({"plant.engine": "drake"}))
        except StewartDrakeError as error:
            return f"{line}. Run {index} does not run on Drake: {error}"
        drake, found = run_metrics(log), [told(log.status, log.reason)]
        for name in COMPARED:
            mine, other = row.get(name), drake.get(name)
            if isinstance(mine, float) and isinstance(other, float) and other != 0.0:
                found.append(f"{name} {other:.3g} (here {100.0 * (mine / other - 1.0):+.2g} %)")
        return f"{line}. Run {index} on Drake: {', '.join(found)}."
    return line + "; no run completed to compare."


def flat(row: Row, **more: Any) -> Row:
    """A row with further columns, and with what of it is no finite number as a text."""
    named = ", ".join(f"{name} {value}" for name, value in row.get(NOT_FINITE, {}).items() if "." not in name)
    return {**row, **more, NOT_FINITE: named or None}


def to_arrow(
    columns: Sequence[Column], rows: Iterable[Mapping[str, Any]], key: str, about: Mapping[str, Any]
) -> pa.Table:
    """A table with unit and text of each column; `about` stands as `stewart_drake.KEY` in its metadata."""
    import pyarrow as pa

    types = {"number": pa.float64(), "whole": pa.int64(), "flag": pa.bool_(), "text": pa.string(), "json": pa.string()}
    fields, arrays, rows = [], [], list(rows)
    for column in columns:
        values = [row.get(column.name) for row in rows]
        if column.kind == "json":
            values = [json.dumps(value) for value in values]
        elif column.kind == "number":
            values = [None if value is None else float(value) for value in values]
        metadata = {"unit": column.unit, "text": column.text}
        fields.append(pa.field(column.name, types[column.kind], metadata=metadata))
        arrays.append(pa.array(values, type=types[column.kind]))
    text = json.dumps(about)
    return pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata={f"stewart_drake.{key}": text}))


def write_table(table: pa.Table, folder: Path, name: str) -> None:
    """Writes NAME.parquet and NAME.csv."""
    write_atomically(folder / f"{name}.parquet", to_parquet(table))
    write_atomically(folder / f"{name}.csv", to_csv(table))


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table as GitHub shows it."""
    return [f"| {' | '.join(each)} |" for each in (header, ["---"] * len(header), *rows)]
