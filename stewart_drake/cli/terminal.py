"""What the commands show on the terminal: bars of progress, tables, lines; with `--json` the tables as JSON."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

QUIET, AS_JSON = "stewart_drake.quiet", "stewart_drake.json"
"""What the options `--quiet` and `--json` leave in a command's context."""
_TEXT_WIDTH = 14  # Of a column of texts that has to fold


def _asked(option: str) -> Any:
    context = click.get_current_context(silent=True)
    return None if context is None else context.meta.get(option)


def say(text: str) -> None:
    """One line on standard error."""
    click.echo(f"stewart-drake: {' '.join(text.split())}", err=True)


def tell(text: str) -> None:
    """What a command has written, and what to do with it: a line beside the tables."""
    if not _asked(QUIET):
        click.echo(text, err=_asked(AS_JSON) is not None)


def console(stderr: bool = False) -> Any:
    from rich.console import Console

    return Console(stderr=stderr, highlight=False)


@contextmanager
def progress_bar(title: str, total: float, unit: str = "s") -> Iterator[Callable[..., None]]:
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
        disable=bool(_asked(QUIET)),
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
def shown_compiling() -> Iterator[None]:
    """A line that moves with every law that numba compiles, where the cache does not have it; nothing where it has."""
    from numba.core import event
    from rich.status import Status

    if _asked(QUIET):
        yield
        return
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

    with event.install_listener("numba:compile", Line()), status:
        status.stop()
        yield


def drop_output() -> None:
    """From here on standard output goes nowhere, so that its buffer does no harm at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def print_table(
    title: str,
    rows: Iterable[Sequence[Any]],
    header: Sequence[str] = ("", ""),
    numbers: Collection[int] | None = None,
    data: Any = None,
) -> None:
    """A table on standard output, with as many of its columns as the terminal has room for.

    Columns `numbers` stand right and never fold, None for all but the first. With `--json` it is `data`, or where that
    is None the rows by their header.
    """
    if _asked(QUIET):
        return
    rows = [[str(cell) for cell in row] for row in rows]
    tables = _asked(AS_JSON)
    if tables is not None:
        plain = [[_plain(cell) for cell in row] for row in rows]
        named: Any = [dict(zip(header, row, strict=True)) for row in plain] if any(header) else dict(plain)
        tables[title] = named if data is None else data
        return
    from rich.markup import escape
    from rich.table import Table

    right = range(1, len(header)) if numbers is None else numbers
    terminal, least = console(), []
    for place, column in enumerate(zip(header, *rows, strict=True)):
        width = max(map(len, column))
        least.append(3 + (width if place in right and any(header) else min(width, _TEXT_WIDTH)))
    shown = max(2, sum(end < terminal.width for end in itertools.accumulate(least)))
    table = Table(title=escape(title), title_justify="left", show_header=any(header))
    for place, name in enumerate(header[:shown]):
        side: Any = "right" if place in right else "left"
        table.add_column(escape(name), justify=side, overflow="fold", no_wrap=place in right and any(header))
    for row in rows:
        table.add_row(*map(escape, row[:shown]))
    terminal.print(table)
    if shown < len(header):
        tell(f"a wider terminal, or --json, also shows: {', '.join(header[shown:])}")


def _plain(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


def print_json(tables: dict[str, Any]) -> None:
    """The tables of a command: one alone as it is, several by title."""
    click.echo(json.dumps(next(iter(tables.values())) if len(tables) == 1 else tables, indent=1, default=str))
