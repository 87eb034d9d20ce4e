"""What the commands show on the terminal: progress bars and tables."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from stewart_drake.logs.metric_table import metrics_of
from stewart_drake.logs.outcomes import told

if TYPE_CHECKING:
    from stewart_drake.logs.log import SimulationLog
    from stewart_drake.planning.feasibility import FeasibilityReport


class ProgressBar:
    """A progress bar of simulated seconds (or of runs, epochs) on the terminal."""

    def __init__(self, title: str, total: float, quiet: bool, unit: str = "s") -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        digits = 2 if unit == "s" else 0
        self._bar = Progress(
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
        self._task = self._bar.add_task(title, total=total)

    def __enter__(self) -> Any:
        return self._advance

    def _advance(self, completed: float, title: str | None = None) -> None:
        # Only now: what is compiled first has a line of its own.
        self._bar.start()
        self._bar.update(self._task, completed=completed, description=title, refresh=True)

    def __exit__(self, *details: object) -> None:
        self._bar.stop()


@contextmanager
def shown_compiling(quiet: bool) -> Iterator[None]:
    """A line that moves with every law that numba compiles, where the cache does not have it; nothing where it has."""
    if quiet:
        yield
        return
    # numba takes half a second to import; what is run needs it too.
    from numba.core import event
    from rich.status import Status

    class Line(event.Listener):
        compiled = depth = 0
        status = Status("", console=console(stderr=True))

        def on_start(self, event: Any) -> None:  # noqa: ARG002
            self.compiled, self.depth = self.compiled + 1, self.depth + 1
            self.status.update(f"compiling, once on this machine: {self.compiled} laws")
            self.status.start()

        def on_end(self, event: Any) -> None:  # noqa: ARG002
            self.depth -= 1
            if self.depth == 0:
                self.status.stop()

    line = Line()
    with event.install_listener("numba:compile", line):
        try:
            yield
        finally:
            line.status.stop()


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Keeps numpy's and others' warnings about numbers that are not finite off the terminal: our checks find those.

    Python's own option -W shows them all the same.
    """
    with np.errstate(all="ignore"), warnings.catch_warnings():
        if not sys.warnoptions:
            warnings.simplefilter("ignore")
        yield


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


def print_table(title: str, rows: list[tuple[str, str]]) -> None:
    """A table of two columns on standard output."""
    print_columns(title, ("", ""), rows)


def print_columns(
    title: str, header: Sequence[str], rows: Iterable[Sequence[str]], numbers: Collection[int] | None = None
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


def print_margins(title: str, report: FeasibilityReport) -> None:
    """The smallest margin of a motion to each of its limits, with its time and place, on standard output."""
    rows = []
    for name, worst in report.smallest.items():
        allowed = f"{'>=' if '>=' in worst.allowed else '<='} {worst.bound:.4g} {worst.unit}"
        margin = f"{'broken ' if worst.margin < 0.0 else ''}{worst.margin:.4g}"
        rows.append((name, allowed, margin, f"{worst.time:.3f} s", worst.where))
    print_columns(title, ("limit", "allowed", "smallest margin", "at", "where"), rows, numbers=(1, 2, 3))


def print_run(log: SimulationLog, metrics: dict[str, Any], folder: Path) -> None:
    """How a run went, as a table."""
    rows = [
        ("status", told(log.status, log.reason)),
        ("simulated time", f"{log.end_time:.3f} s"),
    ]
    if log.scenario.plant.engine == "reduced":
        rows.append(("engine", "reduced, not Drake's plant"))
    for metric in metrics_of(log.scenario):
        value = metrics[metric.name]
        # A second half that was not reached is shown as a dash; weights that a run does not have are left out.
        if metric.label and (value is not None or metric.over.startswith("late")):
            rows.append((metric.label, metric.shown(value)))
    rows += [(f"warning: {w['name']}", f"{w['text']}, t = {w['time']:.3f} s") for w in metrics["warnings"]]
    factor = metrics["real_time_factor"]
    rows += [("real-time factor", "-" if factor is None else f"{factor:.2f}"), ("results in", str(folder))]
    print_table(log.scenario.name, rows)
