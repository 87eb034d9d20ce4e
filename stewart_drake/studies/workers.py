"""Where the runs of a study go: processes of this machine (joblib's loky), a Dask cluster, or this very process."""

from __future__ import annotations

import logging
import math
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import AbstractContextManager, ExitStack, closing
from functools import lru_cache
from typing import Any, TypeVar

from joblib import Parallel, delayed
from joblib.externals.loky import get_reusable_executor
from joblib.externals.loky.backend import context

from stewart_drake.errors import ConfigurationError, StewartDrakeError, quiet_libraries
from stewart_drake.logs import versions

K = TypeVar("K", bound=Hashable)
T = TypeVar("T")
Work = tuple[Callable[..., Any], tuple[Any, ...]]

CONNECT_TIMEOUT = 20.0  # [s] that a scheduler has to answer
NO_WORKERS_TIMEOUT = 60.0  # [s] that a cluster may be without workers as work is handed to it
WORN = 200  # Runs after which a process is replaced: each leaves some tenths of a megabyte behind in Drake
WORKER_GONE = (
    "a worker process ended by itself: it was killed, or ran out of memory, or could not import the script that called,"
    ' which must be a file with the call under `if __name__ == "__main__":`'
)
DEAD = "its worker process died twice, the second time with this run alone in it: killed, out of memory, or a crash"
_QUIET = ExitStack()


class Workers(AbstractContextManager["Workers"]):
    """Processes of this machine, which import the calling script, or a Dask cluster. A context manager.

    `count` processes, None for one per core, at most 8, 0 for this very process, each replaced after `worn` runs.
    """

    def __init__(self, count: int | None = None, scheduler: str | None = None, worn: int | None = WORN) -> None:
        self.count = max(1, min(8, os.cpu_count() or 1)) if count is None else count
        self._client = None if scheduler is None else _connected(scheduler)
        self.life = self.left = math.inf if worn is None or scheduler is not None else self.count * worn

    def __exit__(self, *_: object) -> None:
        if self._client is not None:
            self._client.close()

    def results(self, jobs: Iterable[Any], alone: bool = False) -> Iterator[Any]:
        """What joblib's delayed calls give, in any order; `alone` for one after the other."""
        ahead = 1 if alone or self.count == 1 else "n_jobs + 1"
        options: dict[str, Any] = {"return_as": "generator_unordered", "batch_size": 1, "pre_dispatch": ahead}
        if self._client is not None:
            return iter(Parallel(n_jobs=-1, backend=_dask_backend(self._client), **options)(jobs))
        # With one, joblib would work in this process, which a crash must not end.
        options |= {"n_jobs": max(2, self.count), "initializer": start_worker, "initargs": (os.getpid(),)}
        # Ctrl-C is not for the workers: this process ends them, without a traceback from each.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        context.set_start_method("loky_init_main", force=True)
        try:
            return iter(Parallel(backend="loky", max_nbytes=None, **options)(jobs))
        finally:
            context.set_start_method(None, force=True)
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def run_jobs(
    keys: Iterable[K],
    work: Callable[[K], Work],
    keep: Callable[[K, Any], None],
    workers: Workers | None = None,
    died: Callable[[K], Any] | None = None,
) -> None:
    """Does the work of each key, in any order; `keep` gets each result in this process as it comes.

    Where a worker process dies, what was under way is done again, one piece at a time; `died` gives the result of work
    whose process dies twice, and without it all ends.
    """
    workers = workers or Workers()
    if workers.count == 0:
        for key in keys:
            function, arguments = work(key)
            keep(key, function(*arguments))
        return
    waiting, suspects = deque(keys), deque[K]()
    while waiting or suspects:
        alone, queue = not waiting, waiting or suspects
        most = 1 if alone else int(min(workers.left, len(queue)))
        batch = {key: work(key) for key in (queue.popleft() for _ in range(most))}
        left = _work_through(batch, keep, workers, alone)
        waiting.extendleft(key for key in reversed(batch) if left.get(key) is False)
        if not alone:
            suspects += [key for key, started in left.items() if started]
        elif left:
            # Where not even nothing can be done, no work is to blame.
            if _work_through({None: (int, ())}, lambda *_: None, workers, True) or died is None:
                raise StewartDrakeError(WORKER_GONE)
            for key in left:
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


def _work_through(batch: dict[K, Work], keep: Callable[[K, Any], None], workers: Workers, alone: bool) -> dict[K, bool]:
    """Does a batch as far as the workers live; what is not done, and whether it was under way."""
    left = dict.fromkeys(batch, False)
    source = str(versions.source_digest())

    def jobs() -> Iterator[Any]:
        for key, (function, arguments) in batch.items():
            left[key] = True
            yield delayed(_do)(key, source, function, arguments)

    try:
        with closing(workers.results(jobs(), alone)) as results:  # type: ignore[type-var]
            for key, result in results:
                del left[key]
                keep(key, result)
    except BrokenExecutor:
        pass  # what is left says how far it came
    workers.left -= len(batch) - len(left)
    if workers.left <= 0:
        # The next run starts other processes.
        get_reusable_executor().shutdown(wait=True)
        workers.left = workers.life
    return left


def _do(key: K, source: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    if _own_source() != source:
        raise StewartDrakeError(
            "a worker has another version of stewart-drake than this process: install the same everywhere, and leave "
            "its files alone while a study runs"
        )
    return key, function(*arguments)


@lru_cache(maxsize=1)
def _own_source() -> str:
    return versions.source_digest()  # once a process: what is loaded does not change


def start_worker(parent: int) -> None:
    """Keeps libraries quiet in this worker, and ends it once the process that started it is gone."""
    _QUIET.enter_context(quiet_libraries())

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.3)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _connected(address: str) -> Any:
    try:
        import distributed
    except ImportError:
        allowed = "an installation with Dask: pip install 'stewart-drake[dask]'"
        raise ConfigurationError("--scheduler", address, allowed) from None
    client: Any = distributed.Client  # untyped in parts
    # One line of ours stands for the tracebacks that it logs of a cluster that goes away.
    for name in [each for each in logging.root.manager.loggerDict if each.startswith(("distributed", "tornado"))]:
        logging.getLogger(name).disabled = True
    try:
        return client(address, timeout=CONNECT_TIMEOUT, set_as_default=False)
    except Exception as error:  # of what is no scheduler, whatever its first words are taken for
        why = " ".join(str(error).split()) or type(error).__name__
        allowed = f"the address of a Dask scheduler that answers, such as tcp://host:8786 ({why})"
        raise ConfigurationError("--scheduler", address, allowed) from None


def _dask_backend(client: Any) -> Any:
    """joblib's, which hears of results alone, made to hear of work that has killed its workers too."""
    from joblib._dask import DaskDistributedBackend

    class Backend(DaskDistributedBackend):
        def submit(self, func: Any, callback: Any = None) -> Any:
            future = super().submit(func, callback)
            future.add_done_callback(lambda done: done.exception() and callback(done.exception()))
            return future

        def effective_n_jobs(self, n_jobs: int) -> int:
            # With one, joblib would work in this process.
            return max(2, int(super().effective_n_jobs(n_jobs)))

        def retrieve_result_callback(self, out: Any) -> Any:
            if not isinstance(out, BaseException):
                return super().retrieve_result_callback(out)
            if type(out).__name__ == "KilledWorker":
                raise BrokenExecutor from out
            if type(out).__module__.partition(".")[0] in ("distributed", "asyncio", "concurrent"):
                raise StewartDrakeError(f"the Dask cluster failed: {type(out).__name__}: {out}; rows done are kept")
            raise out

    return Backend(client=client, wait_for_workers_timeout=NO_WORKERS_TIMEOUT, retries=0)
