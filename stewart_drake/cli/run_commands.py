"""Commands on one scenario: `run`, `check`, `margins`, `workspace`; and `schema` and `reproduce`."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_table, progress_bar, say, shown_compiling, tell, working
from stewart_drake.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.families import user_parts
from stewart_drake.files.whole import write_atomically
from stewart_drake.files.yaml_files import to_yaml
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import metrics_of
from stewart_drake.logs.outcomes import told
from stewart_drake.runs.outputs import Results, prepare_folder, results_place, write_run
from stewart_drake.scenario import load_scenario


@command("run")
@click.argument("scenario", **opt.SCENARIO)
@click.option("--out", type=opt.PATH, help="Folder for the results [default: runs/NAME, or runs/NAME-2, ...].")
@opt.overrides()
@click.option("--force", is_flag=True, help="Replace the results of another scenario in the folder.")
@click.option("--video", type=opt.PATH, help="Write a film of the run too: FILE.gif, or FILE.mp4 where ffmpeg is.")
def run(scenario: str, out: Path | None, overrides: tuple[str, ...], force: bool, video: Path | None) -> None:
    """SCENARIO is a YAML file, or the name of a shipped one such as paper_fig7."""
    from stewart_drake.runs.checks import check_scenario, refuse_unrunnable
    from stewart_drake.runs.simulation import engine_of
    from stewart_drake.runs.simulation import run as simulate

    loaded = load_scenario(scenario, overrides)
    place = results_place(loaded, out, force)
    if video is not None:
        from stewart_drake.runs.pictures import check_film

        check_film(video)
    refuse_unrunnable(loaded)
    with shown_compiling():
        check_scenario(loaded)
    engine = engine_of(loaded)
    graph = engine.graph()
    # Only now, with everything checked, does anything appear on the disk.
    prepare_folder(place.parent, out)
    with shown_compiling(), progress_bar(loaded.name, loaded.duration) as advance:
        log = simulate(loaded, progress=advance, check=False, engine=engine)
    results = write_run(log, out, graph, force=force)
    if video is not None and len(log.time):
        from stewart_drake.runs.pictures import write_film

        with progress_bar("film", log.end_time) as advance:
            write_film(log, video, progress=advance)
    _print_run(log, results)
    if video is not None:
        tell(f"film in {video}")
    if log.status != "completed":
        why = (log.message or "").removeprefix(f"{log.reason}: ")
        say(f"{told(log.status, log.reason, log.outcome_time)}: {why}")
        sys.exit(opt.EXIT_INTERRUPTED if log.status == "interrupted" else opt.EXIT_RUN_FAILED)


def _print_run(log: SimulationLog, results: Results) -> None:
    metrics = results.metrics
    rows = [("status", told(log.status, log.reason)), ("simulated time", f"{log.end_time:.3f} s")]
    if log.scenario.plant.engine == "reduced":
        rows.append(("engine", "reduced, not Drake's plant"))
    for metric in metrics_of(log.scenario):
        value = metrics[metric.name]
        # A second half that was not reached is shown as a dash; weights that a run does not have are left out.
        if metric.label and (value is not None or metric.over.startswith("late")):
            rows.append((metric.label, metric.shown(value)))
    rows += [(f"warning: {each['name']}", f"{each['text']}, t = {each['time']:.3f} s") for each in log.warnings]
    factor = metrics["real_time_factor"]
    rows += [("real-time factor", "-" if factor is None else f"{factor:.2f}"), ("results in", str(results.folder))]
    print_table(log.scenario.name, rows, data=metrics)
    shown = results.folder / "replay.html"
    if shown.exists():
        other = "run exact_fig7" if log.scenario.name == "paper_fig7" else "live"
        tell(f"open {shown}; try: stewart-drake {other}")


@command("check")
@click.argument("scenario", **opt.SCENARIO)
@opt.overrides()
@click.option("--scale", is_flag=True, help="If it cannot be done, find how much smaller it can.")
@click.option("--retime", is_flag=True, help="If it cannot be done, find how much slower it can.")
@click.option("--out", type=opt.OUT_FILE, help="Write the scenario so made feasible; with one of --scale, --retime.")
def check(scenario: str, overrides: tuple[str, ...], scale: bool, retime: bool, out: Path | None) -> None:
    """The motion of SCENARIO over the whole run; its code is named and not run. Exit status 2: it cannot be done."""
    from stewart_drake.runs.checks import check_scenario, fit_amplitude, fit_speed, motion_report

    if out is not None and scale == retime:
        raise click.UsageError("--out needs one of --scale and --retime")
    loaded = load_scenario(scenario, overrides)
    for part in user_parts(loaded):
        part.code.find(part.code_key)
    for code in dict.fromkeys(part.code for part in user_parts(loaded)):
        asks = "" if code.trusted else "; `run` asks for --trust-code"
        tell(f"runs code: {code}{asks}")
    if user_parts((loaded.reference, loaded.safety)):
        if scale or retime:
            allowed = "a motion and monitors of the package, for --scale and --retime: check runs no user's code"
            raise ConfigurationError("SCENARIO", scenario, allowed)
        tell("the motion or a monitor is a user's code, which check does not run: `run` checks the motion first")
        return
    rows, numbers = [], {}
    for name, worst in motion_report(loaded).smallest.items():
        allowed = f"{'>=' if '>=' in worst.allowed else '<='} {worst.bound:.4g} {worst.unit}"
        margin = f"{'broken ' if worst.margin < 0.0 else ''}{worst.margin:.4g}"
        rows.append((name, allowed, margin, f"{worst.time:.3f} s", worst.where))
        numbers[name] = asdict(worst) | {"unit": worst.unit}
    header = ("limit", "allowed", "smallest margin", "at", "where")
    print_table(f"{loaded.name}, {loaded.duration:g} s", rows, header, numbers=(1, 2, 3), data=numbers)
    tell("stewart-drake explain limits: what each of them is")
    motion = (loaded.robot, loaded.limits, loaded.reference, loaded.duration, loaded.gravity)
    changes: dict[str, Any] = {}
    if scale:
        try:
            with working("looking for the largest size"):
                changes["reference"], factor = fit_amplitude(*motion)
            tell(f"feasible at {factor:.4f} of its size")
        except InfeasibleReferenceError as error:
            tell(f"feasible at no size; resting in its centre, {error}")
    if retime:
        try:
            with working("looking for the highest speed"):
                changes["reference"], factor = fit_speed(*motion)
            changes["duration"] = factor * loaded.duration
            tell(
                "feasible as fast as it is"
                if factor == 1.0
                else f"feasible {factor:.4f} times slower, over {changes['duration']:.4g} s"
            )
        except InfeasibleReferenceError as error:
            tell(f"feasible at no speed; standing still, {error}")
    if out is not None and changes:
        write_atomically(out, to_yaml(loaded.replace(changes).to_dict()).encode())
        tell(f"scenario in {out}")
    check_scenario(loaded)


@command("margins")
@click.argument("scenario", default="exact_breathing", **opt.SCENARIO)
@opt.out_folder("runs/margins")
@click.option("--poses", type=click.IntRange(1, 100_000), default=1000, help="Drawn from the near box.")
@opt.overrides("estimator.kind=observer")
def margins(scenario: str, out: Path, poses: int, overrides: tuple[str, ...]) -> None:
    """SCENARIO is a file or a shipped name [default: exact_breathing].

    At poses at rest the loop, with sensors, estimator, controller and delay, is broken at the six motors' torques:
    gain, phase, delay and disk margins, one motor at a time and all at once. The poses are drawn from the near box: up
    to 30 deg about each axis, 60 mm in X and Y and 50 mm in Z about home, shifts by the robot's size, within the
    scenario's limits. Friction, saturation and counts of encoders are not linear, and left out; weights stay as at the
    start. Writes margins.json and margins.png.
    """
    from stewart_drake.stability.linear_loop import linear_loops, poses_to_stand_at

    loaded = load_scenario(scenario, overrides)
    with shown_compiling(), working(f"{poses} poses"):
        loops = linear_loops(loaded, poses_to_stand_at(loaded, poses, 0))
    folder = prepare_folder(out)

    from stewart_drake.plotting.model_plots import plot_margins
    from stewart_drake.stability import margins as report

    found = report.loop_margins(loops)
    numbers = report.document(loops, found)
    write_atomically(folder / "margins.json", (json.dumps(numbers, indent=1, allow_nan=False) + "\n").encode())
    plot_margins(found, folder / "margins.png")
    title = f"{loaded.name}: margins at {len(loops.poses)} poses, beside {loaded.command_delay} ticks of delay"
    print_table(title, report.table(found, loops.period), report.HEADER, data=numbers)
    print_table("poses", [*report.facts(loops, found), ("results in", str(folder))])


@command("workspace")
@opt.out_folder("runs/workspace")
@click.option("--samples", type=click.IntRange(1000, 10**7), default=10**6, help="Poses in each of the two workspaces.")
@click.option("--scenario", default="paper_fig7", help="Take robot, limits and controller of this scenario.")
@opt.overrides("limits.clearance=0.01")
def workspace(out: Path, samples: int, scenario: str, overrides: tuple[str, ...]) -> None:
    """Writes workspace.json and figures/, about home.

    Positions at a fixed orientation and orientations at a fixed position, within reach, joint swing, clearance,
    conditioning and motor torque, with serial and parallel singularities told apart; and the region of states and
    torques that motions visit.
    """
    from stewart_drake.paper.reproduce import Study
    from stewart_drake.paper.workspace import motion_numbers
    from stewart_drake.planning.workspace import KINDS, check_center, slices, study_poses
    from stewart_drake.plotting import save_figure
    from stewart_drake.plotting.workspace_plots import plot_capability
    from stewart_drake.runs.checks import check_scenario

    base = load_scenario(scenario, overrides)
    check_center(base.robot, base.robot.home_pose)
    base.tuner.network()
    try:
        check_scenario(base)
    except ConfigurationError as error:
        # A region of poses needs no motion.
        say(f"left out is the scenario's own motion: {error}")
    figures = prepare_folder(out / "figures", out)
    of_base = base.robot, base.limits, base.gravity
    with progress_bar("workspace", 100.0, unit="%") as advance:
        numbers, surveys = study_poses(
            *of_base, base.robot.home_pose, samples, 20_000, lambda share: advance(60.0 * share)
        )
        motions, draw = motion_numbers(Study(base=base, progress=lambda share: advance(60.0 + 40.0 * share)))
    numbers |= {"motions": motions}
    write_atomically(out / "workspace.json", (json.dumps(numbers, indent=1, allow_nan=False) + "\n").encode())
    save_figure(draw(), figures / "torques.png")
    for kind, shown in zip(KINDS, (-1, 2), strict=True):
        cut = slices(*of_base, surveys[kind], 220)[shown]
        save_figure(plot_capability(cut), figures / f"{kind}-capability.png")
    rows = []
    for kind, scale, unit in (("position", 1e3, "L"), ("orientation", 100.0, "% of all")):
        found = numbers["workspaces"][kind]
        rows += [
            (f"{kind}s that the mechanism can reach", f"{scale * found['regular']:.3g} {unit}"),
            (f"{kind}s within all limits", f"{scale * found['connected']:.3g} {unit}"),
            (f"first limit on straight ways through {kind}s", next(iter(found["first"]), "none").replace("_", " ")),
        ]
    way, turn = (numbers["workspaces"][kind]["inscribed_radius"] for kind in ("position", "orientation"))
    rows.append(("free in every direction", f"{1e3 * way:.0f} mm, {math.degrees(turn):.0f} deg"))
    rows += [(f"torque of {name}", f"{of['peak_torque']:.3f} N m, {of['status']}") for name, of in motions.items()]
    print_table(f"numbers and figures in {out}", rows, data=numbers)


@command("reproduce")
@click.option("--quick", is_flag=True, help="Smaller sizes, a minute or two.")
@click.option("--out", type=opt.PATH, help="Folder for numbers.json and figures/ [default: none is written].")
def reproduce(quick: bool, out: Path | None) -> None:
    """A table of claim, paper, ours, verdict, compared with the one that this package has; what differs is named."""
    from stewart_drake.paper.reproduce import differences, rows
    from stewart_drake.paper.reproduce import reproduce as results_of

    if out is not None:
        prepare_folder(out)
    with progress_bar("reproduction", 100.0, unit="%") as advance:
        results = results_of(quick, out, lambda share, name: advance(100.0 * share, name.replace("_", " ")))
    claims = [claim for result in results.values() for claim in result.claims]
    print_table("The paper, claim by claim", rows(claims), ("claim", "paper", "ours", "verdict"))
    different = differences(claims, "quick" if quick else "full")
    for line in different:
        say(line)
    sys.exit(opt.EXIT_DIFFERENT if different else 0)
