"""The engine under every campaign: pieces of work on a few workers, each result kept as soon as it is there."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Generic, TypeVar

from stewart_drake.campaigns.executors import ATTEMPTS, Workplace, worker_deaths, workplace
from stewart_drake.errors import StewartDrakeError
from stewart_drake.logs import versions
from stewart_drake.logs.metric_table import METRICS

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
    _Job(workplace(where), list(keys), work, keep, crashed).run()


def warm_up(source: str, metrics: Iterable[str] = ()) -> None:
    """Loads what a run needs, so that no run pays for it.

    Args:
        source: Digest of the package's source that a worker must have.
        metrics: Names of the metrics that it must have.

    Raises:
        StewartDrakeError: This worker's copy of the package is another one, or lacks a metric.
    """
    import stewart_drake.runs.simulation  # noqa: F401

    if _own_source() != source:
        raise StewartDrakeError(
            "a worker has another version of stewart-drake than this process: install the same everywhere, and leave "
            "its files alone while a campaign runs"
        )
    missing = set(metrics) - {metric.name for metric in METRICS}
    if missing:
        raise StewartDrakeError(
            f"a worker does not have the metric {min(missing)}: `add_metric` must be called in a module that it imports"
            ' too, or in the script that called, outside of `if __name__ == "__main__":`'
        )


@lru_cache(maxsize=1)
def _own_source() -> str:
    # Once a process: what is loaded does not change.
    return versions.source_digest()


@dataclass(frozen=True)
class _Raised:
    """What a piece of work raised, told apart from what befalls its executor."""

    error: BaseException


@dataclass(frozen=True)
class _Died:
    """In place of a result: the worker died, so many times."""

    times: int


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
        self._source, self._metrics = str(versions.source_digest()), [metric.name for metric in METRICS]
        self._waiting = deque(keys)
        self._suspects: deque[K] = deque()
        self._deaths: Counter[K] = Counter()
        self._kept: set[K] = set()
        self._under_way: dict[Future[Any], K] = {}

    def run(self) -> None:
        try:
            while self._waiting:
                self._with_workers(self._waiting)
            while self._suspects:
                self._with_workers(self._suspects, alone=True)
        finally:
            self._place.leave()

    def _with_workers(self, queue: deque[K], alone: bool = False) -> None:
        """Works through a queue until it is empty, the workers are worn, or one of them dies."""
        executor = self._place.open(1 if alone else len(queue))
        abort = True
        try:
            # As many as there are workers: a pool starts one process a task.
            workers = 1 if alone else max(1, min(self._place.workers, len(queue)))
            for future in [executor.submit(warm_up, self._source, self._metrics) for _ in range(workers)]:
                self._wait({future})
                if isinstance(_result(future), _Died):
                    raise StewartDrakeError(WORKER_GONE)
            self._work_through(executor, queue, alone)
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

    def _work_through(self, executor: Executor, queue: deque[K], alone: bool) -> None:
        workers = self._place.workers
        # A few more than there are workers, so that none of these waits.
        most = 1 if alone or workers == 1 else workers + max(1, workers // 4)
        left = workers * self._place.worn if self._place.worn else len(queue)
        while True:
            while queue and left and len(self._under_way) < most:
                try:
                    future = executor.submit(_do, self._source, *self._work(queue[0]))
                except BrokenExecutor:
                    left = 0
                    break
                self._under_way[future] = queue.popleft()
                left -= 1
            if not self._under_way:
                return
            for future in self._wait(set(self._under_way)):
                key, result = self._under_way[future], _result(future)
                if isinstance(result, _Died):
                    left = 0
                    self._accuse(key, result.times if alone else 0)
                else:
                    self._keep(key, result)
                del self._under_way[future]

    def _accuse(self, key: K, times: int) -> None:
        """Decides on what was under way as a worker died; in company, 0 times, it is not known who did it."""
        self._deaths[key] += times
        if self._deaths[key] < ATTEMPTS:
            self._suspects.append(key)
        elif self._crashed is None:
            raise StewartDrakeError(WORKER_GONE)
        else:
            self._keep(key, self._crashed(key))

    def _wait(self, futures: set[Future[Any]]) -> set[Future[Any]]:
        """Those of `futures` that are done, at least one."""
        while True:
            done, _ = wait(futures, CHECK_PERIOD, FIRST_COMPLETED)
            if done:
                return done
            self._place.check()

    def _keep(self, key: K, result: Any) -> None:
        if isinstance(result, _Raised):
            raise result.error
        if key not in self._kept:
            self._kept.add(key)
            self._keep_result(key, result)


def _result(future: Future[Any]) -> Any:
    """What a future that is done holds.

    Raises:
        StewartDrakeError: Its executor failed of its own accord: no result, because no work is to blame.
        KeyboardInterrupt: It was interrupted.
    """
    try:
        return future.result()
    except (StewartDrakeError, KeyboardInterrupt):
        raise
    except CancelledError:
        text = "the executor cancelled a run: it was shut down, or its cluster is gone; rows done are kept"
        raise StewartDrakeError(text) from None
    except BaseException as error:
        if times := worker_deaths(error):
            return _Died(times)
        text = f"the executor failed: {type(error).__name__}: {' '.join(str(error).split())}"
        raise StewartDrakeError(text) from error
