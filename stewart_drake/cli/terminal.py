"""Output of commands on the terminal: progress bars, tables and lines; with `--json` the tables as JSON."""

from __future__ import annotations

import itertools
import json
import os
import signal
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from rich.console import Console, JustifyMethod
    from rich.progress import Progress

QUIET, AS_JSON = "stewart_drake.quiet", "stewart_drake.json"  # Keys of `--quiet` and `--json` in a command's context.
_MAX_WORD = 32  # Characters of a word that a folded column must hold in one line.


def _option(option: str) -> Any:
    context = click.get_current_context(silent=True)
    return None if context is None else context.meta.get(option)


def print_error(text: str) -> None:
    """One line on standard error."""
    with suppress(OSError):  # There is also the exit status.
        click.echo(f"stewart-drake: {' '.join(text.split())}", err=True)


def print_line(text: str) -> None:
    """One line on standard output, or on standard error with `--json`."""
    if not _option(QUIET):
        click.echo(text, err=_option(AS_JSON) is not None)


def console(stderr: bool = False) -> Console:
    from rich.console import Console

    return Console(stderr=stderr, highlight=False)


@contextmanager
def progress_bar(title: str, total: float, unit: str = "s") -> Iterator[Callable[..., None]]:
    """A bar of simulated seconds (or runs, epochs); yields a function of the completed amount and a new title."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    count = f"{{task.completed:.{2 if unit == 's' else 0}f}} / {{task.total:.{2 if unit == 's' else 0}f}} {unit}"
    columns = TextColumn("{task.description}"), BarColumn(), TextColumn(count), TimeElapsedColumn()
    # A refresh thread would slow the simulation.
    bar = Progress(
        *columns, TimeRemainingColumn(), console=console(stderr=True), disable=bool(_option(QUIET)), auto_refresh=False
    )
    task = bar.add_task(title, total=total)

    def advance(completed: float, now: str | None = None) -> None:
        # Not earlier: compilation has another bar.
        bar.start()
        bar.update(task, completed=completed, description=now, refresh=True)

    try:
        yield advance
    finally:
        # Otherwise `stop` prints an empty line.
        if bar.live.is_started:
            bar.stop()


def working(title: str) -> Progress:
    """A bar for work of unknown length, shown within the context."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns, terminal = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()), console(stderr=True)
    hidden = bool(_option(QUIET)) or not terminal.is_terminal
    bar = Progress(*columns, console=terminal, transient=True, disable=hidden)
    bar.add_task(title, total=None)
    return bar


@contextmanager
def shown_compiling() -> Iterator[None]:
    """A bar while numba compiles laws that are not in the cache.

    Ctrl-C acts after the function is compiled: within the compiler it would be lost.
    """
    from numba.core import event

    bar, depth, laws = working(""), 0, 0
    interrupts: list[tuple[int, FrameType | None]] = []
    handler = signal.getsignal(signal.SIGINT)

    class Line(event.Listener):
        def on_start(self, event: object) -> None:  # noqa: ARG002
            nonlocal depth, laws
            if depth == 0:
                _set_interrupt(lambda *received: interrupts.append(received))
            depth, laws = depth + 1, laws + 1
            bar.update(bar.task_ids[0], description=f"compiling, once on this machine: {laws} functions")
            bar.start()

        def on_end(self, event: object) -> None:  # noqa: ARG002
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


def _set_interrupt(handler: Callable[[int, FrameType | None], object] | int | None) -> None:
    # Only the main thread can set handlers, and handlers of C code cannot be set again.
    with suppress(ValueError, TypeError):
        signal.signal(signal.SIGINT, handler)


def drop_output() -> None:
    """Discards standard output, so that flushing its buffer at exit raises no error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def print_table(
    title: str,
    rows: Iterable[Sequence[object]],
    header: Sequence[str] = ("", ""),
    numbers: Collection[int] | None = None,
    data: object = None,
) -> None:
    """A table on standard output, with as many columns as fit into the terminal.

    Columns `numbers` are aligned right; by default all after the first that have a number, or all without a header.
    `--json` prints `data`, by default the rows by their header.
    """
    tables = _option(AS_JSON)
    if _option(QUIET) and tables is None:
        return
    texts = [[str(cell) for cell in row] for row in rows]
    if tables is not None:
        plain = [[_plain(cell) for cell in row] for row in texts]
        if data is None and any(header):
            data = [dict(zip(header, row, strict=True)) for row in plain]
        tables[title] = dict(plain) if data is None else data  # type: ignore[arg-type]
        return
    from rich.markup import escape
    from rich.table import Table

    right = numbers
    if right is None:
        columns = list(enumerate(zip(*texts, strict=True)))[1:]
        right = [k for k, cells in columns if not any(header) or any(map(_is_number, cells))]
    terminal, table = console(), Table(show_header=any(header))
    # Numbers are not folded.
    whole = [any(header) and place in right for place in range(len(header))]
    max_width = max(_MAX_WORD, terminal.width // 3)
    widths = [min(_least_width(*column), max_width) for column in zip(whole, header, *texts, strict=True)]
    shown = max(2, sum(end < terminal.width for end in itertools.accumulate(3 + width for width in widths)))
    room = terminal.width - 1 - sum(3 + width for width in widths[:shown])
    for place, (name, width, *cells) in enumerate(zip(header, widths, *texts, strict=True)):
        if place < shown:
            more = min(max(map(len, [name, *cells])) - width, max(room, 0))
            room -= more
            justify: JustifyMethod = "right" if place in right else "left"
            table.add_column(escape(name), justify=justify, overflow="fold", width=width + more)
    for row in texts:
        table.add_row(*map(escape, row[:shown]))
    terminal.print(title, style="bold", markup=False, soft_wrap=True)
    terminal.print(table)
    if shown < len(header):
        print_line(f"more columns in a wider terminal or with --json: {', '.join(header[shown:])}")


def _least_width(whole: bool, name: str, *cells: str) -> int:
    """Least width of a column whose cells are folded between words, or not at all if `whole`."""
    words = name.split() + [word for cell in cells for word in ([cell] if whole else cell.split())]
    return max(map(len, words), default=0)


def _plain(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


def _is_number(cell: str) -> bool:
    return isinstance(_plain(cell.lstrip("<")), float)


def print_json(tables: dict[str, object]) -> None:
    """The tables of a command as JSON, several by title; null for numbers that are not finite."""
    if tables:
        text = json.dumps(next(iter(tables.values())) if len(tables) == 1 else tables, default=str)
        click.echo(json.dumps(json.loads(text, parse_constant=lambda _: None), indent=1))
