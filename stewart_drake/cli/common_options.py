"""Options and ways that several commands share."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.terminal import ProgressBar

if TYPE_CHECKING:
    from stewart_drake.campaigns.executors import Workplace

EXIT_INTERRUPTED = 130


class OutPath(click.Path):
    """Where to write; an empty text, as an unset variable of a shell gives it, is no place."""

    def __init__(self, **details: Any) -> None:
        super().__init__(path_type=Path, **details)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """As `click.Path`."""
        if value == "":
            self.fail("got an empty text; allowed: a path", param, ctx)
        return super().convert(value, param, ctx)


def out_folder(default: str | None = None) -> Callable[[Any], Any]:
    """`--out DIR`."""
    if default is None:
        return click.option("--out", type=OutPath(), help="Folder for the results [default: runs/NAME].")
    return click.option(
        "--out", type=OutPath(), default=Path(default), show_default=True, help="Folder for the results."
    )


def out_file(default: str) -> Callable[[Any], Any]:
    """`--out FILE`."""
    return click.option(
        "--out", type=OutPath(dir_okay=False), default=Path(default), show_default=True, help="File to write."
    )


def overrides(example: str = "duration=2") -> Callable[[Any], Any]:
    """`--set KEY=VALUE`."""
    return click.option(
        "--set", "overrides", multiple=True, metavar="KEY=VALUE", help=f"Change a key, e.g. --set {example}."
    )


def campaign(function: Callable[..., Any]) -> Callable[..., Any]:
    """`--workers`, `--scheduler`, `--restart` and `--quiet` of a command of many runs."""
    for option in (
        click.option("--quiet", is_flag=True, help="No progress bar and no table."),
        click.option("--restart", is_flag=True, help="Throw away what an earlier call left in the folder."),
        click.option(
            "--scheduler", metavar="ADDRESS", help="Run on the Dask cluster of this scheduler, e.g. tcp://host:8786."
        ),
        click.option(
            "--workers",
            type=click.IntRange(1, 1024),
            help="Processes on this machine [default: one per core, at most 8].",
        ),
    ):
        function = option(function)
    return function


def workplace(workers: int | None, scheduler: str | None) -> Workplace:
    """Where the runs of a campaign go.

    Raises:
        ConfigurationError: Both are given; the scheduler cannot be reached.
    """
    from stewart_drake.campaigns.executors import DaskCluster, LocalProcesses

    if scheduler is None:
        return LocalProcesses(workers)
    if workers is not None:
        raise ConfigurationError(
            "--workers", workers, "no value with --scheduler: the cluster sets the number of workers"
        )
    cluster = DaskCluster(scheduler)
    cluster.connect()
    return cluster


@contextmanager
def under_way(name: str, runs: int, folder: Path, quiet: bool) -> Iterator[Callable[[float], None]]:
    """A progress bar of runs, as a function of how many are done; Ctrl-C ends the command with what is kept."""
    done = 0.0
    try:
        with ProgressBar(name, float(runs), quiet, unit="runs") as advance:

            def progress(count: float) -> None:
                nonlocal done
                done = count
                advance(count)

            yield progress
    except KeyboardInterrupt:
        kept = f"{done:.0f} of {runs} runs are kept in {folder}; the same command goes on from there"
        click.echo(f"stewart-drake: interrupted; {kept}", err=True)
        sys.exit(EXIT_INTERRUPTED)
