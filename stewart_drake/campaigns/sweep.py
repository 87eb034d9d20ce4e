"""Runs a sweep: what is missing goes to the workers, what comes back goes to the disk, and at the end into a table."""

from __future__ import annotations

import hashlib
from collections import Counter, deque
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from stewart_drake.campaigns.distributions import Choice
from stewart_drake.campaigns.executors import ATTEMPTS, Given, LocalProcesses, Workplace, worker_deaths
from stewart_drake.campaigns.one_run import (
    Measure,
    Row,
    RunFunction,
    Task,
    empty_row,
    execute,
    simulate,
    simulate_figures,
    warm_up,
)
from stewart_drake.campaigns.row_store import TABLES, RowStore
from stewart_drake.campaigns.run_store import weights_text
from stewart_drake.campaigns.sweep_file import Sweep, vary
from stewart_drake.campaigns.sweep_table import BEFORE, INCIDENTAL, sweep_table, varied_columns
from stewart_drake.campaigns.tables import VERSION, write_table
from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.files.named_files import file_digests
from stewart_drake.logs.metric_table import columns as run_columns
from stewart_drake.logs.versions import collect_versions
from stewart_drake.scenario import AnnTuner, Scenario

if TYPE_CHECKING:
    import pyarrow as pa

CHECK_PERIOD = 2.0
"""[s] between looks at whether workers are left."""


@dataclass(frozen=True, eq=False)
class SweepResult:
    """What a sweep leaves.

    Attributes:
        table: One row a run, sorted by index; see `table`.
        rows: The same as plain values.
        path: The Parquet file.
    """

    table: pa.Table
    rows: list[Row]
    path: Path


class Plan(Protocol):
    """Runs of one scenario with some keys changed, each known by its index."""

    @property
    def base(self) -> Scenario:
        """The scenario."""

    @property
    def runs(self) -> int:
        """How many."""

    def run_seed(self, index: int) -> int:
        """Seed of a run, for its row."""

    def run_name(self, index: int) -> str:
        """Name of its scenario."""

    def draw(self, index: int) -> Mapping[str, Any]:
        """`values` of its row."""

    def changes(self, drawn: Mapping[str, Any]) -> Mapping[str, Any]:
        """Scenario key -> value for what `draw` gave."""

    def measure(self, index: int) -> Measure | None:
        """What goes into its row; None for `one_run.measure`."""


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
    place: Workplace = Given(where) if isinstance(where, Executor) else where or LocalProcesses()
    rows = {index: row for index, row in store.rows().items() if index < plan.runs}
    _Job(plan, place, function, str(collect_versions()["source"]), store, rows, progress).run()
    return [rows[index] for index in range(plan.runs)]


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
    under way beside it; after `ATTEMPTS` times alone it is a row with status `crashed`.

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


class _Job:
    """One call of `run_plan`: who is under way, who is under suspicion."""

    def __init__(
        self,
        plan: Plan,
        place: Workplace,
        function: RunFunction,
        source: str,
        store: RowStore,
        rows: dict[int, Row],
        progress: Callable[[float], None] | None,
    ) -> None:
        self._plan, self._place, self._function, self._source = plan, place, function, source
        self._store, self._rows, self._progress = store, rows, progress
        self._base = plan.base.to_dict()
        self._waiting = deque(index for index in range(plan.runs) if index not in rows)
        self._suspects: deque[int] = deque()
        self._deaths: Counter[int] = Counter()
        self._attempts: Counter[int] = Counter()
        self._under_way: dict[Future[Row], int] = {}

    def run(self) -> None:
        self._tell()
        try:
            while self._waiting:
                self._with_workers(self._together)
            while self._suspects:
                self._with_workers(self._alone, 1)
        finally:
            self._place.leave()

    def _with_workers(self, work: Callable[[Executor], None], workers: int | None = None) -> None:
        executor = self._place.open(workers)
        abort = True
        try:
            self._warm_up(executor, workers or max(1, min(self._place.workers, len(self._waiting))))
            work(executor)
            abort = False
        except BaseException:
            # Ctrl-C can fall between the end of a run and its row.
            for future in self._under_way:
                if future.done() and not future.cancelled() and future.exception() is None:
                    with suppress(KeyboardInterrupt):  # of `progress`
                        self._keep(future.result())
                future.cancel()
            raise
        finally:
            self._under_way.clear()
            self._place.close(executor, abort)

    def _warm_up(self, executor: Executor, workers: int) -> None:
        # As many as there are workers: a pool starts one process a task.
        for future in [executor.submit(warm_up, self._source) for _ in range(workers)]:
            self._wait({future})
            try:
                future.result()
            except (StewartDrakeError, KeyboardInterrupt):
                raise
            except BaseException as error:
                if worker_deaths(error):
                    raise StewartDrakeError(
                        "a worker process cannot start: it was killed, or ran out of memory, or could not import the "
                        'script that called, which must be a file with the call under `if __name__ == "__main__":`'
                    ) from None
                raise _broken(error) from error

    def _together(self, executor: Executor) -> None:
        """Runs all that wait, a few more at a time than there are workers, until done or a worker dies."""
        at_a_time = self._place.workers + (0 if self._place.workers == 1 else max(1, self._place.workers // 4))
        died = False
        while self._under_way or (self._waiting and not died):
            try:
                while self._waiting and not died and len(self._under_way) < at_a_time:
                    future = self._submit(executor, self._waiting[0])
                    self._under_way[future] = self._waiting.popleft()
            except BaseException as error:
                if not worker_deaths(error):
                    raise
                died = True
            if not self._under_way:
                return
            for future in self._wait(set(self._under_way)):
                row = self._result(future)
                if row is None:
                    # In company it is not known who did it.
                    index = self._under_way[future]
                    self._suspects.append(index)
                    self._deaths[index] = 0
                    died = True
                else:
                    self._keep(row)
                del self._under_way[future]

    def _alone(self, executor: Executor) -> None:
        """Runs the suspects one at a time, until done or a worker dies."""
        while self._suspects:
            index = self._suspects[0]
            future = self._submit(executor, index)
            self._under_way[future] = index
            self._wait({future})
            row = self._result(future)
            died = row is None
            if died and self._deaths[index] < ATTEMPTS:
                return
            self._keep(row or self._crashed(index))
            del self._under_way[future]
            self._suspects.popleft()
            if died:
                return

    def _submit(self, executor: Executor, index: int) -> Future[Row]:
        self._attempts[index] += 1
        return executor.submit(execute, self._function, self._task(index))

    def _task(self, index: int) -> Task:
        drawn = self._plan.draw(index)
        # Figures are those of every tick, whatever the scenario wants in a log.
        changes = {"name": self._plan.run_name(index), **self._plan.changes(drawn), "log_period": None}
        seed, attempt = self._plan.run_seed(index), self._attempts[index]
        measure = self._plan.measure(index)
        return Task(index, seed, self._base, changes, drawn, self._source, attempt, measure)

    def _crashed(self, index: int) -> Row:
        text = "its worker process dies in it, alone too: killed, out of memory, or a crash in code below Python"
        return empty_row(self._task(index), "crashed", "worker_died", text)

    def _wait(self, futures: set[Future[Any]]) -> set[Future[Any]]:
        """Those of `futures` that are done, at least one."""
        while True:
            done, _ = wait(futures, CHECK_PERIOD, FIRST_COMPLETED)
            if done:
                return done
            self._place.check()

    def _result(self, future: Future[Row]) -> Row | None:
        """What a future that is done holds; None where its worker died."""
        try:
            return future.result()
        except (StewartDrakeError, KeyboardInterrupt):
            raise
        except BaseException as error:
            deaths = worker_deaths(error)
            if deaths:
                self._deaths[self._under_way[future]] += deaths
                return None
            raise _broken(error) from error

    def _keep(self, row: Row) -> None:
        if row["index"] not in self._rows:
            self._store.add(row)
            self._rows[row["index"]] = row
        self._tell()

    def _tell(self) -> None:
        if self._progress is not None:
            self._progress(float(len(self._rows)))


def _broken(error: BaseException) -> StewartDrakeError:
    """What an executor raises of its own accord: no row, because no run is to blame."""
    if isinstance(error, CancelledError):
        text = "the executor cancelled a run: it was shut down, or its cluster is gone; rows done are kept"
        return StewartDrakeError(text)
    return StewartDrakeError(f"the executor failed: {type(error).__name__}: {' '.join(str(error).split())}")


def _identity(sweep: Sweep, versions: Mapping[str, str | None]) -> dict[str, Any]:
    """What the rows of a sweep depend on; not how many there are."""
    data = sweep.to_dict()
    del data["runs"], data["name"], data["scenario"]["name"]
    tuners = [sweep.base.tuner]
    for key, distribution in sweep.distributions.items():
        if key.split(".")[0] == "tuner" and isinstance(distribution, Choice) and not distribution.factor:
            for value in distribution.values:
                try:
                    tuners.append(vary(sweep.base, {key: value}).tuner)
                except ConfigurationError:
                    continue  # a row says so
    texts = sorted({weights_text(tuner) for tuner in tuners if isinstance(tuner, AnnTuner)})
    return {
        **data,
        "columns": VERSION,
        "files": file_digests(data),
        "weights": [hashlib.sha256(text.encode()).hexdigest()[:24] for text in texts],
        "versions": {name: versions[name] for name in ("stewart-drake", "drake", "numpy", "scipy", "source")},
    }
