"""Where the work of a campaign goes: a `concurrent.futures.Executor` of processes here, of Dask, or of the caller."""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import signal
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any, ParamSpec, Self, TypeVar

from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.runs.terminal import quiet_libraries

P = ParamSpec("P")
T = TypeVar("T")

CONNECT_TIMEOUT = 20.0
"""[s] that a scheduler has to answer, and to have a worker."""
NO_WORKERS_TIMEOUT = 60.0
"""[s] that a cluster may be without workers; a restarted one needs a few."""
WORN = 200
"""Pieces of work after which a worker process is replaced: each leaves some tenths of a megabyte behind in Drake."""
PROCESSES = max(1, min(8, os.cpu_count() or 1))
"""On this machine, where nobody says how many."""
ATTEMPTS = 2
"""Times that a run, alone, may take its worker with it before that is its row: once could be somebody else's kill."""


class Workplace(ABC):
    """Where work goes. An executor that broke is replaced by another `open`.

    Attributes:
        workers: Pieces of work at a time; known after the first `open`.
        worn: So many for each worker, and `open` is called again; None for any number.
    """

    workers: int = 1
    worn: int | None = None

    @abstractmethod
    def open(self, most: int) -> Executor:
        """An executor that takes work.

        Args:
            most: Pieces of work at a time that are of use, where their number can be chosen.

        Raises:
            ConfigurationError: It cannot be reached.
            StewartDrakeError: It broke and cannot be replaced.
        """

    def check(self) -> None:
        """Called now and then while work is under way.

        Raises:
            StewartDrakeError: Nobody is left to do it.
        """
        return

    @abstractmethod
    def close(self, executor: Executor, abort: bool) -> None:
        """Ends an executor of `open`; `abort` does not wait for what it is doing."""

    def leave(self) -> None:
        """Called at the end of a campaign, whatever happened before."""
        return


class LocalProcesses(Workplace):
    """A pool of fresh processes on this machine.

    They import the calling script again: there the call must stand under `if __name__ == "__main__":`.

    Args:
        workers: Processes; None for one per core, at most 8.
    """

    worn: int | None = WORN

    def __init__(self, workers: int | None = None) -> None:
        self.workers = PROCESSES if workers is None else workers

    def open(self, most: int) -> Executor:
        """See `Workplace.open`."""
        return _Pool(min(most, self.workers))

    def close(self, executor: Executor, abort: bool) -> None:
        """See `Workplace.close`."""
        if abort and isinstance(executor, _Pool):
            executor.kill()
        executor.shutdown(wait=True, cancel_futures=True)


class DaskCluster(Workplace):
    """Workers of a Dask cluster; they need this package, the same version. One thread a worker serves best.

    Attributes:
        address: Of the scheduler, such as tcp://host:8786.
        workers: Threads of all workers.

    Raises:
        ConfigurationError: `dask.distributed` is not installed.
    """

    def __init__(self, address: str) -> None:
        try:
            import distributed  # noqa: F401
        except ImportError:
            allowed = "an installation with Dask: pip install 'stewart-drake[dask]'"
            raise ConfigurationError("--scheduler", address, allowed) from None
        self.address, self.workers = address, 1
        self._client: Any = None
        self._silenced = ExitStack()

    def connect(self) -> None:
        """Connects to the scheduler, where that is not done yet.

        Raises:
            ConfigurationError: It does not answer, or has no workers.
        """
        import distributed

        if self._client is not None:
            return
        client: Any = distributed.Client  # untyped in parts
        self._silenced.enter_context(_silence())
        try:
            # The client itself would wait for ever for a port that takes what it is told and says nothing.
            asyncio.run(_greet(self.address))
            self._client = client(self.address, timeout=CONNECT_TIMEOUT, set_as_default=False)
        except Exception as error:  # of what is no scheduler, whatever its first words are taken for
            self.leave()
            why = " ".join(str(error).split()) or type(error).__name__
            allowed = f"the address of a Dask scheduler that answers, such as tcp://host:8786 ({why})"
            raise ConfigurationError("--scheduler", self.address, allowed) from None
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_TIMEOUT)
        except TimeoutError:
            self.leave()
            raise ConfigurationError("--scheduler", self.address, "a Dask cluster with workers") from None

    def open(self, most: int) -> Executor:  # noqa: ARG002 - a cluster has the workers that it has
        """See `Workplace.open`."""
        self.connect()
        self.check()
        self.workers = max(1, sum(self._client.nthreads().values()))
        # A lost worker must show, not be made good in silence beyond what the scheduler does by itself.
        return self._client.get_executor(pure=False, retries=0)

    def check(self) -> None:
        """See `Workplace.check`."""
        try:
            # A restarted cluster needs a while; in it nothing else can happen.
            if not self._client.nthreads():
                self._client.wait_for_workers(1, timeout=NO_WORKERS_TIMEOUT)
        except TimeoutError:
            raise StewartDrakeError(
                f"the Dask cluster {self.address} has been without workers for {NO_WORKERS_TIMEOUT:g} s; rows done are "
                "kept. Workers started under a nanny come back by themselves"
            ) from None
        except Exception as error:  # of a lost scheduler, whatever kind its transport raises
            raise StewartDrakeError(f"the Dask scheduler {self.address} is gone: {error}") from None

    def close(self, executor: Executor, abort: bool) -> None:
        """See `Workplace.close`."""
        executor.shutdown(wait=not abort)

    def leave(self) -> None:
        """See `Workplace.leave`."""
        client, self._client = self._client, None
        with self._silenced:
            if client is not None:
                client.close()


async def _greet(address: str) -> None:
    """Connects as Dask does, and hangs up."""
    from distributed import comm as library

    connect: Any = vars(library)["connect"]
    comm: Any = await asyncio.wait_for(connect(address, timeout=CONNECT_TIMEOUT), CONNECT_TIMEOUT)
    await comm.close()


@contextmanager
def _silence() -> Iterator[None]:
    """Keeps what Dask logs, with tracebacks, about a cluster that goes away off the terminal: one line of ours says it.

    Its loggers have levels and handlers of their own, so that a level for all of them would not reach them.
    """
    names = [name for name in logging.root.manager.loggerDict if name.partition(".")[0] in ("distributed", "tornado")]
    before = {logger: logger.disabled for logger in map(logging.getLogger, names)}
    for logger in before:
        logger.disabled = True
    try:
        yield
    finally:
        for logger, disabled in before.items():
            logger.disabled = disabled


class Given(Workplace):
    """An executor of the caller's; it stays open.

    Args:
        executor: It.
    """

    def __init__(self, executor: Executor) -> None:
        told = getattr(executor, "_max_workers", None)
        self.workers = told if isinstance(told, int) else 1
        self._executor = executor
        self._broken = False

    def open(self, most: int) -> Executor:  # noqa: ARG002 - it has the workers that it has
        """See `Workplace.open`."""
        if self._broken:
            raise StewartDrakeError("a worker of the executor died, and an executor that is handed over stays broken")
        return self._executor

    def close(self, executor: Executor, abort: bool) -> None:  # noqa: ARG002 - it stays open
        """See `Workplace.close`."""
        self._broken = bool(getattr(executor, "_broken", False))


def workplace(where: Workplace | Executor | None) -> Workplace:
    """What a caller says of where the work goes; None for processes of this machine."""
    return Given(where) if isinstance(where, Executor) else where or LocalProcesses()


class Lasting(Workplace):
    """A workplace whose executor stays from one piece of a campaign to the next: opening it takes seconds.

    A context manager; at its end all is closed.

    Args:
        place: The workplace.
    """

    def __init__(self, place: Workplace) -> None:
        self._place, self._left = place, 0
        self._executor: Executor | None = None
        self.workers = place.workers

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._end(abort=kind is not None)
        self._place.leave()

    def open(self, most: int) -> Executor:
        """See `Workplace.open`."""
        if self._executor is None or (self._place.worn and self._left < most):
            self._end()
            # Not for `most`: the next piece may have more.
            self._executor = self._place.open(self.workers)
            self.workers = self._place.workers
            self._left = self.workers * (self._place.worn or 0)
        self._left -= most
        return self._executor

    def check(self) -> None:
        """See `Workplace.check`."""
        self._place.check()

    def close(self, executor: Executor, abort: bool) -> None:
        """See `Workplace.close`."""
        if abort or getattr(executor, "_broken", False):
            self._end(abort=True)

    def _end(self, abort: bool = False) -> None:
        executor, self._executor = self._executor, None
        if executor is not None:
            self._place.close(executor, abort)


class SerialExecutor(Executor):
    """Runs at once, in the calling thread."""

    def submit(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """A future that is done."""
        future: Future[T] = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def worker_deaths(error: BaseException) -> int:
    """How often a worker ended in the midst of its work, by what an executor says; 0 for any other failure."""
    if isinstance(error, BrokenExecutor):
        return 1
    # By its name: a sweep without Dask does without importing it. The scheduler has tried several workers by itself.
    return ATTEMPTS if type(error).__name__ == "KilledWorker" else 0


_QUIET = ExitStack()


def start_worker() -> None:
    """Ends this worker as soon as the process that started it is gone; by itself it would wait for work for ever.

    And keeps libraries quiet in it, for good.
    """
    _QUIET.enter_context(quiet_libraries())
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class _Pool(ProcessPoolExecutor):
    def __init__(self, workers: int) -> None:
        self._others = set(multiprocessing.active_children())
        # Spawned, not forked: Drake and numpy hold threads that do not survive a fork.
        super().__init__(workers, multiprocessing.get_context("spawn"), initializer=start_worker)

    def submit(self, function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        # The workers inherit that Ctrl-C is not for them: this process ends them, without a traceback from each.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(function, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def kill(self) -> None:
        for worker in set(multiprocessing.active_children()) - self._others:
            worker.terminate()
