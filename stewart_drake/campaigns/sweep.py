"""Runs a sweep: what is missing goes to the workers, what comes back goes to the disk, and at the end into a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stewart_drake.campaigns.distributions import Choice
from stewart_drake.campaigns.engine import Work, fill
from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.identity import identity
from stewart_drake.campaigns.one_run import RunFunction, Task, empty_row, execute, simulate, simulate_figures
from stewart_drake.campaigns.plan import Plan, vary
from stewart_drake.campaigns.row_store import TABLES, Row, RowStore
from stewart_drake.campaigns.sweep_file import Sweep
from stewart_drake.campaigns.sweep_table import BEFORE, INCIDENTAL, sweep_table, varied_columns
from stewart_drake.campaigns.tables import write_table
from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.metric_table import columns as run_columns
from stewart_drake.logs.versions import collect_versions

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True, eq=False)
class SweepResult:
    """What a sweep leaves.

    Attributes:
        table: One row a run, sorted by index; see `sweep_table`.
        rows: The same as plain values.
        path: The Parquet file.
    """

    table: pa.Table
    rows: list[Row]
    path: Path


def run_plan(
    plan: Plan,
    store: RowStore,
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    function: RunFunction = simulate,
) -> list[Row]:
    """Runs what `store` lacks of a plan, as `run_sweep` does.

    Args:
        plan: What to run.
        store: Opened; gets every row as it comes.
        where: Where the runs go; None for processes of this machine.
        progress: Called with the number of runs done.
        function: Simulates one scenario.

    Returns:
        A row for every run, in order.

    Raises:
        StewartDrakeError: There are no workers (any more); rows done are kept.
        KeyboardInterrupt: Rows done are kept.
    """
    base = plan.base.to_dict()

    def task(index: int) -> Task:
        drawn = plan.draw(index)
        # Figures are those of every tick, whatever the scenario wants in a log.
        changes = {"name": plan.run_name(index), **plan.changes(drawn), "log_period": None}
        return Task(index, plan.run_seed(index), base, changes, drawn, plan.measure(index))

    def work(index: int) -> Work:
        return execute, (function, task(index))

    def crashed(index: int) -> Row:
        text = "its worker process dies in it, alone too: killed, out of memory, or a crash in code below Python"
        return empty_row(task(index), "crashed", "worker_died", text)

    return fill(store, range(plan.runs), work, where, progress, crashed)


def run_sweep(
    sweep: Sweep,
    folder: Path,
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
    function: RunFunction = simulate_figures,
) -> SweepResult:
    """Runs what is missing of a sweep and writes its table.

    Every run becomes a row. One that takes its worker process with it is tried again alone, as are those that were
    under way beside it; after `executors.ATTEMPTS` times alone it is a row with status `crashed`.

    Args:
        sweep: What to run.
        folder: For `sweep.parquet`, and for the rows as they come; a second call goes on where the first ended.
        where: Where the runs go; None for processes of this machine.
        progress: Called with the number of runs done.
        restart: Throw away what is in the folder.
        function: Simulates one scenario; for tests.

    Raises:
        ConfigurationError: The folder holds another sweep, is in use or cannot be written to; a weights file that
            cannot be read; a scheduler that cannot be reached.
        StewartDrakeError: There are no workers (any more); rows done are kept.
        KeyboardInterrupt: Rows done are kept.
    """
    fixed = {column.name for column in (*BEFORE, *run_columns(), *INCIDENTAL)}
    for column in varied_columns(sweep):
        if column.name in fixed:
            allowed = "a key that is no column of the table already"
            raise ConfigurationError(f"distributions.{column.name}", column.name, allowed)
    versions = collect_versions()
    with RowStore(folder, _identity(sweep, versions), restart) as store:
        rows = run_plan(sweep, store, where, progress, function)
        table = sweep_table(sweep, rows, versions)
        write_table(table, folder, "sweep")
    return SweepResult(table, rows, folder / TABLES[0])


def _identity(sweep: Sweep, versions: Mapping[str, str | None]) -> dict[str, Any]:
    """What the rows of a sweep depend on; not how many there are."""
    data = sweep.to_dict()
    del data["runs"], data["name"], data["scenario"]["name"]
    tuners = [sweep.base.tuner]
    for key, distribution in sweep.distributions.items():
        if key.split(".")[0] == "tuner" and isinstance(distribution, Choice) and not distribution.factor:
            for value in distribution.values:
                with suppress(ConfigurationError):  # a row says so
                    tuners.append(vary(sweep.base, {key: value}).tuner)
    return identity(data, tuners, versions)
