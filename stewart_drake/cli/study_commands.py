"""Commands of many runs: `sweep`, `compare`, `tune`, `faults`, `tuner`, `collect` and `train`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_table, progress_bar, say, tell
from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.outputs import prepare_file, prepare_folder
from stewart_drake.studies.workers import Workers

if TYPE_CHECKING:
    from stewart_drake.studies.study import Sheet, StudyResult

sized_option = click.option(
    "--robot", help="Name or YAML file; motions, loads and faults are scaled to it [default: the file's robot]."
)
quick_flag = click.option("--quick", is_flag=True, help="Few and short runs, for a first look.")


def study_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """What all commands of many runs take."""
    for option in (
        opt.trust_flag,
        click.option("--restart", is_flag=True, help="Start anew: ignore the finished runs of an earlier call."),
        click.option("--scheduler", metavar="ADDRESS", help="Run on a Dask cluster, e.g. tcp://host:8786."),
        click.option("--workers", type=click.IntRange(1, 1024), help="Processes [default: one per core, at most 8]."),
    ):
        function = option(function)
    return function


@contextmanager
def _under_way(
    name: str, runs: int, out: Path | None, workers: int | None, scheduler: str | None, restart: bool
) -> Iterator[tuple[Path, Workers, Callable[[float], None], bool]]:
    """The folder, where the runs go, what is told how many are done, and `restart`; Ctrl-C keeps what is done."""
    if scheduler is not None and workers is not None:
        allowed = "no value with --scheduler: the cluster sets the number of workers"
        raise ConfigurationError("--workers", workers, allowed)
    where = Workers(workers, scheduler)
    folder = prepare_folder(out if out is not None else Path("runs") / name)
    try:
        with where, progress_bar(name, float(runs), unit="runs") as advance:
            yield folder, where, advance, restart
    except KeyboardInterrupt:
        say(f"interrupted; finished runs are kept in {folder}; the same command continues")
        sys.exit(opt.EXIT_INTERRUPTED)


def _print_sheets(sheets: Sequence[Sheet], *lines: str | None) -> None:
    for each in sheets:
        print_table(each.title, each.rows, each.header)
    for line in lines:
        if line is not None:
            tell(line)


def _exit_if_refused(result: StudyResult) -> None:
    rows = [row for table in result.rows.values() for row in table]
    if all(row["status"] == "rejected" for row in rows):
        say(f"every run was refused, the first: {rows[0]['message']}")
        sys.exit(opt.EXIT_BAD_INPUT)


@command("sweep")
@click.argument("sweep", shell_complete=opt.names("sweeps"))
@opt.out_folder()
@click.option("--runs", type=click.IntRange(1), help="Number of runs, in place of the file's.")
@study_options
def sweep(sweep: str, runs: int | None, **options: Any) -> None:
    """SWEEP is a YAML file, or the name of a shipped one such as initial_offset.

    Writes sweep.parquet and .csv: one row per run, with random values, outcome and metrics. A run that is rejected,
    fails or crashes its worker also has a row, with the reason.
    """
    from stewart_drake.studies.study import run_study
    from stewart_drake.studies.sweep import load_sweep, summary

    loaded = load_sweep(sweep, runs)
    with _under_way(loaded.name, loaded.runs, **options) as way:
        result = run_study(loaded, *way)
    print_table(loaded.name, summary(result.rows["sweep"]))
    _print_sheets((), result.engine, f"table in {result.folder / 'sweep.parquet'}")
    _exit_if_refused(result)


@command("compare")
@click.argument("comparison", default="tracking", shell_complete=opt.names("comparisons"))
@opt.out_folder()
@quick_flag
@sized_option
@study_options
def compare(comparison: str, quick: bool, robot: str | None, **options: Any) -> None:
    """COMPARISON is a YAML file or one of tracking, controllers, fair, observer [default: tracking].

    Writes comparison.parquet, .csv and .md, bands.parquet and .csv (frequency response), and plots.
    """
    from stewart_drake.studies.comparison import load_comparison, write_pictures
    from stewart_drake.studies.study import run_study

    loaded = load_comparison(comparison, quick, robot)
    with _under_way(f"{loaded.name}{'-quick' if quick else ''}", loaded.runs, **options) as way:
        result = run_study(loaded, *way)
        write_pictures(loaded, result)
    _print_sheets(loaded.sheets(result.rows), result.engine, f"tables and pictures in {result.folder}")
    _exit_if_refused(result)


@command("tune")
@click.argument("comparison", shell_complete=opt.names("comparisons"))
@opt.out_folder()
@click.option("--controller", "controllers", multiple=True, metavar="NAME", help="Controller to tune [default: all].")
@click.option("--budget", type=click.IntRange(1), help="Evaluations for each controller, in place of the file's.")
@quick_flag
@study_options
def tune(comparison: str, controllers: tuple[str, ...], budget: int | None, quick: bool, **options: Any) -> None:
    """COMPARISON is a YAML file with the key `tune`, or a shipped name such as fair.

    Every controller gets the same search (CMA-ES) over the same runs. Then the controllers before and after the search
    are compared as in the file, in OUT/verdict-*. Writes tuned.yaml (for the key `tuned` of the comparison),
    tune.parquet and .csv (one row per evaluation), tune.md and tune.png.
    """
    from stewart_drake.studies.tune import load_tuning, run_tuning, write_picture

    loaded = load_tuning(comparison, controllers, budget, quick)
    with _under_way(f"{loaded.name}{'-tune-quick' if quick else '-tune'}", loaded.runs, **options) as way:
        result = run_tuning(loaded, *way)
        write_picture(result, way[0])
    where = f"settings in {way[0] / 'tuned.yaml'}, tables of the verdict in {result.verdict.folder}"
    _print_sheets(result.sheets, where)


@command("faults")
@opt.out_folder("runs/faults")
@quick_flag
@sized_option
@opt.overrides("estimator.kind=observer")
@study_options
def faults(quick: bool, robot: str | None, overrides: tuple[str, ...], **options: Any) -> None:
    """Writes faults.parquet, .csv and .md. --quick runs the platform at rest only, a third of the runs."""
    from stewart_drake.studies.faults import fault_study, holdable_lines, sheet
    from stewart_drake.studies.study import run_study

    plan = fault_study(quick, robot, overrides)
    with _under_way(plan.name, plan.runs, **options) as way:
        rows = run_study(plan, *way).rows["faults"]
    holdable = [f"  {line}" for line in holdable_lines(rows)]
    words = "with a dead motor, the wrench that the other five can hold at rest:"
    _print_sheets([sheet(rows)], words, *holdable, f"table in {way[0] / 'faults.md'}")


@command("tuner", kind=opt.Group)
def tuner() -> None:
    pass


@command("tuner show")
@click.argument("file", required=False, type=opt.PATH)
def show(file: Path | None) -> None:
    """FILE is a policy's weights file [default: the shipped one]."""
    from stewart_drake.control.policy import BOX_HEADER, default_policy_path, load_policy

    path = default_policy_path() if file is None else file
    policy = load_policy(path)
    print_table(f"{path.name}: settings, in decades above the default", policy.box_rows(), BOX_HEADER)
    print_table(path.name, policy.facts(), numbers=())


@command("tuner judge")
@click.argument("file", required=False, type=opt.PATH)
@opt.out_folder("runs/tuner-verdict")
@click.option("--seeds", type=click.IntRange(2), default=14, help="Situations of each kind and robot.")
@study_options
def judge(file: Path | None, seeds: int, **options: Any) -> None:
    """FILE is a policy's weights file [default: the shipped one].

    The situations are new to all of them, on Drake's plant. Writes verdict.md, .parquet, .csv and .png.
    """
    from stewart_drake.control.policy import load_policy
    from stewart_drake.training.benchmark import Baselines, assess, candidates, cells_for, write_picture

    load_policy(file)
    baselines = Baselines.load()
    policy = {"kind": "policy", **({} if file is None else {"weights_file": str(file)})}
    entered = candidates(baselines, {"policy": {"tuner": policy}, "schedule": {"tuner": baselines.schedule}})
    runs = len(entered) * len(cells_for()) * seeds
    with _under_way("tuner verdict", runs, **options) as way:
        verdict = assess(entered, way[0], seeds, "drake", *way[1:])
        write_picture(verdict, way[0])
    tell((way[0] / "verdict.md").read_text())


@command("collect")
@opt.out_file("runs/dataset.parquet")
def collect(out: Path) -> None:
    """Writes a Parquet file with 14,400 samples."""
    from stewart_drake.training.collect import collect_dataset

    prepare_file(out)
    with progress_bar("nine experiments", 9.0, unit="runs") as advance:
        dataset = collect_dataset(progress=advance, workers=Workers())
    dataset.save(out)
    tell(f"{len(dataset.inputs)} samples in {out}; next: stewart-drake train {out}")


@command("train")
@click.argument("dataset", type=opt.PATH, default="runs/dataset.parquet")
@opt.out_file("runs/tuner.json")
@click.option(
    "--tuner",
    type=click.Choice(["paper", "policy"]),
    default="paper",
    help="paper: the paper's network, on DATASET. policy: by evolution on the fast engine, an hour on two cores.",
)
@click.option("--seed", type=click.IntRange(0), default=0, help="Seed of everything random.")
def train(dataset: Path, out: Path, tuner: str, seed: int) -> None:
    """The paper's tuner is the 12-10-2 network, trained on DATASET by back-propagation.

    The policy is trained in the loop, on situations of two robots, on all cores. After an interruption the same command
    continues from the last generation.
    """
    title, rows = _train_policy(out, seed) if tuner == "policy" else _train_paper(dataset, out, seed)
    print_table(title, rows)


def _train_policy(out: Path, seed: int) -> tuple[str, list[tuple[str, str]]]:
    from stewart_drake.training.policy_training import PolicyOptions, train_policy

    prepare_file(out)
    options, state = PolicyOptions(seed=seed), out.with_name(f"{out.name}.state")
    with progress_bar("policy", float(options.generations), unit="generations") as advance:
        policy = train_policy(options, state, lambda done, word: advance(done, f"policy: {word}"))
    policy.save(out)
    card = policy.provenance
    ratios = {"all kinds": card["J_over_best_fixed"], **card["J_over_best_fixed_by_kind"]}
    title = f"cost J relative to the best fixed setting, on validation; policy in {out}"
    return title, [(name, f"{value:.3f}") for name, value in ratios.items()]


def _train_paper(dataset: Path, out: Path, seed: int) -> tuple[str, list[tuple[str, str]]]:
    from stewart_drake.training.collect import load_dataset
    from stewart_drake.training.train import TrainingOptions, train_network

    data, options = load_dataset(dataset), TrainingOptions(seed=seed)
    prepare_file(out)
    with progress_bar("training", float(options.epochs), unit="epochs") as advance:
        result = train_network(data, options, progress=advance)
    result.network.save(out)
    return f"tuner in {out}", [(name, f"{value:.4g}") for name, value in result.scores.items()]
