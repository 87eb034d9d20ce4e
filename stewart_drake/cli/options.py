"""The group of all commands, options that several of them share, and what all commands of many runs do."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import Any

import click

from stewart_drake.cli.terminal import progress_bar, say
from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code import trusting_code
from stewart_drake.files.whole import write_atomically
from stewart_drake.logs.versions import package_version
from stewart_drake.runs.outputs import prepare_file, prepare_folder
from stewart_drake.studies.workers import Workers

EXIT_BAD_INPUT, EXIT_RUN_FAILED, EXIT_INTERNAL, EXIT_INTERRUPTED = 2, 3, 4, 130


@click.group(
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120, "show_default": True},
    invoke_without_command=True,
)
@click.version_option(package_version("stewart-drake") or "not installed", message="stewart-drake %(version)s")
@click.pass_context
def cli(context: click.Context) -> None:
    """Closed-loop torque control of rotary Stewart platforms in Drake."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


class OutPath(click.Path):
    """Where to write; an empty text, as an unset variable of a shell gives it, is no place."""

    def __init__(self, **details: Any) -> None:
        super().__init__(path_type=Path, **details)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """As `click.Path`."""
        if value == "":
            self.fail("expected a path, got an empty text", param, ctx)
        return super().convert(value, param, ctx)


IN_FILE = click.Path(path_type=Path)
OUT_FILE, OUT_FOLDER = OutPath(dir_okay=False), OutPath(file_okay=False)

quiet_flag = click.option("--quiet", is_flag=True, help="No progress bar and no tables.")
guess_option = click.option(
    "--robot", required=True, metavar="GUESS", help="The robot as believed: a YAML file or a name."
)
sized_option = click.option(
    "--robot", help="Name or YAML file: motions, loads and faults in its size [default: that of the file]."
)


def out_folder(default: str | None = None) -> Callable[[Any], Any]:
    """`--out DIR`."""
    if default is None:
        return click.option("--out", type=OutPath(), help="Folder for the results [default: runs/NAME].")
    return click.option("--out", type=OutPath(), default=default, help="Folder for the results.")


def out_file(default: str) -> Callable[[Any], Any]:
    """`--out FILE`."""
    return click.option("--out", type=OUT_FILE, default=default, help="File to write.")


def overrides(example: str = "duration=2") -> Callable[[Any], Any]:
    """`--set KEY=VALUE`."""
    return click.option(
        "--set", "overrides", multiple=True, metavar="KEY=VALUE", help=f"Change a key, e.g. --set {example}."
    )


def trust_flag(function: Callable[..., Any]) -> Callable[..., Any]:
    """`--trust-code`."""

    @click.option(
        "--trust-code",
        is_flag=True,
        help="Run the code that the files and --set name.",
    )
    @wraps(function)
    def command(*args: Any, trust_code: bool, **options: Any) -> Any:
        with trusting_code(trust_code):
            return function(*args, **options)

    return command


def study_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """`--workers`, `--scheduler`, `--restart`, `--quiet` and `--trust-code` of a command of many runs."""
    scheduler = "Run on the Dask cluster of this scheduler, e.g. tcp://host:8786."
    processes = "Processes on this machine [default: one per core, at most 8]."
    for option in (
        trust_flag,
        quiet_flag,
        click.option("--restart", is_flag=True, help="Throw away what an earlier call left in the folder."),
        click.option("--scheduler", metavar="ADDRESS", help=scheduler),
        click.option("--workers", type=click.IntRange(1, 1024), help=processes),
    ):
        function = option(function)
    return function


@contextmanager
def under_way(
    name: str, runs: int, out: Path | None, workers: int | None, scheduler: str | None, quiet: bool
) -> Iterator[tuple[Path, Workers, Callable[[float], None]]]:
    """The folder, where the runs go, and what is told how many are done; Ctrl-C ends the command with what is kept."""
    if scheduler is not None and workers is not None:
        allowed = "no value with --scheduler: the cluster sets the number of workers"
        raise ConfigurationError("--workers", workers, allowed)
    where = Workers(workers, scheduler)
    folder = prepare_folder(out if out is not None else Path("runs") / name)
    try:
        with where, progress_bar(name, float(runs), quiet, unit="runs") as advance:
            yield folder, where, advance
    except KeyboardInterrupt:
        say(f"interrupted; finished runs are kept in {folder}; the same command goes on from there")
        sys.exit(EXIT_INTERRUPTED)


def write_text(path: Path, text: str) -> None:
    """Writes a file as a whole, and its folder where there is none."""
    prepare_file(path)
    write_atomically(path, text.encode())
