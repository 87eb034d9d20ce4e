"""The command group `tuner`: parse, call, print."""

from __future__ import annotations

from pathlib import Path

import click

from stewart_drake.runs.terminal import print_columns


@click.group()
def tuner() -> None:
    """Look at the tuners of settings."""


@tuner.command("show")
@click.argument("file", required=False, type=click.Path(path_type=Path))
def show(file: Path | None) -> None:
    """Print the card of a policy: its box, what it hears, and where it comes from. FILE [default: the shipped one].

    Exit status: 0 shown, 2 no policy file, or not as it was written.
    """
    from stewart_drake.control.policy import default_policy_path, load_policy
    from stewart_drake.control.policy_card import BOX_HEADER, box_rows, facts

    path = default_policy_path() if file is None else file
    policy = load_policy(path)
    print_columns(f"{path.name}: settings, decades above the base", BOX_HEADER, box_rows(policy))
    print_columns(path.name, ("", ""), facts(policy), numbers=())
