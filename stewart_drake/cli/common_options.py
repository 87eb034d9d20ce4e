"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from stewart_drake.files.code import trusting_code

EXIT_INTERRUPTED = 130


class OutPath(click.Path):
    """Where to write; an empty text, as an unset variable of a shell gives it, is no place."""

    def __init__(self, **details: Any) -> None:
        super().__init__(path_type=Path, **details)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """As `click.Path`."""
        if value == "":
            self.fail("expected a path, got an empty text", param, ctx)
        return super().convert(value, param, ctx)


quiet_flag = click.option("--quiet", is_flag=True, help="No progress bar and no table.")
"""`--quiet`."""


def out_folder(default: str | None = None) -> Callable[[Any], Any]:
    """`--out DIR`."""
    if default is None:
        return click.option("--out", type=OutPath(), help="Folder for the results [default: runs/NAME].")
    return click.option("--out", type=OutPath(), default=default, show_default=True, help="Folder for the results.")


def out_file(default: str) -> Callable[[Any], Any]:
    """`--out FILE`."""
    kind = OutPath(dir_okay=False)
    return click.option("--out", type=kind, default=default, show_default=True, help="File to write.")


def trust_flag(function: Callable[..., Any]) -> Callable[..., Any]:
    """`--trust-code`."""

    @click.option(
        "--trust-code",
        is_flag=True,
        help="Run the code that the files and --set name.",
    )
    @wraps(function)
    def command(*args: Any, trust_code: bool, **options: Any) -> Any:
        with trusting_code(trust_code):
            return function(*args, **options)

    return command


def overrides(example: str = "duration=2") -> Callable[[Any], Any]:
    """`--set KEY=VALUE`."""
    return click.option(
        "--set", "overrides", multiple=True, metavar="KEY=VALUE", help=f"Change a key, e.g. --set {example}."
    )
