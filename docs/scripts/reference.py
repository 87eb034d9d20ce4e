"""Writes the reference pages of the site from the code: YAML keys, commands, Python; and a page for each linked file.

`conf.py` calls `write_all` before each build. The pages go to docs/reference and copies of the notebooks to
docs/notebooks; git ignores both.
"""

import re
from collections import defaultdict
from collections.abc import Iterator
from inspect import isclass
from pathlib import Path
from shutil import copytree, ignore_patterns, rmtree

import click
import yaml_keys

import stewart_drake
from stewart_drake.cli.app import cli

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
OUT = DOCS / "reference"
WIDTH = 84
"""Columns of a command's help."""
LINK = re.compile(r"\]\(((?:\.\./)+[^)#\s]+)(#[^)\s]*)?\)")
"""A link from a page upwards, to a file that may be outside of docs."""


def command_lines(command: click.Command, parent: click.Context | None, name: str) -> Iterator[str]:
    """What `--help` says of a command and of those below it."""
    context = command.make_context(
        name, [], parent, resilient_parsing=True, terminal_width=WIDTH, max_content_width=WIDTH
    )
    yield f"## {context.command_path}\n\n```text\n{command.get_help(context)}\n```\n"
    if isinstance(command, click.Group):
        for each in command.list_commands(context):
            yield from command_lines(command.get_command(context, each), context, each)


def python_lines() -> Iterator[str]:
    """What the package exports, by the room that it is from."""
    rooms = defaultdict(list)
    for name in stewart_drake.__all__:
        exported = getattr(stewart_drake, name)
        rooms[exported.__module__.split(".")[1]].append((name, exported))
    yield "# Python\n\nEvery name here is imported from `stewart_drake` itself.\n"
    for room, names in sorted(rooms.items()):
        yield f"## {room}\n\n```{{eval-rst}}"
        for name, exported in names:
            kind = "class" if isclass(exported) else "function"
            kind = "exception" if isclass(exported) and issubclass(exported, Exception) else kind
            # Keys of a section and fields of a tuple stand in the text of their class.
            described = getattr(exported, "__pydantic_fields__", getattr(exported, "_fields", ["__init__"]))
            # The last two are pydantic's.
            left_out = f"   :exclude-members: {', '.join([*described, 'model_config', 'model_post_init'])}\n"
            yield f".. auto{kind}:: stewart_drake.{name}\n" + f"   :members:\n{left_out}" * isclass(exported)
        yield "```\n"


def page_of(target: Path) -> Path | None:
    """The page of the site, from docs, that shows a file of the repository; None where there is no such file."""
    if not target.is_file():
        return None
    if target.is_relative_to(DOCS):
        return target.relative_to(DOCS)
    place = target.relative_to(ROOT)
    if place == Path("README.md"):
        return Path("index.md")
    return place if place.parts[0] == "notebooks" else Path("reference", "files", f"{place}.md")


def file_page(target: Path) -> str:
    """A page that shows a file; Markdown as it reads, anything else as it is."""
    if target.suffix == ".md":
        include = f"```{{include}} /../{target.relative_to(ROOT)}\n:relative-docs: docs/\n:relative-images:\n```"
        return f"---\norphan: true\n---\n{include}\n"
    text = f"---\norphan: true\nnosearch: true\n---\n# {target.name}\n\n`{target.relative_to(ROOT)}`\n\n"
    language = {".py": "python", ".yaml": "yaml"}.get(target.suffix, "text")
    return f"{text}```{{literalinclude}} /../{target.relative_to(ROOT)}\n:language: {language}\n:linenos:\n```\n"


def write_all() -> None:
    """Writes every page anew, and copies the notebooks to where Sphinx finds them."""
    rmtree(OUT, ignore_errors=True)
    OUT.mkdir()
    rmtree(DOCS / "notebooks", ignore_errors=True)
    copytree(ROOT / "notebooks", DOCS / "notebooks", ignore=ignore_patterns("runs", "*.gif", ".ipynb_checkpoints"))
    pages = {OUT / f"{name}.md": text for name, text in yaml_keys.pages()}
    pages[OUT / "commands.md"] = "\n".join(["# Commands\n", *command_lines(cli, None, "stewart-drake")])
    pages[OUT / "python.md"] = "\n".join(python_lines())
    for source in [*DOCS.glob("*.md"), *DOCS.glob("results/*.md"), *ROOT.glob("notebooks/**/*.ipynb")]:
        for link in LINK.finditer(source.read_text(encoding="utf-8")):
            page = page_of(target := (source.parent / link[1]).resolve())
            if page is not None and page.parts[0] == "reference":
                pages[DOCS / page] = file_page(target)
    for page, text in pages.items():
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text(text, encoding="utf-8")
