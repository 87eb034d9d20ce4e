"""Commands on one scenario: `run`, `check`, `margins`, `bode`, `step`, `workspace`; and `reproduce`."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path

import click
import numpy as np

from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.config import number_in, to_plain
from stewart_drake.base.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.base.families import user_parts
from stewart_drake.base.keys import join_or
from stewart_drake.base.tables import COORDINATES, numbers_to_csv
from stewart_drake.base.yaml_files import read_mapping, to_yaml
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_error, print_line, print_table, progress_bar, shown_compiling, working
from stewart_drake.control.adaptation import (
    has_learnt,
    last_learnt,
    machine_text,
    model_of,
    rows_of,
)
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.metrics import metrics_of, run_metrics
from stewart_drake.logs.outcomes import describe_outcome
from stewart_drake.runs.outputs import (
    check_run_folder,
    draw_run,
    new_run_folder,
    prepare_file,
    prepare_folder,
    save_run,
    write_text,
)
from stewart_drake.scenario.scenario import Scenario, load_driven, load_scenario

_LEARNT_OF = "learnt_of"  # Key of a file of `--keep-model`: see `machine_text`.


@command(
    "run",
    out=opt.option("Folder for the results [default: runs/NAME, or runs/NAME-2, ...].", opt.PATH),
)
def run(
    scenario: str,
    out: Path | None,
    overrides: tuple[str, ...],
    force: bool,
    keep_model: Path | None,
    plots: bool,
    video: Path | None,
    trust_code: bool,
) -> None:
    """SCENARIO is a YAML file, or the name of a shipped one such as paper_fig7."""
    from stewart_drake.runs.checks import check_scenario, refuse_unrunnable
    from stewart_drake.runs.simulation import run as simulate
    from stewart_drake.runs.simulation import run_of

    loaded = load_learnt(load_scenario, scenario, overrides, keep_model, trust_code)
    if out is not None:
        check_run_folder(loaded, out, force)
    if video is not None:
        from stewart_drake.runs.pictures import check_film

        check_film(video)
    refuse_unrunnable(loaded)
    with shown_compiling():
        check_scenario(loaded)
    prepared = run_of(loaded)
    graph = prepared.graph()
    # Files are written only after all checks.
    if video is not None:
        prepare_file(video)
    if keep_model is not None:
        prepare_file(keep_model, "--keep-model")
    with new_run_folder(loaded, out, force) as claimed:
        with shown_compiling(), progress_bar(loaded.name, loaded.duration) as advance:
            log = simulate(loaded, progress=advance, check=False, prepared=prepared)
        place = write_results(log, claimed, graph, plots=plots)
    save_learnt(log, keep_model)
    if (place / "replay.html").exists():
        other = "run exact_fig7" if loaded.name == "paper_fig7" else "live"
        print_line(f"open {place / 'replay.html'}; try: stewart-drake {other}")
    if video is not None and len(log.time):
        from stewart_drake.runs.pictures import write_film

        with progress_bar("film", log.end_time) as advance:
            write_film(log, video, progress=advance)
        print_line(f"film in {video}")
    exit_unless_completed(log, place == claimed)


def write_results(
    log: SimulationLog, claimed: Path, graph: str | None = None, machine: str = "", plots: bool = True
) -> Path:
    """Saves a log, prints its metrics and draws its pictures; returns the folder that was used."""
    place, problem = save_run(log, claimed)
    _print_run(log, place, machine)
    try:
        problem = problem or draw_run(log, place, graph, plots)
    except KeyboardInterrupt:
        print_error("pictures: interrupted")
        raise
    if problem:
        print_error(problem)
    return place


def load_learnt(
    load: Callable[[str, Iterable[str], bool], Scenario],
    scenario: str,
    overrides: Iterable[str],
    file: Path | None,
    trust_code: bool = False,
) -> Scenario:
    """Loads a scenario, with the `model` that an earlier run saved in `file`, if it exists.

    Raises a ConfigurationError if the scenario does not learn, or the model is that of another robot.
    """
    loaded = load(scenario, overrides, trust_code)
    if file is None:
        return loaded
    if loaded.adaptation is None or not loaded.adaptation.is_kept:
        kind = None if loaded.adaptation is None else loaded.adaptation.kind
        raise ConfigurationError(
            "adaptation.kind", kind, "regression, for --keep-model; try --set adaptation=regression"
        )
    if not file.exists():
        return loaded
    data, machine = read_mapping("model", file, 100), machine_text(loaded.controller_model)
    if (keys := set(data) - {"name", _LEARNT_OF}) != {"model"}:
        raise ConfigurationError(f"--keep-model {file}", join_or(sorted(map(str, keys))), "a file with `model` alone")
    if (learnt_of := data.get(_LEARNT_OF, machine)) != machine:
        allowed = f"what was learnt of this robot and its motors, {machine}, or a new file"
        raise ConfigurationError(f"--keep-model {file}", learnt_of, allowed)
    # The model does not change the simulated robot.
    learnt = load(scenario, (f"model={json.dumps(data['model'])}", *overrides), trust_code)
    return learnt.replace({"robot": loaded.robot, "motors": loaded.motors})


def save_learnt(log: SimulationLog, file: Path | None) -> None:
    """Saves the learnt parameters in a file for the next run, unless the run failed or was stopped."""
    if file is None or not len(log.time):
        return
    if log.status not in ("completed", "interrupted"):
        print_error(f"nothing saved in {file}: the result of a run that was not completed may be wrong")
        return
    if not has_learnt(log):
        print_error(
            f"nothing saved in {file}: nothing was learnt; the robot must move, and `adaptation` must not be frozen"
        )
        return
    model = log.scenario.model.given() | model_of(last_learnt(log), log.scenario.controller_model)
    write_text(file, to_yaml({_LEARNT_OF: machine_text(log.scenario.controller_model), "model": to_plain(model)}))
    print_line(f"learnt model in {file}; the next run with --keep-model {file} starts with it")
    if (learning := log.scenario.adaptation) and (key := learning.forgets):
        print_line(f"adaptation.{key} starts without friction nevertheless: --set adaptation.{key}=false")


def exit_unless_completed(log: SimulationLog, in_place: bool) -> None:
    """Exits with an error status if the run was not completed, or its results are in another folder."""
    if log.status != "completed":
        message = (log.message or "").removeprefix(f"{log.reason}: ")
        print_error(f"{describe_outcome(log.status, log.reason, log.outcome_time)}: {message}")
        sys.exit(opt.EXIT_INTERRUPTED if log.status == "interrupted" else opt.EXIT_RUN_FAILED)
    if not in_place:
        # The disk was full.
        sys.exit(opt.EXIT_RUN_FAILED)


def _print_run(log: SimulationLog, place: Path, machine: str) -> None:
    metrics = run_metrics(log)
    rows = [("status", describe_outcome(log.status, log.reason)), ("time", f"{log.end_time:.3f} s")]
    if machine:
        rows.append(("machine", machine))
        late = 1e3 * np.quantile(log["lateness"], [0.5, 0.999]) if len(log.time) else np.zeros(2)
        rows.append(("lateness of a tick, median, 99.9 %", f"{late[0]:.3f}  {late[1]:.3f} ms"))
    elif not log.scenario.plant.in_diagram:
        rows.append(("plant", f"{log.scenario.plant.kind}, not Drake's"))
    if note := getattr(log.scenario.reference, "note", ""):
        rows.append(("reference", note))
    for metric in metrics_of(log.scenario):
        value = metrics[metric.name]
        # A dash if the second half was not reached; without weights, their lines are left out.
        if metric.label and (value is not None or metric.over.startswith("second_half")):
            rows.append((metric.label, metric.shown(value)))
    if log.learns and len(log.time):
        rows += rows_of(last_learnt(log))
    rows += [(f"warning: {entry['name']}", f"{entry['text']}, t = {entry['time']:.3f} s") for entry in log.warnings]
    factor = metrics["real_time_factor"]
    rows += [("real-time factor", "-" if factor is None else f"{factor:.2f}"), ("results in", str(place))]
    print_table(log.scenario.name, rows, data=metrics)


@command(
    "check",
    out=opt.option("Write the feasible scenario; needs --scale or --retime.", opt.OUT_FILE),
)
def check(
    scenario: str, overrides: tuple[str, ...], scale: bool, retime: bool, out: Path | None, trust_code: bool
) -> None:
    """The check covers the whole run of SCENARIO, or of a controller's file. User code is named but not run.

    `plant_torque` includes payload, friction and disturbances, which the controller does not know. Exit status 2: the
    motion is infeasible, or the plant needs more torque than the motors have.
    """
    from stewart_drake.runs import checks

    if out is not None and scale == retime:
        raise click.UsageError("--out needs either --scale or --retime")
    loaded = load_driven(scenario, overrides, trust_code)
    for part in user_parts(loaded):
        part.code.find(part.code_key)
    for code in dict.fromkeys(part.code for part in user_parts(loaded)):
        hint = "" if code.trusted else "; `run` needs --trust-code for it"
        print_line(f"runs code: {code}{hint}")
    if user_parts((loaded.reference, loaded.safety, loaded.base)):
        if scale or retime:
            allowed = "a motion and monitors of the package for --scale and --retime; check does not run user code"
            raise ConfigurationError("SCENARIO", scenario, allowed)
        print_line("the motion or a monitor is user code, which check does not run; `run` checks the motion first")
        return
    rows, numbers, plant = [], {}, checks.plant_report(loaded)
    for name, worst in {**checks.motion_report(loaded).smallest, **plant.smallest}.items():
        allowed = f"{'>=' if '>=' in worst.allowed else '<='} {worst.bound:.4g} {worst.unit}"
        margin = f"{'broken ' if worst.margin < 0.0 else ''}{worst.margin:.4g}"
        rows.append((name, allowed, margin, f"{worst.time:.3f} s", worst.where))
        numbers[name] = asdict(worst) | {"unit": worst.unit}
    header = ("limit", "allowed", "smallest margin", "at", "where")
    print_table(f"{loaded.name}, {loaded.duration:g} s", rows, header, numbers=(1, 2, 3), data=numbers)
    if note := getattr(loaded.reference, "note", ""):
        print_line(f"reference: {note}")
    print_line("to explain the limits: stewart-drake explain limits")
    models = ("", "simulated", "model")
    print_table("the robot and the controller's model of it", checks.compared_with_model(loaded), models, numbers=())
    changes = _feasible_changes(loaded, scale, retime)
    if out is not None and changes:
        write_atomically(out, to_yaml(loaded.replace(changes).to_dict()).encode())
        print_line(f"scenario in {out}")
    checks.check_scenario(loaded)
    plant.raise_if_infeasible()


def _feasible_changes(loaded: Scenario, scale: bool, retime: bool) -> dict[str, object]:
    """Keys that make the motion of a scenario feasible, smaller or slower; prints the factor."""
    from stewart_drake.runs.checks import fit_amplitude, fit_speed

    motion = (loaded.robot, loaded.limits, loaded.reference, loaded.duration, loaded.gravity_in_base)
    changes: dict[str, object] = {}
    if scale:
        try:
            with working("looking for the largest size"):
                changes["reference"], factor = fit_amplitude(*motion)
            print_line(f"feasible at {factor:.4f} of its size")
        except InfeasibleReferenceError as error:
            print_line(f"infeasible at every size; even at rest in its centre, {error}")
    if retime:
        try:
            with working("looking for the highest speed"):
                changes["reference"], factor = fit_speed(*motion)
            changes["duration"] = duration = factor * loaded.duration
            slower = f"feasible {factor:.4f} times slower, over {duration:.4g} s"
            print_line("feasible at its speed" if factor == 1.0 else slower)
        except InfeasibleReferenceError as error:
            print_line(f"infeasible at every speed; even at rest, {error}")
    return changes


_QUICK_POSES = 50


@command(
    "margins",
    scenario="exact_breathing",
    out="runs/margins",
    quick=opt.switch(f"At most {_QUICK_POSES} poses, for a first look."),
    example="estimator.kind=observer",
)
def margins(scenario: str, out: Path, poses: int, quick: bool, overrides: tuple[str, ...], trust_code: bool) -> None:
    """SCENARIO is a file or a shipped name [default: exact_breathing].

    The loop with sensors, estimator, controller and delay is linearised at rest and opened at the six motor torques.
    The margins are gain, phase, delay and disk margins, one motor at a time and all at once. The random poses are up to
    30 deg about every axis, 60 mm in X and Y and 50 mm in Z from home, within the scenario's limits; lengths scale with
    the robot. Friction, learning, saturation, a dead band, encoder resolution and an inertial sensor are left out;
    weights keep their start values. Writes margins.json and margins.png.
    """
    from stewart_drake.analysis.linear_loop import linear_loops, poses_to_stand_at

    loaded = load_scenario(scenario, overrides, trust_code)
    chosen = poses_to_stand_at(loaded, min(poses, _QUICK_POSES) if quick else poses, 0)
    with shown_compiling(), progress_bar("margins", float(len(chosen)), unit="poses") as advance:
        loops = linear_loops(loaded, chosen, advance)
    folder = prepare_folder(out)

    from stewart_drake.analysis import margins as report
    from stewart_drake.plotting.model_plots import plot_margins

    margins = report.loop_margins(loops)
    numbers = report.document(loops, margins)
    write_atomically(folder / "margins.json", (json.dumps(numbers, indent=1, allow_nan=False) + "\n").encode())
    plot_margins(margins, folder / "margins.png")
    title = f"{loaded.name}: margins at {len(loops.poses)} poses, beside {loaded.loop_delay} ticks of delay"
    print_table(title, report.table(margins, loops.period), report.HEADER, data=numbers)
    print_table("poses", [*report.facts(loops, margins), ("results in", str(folder))])


@command("bode", scenario="exact_breathing", out="runs/bode", example="estimator.kind=observer")
def bode(scenario: str, out: Path, overrides: tuple[str, ...], trust_code: bool) -> None:
    """SCENARIO is a file or a shipped name [default: exact_breathing].

    The loop of `margins` at the initial pose: singular values of the loop gain, of the sensitivity and of
    the complementary sensitivity. Writes bode.png and bode.csv.
    """
    from stewart_drake.analysis import response
    from stewart_drake.plotting.model_plots import plot_bode

    loaded = load_scenario(scenario, overrides, trust_code)
    with shown_compiling():
        found = response.bode(loaded)
    folder = prepare_folder(out)
    plot_bode(found, folder / "bode.png")
    names = ("loop", "sensitivity", "complementary")
    gains = {name: found.gains(name) for name in names}
    columns = [("frequency", "Hz"), *((f"{name}_{k}", "1") for name in names for k in range(6))]
    table = numbers_to_csv(columns, np.column_stack([found.frequency, *gains.values()]))
    write_text(folder / "bode.csv", table)
    low, high = found.crossover
    rows = [("gains of the loop fall below 1 at", f"{low:.3g} to {high:.3g} Hz")]
    rows += [(f"largest {name}", f"{gains[name].max():.3g}") for name in names[1:]]
    print_table(f"{loaded.name}: loop, opened at the motors", [*rows, ("results in", str(folder))])


@command(
    "step",
    scenario="exact_breathing",
    out="runs/step",
    axis=opt.option("Coordinate.", click.Choice(COORDINATES), default="Z"),
    size=opt.option("Size, e.g. '1 mm' or '1 deg' [default: 0.01 rad, or 0.01 of the robot's size]."),
)
def step(scenario: str, out: Path, axis: str, size: str | None, overrides: tuple[str, ...], trust_code: bool) -> None:
    """SCENARIO is a file or a shipped name [default: exact_breathing].

    A run of the whole loop that starts with an offset from the pose to hold. Writes step.png.
    """
    from stewart_drake.plotting.model_plots import plot_step
    from stewart_drake.runs import step_response

    loaded = load_scenario(scenario, overrides, trust_code)
    unit = "rad" if axis in COORDINATES[:3] else "m"
    with shown_compiling():
        found = step_response.step(loaded, axis, None if size is None else number_in("--size", size, unit))
    folder = prepare_folder(out)
    plot_step(found, f"{loaded.name}: step of {axis}", folder / "step.png")
    data = {name: to_plain(getattr(found, name)) for name in ("rise_time", "overshoot", "settling_time")}
    print_table(f"{loaded.name}: step of {axis}", [*found.rows(), ("results in", str(folder))], data=data)


@command(
    "workspace",
    out="runs/workspace",
    scenario=opt.option("Scenario with the robot, limits and controller.", default="paper_fig7"),
    example="limits.clearance=0.01",
)
def workspace(out: Path, samples: int, scenario: str, overrides: tuple[str, ...], trust_code: bool) -> None:
    """Writes workspace.json and figures/.

    There are two workspaces: positions at the home orientation, and orientations at the home position. Both respect
    reach, joint swing, clearance, conditioning and motor torque, and distinguish serial from parallel singularities.
    A third part shows which states and torques some motions visit.
    """
    from stewart_drake.analysis.workspace import KINDS, check_center, slices, study_poses
    from stewart_drake.plotting import save_figure
    from stewart_drake.plotting.workspace_plots import plot_capability
    from stewart_drake.runs.checks import check_scenario
    from stewart_drake.studies.visited import motion_numbers

    base = load_scenario(scenario, overrides, trust_code)
    check_center(base.robot, base.robot.home_pose)
    base.tuner.network()
    try:
        check_scenario(base)
    except ConfigurationError as error:
        # A workspace needs no motion.
        print_error(f"the scenario's motion is left out: {error}")
    figures = prepare_folder(out / "figures", out)
    setup = base.robot, base.limits, base.gravity_in_base
    with progress_bar("workspace", 100.0, unit="%") as advance:
        numbers, surveys = study_poses(
            *setup, base.robot.home_pose, samples, 20_000, lambda share: advance(60.0 * share)
        )
        motions, draw = motion_numbers(base, progress=lambda share: advance(60.0 + 40.0 * share))
    numbers |= {"motions": motions}
    write_atomically(out / "workspace.json", (json.dumps(numbers, indent=1, allow_nan=False) + "\n").encode())
    save_figure(draw(), figures / "torques.png")
    for kind, shown in zip(KINDS, (-1, 2), strict=True):
        cut = slices(*setup, surveys[kind], 220)[shown]
        save_figure(plot_capability(cut), figures / f"{kind}-capability.png")
    rows = []
    for kind, scale, unit in (("position", 1e3, "L"), ("orientation", 100.0, "% of all")):
        space = numbers["workspaces"][kind]
        rows += [
            (f"{kind}s that the mechanism can reach", f"{scale * space['regular']:.3g} {unit}"),
            (f"{kind}s within all limits", f"{scale * space['connected']:.3g} {unit}"),
            (f"first limit on straight lines through {kind}s", next(iter(space["first"]), "none").replace("_", " ")),
        ]
    distance, angle = (numbers["workspaces"][kind]["inscribed_radius"] for kind in ("position", "orientation"))
    rows.append(("free distance in every direction", f"{1e3 * distance:.0f} mm, {math.degrees(angle):.0f} deg"))
    rows += [
        (f"peak torque of {name}", f"{motion['peak_torque']:.3f} N m, {motion['status']}")
        for name, motion in motions.items()
    ]
    print_table(f"numbers and figures in {out}", rows, data=numbers)


@command(
    "reproduce",
    quick=opt.switch("Smaller samples; takes a minute or two."),
    out=opt.option("Folder for numbers.json and figures/ [default: none is written].", opt.PATH),
)
def reproduce(quick: bool, out: Path | None) -> None:
    """Prints a table of claim, paper, ours, verdict, and all differences from the table recorded in the package."""
    from stewart_drake.paper.reproduce import differences, rows
    from stewart_drake.paper.reproduce import reproduce as results_of

    with progress_bar("reproduction", 100.0, unit="%") as advance:
        results = results_of(quick, out, lambda share, name: advance(100.0 * share, name.replace("_", " ")))
    claims = [claim for result in results.values() for claim in result.claims]
    print_table("The paper, claim by claim", rows(claims), ("claim", "paper", "ours", "verdict"))
    different = differences(claims, "quick" if quick else "full")
    for line in different:
        print_error(line)
    sys.exit(opt.EXIT_DIFFERENT if different else 0)
