"""An experiment: runs of scenarios, a table with a row per run, a page and figures."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Self, TypeVar

from pydantic import Field

from stewart_drake.base.atomic_files import locked_folder, write_atomically
from stewart_drake.base.code import anchored
from stewart_drake.base.config import NAME, NAME_WORDS, Section, Text, with_message
from stewart_drake.base.errors import ConfigurationError, StewartDrakeError
from stewart_drake.base.families import refuse_given, user_parts
from stewart_drake.base.markdown import TextTable, number
from stewart_drake.base.tables import to_csv, to_parquet
from stewart_drake.base.yaml_files import find_file, read_mapping
from stewart_drake.logs.metrics import Column, run_metrics
from stewart_drake.logs.outcomes import describe_outcome
from stewart_drake.logs.versions import collect_versions
from stewart_drake.scenario.scenario import Scenario, load_scenario
from stewart_drake.studies.runs import Measure, Row, RowStore, RunFunction, Trial, identity, measure_all, simulate
from stewart_drake.studies.workers import Workers

if TYPE_CHECKING:
    import pyarrow as pa
    from matplotlib.figure import Figure

T = TypeVar("T")
RowT = TypeVar("RowT", bound=Mapping[str, Any])
Keys = dict[Text, Any]  # Scenario key -> value.
StudyName = Annotated[Text, Field(max_length=80, pattern=NAME), with_message(f"at most 80 {NAME_WORDS}")]
Tables = Mapping[str, tuple[Sequence[Column], list[Row]]]
"""Name of a table -> its columns, and its rows, which may have further values."""
Figures = Mapping[str, Callable[[], "Figure"]]
"""Name of a figure -> function that draws it."""
RunTrials = Callable[[Sequence[Trial]], list[Row]]
"""See `RowStore.rows`."""
INCIDENTAL = (
    Column("wall_s", "s", "wall-clock time of the run: diagram, simulation, metrics"),
    Column("simulation_s", "s", "wall-clock time of the simulation alone"),
    Column("host", "", "name of the machine", "text"),
    Column("worker", "", "number of the worker process", "integer"),
)
MAX_REASONS = 5  # Reasons of refusals below a table.
COMPARED_FIGURES = ("rmse_norm_deg", "rmse_norm_mm", "torque_change_rms")


class StudyFile(Section):
    """Keys of both sweep and comparison files; paths in their values are absolute."""

    name: StudyName
    """Name of the study, for the output folder and titles."""
    scenario: Text
    """The scenario to change: a file, relative to this one, or the name of a shipped scenario."""
    set: Keys = Field(default_factory=dict)
    """Scenario key -> value, for every run."""

    @classmethod
    def read(cls, what: str, data: object, folder: Path | None, trust_code: bool) -> tuple[Self, Scenario]:
        """The keys, read from plain values, and the scenario with `set` applied; paths are relative to `folder`."""
        folder = Path() if folder is None else folder
        if not isinstance(data, Mapping):
            raise ConfigurationError(what, data, "a mapping of keys to values")
        given = cls.from_dict(anchored(data, folder))
        place = folder / given.scenario
        with error_prefix("scenario: "):
            # `Path.is_file` may raise.
            file = place if os.path.isfile(place) else given.scenario  # noqa: PTH113
            loaded = load_scenario(file, trust_code=trust_code)
        with error_prefix("set."):
            return given, with_changes(loaded, given.set, trust_code)


@dataclass(frozen=True, eq=False, kw_only=True)
class Experiment:
    """Runs of a scenario with some keys changed, and the tables and figures of their rows."""

    kind: str  # Name of the first table, and key of the metadata.
    name: str
    base: Scenario
    trials: Sequence[Trial]
    columns: Sequence[Column]
    work: Mapping[str, object]  # All that the rows depend on, in plain values.
    variants: Sequence[Scenario] = ()  # Scenarios that together name all weights files and user classes.

    @property
    def runs(self) -> int:
        return len(self.trials)

    def rows(self, run: RunTrials) -> list[Row]:
        return run(self.trials)

    def tables(self, rows: list[Row]) -> Tables:
        return {self.kind: (self.columns, rows)}

    def page(self, rows: Mapping[str, list[Row]]) -> str:  # noqa: ARG002
        """Markdown of the rows by table; empty for no page."""
        return ""

    def figures(self, rows: Mapping[str, list[Row]]) -> Figures:  # noqa: ARG002
        """Figures of the rows by table."""
        return {}

    def scenario(self, index: int) -> Scenario:
        """The scenario of run `index`; raises a ConfigurationError if its values are not valid."""
        return self.trials[index].scenario()

    def identity(self) -> dict[str, object]:
        """All that the rows depend on, see `identity`; loads the user's classes, so that a missing one shows early."""
        for part in {part.code: part for variant in self.variants for part in user_parts(variant)}.values():
            part.load()
        return identity(self.work, self.variants)

    def compared(self, rows: Sequence[Row]) -> str | None:
        """A line that compares the first completed run on a fast plant with Drake's; None without a fast plant."""
        kinds = {variant.plant.kind for variant in self.variants if variant.plant.compared_with}
        if not kinds:
            return None
        line = f"Plant: {', '.join(sorted(kinds))}"
        for trial, row in zip(self.trials, rows, strict=True):
            if row["status"] != "completed" or (other := trial.scenario().plant.compared_with) is None:
                continue
            try:
                log = trial.function(trial.scenario().replace({"plant.kind": other}))
            except StewartDrakeError as error:
                return f"{line}. Run {trial.key} does not run on {other}: {error}"
            figures, words = run_metrics(log), [describe_outcome(log.status, log.reason)]
            for name in COMPARED_FIGURES:
                if row.get(name) is not None and figures.get(name):
                    change = 100.0 * (row[name] / figures[name] - 1.0)
                    words.append(f"{name} {figures[name]:.3g} (here {change:+.2g} %)")
            return f"{line}. Run {trial.key} on {other}: {', '.join(words)}."
        return f"{line}; no run completed to compare."


class Result(NamedTuple):
    folder: Path
    rows: dict[str, list[Row]]
    tables: dict[str, pa.Table]
    compared: str | None = None


def run_experiment(
    experiment: Experiment,
    folder: Path,
    workers: Workers | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
) -> Result:
    """Does the missing runs of an experiment and writes its tables; `progress` gets the number of runs done."""
    with RowStore(folder, experiment.identity(), workers, progress, restart) as store:
        rows = experiment.rows(store.rows)
        compared = experiment.compared(rows)
        about = {"name": experiment.name, "runs": experiment.runs, **experiment.work}
        metadata = {experiment.kind: about, "versions": collect_versions(), "compared": compared}
        tables = experiment.tables(rows)
        arrow = {name: to_arrow(*table, experiment.kind, metadata) for name, table in tables.items()}
        result = Result(folder, {name: wide for name, (_, wide) in tables.items()}, arrow, compared)
        for name, table in arrow.items():
            if table.num_rows:
                write_atomically(folder / f"{name}.parquet", to_parquet(table))
                write_atomically(folder / f"{name}.csv", to_csv(table))
        if page := experiment.page(result.rows):
            text = page if compared is None else f"{page}\n{compared}\n"
            write_atomically(folder / f"{experiment.kind}.md", text.encode())
    return result


def write_figures(figures: Figures, folder: Path) -> bool:
    """Writes all figures as .png and .pdf; returns whether there are any."""
    # Here, because matplotlib takes a second to load.
    from stewart_drake.plotting import save_figure

    with locked_folder(folder):
        for name, draw in figures.items():
            figure = draw()
            for suffix in ("png", "pdf"):
                save_figure(figure, folder / f"{name}.{suffix}")
    return bool(figures)


def load_experiment(kind: str, path: str | Path, make: Callable[[dict[str, object], Path], T]) -> T:
    path = find_file(kind, path)
    return make(read_mapping(kind, path, 80), path.parent)


def trial_of(
    base: Mapping[str, object],
    index: int,
    name: str,
    changes: Mapping[str, object],
    labels: Mapping[str, object],
    measure: Measure = measure_all,
    function: RunFunction = simulate,
    trust_code: bool = False,
) -> Trial:
    """Run `index` of an experiment; its figures use every tick, whatever the scenario's `log_period`."""
    changes = {"name": name, **changes, "log_period": None}
    return Trial(str(index), base, changes, {"index": index, **labels}, measure, function, trust_code)


@contextmanager
def error_prefix(where: str) -> Iterator[None]:
    try:
        yield
    except ConfigurationError as error:
        raise error.within(where) from None


def with_changes(base: Scenario, changes: Mapping[str, object], trust_code: bool = False) -> Scenario:
    """A scenario with some keys changed; raises a ConfigurationError if it is invalid or has a part given in Python."""
    changed = base.replace(changes, trust_code)
    refuse_given(changed)
    return changed


# --- tables, for programs and for readers ---


def to_arrow(columns: Sequence[Column], rows: Iterable[Row], key: str, about: Mapping[str, object]) -> pa.Table:
    import pyarrow as pa

    types = {"number": pa.float64(), "integer": pa.int64(), "flag": pa.bool_()}
    fields = [
        pa.field(column.name, types.get(column.kind, pa.string()), metadata={"unit": column.unit, "text": column.text})
        for column in columns
    ]
    as_text = [column.name for column in columns if column.kind == "json"]
    plain = [{**row, **{name: json.dumps(row.get(name)) for name in as_text}} for row in rows]
    return pa.Table.from_pylist(plain, pa.schema(fields, metadata={f"stewart_drake.{key}": json.dumps(about)}))


def grouped(rows: Iterable[RowT], *columns: str) -> dict[tuple[Any, ...], list[RowT]]:
    """Rows by their values in some columns, in order of first appearance."""
    groups: dict[tuple[Any, ...], list[RowT]] = {}
    for row in rows:
        groups.setdefault(tuple(row[column] for column in columns), []).append(row)
    return groups


Show = Callable[[list[Row]], str]
"""Text of a cell for its rows."""


def pivot(
    title: str, rows: Sequence[Row], line: str, column: str, show: Show, more: Mapping[str, Show] | None = None
) -> TextTable:
    """Lines by the values of one column, cells by those of another; `more`: heading -> cell for the whole line."""
    cells, more = grouped(rows, line, column), more or {}
    values = [value for (value,) in grouped(rows, column)]
    lines = [
        (name, *(show(cells[name, value]) if (name, value) in cells else "-" for value in values))
        + tuple(show_line(group) for show_line in more.values())
        for (name,), group in grouped(rows, line).items()
    ]
    headings = [f"{value:g} Hz" if isinstance(value, float) else value for value in values]
    return TextTable(title, (line, *headings, *more), lines, refusals(rows))


def refusals(rows: Iterable[Row]) -> list[str]:
    """Why runs were refused or raised an error: at most `MAX_REASONS` lines; numbers do not distinguish reasons."""
    texts = [f"{row['status']}: {row['message']}" for row in rows if row["status"] in ("rejected", "raised")]
    reasons = [re.sub(r"-?\d[\d.]*(e[+-]\d+)?", "", text) for text in texts]
    counts = Counter(reasons).most_common(MAX_REASONS)
    lines = [f"{count} {' '.join(texts[reasons.index(reason)].split())}" for reason, count in counts]
    rest = len(texts) - sum(count for _, count in counts)
    return [*lines, f"{rest} more for other reasons: see the column `message`"] if rest else lines


def worst(rows: Iterable[Row], column: str) -> str:
    """The largest number in a column, or a dash if one is missing."""
    values: list[Any] = [row.get(column) for row in rows]
    return number(max(values, default=None) if None not in values else None)


def not_completed(rows: Iterable[Row]) -> int:
    return sum(row["status"] != "completed" for row in rows)
