"""Runs the work of a study in processes of this machine (loky), on a Dask cluster, or in this process."""

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
Work = tuple[Callable[..., T], tuple[object, ...]]  # Function and arguments.

CONNECT_TIMEOUT = 20.0  # [s] for the answer of a Dask scheduler, and for its first worker.
IDLE_TIMEOUT = 3600.0  # [s] after which an idle process ends; long, because loky may lose work that comes just then.
RUNS_PER_PROCESS = 200  # A process is then replaced: Drake leaks some tenths of a megabyte per run.
WORKER_ENDED = (
    "a worker process ended by itself: it was killed, or ran out of memory, or could not import the script that called,"
    ' which must be a file with the call under `if __name__ == "__main__":`'
)
DIED_TWICE = (
    "its worker process died twice, the second time with this run alone in it: killed, out of memory, or a crash"
)
_WITHOUT_STDERR = ExitStack()
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
"""Environment of a worker; with more threads, workers would compete for the cores."""


class Workers(AbstractContextManager["Workers"]):
    """Processes of this machine, which import the calling script, or a Dask cluster. A context manager.

    Args:
        count: Number of processes; None for one per core, at most 8; 0 for this process.
        scheduler: Address of a Dask scheduler, in place of processes.
        runs_per_process: Runs after which processes are replaced, on average; None for never.
    """

    def __init__(
        self, count: int | None = None, scheduler: str | None = None, runs_per_process: int | None = RUNS_PER_PROCESS
    ) -> None:
        self.count = max(1, min(8, os.cpu_count() or 1)) if count is None else count
        self._client = None
        if scheduler is not None:
            self._client, runs_per_process = _connected(scheduler), None
            self.count = max(1, sum(self._client.nthreads().values()))
        self._max_runs = self.runs_left = math.inf if runs_per_process is None else self.count * runs_per_process

    def __exit__(self, *_: object) -> None:
        if self._client is not None:
            self._client.close()

    def executor(self) -> Executor:
        if self._client is not None:
            client: Executor = self._client.get_executor(pure=False, retries=0)
            return client
        # Processes started now do not import modules of the current folder.
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
        """Ends the processes; the next run starts new ones."""
        if self._client is None:
            get_reusable_executor().shutdown(wait=True, kill_workers=True)
        self.runs_left = self._max_runs


def run_jobs(
    keys: Iterable[K],
    work: Callable[[K], Work[T]],
    keep: Callable[[K, T], None],
    workers: Workers | None = None,
    died: Callable[[K], T] | None = None,
) -> None:
    """Does the work of all keys, in any order, and calls `keep` in this process with the results as they come.

    If a worker process dies, unfinished work is repeated, one piece at a time. If its process dies again, the result is
    that of `died`, or a StewartDrakeError.
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
        # If even a trivial function fails, no process can start, and the work is not the cause.
        trivial: deque[int] = deque([0] if suspects else [])
        if _work_off(trivial, lambda _: (int, ()), lambda *_: None, workers):
            raise StewartDrakeError(WORKER_ENDED)
    for key in suspects:
        if _work_off(deque([key]), work, keep, workers):
            if died is None:
                raise StewartDrakeError(WORKER_ENDED)
            keep(key, died(key))


def run_all(
    function: Callable[..., T],
    arguments: Sequence[tuple[object, ...]],
    workers: Workers | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> list[T]:
    """Results of a function for a sequence of arguments, in order; `progress` gets the number of results."""
    results: dict[int, T] = {}

    def keep(index: int, result: T) -> None:
        results[index] = result
        progress(float(len(results)))

    run_jobs(range(len(arguments)), lambda index: (function, arguments[index]), keep, workers)
    return [results[index] for index in range(len(arguments))]


def _work_off(
    waiting: deque[K], work: Callable[[K], Work[T]], keep: Callable[[K, T], None], workers: Workers
) -> list[K]:
    """Works off `waiting` until it is empty, a process dies or all are to be replaced; returns unfinished keys."""
    source, executor, died = str(versions.source_digest()), workers.executor(), False
    pending: dict[Future[T], K] = {}
    try:
        while not died and (pending or (waiting and workers.runs_left > 0)):
            while waiting and workers.runs_left > 0 and len(pending) <= workers.count:
                future = _submit(executor, _checked, source, *work(waiting[0]))
                pending[future] = waiting.popleft()
                workers.runs_left -= 1
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                error = future.exception()
                if isinstance(error, BrokenExecutor) or type(error).__name__ == "KilledWorker":  # Dask's.
                    died = True
                elif error is not None:
                    raise error
                else:
                    keep(pending.pop(future), future.result())
    except BrokenExecutor:
        pass  # The executor broke between two pieces of work.
    except BaseException as error:
        for future in pending:
            future.cancel()
        workers.replace()
        if isinstance(error, CancelledError):
            raise StewartDrakeError("the Dask cluster is gone; finished rows are kept") from error
        raise
    for future in pending:
        # Dask may forget pending work when a worker dies.
        future.cancel()
    if workers.runs_left <= 0:
        workers.replace()
    return list(pending.values())


def _submit(executor: Executor, function: Callable[..., T], *arguments: object) -> Future[T]:
    # Processes started here ignore Ctrl-C; this process ends them, without their tracebacks. Trackers of resources come
    # first, because starting one unblocks the signal.
    for tracker in (loky_tracker, resource_tracker):
        tracker.ensure_running()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return executor.submit(function, *arguments)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _checked(source: str, function: Callable[..., T], arguments: tuple[object, ...]) -> T:
    """Calls a function in a worker, which must have the sources of this process."""
    if _own_source() != source:
        raise StewartDrakeError(
            "a worker has another version of stewart-drake than this process: install the same one everywhere, and do "
            "not change its files during a study"
        )
    return function(*arguments)


@lru_cache(maxsize=1)
def _own_source() -> str:
    return versions.source_digest()  # Cached, because loaded code does not change.


def start_worker(parent: int) -> None:
    """Silences libraries in this worker, and ends it when its parent process has ended."""
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
    # When a cluster goes away, one line is printed in place of the tracebacks in these logs.
    for name in logging.root.manager.loggerDict:
        logging.getLogger(name).disabled |= name.startswith(("distributed", "tornado"))
    connect: Any = distributed.Client  # Partly untyped.
    try:
        client = connect(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        client.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
    except Exception as error:  # Another server may cause any error.
        why = " ".join(str(error).split()) or type(error).__name__
        allowed = f"the address of a Dask scheduler that answers, such as tcp://host:8786 ({why})"
        raise ConfigurationError("--scheduler", address, allowed) from None
    return client
