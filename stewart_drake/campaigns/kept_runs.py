"""Runs of a search, each kept in a folder as it comes: one that is there already is not run again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from stewart_drake.campaigns.engine import Work, carry_out
from stewart_drake.campaigns.executors import Lasting, Workplace, workplace
from stewart_drake.campaigns.one_run import RunFunction, Task, empty_row, execute
from stewart_drake.campaigns.row_store import RowStore
from stewart_drake.campaigns.tables import Row


class KeptRuns:
    """Runs, known by their index and what is drawn for them. A context manager: the folder is this process's alone.

    Args:
        folder: For the rows.
        identity: See `RowStore`.
        where: Where the runs go; None for processes of this machine.
        tell: Called with the number of runs done.
        restart: Throw away what is in the folder.
        products: See `RowStore`.

    Raises:
        ConfigurationError: See `RowStore`.
    """

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
        where: Workplace | Executor | None = None,
        tell: Callable[[float], None] | None = None,
        restart: bool = False,
        products: Sequence[str] = (),
    ) -> None:
        self._store, self._place = RowStore(folder, identity, restart, products), Lasting(workplace(where))
        self._tell = tell or (lambda _: None)
        self._open = ExitStack()
        self._kept: dict[int, Row] = {}
        self._done = 0

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(self._store)
            opened.enter_context(self._place)
            self._kept = self._store.rows()
            self._open = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.__exit__(kind, error, trace)

    def rows(self, tasks: Sequence[Task], function: Callable[[Task], RunFunction]) -> list[Row]:
        """A row for each task, see `one_run.execute`; what is missing is run by its function.

        Raises:
            ConfigurationError: A file of a scenario that cannot be used.
            StewartDrakeError: There are no workers (any more); rows done are kept.
            KeyboardInterrupt: Rows done are kept.
        """
        missing = {
            task.index: task for task in tasks if self._kept.get(task.index, {}).get("values") != dict(task.drawn)
        }
        self._progress(len(tasks) - len(missing))

        def work(index: int) -> Work:
            return execute, (function(missing[index]), missing[index])

        def crashed(index: int) -> Row:
            return empty_row(missing[index], "crashed", "worker_died", "its worker process died, also with it alone")

        carry_out(missing, work, self._keep, self._place, crashed)
        return [self._kept[task.index] for task in tasks]

    def _keep(self, index: int, row: Row) -> None:
        self._store.add(row)
        self._kept[index] = row
        self._progress(1)

    def _progress(self, more: int) -> None:
        self._done += more
        self._tell(float(self._done))
