"""What every campaign is: runs of one scenario with some keys changed, each known by its index; and its tables."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

from pydantic import Field

from stewart_drake.campaigns.engine import Work, carry_out
from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.judge import verdict
from stewart_drake.campaigns.one_run import Measure, RunFunction, Task, empty_row, execute, measure, simulate
from stewart_drake.campaigns.row_store import RowStore
from stewart_drake.campaigns.tables import Row, to_arrow, write_table
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import refuse_given, user_parts
from stewart_drake.files.code_path import CodePath
from stewart_drake.files.named_files import anchored, code_named, file_digests
from stewart_drake.files.whole import checksum, write_atomically
from stewart_drake.logs.metric_table import Column, added_code, columns
from stewart_drake.logs.versions import collect_versions
from stewart_drake.registry import REGISTERED
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.section import NAME, NAME_WORDS, Section, Text

if TYPE_CHECKING:
    import pyarrow as pa

PlanName = Annotated[Text, Field(min_length=1, max_length=80, pattern=NAME), NAME_WORDS]

CODE = ("stewart-drake", "drake", "numpy", "scipy", "source")
"""Versions on which every number depends."""


class PlanFile(Section):
    """Keys that the files of sweeps and comparisons have; paths among them are absolute."""

    name: PlanName
    """Used for the output folder and titles."""
    scenario: Text
    """What is changed: a file, relative to this one, or the name of a shipped scenario."""
    set: dict[Text, Any] = Field(default_factory=dict)
    """Scenario key -> value, in every run."""

    @classmethod
    def read(cls, what: str, data: Any, folder: Path | None) -> tuple[Self, Scenario]:
        """The keys from plain values, as YAML gives them, and the scenario with `set` in it.

        Args:
            what: What it is a file of, for messages.
            data: Keys and values.
            folder: Paths in `data` are relative to it; None for the current folder.

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
class Plan(ABC):
    """Runs of one scenario with some keys changed, each known by its index.

    Attributes:
        base: The scenario, with everything fixed in it.
        runs: How many.
        name: For folders and titles.
    """

    kind: ClassVar[str]
    """Name of the first table, and key of what the tables' metadata say of the plan."""
    products: ClassVar[tuple[str, ...]]
    """Names of the files that are made of the rows."""

    base: Scenario
    runs: int = field(kw_only=True)
    name: str = field(kw_only=True)

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
        """The tables that rows of `one_run.execute` make, by name: columns, and flat rows."""

    def page(self, tables: Mapping[str, list[Row]]) -> str | None:  # noqa: ARG002
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

    def run_seed(self, index: int) -> int:  # noqa: ARG002 - here and below the same for all
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

    def work_item(self, index: int, function: RunFunction | None = None) -> Work:
        """Run `index` as a worker does it, `function` in place of `simulation`."""
        return execute, (function or self.simulation(index), self.task(index))

    def task(self, index: int) -> Task:
        """Run `index` in plain values."""
        drawn = self.draw(index)
        # Figures are those of every tick, whatever the scenario wants in a log.
        changes = {"name": self.run_name(index), **self.changes(drawn), "log_period": None}
        measured = self.measure(index)
        return Task(index, self.run_seed(index), self._base_values, changes, drawn, measured, self._trusted)

    @cached_property
    def code(self) -> list[CodePath]:
        """The user's code that the runs name, as it was when this was asked first: no row comes from another."""
        return code_named(self.work)

    @cached_property
    def _trusted(self) -> frozenset[str]:
        return frozenset(code.key for code in self.code if code.trusted)

    @cached_property
    def _base_values(self) -> dict[str, Any]:
        return self.base.to_dict()

    def scenario(self, index: int) -> Scenario:
        """The scenario of run `index`.

        Raises:
            ConfigurationError: Its values do not make one.
        """
        return vary(self.base, {"name": self.run_name(index), **self.changes(self.draw(index))})


@dataclass(frozen=True, eq=False)
class Made:
    """A table of a campaign.

    Attributes:
        table: One row a run, unit and text of each column in its metadata.
        rows: The same as plain values, with what else a row says.
        path: The Parquet file; a CSV file is beside it.
        engine: What Drake says of runs on the reduced engine, see `judge.verdict`; None where there are none.
    """

    table: pa.Table
    rows: list[Row]
    path: Path
    engine: str | None = None


def run_plan(
    plan: Plan,
    folder: Path,
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
    function: RunFunction | None = None,
) -> dict[str, Made]:
    """Runs what is missing of a plan and writes its tables.

    Every run becomes a row. One that takes its worker process with it is tried again alone, as are those that were
    under way beside it; after `executors.ATTEMPTS` times alone it is a row with status `crashed`.

    Args:
        plan: What to run.
        folder: For the tables, and for the rows as they come; a second call goes on where the first ended.
        where: Where the runs go; None for processes of this machine.
        progress: Called with the number of runs done.
        restart: Throw away what is in the folder.
        function: Simulates one scenario, in place of `plan.simulation`.

    Returns:
        The tables by name, those without rows left out.

    Raises:
        ConfigurationError: The folder holds another campaign, is in use or cannot be written to; a weights file or a
            class of the user's that cannot be read; a scheduler that cannot be reached.
        StewartDrakeError: There are no workers (any more); rows done are kept.
        KeyboardInterrupt: Rows done are kept.
    """
    versions, indices = collect_versions(), list(plan.indices)

    def crashed(index: int) -> Row:
        text = "its worker process died, also with this run alone in it: killed, out of memory, or a crash below Python"
        return empty_row(plan.task(index), "crashed", "worker_died", text)

    with RowStore(folder, identity_of(plan, versions), restart, plan.products) as store:
        kept = store.rows()
        rows = {index: kept[index] for index in indices if index in kept}

        def keep(index: int, row: Row) -> None:
            store.add(row)
            rows[index] = row
            tell()

        def tell() -> None:
            if progress is not None:
                progress(float(len(rows)))

        tell()
        missing = [index for index in indices if index not in rows]
        carry_out(missing, lambda index: plan.work_item(index, function), keep, where, crashed)
        engine = verdict(plan, rows, function)
        about = {plan.kind: plan.to_dict(), "versions": versions, **({} if engine is None else {"engine": engine})}
        made = {}
        for name, (fields, flat) in plan.tables([rows[index] for index in indices]).items():
            made[name] = Made(to_arrow(fields, flat, plan.kind, about), flat, folder / f"{name}.parquet", engine)
            if flat:
                write_table(made[name].table, folder, name)
        page = plan.page({name: each.rows for name, each in made.items()})
        if page is not None:
            said = page if engine is None else f"{page}\n{engine}\n"
            write_atomically(folder / f"{plan.kind}.md", said.encode())
    return made


def vary(base: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """A scenario with some keys changed, see `Scenario.replace`.

    Raises:
        ConfigurationError: The key does not exist, or what comes out is no scenario; a part of it was given in Python.
    """
    changed = base.replace(changes)
    refuse_given(changed)
    return changed


def identity(
    work: Mapping[str, Any],
    scenarios: Iterable[Scenario] = (),
    versions: Mapping[str, str | None] | None = None,
    more: Iterable[str] = (),
    code: Iterable[CodePath] | None = None,
) -> dict[str, Any]:
    """What results depend on, in plain values, so that kept ones are known again: the work, its files, the code.

    Args:
        work: What is computed, in plain values.
        scenarios: Of the work; of networks the weights count, and not what their file is called.
        versions: From `collect_versions`; None collects them.
        more: Names of versions beside `CODE`.
        code: See `file_digests`.

    Raises:
        ConfigurationError: A weights file cannot be read.
    """
    versions = collect_versions() if versions is None else versions
    texts = {text for scenario in scenarios if (text := scenario.tuner.content()) is not None}
    return {
        **work,
        "files": file_digests(work, code),
        "weights": sorted(hashlib.sha256(text.encode()).hexdigest()[:24] for text in texts),
        "columns": checksum([[asdict(column) for column in columns(*scenarios)], added_code()])[:8],
        "kinds": checksum([each.added_code() for each in REGISTERED])[:8],
        "versions": {name: versions[name] for name in (*CODE, *more)},
    }


def identity_of(plan: Plan, versions: Mapping[str, str | None]) -> dict[str, Any]:
    """What rows of `plan` depend on, in plain values; the user's classes are loaded: one that lacks shows early.

    Args:
        plan: Whose scenarios are run.
        versions: From `collect_versions`.

    Raises:
        ConfigurationError: A weights file, or a class, that cannot be read.
    """
    code, variants = plan.code, plan.variants()
    for part in {part.code: part for variant in variants for part in user_parts(variant)}.values():
        part.load()
    return identity(plan.work, variants, versions, code=code)
