"""The engine under every campaign: pieces of work on a few workers, each result kept as soon as it is there."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Generic, TypeVar

from stewart_drake.campaigns.executors import ATTEMPTS, Given, LocalProcesses, Workplace, worker_deaths
from stewart_drake.campaigns.row_store import Row, RowStore
from stewart_drake.errors import StewartDrakeError
from stewart_drake.logs import versions

K = TypeVar("K", bound=Hashable)
Work = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function of a module that the workers can import, and its arguments, in values that travel."""

CHECK_PERIOD = 2.0
"""[s] between looks at whether workers are left."""
WORKER_GONE = (
    "a worker process ended by itself: it was killed, or ran out of memory, or could not import the script that called,"
    ' which must be a file with the call under `if __name__ == "__main__":`'
)


def carry_out(
    keys: Iterable[K],
    work: Callable[[K], Work],
    keep: Callable[[K, Any], None],
    where: Workplace | Executor | None = None,
    crashed: Callable[[K], Any] | None = None,
) -> None:
    """Does pieces of work, each known by its key, in any order.

    One that takes its worker process with it is tried again alone, as are those that were under way beside it, up to
    `ATTEMPTS` times.

    Args:
        keys: What is to be done.
        work: What a key stands for.
        keep: Called in this process with each result as it comes.
        where: Where the work goes; None for processes of this machine.
        crashed: The result of work that kills its worker alone too; None ends the campaign.

    Raises:
        StewartDrakeError: There are no workers (any more), or they have another version of this package.
        KeyboardInterrupt: What is done has been kept.
        BaseException: Whatever a piece of work raises.
    """
    place = Given(where) if isinstance(where, Executor) else where or LocalProcesses()
    _Job(place, list(keys), work, keep, crashed).run()


def fill(
    store: RowStore,
    keys: Iterable[int],
    work: Callable[[int], Work],
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    crashed: Callable[[int], Row] | None = None,
) -> list[Row]:
    """Rows of `keys`, in order: those that a store has, and the others from `carry_out`; kept as they come.

    Args:
        store: Opened.
        keys: Index of each row.
        work: Makes a row.
        where: See `carry_out`.
        progress: Called with the number of rows that are there.
        crashed: See `carry_out`.

    Raises:
        ConfigurationError: The disk is full, or the like.
        BaseException: As `carry_out`.
    """
    keys, kept = list(keys), store.rows()
    rows = {key: kept[key] for key in keys if key in kept}

    def tell() -> None:
        if progress is not None:
            progress(float(len(rows)))

    def keep(key: int, row: Row) -> None:
        store.add(row)
        rows[key] = row
        tell()

    tell()
    carry_out([key for key in keys if key not in rows], work, keep, where, crashed)
    return [rows[key] for key in keys]


def warm_up(source: str) -> None:
    """Loads what a run needs, so that no run pays for it.

    Args:
        source: Digest of the package's source that a worker must have.

    Raises:
        StewartDrakeError: This worker's copy of the package is another one.
    """
    import stewart_drake.runs.simulation  # noqa: F401

    if _own_source() != source:
        raise StewartDrakeError(
            "a worker has another version of stewart-drake than this process: install the same everywhere, and leave "
            "its files alone while a campaign runs"
        )


@lru_cache(maxsize=1)
def _own_source() -> str:
    # Once a process: what is loaded does not change.
    return versions.source_digest()


@dataclass(frozen=True)
class _Raised:
    """What a piece of work raised, told apart from what befalls its executor."""

    error: BaseException


def _do(source: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """What a worker does."""
    warm_up(source)
    try:
        return function(*arguments)
    except (Exception, SystemExit) as error:
        return _Raised(error)


class _Job(Generic[K]):
    """One call of `carry_out`: who is under way, who is under suspicion."""

    def __init__(
        self,
        place: Workplace,
        keys: list[K],
        work: Callable[[K], Work],
        keep: Callable[[K, Any], None],
        crashed: Callable[[K], Any] | None,
    ) -> None:
        self._place, self._work, self._keep_result, self._crashed = place, work, keep, crashed
        self._source = str(versions.source_digest())
        self._waiting = deque(keys)
        self._suspects: deque[K] = deque()
        self._deaths: Counter[K] = Counter()
        self._kept: set[K] = set()
        self._under_way: dict[Future[Any], K] = {}

    def run(self) -> None:
        try:
            while self._waiting:
                self._with_workers(self._together)
            while self._suspects:
                self._with_workers(self._alone, 1)
        finally:
            self._place.leave()

    def _with_workers(self, work: Callable[[Executor], None], workers: int | None = None) -> None:
        executor = self._place.open(workers or len(self._waiting))
        abort = True
        try:
            self._warm_up(executor, workers or max(1, min(self._place.workers, len(self._waiting))))
            work(executor)
            abort = False
        except BaseException:
            # Ctrl-C can fall between the end of a run and its row.
            for future, key in self._under_way.items():
                if future.done() and not future.cancelled() and future.exception() is None:
                    with suppress(KeyboardInterrupt):  # of `progress`
                        if not isinstance(future.result(), _Raised):
                            self._keep(key, future.result())
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
                raise (StewartDrakeError(WORKER_GONE) if worker_deaths(error) else _broken(error)) from None

    def _together(self, executor: Executor) -> None:
        """Does all that wait, a few more at a time than there are workers, until done, worn, or a worker dies."""
        at_a_time = self._place.workers + (0 if self._place.workers == 1 else max(1, self._place.workers // 4))
        left = self._place.workers * self._place.worn if self._place.worn else len(self._waiting)
        died = False
        while self._under_way or (self._waiting and left and not died):
            try:
                while self._waiting and left and not died and len(self._under_way) < at_a_time:
                    self._submit(executor, self._waiting[0])
                    self._waiting.popleft()
                    left -= 1
            except BaseException as error:
                if not worker_deaths(error):
                    raise
                died = True
            if not self._under_way:
                return
            for future in self._wait(set(self._under_way)):
                key = self._under_way[future]
                if self._take(future, key):
                    # In company it is not known who did it.
                    self._suspects.append(key)
                    self._deaths[key] = 0
                    died = True
                del self._under_way[future]

    def _alone(self, executor: Executor) -> None:
        """Does the suspects one at a time, until done or a worker dies."""
        while self._suspects:
            key = self._suspects[0]
            future = self._submit(executor, key)
            self._wait({future})
            died = self._take(future, key)
            if died and self._deaths[key] < ATTEMPTS:
                return
            if died:
                if self._crashed is None:
                    raise StewartDrakeError(WORKER_GONE)
                self._keep(key, self._crashed(key))
            del self._under_way[future]
            self._suspects.popleft()
            if died:
                return

    def _submit(self, executor: Executor, key: K) -> Future[Any]:
        future = executor.submit(_do, self._source, *self._work(key))
        self._under_way[future] = key
        return future

    def _wait(self, futures: set[Future[Any]]) -> set[Future[Any]]:
        """Those of `futures` that are done, at least one."""
        while True:
            done, _ = wait(futures, CHECK_PERIOD, FIRST_COMPLETED)
            if done:
                return done
            self._place.check()

    def _take(self, future: Future[Any], key: K) -> bool:
        """Keeps what a future that is done holds; whether its worker died instead."""
        try:
            result = future.result()
        except (StewartDrakeError, KeyboardInterrupt):
            raise
        except BaseException as error:
            deaths = worker_deaths(error)
            if deaths:
                self._deaths[key] += deaths
                return True
            raise _broken(error) from error
        self._keep(key, result)
        return False

    def _keep(self, key: K, result: Any) -> None:
        if isinstance(result, _Raised):
            raise result.error
        if key not in self._kept:
            self._kept.add(key)
            self._keep_result(key, result)


def _broken(error: BaseException) -> StewartDrakeError:
    """What an executor raises of its own accord: no result, because no work is to blame."""
    if isinstance(error, CancelledError):
        text = "the executor cancelled a run: it was shut down, or its cluster is gone; rows done are kept"
        return StewartDrakeError(text)
    return StewartDrakeError(f"the executor failed: {type(error).__name__}: {' '.join(str(error).split())}")
