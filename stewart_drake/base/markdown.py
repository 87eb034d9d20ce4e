"""Tables that people read, in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from decimal import Decimal
from typing import NamedTuple

MIN_SHOWN = 1e-5  # Smaller numbers are shown as less than this.


class TextTable(NamedTuple):
    """A table for a page or the terminal, with lines below it."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()

    def markdown(self) -> str:
        """With its title above it."""
        notes = "".join(f"\n- {note}" for note in self.notes) + "\n" * bool(self.notes)
        return f"**{self.title}**\n\n{markdown_table(self.header, self.rows)}\n{notes}"


def markdown_table(header: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """A table of any values: floats with four digits, a dash for None."""
    names = [_cell(name) for name in header]
    lines = [names, ["---"] * len(names), *([_cell(value) for value in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def number(value: float | None) -> str:
    """Three significant digits, without an exponent."""
    if value is None:
        return "-"
    if 0.0 < abs(value) < MIN_SHOWN:
        return f"<{MIN_SHOWN:.5f}"
    return format(Decimal(f"{value:.2e}"), "f")


def _cell(value: object) -> str:
    text = "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|")
