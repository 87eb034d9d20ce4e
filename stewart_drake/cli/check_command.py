"""The command `check`: parse, call, print."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stewart_drake.cli.common_options import OutPath, overrides
from stewart_drake.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.runs.terminal import print_margins

if TYPE_CHECKING:
    from stewart_drake.scenario import Scenario


@click.command()
@click.argument("scenario")
@overrides()
@click.option("--scale", is_flag=True, help="If it cannot be done, find how much smaller it can.")
@click.option("--retime", is_flag=True, help="If it cannot be done, find how much slower it can.")
@click.option(
    "--out",
    type=OutPath(dir_okay=False),
    help="Write the scenario with the motion so made feasible; with one of --scale, --retime.",
)
def check(scenario: str, overrides: tuple[str, ...], scale: bool, retime: bool, out: Path | None) -> None:
    """Check the motion of SCENARIO against its limits, over the whole run, and name its code; nothing is run.

    Exit status: 0 it can be done as it stands, 2 it cannot, or bad input.
    """
    from stewart_drake.families import user_sources
    from stewart_drake.files.user_code import MAX_BYTES
    from stewart_drake.files.whole import read_checked
    from stewart_drake.runs.motion_fit import fit_amplitude, fit_speed, motion_report
    from stewart_drake.scenario import load_scenario

    if out is not None and scale == retime:
        raise click.UsageError("--out needs one of --scale and --retime")
    loaded = load_scenario(scenario, overrides)
    for code, file in dict.fromkeys((source.code, source.file) for source in user_sources(loaded)):
        click.echo(f"runs code: {code}")
        if file is not None:
            read_checked(file, f"code file {file}", MAX_BYTES)
    if user_sources((loaded.reference, loaded.safety)):
        if scale or retime:
            allowed = "a motion and monitors of the package, for --scale and --retime: check runs no user's code"
            raise ConfigurationError("SCENARIO", scenario, allowed)
        click.echo("the motion or a monitor is a user's code, which check does not run: `run` checks the motion first")
        return
    report = motion_report(loaded)
    motion = (loaded.robot, loaded.limits, loaded.reference, loaded.duration, loaded.gravity)
    changes: dict[str, Any] = {}
    found: list[str] = []
    if scale:
        try:
            changes["reference"], factor = fit_amplitude(*motion)
            found.append(f"feasible at {factor:.4f} of its size")
        except InfeasibleReferenceError as error:
            found.append(f"feasible at no size; resting in its centre, {error}")
    if retime:
        try:
            changes["reference"], factor = fit_speed(*motion)
            changes["duration"] = factor * loaded.duration
            found.append(f"feasible {factor:.4f} times slower, over {changes['duration']:.4g} s")
        except InfeasibleReferenceError as error:
            found.append(f"feasible at no speed; standing still, {error}")
    if out is not None and changes:
        _write_scenario(loaded.replace(changes), out)
        found.append(f"scenario in {out}")
    # Last, so that a reader who leaves early costs nothing but the text.
    print_margins(f"{loaded.name}, {loaded.duration:g} s", report)
    for line in found:
        click.echo(line)

    from stewart_drake.runs.simulation import check_scenario

    check_scenario(loaded)


def _write_scenario(scenario: Scenario, out: Path) -> None:
    """Writes a scenario with the controller's file, if it has one, beside it."""
    from stewart_drake.files.named_files import digest, take_code_along
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.files.yaml_files import to_yaml

    data, files = take_code_along(scenario.to_dict())
    for name, content in files.items():
        there = out.parent / name
        if there.exists() and digest(there) != hashlib.sha256(content).hexdigest():
            raise ConfigurationError("--out", str(out), f"a folder without another {name}, which would be lost")
        write_atomically(there, content)
    write_atomically(out, to_yaml(data).encode())
