"""Many runs, each log kept on disk as soon as it is done."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stewart_drake.campaigns.engine import carry_out
from stewart_drake.campaigns.executors import PROCESSES, LocalProcesses, SerialExecutor
from stewart_drake.campaigns.one_run import simulate
from stewart_drake.campaigns.plan import identity
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import refuse_given
from stewart_drake.files.whole import checksum, locked_folder
from stewart_drake.logs.log import SimulationLog, load_log
from stewart_drake.logs.versions import collect_versions
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.scenario import Scenario


def run_key(scenario: Scenario, versions: Mapping[str, str | None] | None = None) -> str:
    """A name for the result of `scenario`: digest of its keys (not its name), files that it names, versions.

    Args:
        scenario: What to run.
        versions: From `collect_versions`; None collects them.

    Raises:
        ConfigurationError: The tuner's weights file cannot be read; a part was given in Python as a class or an object.
    """
    refuse_given(scenario)
    data = scenario.to_dict()
    data.pop("name")
    return checksum(identity(data, [scenario], versions))[:24]


@dataclass(frozen=True)
class RunStore:
    """Runs scenarios and keeps their logs (without the plant's state); an interrupted experiment goes on where it was.

    Several workers are processes that import the calling script again: there the call must stand under
    `if __name__ == "__main__":`. One worker runs in the calling process.

    Attributes:
        folder: Where the logs lie.
        workers: Processes.
    """

    folder: Path
    workers: int = PROCESSES

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
            versions = collect_versions()
            paths = [self.folder / f"{run_key(s, versions)}.parquet" for s in scenarios]
            logs = {path: _kept(path) for path in dict.fromkeys(paths)}
            missing = {path: s for path, s in zip(paths, scenarios, strict=True) if logs[path] is None}
            tell = (lambda _: None) if progress is None else progress
            shares = iter(range(len(logs) - len(missing) + 1, len(logs) + 1))
            carry_out(
                missing,
                lambda path: (_run_and_keep, (missing[path], path, check)),
                lambda *_: tell(next(shares) / len(logs)),
                LocalProcesses(self.workers) if min(self.workers, len(missing)) > 1 else SerialExecutor(),
            )
            tell(1.0)
            whole = {path: load_log(path) if log is None else log for path, log in logs.items()}
            return [replace(whole[path], scenario=s) for path, s in zip(paths, scenarios, strict=True)]


def _run_and_keep(scenario: Scenario, path: Path, check: bool) -> None:
    log = simulate(scenario, check=check)
    kept = {name: values for name, values in log.signals.items() if name != "plant_state"}
    replace(log, signals=kept, state_names=()).save(path)


def _kept(path: Path) -> SimulationLog | None:
    """The log at `path`; None where there is none that can be read."""
    try:
        return load_log(path)
    except ConfigurationError:
        return None
