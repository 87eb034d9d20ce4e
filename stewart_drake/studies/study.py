"""What every study is: runs of one scenario with some keys changed, each known by its index; and its tables."""

from __future__ import annotations

import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, Self, TypeVar

from pydantic import Field

from stewart_drake.config import NAME, NAME_WORDS, Section, Text, words
from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.families import given_keys, refuse_given, user_parts
from stewart_drake.files.code import anchored, code_is_trusted, trusting_code
from stewart_drake.files.tables import to_csv, to_parquet
from stewart_drake.files.whole import write_atomically
from stewart_drake.files.yaml_files import find_file, read_mapping
from stewart_drake.logs.metrics import Column, run_metrics
from stewart_drake.logs.outcomes import told
from stewart_drake.logs.versions import collect_versions
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.studies.runs import KeptRuns, Row, Task, identity
from stewart_drake.studies.workers import Workers

if TYPE_CHECKING:
    import pyarrow as pa

T = TypeVar("T")
StudyName = Annotated[Text, Field(max_length=80, pattern=NAME), words(f"at most 80 {NAME_WORDS}")]
Tables = Mapping[str, tuple[Sequence[Column], list[Row]]]
"""Name of a table -> its columns, and its rows, which may say more."""
INCIDENTAL = (
    Column("wall_s", "s", "wall-clock time of the run: diagram, simulation, metrics"),
    Column("simulation_s", "s", "wall-clock time of the simulation alone"),
    Column("host", "", "name of the machine", "text"),
    Column("worker", "", "number of the worker process", "whole"),
)
COMPARED = ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")
SMALLEST = 1e-5  # What is smaller is not written out


class StudyFile(Section):
    """Keys that the files of sweeps and comparisons have; paths among them are absolute."""

    name: StudyName
    """Name of the study, for the output folder and titles."""
    scenario: Text
    """The scenario to change: a file, relative to this one, or the name of a shipped scenario."""
    set: dict[Text, Any] = Field(default_factory=dict)
    """Scenario key -> value, for every run."""

    @classmethod
    def read(cls, what: str, data: Any, folder: Path | None) -> tuple[Self, Scenario]:
        """The keys from plain values, and the scenario with `set` in it; paths are relative to `folder`."""
        folder = Path() if folder is None else folder
        if not isinstance(data, Mapping):
            raise ConfigurationError(what, data, "a mapping of keys to values")
        given = cls.from_dict(anchored(data, folder))
        place = folder / given.scenario
        with within("scenario: "):
            # Unlike `Path.is_file` this never raises, whatever stands in the way.
            loaded = load_scenario(place if os.path.isfile(place) else given.scenario)  # noqa: PTH113
        with within("set."):
            return given, vary(loaded, given.set)


@dataclass(frozen=True, eq=False)
class Study(ABC):
    """Runs of one scenario with some keys changed, each known by its index."""

    kind: ClassVar[str]
    """Name of the first table, and key of what the tables' metadata say of the study."""

    base: Scenario
    name: str = field(kw_only=True)
    indices: Sequence[int] = field(kw_only=True)
    trust_code: bool = field(kw_only=True, default_factory=code_is_trusted)
    """Whether code that it names beside `base` may run."""

    @abstractmethod
    def task(self, index: int) -> Task: ...

    @property
    @abstractmethod
    def work(self) -> dict[str, Any]:
        """What the rows depend on, in plain values."""

    @abstractmethod
    def tables(self, rows: Sequence[Row]) -> Tables: ...

    def page(self, rows: Mapping[str, list[Row]]) -> str:  # noqa: ARG002
        return ""

    @property
    def variants(self) -> list[Scenario]:
        """Scenarios that together name every weights file and every class of the user's in the runs."""
        return [self.base]

    @property
    def runs(self) -> int:
        return len(self.indices)

    def scenario(self, index: int) -> Scenario:
        """The scenario of run `index`; ConfigurationError where its values do not make one."""
        return self.vary(self.task(index).changes)

    def vary(self, changes: Mapping[str, Any]) -> Scenario:
        with trusting_code(self.trust_code):
            return vary(self.base, changes)

    def _task(self, index: int, changes: Mapping[str, Any], seed: int = 0, **more: Any) -> Task:
        """Run `index` with some keys changed; figures are those of every tick, whatever the scenario wants in a log."""
        changes = {"name": f"{self.name} {index}", **changes, "log_period": None}
        return Task(index, seed, self._base, changes, trust_code=self.trust_code, **more)

    @cached_property
    def _base(self) -> dict[str, Any]:
        values: dict[str, Any] = given_keys(self.base)
        return values

    def identity(self) -> dict[str, Any]:
        """What kept rows are known by; the user's classes are loaded: one that lacks shows early."""
        for part in {part.code: part for variant in self.variants for part in user_parts(variant)}.values():
            part.load()
        return identity(self.work, self.variants)


class StudyResult(NamedTuple):
    folder: Path
    rows: dict[str, list[Row]]
    tables: dict[str, pa.Table]
    engine: str | None = None


def run_study(
    study: Study,
    folder: Path,
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
) -> StudyResult:
    """Runs what is missing of a study and writes its tables; `progress` gets the number of runs done."""
    with KeptRuns(folder, study.identity(), workers, progress, restart) as kept:
        rows = kept.rows(study.indices, study.task)
        engine = compare_engines(study, rows)
        about = {"name": study.name, "runs": study.runs, **study.work}
        metadata = {study.kind: about, "versions": collect_versions(), "engine": engine}
        tables = study.tables(rows)
        arrow = {name: to_arrow(*table, study.kind, metadata) for name, table in tables.items()}
        result = StudyResult(folder, {name: wide for name, (_, wide) in tables.items()}, arrow, engine)
        for name, table in arrow.items():
            if table.num_rows:
                write_table(table, folder, name)
        if page := study.page(result.rows):
            text = page if engine is None else f"{page}\n{engine}\n"
            write_atomically(folder / f"{study.kind}.md", text.encode())
    return result


def compare_engines(study: Study, rows: Iterable[Row]) -> str | None:
    """A line on runs on the reduced engine: the first completed one again, on Drake's plant; None without such runs."""
    if not any(variant.plant.engine == "reduced" for variant in study.variants):
        return None
    line = "Engine: reduced, the exact closed form of the robot in place of Drake's plant"
    for row in (each for each in rows if each["status"] == "completed"):
        index, scenario = row["index"], study.scenario(row["index"])
        if scenario.plant.engine != "reduced":
            continue
        try:
            log = study.task(index).function(scenario.replace({"plant.engine": "drake"}))
        except StewartDrakeError as error:
            return f"{line}. Run {index} does not run on Drake: {error}"
        drake, words = run_metrics(log), [told(log.status, log.reason)]
        for name in COMPARED:
            if row.get(name) is not None and drake.get(name):
                words.append(f"{name} {drake[name]:.3g} (here {100.0 * (row[name] / drake[name] - 1.0):+.2g} %)")
        return f"{line}. Run {index} on Drake: {', '.join(words)}."
    return f"{line}; no run completed to compare."


def load_study(kind: str, path: str | Path, make: Callable[[dict[str, Any], Path], T]) -> T:
    """Code that the file names runs where it is loaded within `trusting_code`."""
    path = find_file(kind, path)
    return make(read_mapping(kind, path, 80), path.parent)


@contextmanager
def within(where: str) -> Iterator[None]:
    try:
        yield
    except ConfigurationError as error:
        raise error.within(where) from None


def vary(base: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """A scenario with some keys changed; ConfigurationError where none results, or with a part given in Python."""
    changed = base.replace(changes)
    refuse_given(changed)
    return changed


# --- tables, for programs and for readers ---


def to_arrow(
    columns: Sequence[Column], rows: Iterable[Mapping[str, Any]], key: str, about: Mapping[str, Any]
) -> pa.Table:
    import pyarrow as pa

    types = {"number": pa.float64(), "whole": pa.int64(), "flag": pa.bool_(), "text": pa.string(), "json": pa.string()}
    fields = [
        pa.field(each.name, types[each.kind], metadata={"unit": each.unit, "text": each.text}) for each in columns
    ]
    as_text = [column.name for column in columns if column.kind == "json"]
    plain = [{**row, **{name: json.dumps(row.get(name)) for name in as_text}} for row in rows]
    return pa.Table.from_pylist(plain, pa.schema(fields, metadata={f"stewart_drake.{key}": json.dumps(about)}))


def write_table(table: pa.Table, folder: Path, name: str) -> None:
    write_atomically(folder / f"{name}.parquet", to_parquet(table))
    write_atomically(folder / f"{name}.csv", to_csv(table))


class Sheet(NamedTuple):
    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        return "\n".join([f"**{self.title}**", "", *markdown(self.header, self.rows)]) + "\n"


def markdown(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(each)} |" for each in (header, ["---"] * len(header), *rows)]


def number(value: float | None) -> str:
    """Three significant digits, without an exponent."""
    if value is None:
        return "-"
    if 0.0 < abs(value) < SMALLEST:
        return f"<{SMALLEST:.5f}"
    return format(Decimal(f"{value:.2e}"), "f")
