"""The command `check`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from stewart_drake.cli.common_options import OutPath, overrides
from stewart_drake.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.runs.terminal import print_margins


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
    from stewart_drake.families import user_parts
    from stewart_drake.files.whole import write_atomically
    from stewart_drake.files.yaml_files import to_yaml
    from stewart_drake.runs.motion_fit import fit_amplitude, fit_speed, motion_report
    from stewart_drake.scenario import load_scenario

    if out is not None and scale == retime:
        raise click.UsageError("--out needs one of --scale and --retime")
    loaded = load_scenario(scenario, overrides)
    for part in user_parts(loaded):
        part.code.find(part.code_key)
    for code in dict.fromkeys(part.code for part in user_parts(loaded)):
        asks = "" if code.trusted else "; `run` asks for --trust-code"
        click.echo(f"runs code: {code.file}:{code.name}{asks}")
    if user_parts((loaded.reference, loaded.safety)):
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
        write_atomically(out, to_yaml(loaded.replace(changes).to_dict()).encode())
        found.append(f"scenario in {out}")
    # Last, so that a reader who leaves early costs nothing but the text.
    print_margins(f"{loaded.name}, {loaded.duration:g} s", report)
    for line in found:
        click.echo(line)

    from stewart_drake.runs.simulation import check_scenario

    check_scenario(loaded)
