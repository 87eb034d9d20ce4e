"""A report as sections of text, tables and figures; written as Markdown and as one self-contained HTML page."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from stewart_drake.files.whole import read_checked, write_atomically

MAX_PICTURE_BYTES = 50_000_000


@dataclass(frozen=True)
class Text:
    """Paragraphs of Markdown."""

    markdown: str


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        caption: What it shows, and over what.
        columns: Headings, units included.
        rows: Cells as they are to be read; numbers are formatted by whoever makes the table.

    Raises:
        ValueError: A row has more or fewer cells than there are columns.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.caption!r}: {len(row)} cells under {len(self.columns)} columns: {row}")


@dataclass(frozen=True)
class Figure:
    """A picture.

    Attributes:
        caption: What it shows.
        file: Name of a PNG in the report's `figures` folder.
    """

    caption: str
    file: str


Item = Text | Table | Figure


@dataclass
class Section:
    """One claim of the paper and what came of it.

    Attributes:
        key: Short name, used for files.
        title: Heading.
        claim: What the paper says, with its equation or figure, in our words.
        verdict: One line: holds, holds in part, does not hold; and why.
        items: The evidence, in order.
        numbers: Every figure that other code or a test may want, by name.
        files: Other files that it left, relative to the report's folder.
    """

    key: str
    title: str
    claim: str
    verdict: str = ""
    items: list[Item] = field(default_factory=list)
    numbers: dict[str, Any] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)

    def text(self, markdown: str) -> None:
        """Adds paragraphs."""
        self.items.append(Text(markdown))

    def table(self, caption: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Adds a table; cells become text by `cell`."""
        self.items.append(Table(caption, tuple(columns), tuple(tuple(cell(v) for v in row) for row in rows)))

    def figure(self, caption: str, file: str) -> None:
        """Adds a picture that already lies in the report's `figures` folder."""
        self.items.append(Figure(caption, file))

    def to_json(self) -> str:
        """The section as JSON that `from_json` reads back.

        Raises:
            ValueError, TypeError: `numbers` holds NaN, an infinity or something that is no plain value.
        """
        items = [{"type": type(item).__name__, **asdict(item)} for item in self.items]
        return json.dumps({**{k: getattr(self, k) for k in _PLAIN}, "items": items}, indent=1, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Section:
        """The inverse of `to_json`.

        Raises:
            ValueError, KeyError, TypeError: Not a section.
        """
        document = json.loads(text)
        section = cls(**{k: document[k] for k in _PLAIN})
        for item in map(dict, document["items"]):
            kind = item.pop("type")
            if kind == "Table":
                item["columns"], item["rows"] = tuple(item["columns"]), tuple(tuple(row) for row in item["rows"])
            section.items.append({"Text": Text, "Table": Table, "Figure": Figure}[kind](**item))
        return section


_PLAIN = ("key", "title", "claim", "verdict", "numbers", "files")


def holds(parts: Iterable[bool]) -> str:
    """First words of a verdict on a claim of several parts: all of them hold, some do, or none."""
    held = list(parts)
    return "Holds" if all(held) else "Holds in part" if any(held) else "Does not hold"


def cell(value: object) -> str:
    """A table cell: four significant digits for a float, a dash for nothing."""
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def to_markdown(title: str, preface: str, sections: Sequence[Section]) -> str:
    """The whole report; pictures are links into `figures/`."""
    lines = [f"# {title}", "", preface, "", "| section | verdict |", "|---|---|"]
    lines += [f"| [{_in_row(s.title)}](#{_anchor(s.title)}) | {_in_row(s.verdict)} |" for s in sections]
    for section in sections:
        lines += ["", f"## {section.title}", "", f"**Claim.** {section.claim}", "", f"**Verdict.** {section.verdict}"]
        for item in section.items:
            lines += ["", *_item_lines(item)]
    return "\n".join(lines) + "\n"


def to_html(markdown: str, title: str, folder: Path) -> str:
    """The Markdown report as one page: pictures from `folder` inside it, nothing loaded from elsewhere.

    Raises:
        ConfigurationError: A picture cannot be read.
    """
    from markdown_it import MarkdownIt

    # No raw HTML: what stands in angle brackets is meant to be read.
    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(markdown)

    def inline(match: re.Match[str]) -> str:
        path = folder / unquote(html.unescape(match[1]))
        picture = read_checked(path, f"figure {path}", MAX_PICTURE_BYTES, "the picture that its section made")
        return f'src="data:image/png;base64,{base64.b64encode(picture).decode()}"'

    def heading(match: re.Match[str]) -> str:
        return f'<h2 id="{_anchor(html.unescape(re.sub("<[^>]*>", "", match[1])))}">{match[1]}</h2>'

    body = re.sub(r'src="(figures/[^"]+)"', inline, body)
    body = re.sub(r"<h2>(.*?)</h2>", heading, body)
    body = re.sub(r"<t([hd])>(.*?)</t\1>", _unbroken, body)
    body = body.replace("<table>", '<div class="wide"><table>').replace("</table>", "</table></div>")
    head, foot = _PAGE.split("{body}")
    return head.replace("{title}", html.escape(title)) + body + foot


def write_report(folder: Path, title: str, preface: str, sections: Sequence[Section]) -> None:
    """Writes report.md and report.html into `folder`, whose `figures` the sections refer to.

    Raises:
        ConfigurationError: A picture is missing, or the folder cannot be written to; of a missing one before anything
            is written.
    """
    markdown = to_markdown(title, preface, sections)
    page = to_html(markdown, title, folder)
    write_atomically(folder / "report.md", markdown.encode())
    write_atomically(folder / "report.html", page.encode())


def _item_lines(item: Item) -> list[str]:
    if isinstance(item, Text):
        return [item.markdown]
    if isinstance(item, Figure):
        alternative = re.sub(r"([\[\]])", r"\\\1", item.caption)
        return [f"![{alternative}](<figures/{item.file}>)", "", f"*{item.caption}*"]
    head, *rows = ("| " + " | ".join(map(_in_row, row)) + " |" for row in (item.columns, *item.rows))
    return [f"*{item.caption}*", "", head, "|" + "---|" * len(item.columns), *rows]


def _in_row(text: str) -> str:
    """Text as it must stand in a row of a table: one line, its pipes no borders."""
    # Not split(): that would break unbreakable spaces too.
    return re.sub(r"[ \t\r\n]+", " ", text).strip().replace("|", "\\|")


def _unbroken(cell: re.Match[str]) -> str:
    """A cell of the page whose numbers and units do not part at the end of a line."""
    text = re.sub(r"\[[^\]<]*\]", lambda unit: unit[0].replace(" ", "\u00a0"), cell[2])
    text = re.sub(rf"(?<=\d) (?=(?:{_UNITS})(?![\w/]))", "\u00a0", text)
    return f"<t{cell[1]}>{text}</t{cell[1]}>"


def _anchor(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


_UNITS = "%|deg|mm|m|s|ms|Hz|L|N m|rad/s|deg/s|mm/s"

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body { font: 16px/1.55 system-ui, sans-serif; color: #1d2530; background: #fff; max-width: 64rem; }
body { margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.9rem; line-height: 1.2; }
h2 { margin-top: 3rem; padding-top: .6rem; border-top: 1px solid #d5dae1; font-size: 1.4rem; }
h3 { font-size: 1.1rem; margin-top: 2rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; margin: .6rem 0 1.4rem; }
th, td { padding: .28rem .7rem; text-align: left; border-bottom: 1px solid #e4e8ed; vertical-align: top; }
th { border-bottom: 2px solid #98a3b3; }
img { max-width: 100%; height: auto; }
code { background: #f1f4f7; padding: .1em .3em; border-radius: 3px; }
em { color: #45505f; }
a { color: #0b5cad; }
</style>
</head> <body> {body} </body> </html>
"""
