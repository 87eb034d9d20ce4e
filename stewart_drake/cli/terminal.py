"""What the commands show on the terminal: bars of progress, tables, lines; with `--json` the tables as JSON."""

from __future__ import annotations

import itertools
import json
import os
import signal
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import click

QUIET, AS_JSON = "stewart_drake.quiet", "stewart_drake.json"
"""What the options `--quiet` and `--json` leave in a command's context."""
_WORD = 32  # Of a column that folds: as wide as its longest word, up to this


def _asked(option: str) -> Any:
    context = click.get_current_context(silent=True)
    return None if context is None else context.meta.get(option)


def say(text: str) -> None:
    """One line on standard error."""
    with suppress(OSError):  # The exit status counts too.
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
    """A bar of simulated seconds (or of runs, epochs); yields a function of how much is done, and of a new title."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    count = f"{{task.completed:.{2 if unit == 's' else 0}f}} / {{task.total:.{2 if unit == 's' else 0}f}} {unit}"
    columns = TextColumn("{task.description}"), BarColumn(), TextColumn(count), TimeElapsedColumn()
    # A refresh thread would take the interpreter from the simulation at every step.
    bar = Progress(
        *columns, TimeRemainingColumn(), console=console(stderr=True), disable=bool(_asked(QUIET)), auto_refresh=False
    )
    task = bar.add_task(title, total=total)

    def advance(completed: float, now: str | None = None) -> None:
        # Only now: what is compiled first has a line of its own.
        bar.start()
        bar.update(task, completed=completed, description=now, refresh=True)

    try:
        yield advance
    finally:
        # One that has not begun would end with an empty line.
        if bar.live.is_started:
            bar.stop()


def working(title: str) -> Any:
    """A bar that moves within the context, for work of unknown length; gone afterwards."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns, terminal = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()), console(stderr=True)
    hidden = bool(_asked(QUIET)) or not terminal.is_terminal
    bar = Progress(*columns, console=terminal, transient=True, disable=hidden)
    bar.add_task(title, total=None)
    return bar


@contextmanager
def shown_compiling() -> Iterator[None]:
    """A bar that moves while numba compiles, where the cache does not have a law; nothing where it has.

    Ctrl-C waits for the function: within the compiler it would be lost.
    """
    from numba.core import event

    bar, depth, laws = working(""), 0, 0
    interrupts: list[Any] = []
    handler = signal.getsignal(signal.SIGINT)

    class Line(event.Listener):
        def on_start(self, event: Any) -> None:  # noqa: ARG002
            nonlocal depth, laws
            if depth == 0:
                _set_interrupt(lambda *received: interrupts.append(received))
            depth, laws = depth + 1, laws + 1
            bar.update(bar.task_ids[0], description=f"compiling, once on this machine: {laws} functions")
            bar.start()

        def on_end(self, event: Any) -> None:  # noqa: ARG002
            nonlocal depth
            depth -= 1
            if depth == 0:
                bar.stop()
                _set_interrupt(handler)
                if interrupts and callable(handler):
                    handler(*interrupts.pop())

    with event.install_listener("numba:compile", Line()):
        try:
            yield
        finally:
            bar.stop()
            _set_interrupt(handler)


def _set_interrupt(handler: Any) -> None:
    # Another thread than the first gets no signals, and a handler of C's cannot be set again.
    with suppress(ValueError, TypeError):
        signal.signal(signal.SIGINT, handler)


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

    Columns `numbers` stand right, None for those after the first that have one; without a header all after it. With
    `--json` it is `data`, or where that is None the rows by their header.
    """
    tables = _asked(AS_JSON)
    if _asked(QUIET) and tables is None:
        return
    rows = [[str(cell) for cell in row] for row in rows]
    if tables is not None:
        plain = [[_plain(cell) for cell in row] for row in rows]
        if data is None and any(header):
            data = [dict(zip(header, row, strict=True)) for row in plain]
        tables[title] = dict(plain) if data is None else data  # type: ignore[arg-type]
        return
    from rich.markup import escape
    from rich.table import Table

    right = numbers
    if right is None:
        columns = list(enumerate(zip(*rows, strict=True)))[1:]
        right = [k for k, cells in columns if not any(header) or any(map(_is_number, cells))]
    terminal, table = console(), Table(show_header=any(header))
    # Numbers stay in one line.
    whole = [any(header) and place in right for place in range(len(header))]
    most = max(_WORD, terminal.width // 3)
    widths = [min(_least_width(*column), most) for column in zip(whole, header, *rows, strict=True)]
    shown = max(2, sum(end < terminal.width for end in itertools.accumulate(3 + width for width in widths)))
    room = terminal.width - 1 - sum(3 + width for width in widths[:shown])
    for place, (name, width, *cells) in enumerate(zip(header, widths, *rows, strict=True)):
        if place < shown:
            more = min(max(map(len, [name, *cells])) - width, max(room, 0))
            room -= more
            side: Any = "right" if place in right else "left"
            table.add_column(escape(name), justify=side, overflow="fold", width=width + more)
    for row in rows:
        table.add_row(*map(escape, row[:shown]))
    terminal.print(title, style="bold", markup=False, soft_wrap=True)
    terminal.print(table)
    if shown < len(header):
        tell(f"more columns in a wider terminal or with --json: {', '.join(header[shown:])}")


def _least_width(whole: bool, name: str, *cells: str) -> int:
    """Of a column whose cells are folded between words, or are kept whole."""
    words = name.split() + [word for cell in cells for word in ([cell] if whole else cell.split())]
    return max(map(len, words), default=0)


def _plain(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


def _is_number(cell: str) -> bool:
    return isinstance(_plain(cell.lstrip("<")), float)


def print_json(tables: dict[str, Any]) -> None:
    """The tables of a command: one alone as it is, several by title; null for what is no number."""
    if tables:
        text = json.dumps(next(iter(tables.values())) if len(tables) == 1 else tables, default=str)
        click.echo(json.dumps(json.loads(text, parse_constant=lambda _: None), indent=1))
