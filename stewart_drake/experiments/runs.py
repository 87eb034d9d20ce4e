"""Many runs on a few processes, each kept on disk as soon as it is done."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stewart_drake.errors import ConfigurationError
from stewart_drake.log import SimulationLog, load_log
from stewart_drake.network import default_network_path
from stewart_drake.scenario import AnnTuner, Scenario
from stewart_drake.versions import collect_versions


def run_key(scenario: Scenario) -> str:
    """A name for the result of `scenario`: digest of its keys (not its name), the tuner's weights and the versions."""
    data = scenario.to_dict()
    data.pop("name")
    content: list[Any] = [data]
    if isinstance(scenario.tuner, AnnTuner):
        path = scenario.tuner.weights_file
        content.append((default_network_path() if path is None else Path(path)).read_text(encoding="utf-8"))
    versions = collect_versions()
    content.append({name: versions[name] for name in ("stewart-drake", "drake", "numpy", "source")})
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


def _run_and_keep(scenario: Scenario, path: Path, check: bool) -> None:
    from stewart_drake.simulation import run

    log = run(scenario, check=check)
    if log.status == "interrupted":
        raise KeyboardInterrupt
    kept = {name: values for name, values in log.signals.items() if name != "plant_state"}
    replace(log, signals=kept, state_names=()).save(path)


@dataclass(frozen=True)
class RunStore:
    """Runs scenarios and keeps their logs (without the plant's state); an interrupted experiment goes on where it was.

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
            ConfigurationError: A scenario is refused before its run.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        paths = [self.folder / f"{run_key(s)}.parquet" for s in scenarios]
        missing = {path: s for path, s in zip(paths, scenarios, strict=True) if not _readable(path)}
        total = max(1, len(set(paths)))
        if missing:
            self._run_missing(missing, total, progress, check)
        if progress is not None:
            progress(1.0)
        return [replace(load_log(path), scenario=s) for path, s in zip(paths, scenarios, strict=True)]

    def _run_missing(
        self,
        missing: dict[Path, Scenario],
        total: int,
        progress: Callable[[float], None] | None,
        check: bool,
    ) -> None:
        done = total - len(missing)
        # Spawned, not forked: Drake and numpy hold threads that do not survive a fork.
        pool = ProcessPoolExecutor(min(self.workers, len(missing)), multiprocessing.get_context("spawn"))
        try:
            pending = {pool.submit(_run_and_keep, s, path, check) for path, s in missing.items()}
            while pending:
                finished, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in finished:
                    future.result()
                    done += 1
                    if progress is not None:
                        progress(done / total)
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _readable(path: Path) -> bool:
    if not path.is_file():
        return False
    try:
        load_log(path)
    except ConfigurationError:
        return False
    return True
