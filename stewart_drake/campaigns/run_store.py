"""Many runs on a few processes, each kept on disk as soon as it is done."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stewart_drake.control.network import default_network_path, read_weights
from stewart_drake.errors import ConfigurationError, StewartDrakeError
from stewart_drake.files.named_files import file_digests
from stewart_drake.files.whole import locked_folder
from stewart_drake.logs.log import SimulationLog, load_log
from stewart_drake.logs.versions import collect_versions
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.runs.terminal import quiet_libraries
from stewart_drake.scenario import AnnTuner, Scenario

WORKER_GONE = (
    "a worker process ended by itself: it was killed, or ran out of memory, or could not import the script that called,"
    ' which must be a file with the call under `if __name__ == "__main__":`'
)


def run_key(scenario: Scenario, versions: Mapping[str, str | None] | None = None) -> str:
    """A name for the result of `scenario`: digest of its keys (not its name), files that it names, versions.

    Args:
        scenario: What to run.
        versions: From `collect_versions`; None collects them.

    Raises:
        ConfigurationError: The tuner's weights file cannot be read.
    """
    data = scenario.to_dict()
    data.pop("name")
    content: list[Any] = [data]
    if isinstance(scenario.tuner, AnnTuner):
        content.append(weights_text(scenario.tuner))
    content.append(file_digests(data))
    versions = collect_versions() if versions is None else versions
    content.append({name: versions[name] for name in ("stewart-drake", "drake", "numpy", "source")})
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


def weights_text(tuner: AnnTuner) -> str:
    """Content of the weights file that `tuner` names.

    Raises:
        ConfigurationError: It cannot be read.
    """
    return read_weights(default_network_path() if tuner.weights_file is None else Path(tuner.weights_file))


@dataclass(frozen=True)
class RunStore:
    """Runs scenarios and keeps their logs (without the plant's state); an interrupted experiment goes on where it was.

    Several workers are processes that import the calling script anew: there the call must stand under
    `if __name__ == "__main__":`. One worker runs in the calling process.

    Attributes:
        folder: Where the logs lie.
        workers: Processes.
    """

    folder: Path
    workers: int = max(1, min(8, os.cpu_count() or 1))

    def run_all(
        self,
        scenarios: Sequence[Scenario],
        progress: Callable[[float], None] | None = None,
        check: bool = True,
    ) -> list[SimulationLog]:
        """Logs of `scenarios`, in order; those on disk are read, the others run.

        Args:
            scenarios: What to run.
            progress: Called with the share done, 0 to 1.
            check: As in `simulation.run`.

        Raises:
            ConfigurationError: A scenario is refused before its run, or the folder cannot be written to or is in use.
            StewartDrakeError: A worker process ended by itself.
        """
        with locked_folder(prepare_folder(self.folder)):
            return self._run_all(scenarios, progress, check)

    def _run_all(
        self, scenarios: Sequence[Scenario], progress: Callable[[float], None] | None, check: bool
    ) -> list[SimulationLog]:
        versions = collect_versions()
        paths = [self.folder / f"{run_key(s, versions)}.parquet" for s in scenarios]
        logs = {path: _kept(path) for path in dict.fromkeys(paths)}
        missing = {path: s for path, s in zip(paths, scenarios, strict=True) if logs[path] is None}
        done = len(logs) - len(missing)

        def advance() -> None:
            nonlocal done
            done += 1
            if progress is not None:
                progress(done / len(logs))

        workers = min(self.workers, len(missing))
        if workers > 1:
            _run_in_processes(missing, workers, check, advance)
        else:
            for path, scenario in missing.items():
                _run_and_keep(scenario, path, check)
                advance()
        if progress is not None:
            progress(1.0)
        return [replace(logs[path] or load_log(path), scenario=s) for path, s in zip(paths, scenarios, strict=True)]


def _run_and_keep(scenario: Scenario, path: Path, check: bool) -> None:
    from stewart_drake.runs.simulation import run

    log = run(scenario, check=check)
    if log.status == "interrupted":
        raise KeyboardInterrupt
    kept = {name: values for name, values in log.signals.items() if name != "plant_state"}
    replace(log, signals=kept, state_names=()).save(path)


def _run_in_processes(missing: Mapping[Path, Scenario], workers: int, check: bool, advance: Callable[[], None]) -> None:
    others = set(multiprocessing.active_children())
    # Spawned, not forked: Drake and numpy hold threads that do not survive a fork.
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), initializer=start_worker)
    try:
        # The workers inherit that Ctrl-C is not for them: this process ends them, without a traceback from each.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            futures = [pool.submit(_run_and_keep, scenario, path, check) for path, scenario in missing.items()]
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for future in as_completed(futures):
            future.result()
            advance()
    except BrokenProcessPool:
        raise StewartDrakeError(WORKER_GONE) from None
    except KeyboardInterrupt:
        # What is half done is lost all the same, so nobody waits for it.
        for worker in set(multiprocessing.active_children()) - others:
            worker.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


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


def _kept(path: Path) -> SimulationLog | None:
    """The log at `path`; None where there is none that can be read."""
    try:
        return load_log(path)
    except (ConfigurationError, ValueError, KeyError, TypeError):
        return None
