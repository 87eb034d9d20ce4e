"""What the commands show on the terminal: progress bars and tables."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any

import click


def say(text: str) -> None:
    """One line on standard error."""
    click.echo(f"stewart-drake: {' '.join(text.split())}", err=True)


@contextmanager
def progress_bar(title: str, total: float, quiet: bool, unit: str = "s") -> Iterator[Callable[..., None]]:
    """A bar of simulated seconds (or of runs, epochs); yields what takes how much is done, and what is done now."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    digits = 2 if unit == "s" else 0
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn(f"{{task.completed:.{digits}f}} / {{task.total:.{digits}f}} {unit}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console(stderr=True),
        disable=quiet,
        # A refresh thread would take the interpreter from the simulation at every step.
        auto_refresh=False,
    )
    task = bar.add_task(title, total=total)

    def advance(completed: float, now: str | None = None) -> None:
        # Only now: what is compiled first has a line of its own.
        bar.start()
        bar.update(task, completed=completed, description=now, refresh=True)

    try:
        yield advance
    finally:
        bar.stop()


@contextmanager
def shown_compiling(quiet: bool) -> Iterator[None]:
    """A line that moves with every law that numba compiles, where the cache does not have it; nothing where it has."""
    from numba.core import event
    from rich.status import Status

    status, depth, laws = Status("", console=console(stderr=True)), 0, 0

    class Line(event.Listener):
        def on_start(self, event: Any) -> None:  # noqa: ARG002
            nonlocal depth, laws
            depth, laws = depth + 1, laws + 1
            status.update(f"compiling, once on this machine: {laws} laws")
            status.start()

        def on_end(self, event: Any) -> None:  # noqa: ARG002
            nonlocal depth
            depth -= 1
            if depth == 0:
                status.stop()

    if quiet:
        yield
        return
    with event.install_listener("numba:compile", Line()):
        try:
            yield
        finally:
            status.stop()


def console(stderr: bool = False) -> Any:
    """Terminal that wraps and colours; where nobody reads any more, what is written is lost and nothing else."""
    from rich.console import Console

    class Patient(Console):
        def on_broken_pipe(self) -> None:
            drop_output(self.file)

    return Patient(stderr=stderr)


def drop_output(stream: IO[str]) -> None:
    """From here on a stream goes nowhere, so that its buffer does no harm at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def print_table(
    title: str,
    rows: Iterable[Sequence[str]],
    header: Sequence[str] = ("", ""),
    numbers: Collection[int] | None = None,
) -> None:
    """A table on standard output, without empty headers; columns `numbers` stand right, None for all but the first."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left", show_header=any(header))
    right = range(1, len(header)) if numbers is None else numbers
    for place, name in enumerate(header):
        side: Any = "right" if place in right else "left"
        table.add_column(escape(name), justify=side, overflow="fold", no_wrap=place == 0 and numbers is not None)
    for row in rows:
        table.add_row(*map(escape, row))
    console().print(table)
