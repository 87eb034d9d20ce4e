"""The fault table: all runs, as Parquet and Markdown."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stewart_drake.campaigns.engine import Work, fill
from stewart_drake.campaigns.executors import Workplace
from stewart_drake.campaigns.fault import BY_NAME, DURATION, FAULTS, MOTIONS, ONSET, Fault
from stewart_drake.campaigns.fault_rows import COLUMNS, FaultRow, all_rows, named_row
from stewart_drake.campaigns.identity import identity
from stewart_drake.campaigns.row_store import Row, RowStore
from stewart_drake.campaigns.tables import markdown, to_arrow, write_table
from stewart_drake.errors import StewartDrakeError
from stewart_drake.files.whole import plain_json, write_atomically
from stewart_drake.logs.versions import collect_versions
from stewart_drake.runs.outputs import prepare_folder

QUICK_MOTIONS = ("hold",)


@dataclass(frozen=True)
class FaultTable:
    """The rows and where they are kept.

    Attributes:
        rows: In the order of `fault.FAULTS`, motion by motion.
        parquet: File with all columns of `FaultRow`.
        markdown: File with the short form and an explanation.
    """

    rows: tuple[FaultRow, ...]
    parquet: Path
    markdown: Path


def make_table(
    folder: str | Path,
    quick: bool = False,
    where: Workplace | Executor | None = None,
    progress: Callable[[float], None] | None = None,
    restart: bool = False,
) -> FaultTable:
    """Runs every fault during every motion and writes `faults.parquet`, `.csv` and `.md`; goes on where it was stopped.

    Args:
        folder: Where to.
        quick: The held platform alone.
        where: Where the runs go; None for processes of this machine.
        progress: Called with the number of rows done.
        restart: Throw away the rows that an earlier call left in the folder.

    Raises:
        ConfigurationError: The folder cannot be written to, is in use, or holds rows of another version.
        StewartDrakeError: A worker ended by itself, or a run raised what is no verdict on it; rows done are kept.
    """
    folder = prepare_folder(folder)
    parquet, markdown_file = folder / "faults.parquet", folder / "faults.md"
    wanted = {index: pair for index, pair in enumerate(all_rows()) if not quick or pair[1] in QUICK_MOTIONS}

    def work(index: int) -> Work:
        return _row, (index, *wanted[index])

    versions = collect_versions()
    with RowStore(folder, _identity(versions), restart, (parquet.name, "faults.csv", markdown_file.name)) as store:
        done = fill(store, wanted, work, where, progress)
        rows = tuple(FaultRow.from_plain(row) for row in done)
        write_table(
            to_arrow(COLUMNS, (row.plain() for row in rows), "faults", {"versions": versions}), folder, "faults"
        )
        write_atomically(markdown_file, markdown_table(rows).encode())
    return FaultTable(rows, parquet, markdown_file)


def _row(index: int, fault: str, motion: str) -> Row:
    """What a worker does: figures that are not finite become null where they are made."""
    try:
        return plain_json({"index": index, **named_row(fault, motion).plain()})
    except (StewartDrakeError, KeyboardInterrupt):
        raise
    except BaseException as error:  # SystemExit among them, which would end this process without a word
        raise StewartDrakeError(f"{fault}, {motion}: {type(error).__name__}: {error}") from error


def _identity(versions: Mapping[str, str | None]) -> dict[str, Any]:
    """What the rows depend on."""
    faults = hashlib.sha256(repr((FAULTS, MOTIONS, DURATION, ONSET)).encode()).hexdigest()[:24]
    return identity({"faults": faults}, versions=versions)


HEADERS = ("fault", *MOTIONS, "peak error", "travel", "peak torque")


def short_rows(rows: Sequence[FaultRow]) -> list[tuple[str, ...]]:
    """A line per fault, see `HEADERS`: how each motion ends, and the worst figures over the motions."""
    lines = []
    for fault in FAULTS:
        mine = {row.motion: row for row in rows if row.fault == fault.name}
        if mine:
            worst = [
                _largest(mine, names) for names in (("peak_error_deg", "peak_error_mm"), ("travel_deg", "travel_mm"))
            ]
            torque = _largest(mine, ("peak_torque",))
            ends = [_end(mine[motion]) if motion in mine else "-" for motion in MOTIONS]
            lines.append((fault.name, *ends, *worst, torque))
    return lines


TERSE_HEADERS = ("fault", "reaction", "outcome", "monitor", "ms", "deg", "mm", "N m")


def terse_rows(rows: Sequence[FaultRow]) -> list[tuple[str, ...]]:
    """A short line per fault for a terminal, see `TERSE_HEADERS`: what differs between motions stands side by side.

    Latency [ms] from the smallest to the largest; worst peak error [deg, mm] and torque [N m].
    """
    lines = []
    for name in dict.fromkeys(row.fault for row in rows):
        mine = [row for row in rows if row.fault == name]
        waits = [row.latency_ms for row in mine if row.latency_ms is not None] if _begins(name) else []
        ends = sorted({f"{wait:.0f}" for wait in (min(waits), max(waits))}, key=float) if waits else ["-"]
        most = [_most(mine, figure) for figure in ("peak_error_deg", "peak_error_mm", "peak_torque")]
        figures = ["-" if value is None else f"{value:.2f}" for value in most]
        words = ([getattr(row, key) or "-" for row in mine] for key in ("reaction", "status", "safety_monitor"))
        told = (" / ".join(texts if len(set(texts)) > 1 else texts[:1]) for texts in words)
        lines.append((name, *told, "-".join(ends), *figures))
    return lines


def holdable_lines(rows: Sequence[FaultRow]) -> list[str]:
    """What five motors hold, a line per dead motor and motion."""
    lines = []
    for row in rows:
        if row.holds_weight is None or row.support_newton is None:
            continue
        held = "none: not even the weight; smallest force from outside with which it would stand: "
        held += f"{row.support_newton:.1f} N"
        if row.holds_weight:
            held = f"{row.force_newton:.0f} N or {row.moment_newton_metre:.1f} N m"
        lines.append(f"{row.fault}, {row.motion}: {held}")
    return lines


def markdown_table(rows: Sequence[FaultRow]) -> str:
    """The table as a Markdown page."""
    page = [
        "# Fault table",
        "",
        f"{len(rows)} runs of {DURATION:g} s; faults begin at {ONSET:g} s, or are there from the start. The",
        "exact-model LQI at 1 kHz behind the safety layer with its defaults. In brackets: monitor, latency, leg;",
        "after the colon: the outcome of the run, and its warnings.",
        "Peak error: how far the true pose was from the reference while the controller was in charge. Travel: how far",
        "it went after the safety layer took over. The worst of the motions counts.",
        "",
        *markdown(HEADERS, short_rows(rows)),
        "",
        "With a dead motor, the wrench that the other five hold at rest:",
        "",
        *(f"- {line}" for line in holdable_lines(rows)),
        "",
        "What the faults are:",
        "",
        *(_told(BY_NAME[name]) for name in dict.fromkeys(row.fault for row in rows)),
        "",
        "Command: `stewart-drake faults`. All figures: `faults.parquet`.",
        "",
    ]
    return "\n".join(page)


def _told(fault: Fault) -> str:
    bound = "" if fault.within is None else f" (a monitor trips within {1e3 * fault.within:.0f} ms)"
    return f"- `{fault.name}`: {fault.text}{bound}"


def _end(row: FaultRow) -> str:
    status = "" if row.status is None else f": {row.status}"
    status += "" if row.warnings is None else f", {row.warnings.replace('_', ' ')}"
    if row.safety_monitor is None or row.latency_ms is None:
        return f"{row.reaction}{status}"
    leg = "" if row.safety_leg is None else f", leg {row.safety_leg}"
    # What chance brings, such as ticks lost in a row, has a time but no latency.
    when = f", {row.latency_ms:.0f} ms" if _begins(row.fault) else ""
    return f"{row.reaction} ({row.safety_monitor}{when}{leg}){status}"


def _begins(name: str) -> bool:
    return BY_NAME[name].since > 0.0


def _largest(rows: dict[str, FaultRow], names: Sequence[str]) -> str:
    units = {"deg": "deg", "mm": "mm", "torque": "N m"}
    most = ((units[name.rpartition("_")[2]], _most(rows.values(), name)) for name in names)
    return ", ".join(f"{value:.2f} {unit}" for unit, value in most if value is not None) or "-"


def _most(rows: Iterable[FaultRow], name: str) -> float | None:
    return max((value for row in rows if (value := getattr(row, name)) is not None), default=None)
