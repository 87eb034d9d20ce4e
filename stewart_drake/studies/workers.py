"""Where the runs of a study go: processes of this machine (loky's), a Dask cluster, or this very process."""

from __future__ import annotations

import logging
import math
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import AbstractContextManager, ExitStack
from functools import lru_cache
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.backend import resource_tracker as loky_tracker

from stewart_drake.base.errors import ConfigurationError, StewartDrakeError, installed_with, quiet_libraries
from stewart_drake.logs import versions

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")
Work = tuple[Callable[..., Any], tuple[Any, ...]]

CONNECT_TIMEOUT = 20.0  # [s] that a Dask scheduler has to answer, and its first worker to come
IDLE_TIMEOUT = 3600.0  # [s] after which a process without work ends; loky may lose work that comes just then
WORN = 200  # Runs after which a process is replaced: each leaves some tenths of a megabyte behind in Drake
WORKER_GONE = (
    "a worker process ended by itself: it was killed, or ran out of memory, or could not import the script that called,"
    ' which must be a file with the call under `if __name__ == "__main__":`'
)
DEAD = "its worker process died twice, the second time with this run alone in it: killed, out of memory, or a crash"
_WITHOUT_STDERR = ExitStack()
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Of a worker: with more, those of several workers would be in each other's way."""


class Workers(AbstractContextManager["Workers"]):
    """Processes of this machine, which import the calling script, or a Dask cluster. A context manager.

    `count` processes, None for one per core, at most 8, 0 for this very process, each replaced after `worn` runs.
    """

    def __init__(self, count: int | None = None, scheduler: str | None = None, worn: int | None = WORN) -> None:
        self.count = max(1, min(8, os.cpu_count() or 1)) if count is None else count
        self._client = None
        if scheduler is not None:
            self._client, worn = _connected(scheduler), None
            self.count = max(1, sum(self._client.nthreads().values()))
        self._life = self.left = math.inf if worn is None else self.count * worn

    def __exit__(self, *_: object) -> None:
        if self._client is not None:
            self._client.close()

    def executor(self) -> Executor:
        if self._client is not None:
            client: Executor = self._client.get_executor(pure=False, retries=0)
            return client
        # What is started now takes no module of the current folder for Python's own.
        os.environ["PYTHONSAFEPATH"] = "1"
        return get_reusable_executor(
            self.count,
            context="loky_init_main",
            env=_ONE_THREAD,
            timeout=IDLE_TIMEOUT,
            initializer=start_worker,
            initargs=(os.getpid(),),
        )

    def replace(self) -> None:
        """Ends the processes; the next run starts others."""
        if self._client is None:
            get_reusable_executor().shutdown(wait=True, kill_workers=True)
        self.left = self._life


def run_jobs(
    keys: Iterable[K],
    work: Callable[[K], Work],
    keep: Callable[[K, Any], None],
    workers: Workers | None = None,
    died: Callable[[K], Any] | None = None,
) -> None:
    """Does the work of each key, in any order; `keep` gets each result in this process as it comes.

    Where a worker process dies, the work that was under way is done again, one piece at a time; `died` gives the result
    of work whose process dies twice. Without it that is an error.
    """
    workers = workers or Workers()
    if workers.count == 0:
        for key in keys:
            function, arguments = work(key)
            keep(key, function(*arguments))
        return
    waiting, suspects = deque(keys), list[K]()
    while waiting:
        suspects += _work_off(waiting, work, keep, workers)
        # Where no process starts at all, no work is to blame.
        nothing: deque[int] = deque([0] if suspects else [])
        if _work_off(nothing, lambda _: (int, ()), lambda *_: None, workers):
            raise StewartDrakeError(WORKER_GONE)
    for key in suspects:
        if _work_off(deque([key]), work, keep, workers):
            if died is None:
                raise StewartDrakeError(WORKER_GONE)
            keep(key, died(key))


def run_all(
    function: Callable[..., T],
    arguments: Sequence[tuple[Any, ...]],
    workers: Workers | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> list[T]:
    """What a function gives for each of some arguments, in their order; `progress` gets the number done."""
    results: dict[int, T] = {}

    def keep(index: int, result: T) -> None:
        results[index] = result
        progress(float(len(results)))

    run_jobs(range(len(arguments)), lambda index: (function, arguments[index]), keep, workers)
    return [results[index] for index in range(len(arguments))]


def _work_off(
    waiting: deque[K], work: Callable[[K], Work], keep: Callable[[K, Any], None], workers: Workers
) -> list[K]:
    """Takes work from `waiting` until there is none, a process dies, or all are worn; what a death has left undone."""
    source, executor, died = str(versions.source_digest()), workers.executor(), False
    pending: dict[Future[Any], K] = {}
    try:
        while not died and (pending or (waiting and workers.left > 0)):
            while waiting and workers.left > 0 and len(pending) <= workers.count:
                future = _submit(executor, _checked, source, *work(waiting[0]))
                pending[future] = waiting.popleft()
                workers.left -= 1
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                error = future.exception()
                if isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":  # the latter Dask's
                    died = True
                elif error is not None:
                    raise error
                else:
                    keep(pending.pop(future), future.result())
    except BrokenExecutor:
        pass  # It broke between two pieces of work.
    except BaseException as error:
        for future in pending:
            future.cancel()
        workers.replace()
        if isinstance(error, CancelledError):
            raise StewartDrakeError("the Dask cluster is gone; finished rows are kept") from error
        raise
    for future in pending:
        # Dask may forget work whose worker died beside it.
        future.cancel()
    if workers.left <= 0:
        workers.replace()
    return list(pending.values())


def _submit(executor: Executor, *call: Any) -> Future[Any]:
    # Ctrl-C is not for the processes that this may start: this one ends them, without a traceback from each. The
    # trackers of resources come first: starting one lifts the mask.
    for tracker in (loky_tracker, resource_tracker):
        tracker.ensure_running()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return executor.submit(*call)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _checked(source: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    if _own_source() != source:
        raise StewartDrakeError(
            "a worker has another version of stewart-drake than this process: install the same one everywhere, and do "
            "not change its files during a study"
        )
    return function(*arguments)


@lru_cache(maxsize=1)
def _own_source() -> str:
    return versions.source_digest()  # What this process has loaded does not change.


def start_worker(parent: int) -> None:
    """Keeps libraries quiet in this worker, and ends it once the process that started it is gone."""
    _WITHOUT_STDERR.enter_context(quiet_libraries())
    logging.getLogger("stewart_drake").setLevel(logging.ERROR)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.3)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _connected(address: str) -> Any:
    with installed_with("stewart-drake[dask]"):
        import distributed
    # One line of ours stands for the tracebacks that it logs of a cluster that goes away.
    for name in logging.root.manager.loggerDict:
        logging.getLogger(name).disabled |= name.startswith(("distributed", "tornado"))
    connect: Any = distributed.Client  # untyped in parts
    try:
        client = connect(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        client.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
    except Exception as error:  # of what is no scheduler, whatever its first words are taken for
        why = " ".join(str(error).split()) or type(error).__name__
        allowed = f"the address of a Dask scheduler that answers, such as tcp://host:8786 ({why})"
        raise ConfigurationError("--scheduler", address, allowed) from None
    return client
