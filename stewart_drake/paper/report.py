"""A report as sections of Markdown and numbers; written as Markdown and as one self-contained HTML page."""

from __future__ import annotations

import base64
import html
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from stewart_drake.files.whole import read_checked, write_atomically
from stewart_drake.paper.rendering import environment, in_row

MAX_PICTURE_BYTES = 50_000_000
_UNITS = "%|deg|mm|m|s|ms|Hz|L|N m|rad/s|deg/s|mm/s"


@dataclass
class Section:
    """One claim of the paper and what came of it.

    Attributes:
        key: Short name, used for files.
        title: Heading.
        claim: What the paper says, with its equation or figure, in our words.
        verdict: One line: holds, holds in part, does not hold; and why.
        body: The evidence, as Markdown; pictures are links into `figures/`.
        numbers: Every figure that other code or a test may want, by name.
        files: What it left, pictures too, relative to the report's folder.
    """

    key: str
    title: str
    claim: str
    verdict: str
    body: str = ""
    numbers: dict[str, Any] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)

    def to_json(self) -> str:
        """The section as JSON that `from_json` reads back.

        Raises:
            ValueError, TypeError: `numbers` holds NaN, an infinity or something that is no plain value.
        """
        return json.dumps(asdict(self), indent=1, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> Section:
        """The inverse of `to_json`.

        Raises:
            ValueError, TypeError: Not a section.
        """
        return cls(**json.loads(text))


def to_markdown(title: str, preface: str, sections: Sequence[Section]) -> str:
    """The whole report; pictures are links into `figures/`."""
    lines = [f"# {title}", "", preface, "", "| section | verdict |", "|---|---|"]
    lines += [f"| [{in_row(s.title)}](#{_anchor(s.title)}) | {in_row(s.verdict)} |" for s in sections]
    for section in sections:
        lines += ["", f"## {section.title}", "", f"**Claim.** {section.claim}", "", f"**Verdict.** {section.verdict}"]
        lines += ["", section.body] if section.body else []
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
    return environment().get_template("page.html.j2").render(title=html.escape(title), body=body)


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


def _unbroken(cell: re.Match[str]) -> str:
    """A cell of the page whose numbers and units do not part at the end of a line."""
    text = re.sub(r"\[[^\]<]*\]", lambda unit: unit[0].replace(" ", "\u00a0"), cell[2])
    text = re.sub(rf"(?<=\d) (?=(?:{_UNITS})(?![\w/]))", "\u00a0", text)
    return f"<t{cell[1]}>{text}</t{cell[1]}>"


def _anchor(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
