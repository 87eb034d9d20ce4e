"""The words of the report: Jinja2 templates, one a section, that speak of the numbers they are given.

A template has the blocks `title`, `claim`, `verdict` and `body`. It is Markdown in which a paragraph may run over
several lines, a table needs no rule below its head, and `![caption](name)` shows a picture by its name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined


def render(template: str, block: str, figures: Mapping[str, str] | None = None, **values: Any) -> str:
    """One block of a template as tidy Markdown.

    Args:
        template: Name of a section, or `report`.
        block: Name of the block.
        figures: Name of a picture -> its file in the report's `figures` folder.
        values: What the template speaks of; by custom `n` are the section's numbers.

    Raises:
        jinja2.UndefinedError: The template speaks of a value that is not given.
        KeyError: It shows a picture that is not given.
        ValueError: A row of a table has more or fewer cells than its head.
    """
    found = environment().get_template(f"{template}.md.j2")
    return tidy("".join(found.blocks[block](found.new_context(values))), figures or {})


def _source(name: str) -> str:
    return without_tag_lines(files(__package__).joinpath("templates", name).read_text(encoding="utf-8"))


def without_tag_lines(text: str) -> str:
    """A template in which a tag alone on its line leaves no line; jinja's `trim_blocks` would join words at others."""
    return re.sub(r"(?m)^[ \t]*(\{%(?:(?!%\}).)*%\})[ \t]*\n", r"\1", text)


@cache
def environment() -> Environment:
    """The templates' surroundings: values are shown as `cell` does; `f` formats a number by a specification."""
    made = Environment(
        loader=FunctionLoader(_source),
        undefined=StrictUndefined,
        finalize=cell,
        autoescape=False,
    )
    made.filters |= {"f": formatted, "quantiles": quantiles, "in_row": in_row, "sentence": sentence}
    made.globals |= {"holds": holds, "row": row, "zip": zip, "degree": 180.0 / math.pi}
    return made


def holds(parts: Iterable[bool]) -> str:
    """First words of a verdict on a claim of several parts: all of them hold, some do, or none."""
    held = list(parts)
    return "Holds" if all(held) else "Holds in part" if any(held) else "Does not hold"


def cell(value: object) -> str:
    """A value as text: four significant digits for a float, a dash for nothing."""
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def formatted(value: float | None, specification: str, scale: float = 1.0) -> str:
    """A number times `scale` by a format specification, a dash for nothing."""
    return "-" if value is None else format(scale * value if scale != 1.0 else value, specification)


def quantiles(values: Iterable[float], specification: str, scale: float = 1.0, least: float = 0.0) -> str:
    """Quantiles as `median / 95 % / largest`; what is no more than `least` counts as zero, a dash for nothing."""
    return " / ".join(formatted(v, specification, scale) if v > least else "0" for v in values) or "-"


def sentence(words: str) -> str:
    """Words with a capital at their beginning."""
    return words[:1].upper() + words[1:]


def row(*cells: object) -> str:
    """A row of a table whose number of cells depends on the values."""
    return "| " + " | ".join(in_row(cell(value)) for value in cells) + " |"


def in_row(text: str) -> str:
    """Text as it must stand in a row of a table: one line, its pipes no borders."""
    # Not split(): that would break unbreakable spaces too.
    return re.sub(r"[ \t\r\n]+", " ", text).strip().replace("|", "\\|")


def tidy(text: str, figures: Mapping[str, str]) -> str:
    """Markdown of a rendered block: paragraphs, points of a list and rows of a table on one line each."""
    blocks = []
    for block in re.split(r"\n\s*\n", text.strip()):
        lines = [line for line in (re.sub(r"[ \t]+", " ", line).strip(" \t") for line in block.split("\n")) if line]
        whole = " ".join(lines)
        if whole.startswith("|"):
            blocks.append("\n".join(_table(lines)))
        elif picture := re.fullmatch(r"!\[(.*)\]\(([\w-]+)\)", whole):
            alternative = re.sub(r"([\[\]])", r"\\\1", picture[1])
            blocks += [f"![{alternative}](<figures/{figures[picture[2]]}>)", f"*{picture[1]}*"]
        elif whole.startswith("- "):
            blocks.append(re.sub(r"\n(?!- )", " ", "\n".join(lines)))
        else:
            blocks.append(whole)
    return "\n\n".join(blocks)


def _table(rows: list[str]) -> list[str]:
    """Rows with the rule below the head."""
    widths = [len(re.findall(r"(?<!\\)\|", line)) for line in rows]
    for line, width in zip(rows, widths, strict=True):
        if width != widths[0]:
            raise ValueError(f"{width - 1} cells under {widths[0] - 1} columns: {line}")
    return [rows[0], "|" + "---|" * (widths[0] - 1), *rows[1:]]
