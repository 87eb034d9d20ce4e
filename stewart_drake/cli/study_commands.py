"""Commands of many runs: `sweep`, `compare`, `tune`, `faults`, `tuner`, `collect` and `train`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import StudyOptions, command
from stewart_drake.cli.terminal import print_error, print_line, print_table, progress_bar
from stewart_drake.runs.outputs import prepare_file, prepare_folder
from stewart_drake.studies.workers import Workers

if TYPE_CHECKING:
    from stewart_drake.base.markdown import TextTable
    from stewart_drake.studies.experiment import Result
    from stewart_drake.training.benchmark import PlantKind


@contextmanager
def _running(
    name: str, runs: int, out: Path | None, workers: int | None, scheduler: str | None, restart: bool
) -> Iterator[tuple[Path, Workers, Callable[[float], None], bool]]:
    """Arguments of `run_experiment` (folder, workers, progress, restart) within a progress bar."""
    if scheduler is not None and workers is not None:
        allowed = "no value with --scheduler: the cluster sets the number of workers"
        raise ConfigurationError("--workers", workers, allowed)
    where = Workers(workers, scheduler)
    folder = prepare_folder(out if out is not None else Path("runs") / name)
    try:
        with where, progress_bar(name, float(runs), unit="runs") as advance:
            yield folder, where, advance, restart
    except KeyboardInterrupt:
        print_error(f"interrupted; finished runs are kept in {folder}; the same command continues")
        sys.exit(opt.EXIT_INTERRUPTED)


def _print_sheets(sheets: Sequence[TextTable], *lines: str | None) -> None:
    for sheet in sheets:
        print_table(sheet.title, sheet.rows, sheet.header)
        for note in sheet.notes:
            print_line(note)
    for line in lines:
        if line is not None:
            print_line(line)


def _exit_if_refused(result: Result) -> None:
    rows = [row for table in result.rows.values() for row in table]
    if all(row["status"] == "rejected" for row in rows):
        print_error(f"every run was refused, the first: {rows[0]['message']}")
        sys.exit(opt.EXIT_BAD_INPUT)


@command("sweep")
def sweep(sweep: str, out: Path | None, runs: int | None, trust_code: bool, **options: Unpack[StudyOptions]) -> None:
    """SWEEP is a YAML file, or the name of a shipped one such as initial_offset.

    Writes sweep.parquet and .csv: one row per run, with random values, outcome and metrics. A run that is rejected,
    fails or crashes its worker also has a row, with the reason. sweep.png and .pdf show error against varied keys.
    """
    from stewart_drake.studies.experiment import refusals, run_experiment, write_figures
    from stewart_drake.studies.sweep import load_sweep, summary

    loaded = load_sweep(sweep, runs, trust_code)
    with _running(loaded.name, loaded.runs, out, **options) as arguments:
        result = run_experiment(loaded, *arguments)
        drawn = write_figures(loaded.figures(result.rows), result.folder)
    print_table(loaded.name, summary(result.rows["sweep"]))
    where = f"table{' and picture' if drawn else ''} in {result.folder}"
    _print_sheets((), *refusals(result.rows["sweep"]), result.compared, where)
    _exit_if_refused(result)


@command("compare", comparison="tracking")
def compare(
    comparison: str, out: Path | None, quick: bool, robot: str | None, trust_code: bool, **options: Unpack[StudyOptions]
) -> None:
    """COMPARISON is a YAML file or one of tracking, controllers, fair, observer, reachy [default: tracking].

    Writes comparison.parquet, .csv and .md, bands.parquet and .csv (frequency response), and plots.
    """
    from stewart_drake.studies.comparison import load_comparison
    from stewart_drake.studies.experiment import run_experiment, write_figures

    loaded = load_comparison(comparison, quick, robot, trust_code)
    with _running(f"{loaded.name}{'-quick' if quick else ''}", loaded.runs, out, **options) as arguments:
        result = run_experiment(loaded, *arguments)
        write_figures(loaded.figures(result.rows), result.folder)
    _print_sheets(loaded.sheets(result.rows), result.compared, f"tables and pictures in {result.folder}")
    _exit_if_refused(result)


@command("tune")
def tune(
    comparison: str,
    out: Path | None,
    controllers: tuple[str, ...],
    budget: int | None,
    quick: bool,
    trust_code: bool,
    **options: Unpack[StudyOptions],
) -> None:
    """COMPARISON is a YAML file with the key `tune`, or a shipped name such as fair.

    All controllers get the same search (CMA-ES) over the same runs. Then the controllers before and after the search
    are compared as in the file, in OUT/verdict-*. Writes tuned.yaml (for the key `tuned` of the comparison),
    tune.parquet and .csv (one row per evaluation), tune.md, and tune.png and .pdf.
    """
    from stewart_drake.studies.experiment import write_figures
    from stewart_drake.studies.tune import load_tuning, run_tuning

    loaded = load_tuning(comparison, controllers, budget, quick, trust_code)
    with _running(f"{loaded.name}{'-tune-quick' if quick else '-tune'}", loaded.runs, out, **options) as arguments:
        result = run_tuning(loaded, *arguments)
        write_figures(loaded.figures({"tune": result.rows}), arguments[0])
    where = f"settings in {arguments[0] / 'tuned.yaml'}, tables of the verdict in {result.test.folder}"
    _print_sheets(result.sheets, where)


@command("faults", out="runs/faults", example="estimator.kind=observer")
def faults(
    out: Path,
    quick: bool,
    robot: str | None,
    overrides: tuple[str, ...],
    trust_code: bool,
    **options: Unpack[StudyOptions],
) -> None:
    """Writes faults.parquet, .csv and .md. --quick runs the platform at rest only, a third of the runs."""
    from stewart_drake.studies.experiment import run_experiment
    from stewart_drake.studies.faults import fault_study, holdable_lines

    plan = fault_study(quick, robot, overrides, trust_code=trust_code)
    with _running(plan.name, plan.runs, out, **options) as arguments:
        rows = run_experiment(plan, *arguments).rows["faults"]
    holdable = [f"  {line}" for line in holdable_lines(rows)]
    words = "with a dead motor, the wrench that the other five can hold at rest:"
    _print_sheets([plan.sheet(rows)], words, *holdable, f"table in {arguments[0] / 'faults.md'}")


@command("tuner", kind=opt.Group)
def tuner() -> None:
    pass


@command("tuner show")
def show(file: Path | None) -> None:
    """FILE is a policy's weights file [default: the shipped one]."""
    from stewart_drake.control.policy import BOX_HEADER, Policy

    path = Policy.shipped if file is None else file
    policy = Policy.load(path)
    print_table(f"{path.name}: settings, in decades above the default", policy.box_rows(), BOX_HEADER)
    print_table(path.name, policy.facts(), numbers=())


@command(
    "tuner judge",
    out="runs/tuner-verdict",
    plant=opt.option("Engine of the runs.", click.Choice(["drake", "closed_form"]), default="drake"),
    only=opt.option("A candidate besides the policy and the best fixed setting [default: all].", multiple=True),
)
def judge(
    file: Path | None, out: Path, seeds: int, plant: PlantKind, only: tuple[str, ...], **options: Unpack[StudyOptions]
) -> None:
    """FILE is a policy's weights file [default: the shipped one].

    The situations are not those of the training. Writes verdict.md, .parquet, .csv, .png and .pdf.
    """
    from stewart_drake.control.policy import Policy
    from stewart_drake.studies.experiment import run_experiment, write_figures
    from stewart_drake.training.benchmark import BEST_FIXED, Baselines, candidates, evaluation

    Policy.load(file)
    policy = {"kind": "policy", **({} if file is None else {"weights_file": str(file)})}
    named = candidates(Baselines.load(), policy)
    kept = [name for name in named if not only or name in (BEST_FIXED, "policy", *only)]
    loaded = evaluation({name: named[name] for name in kept}, seeds, plant)
    with _running(loaded.name, loaded.runs, out, **options) as arguments:
        write_figures(loaded.figures(run_experiment(loaded, *arguments).rows), arguments[0])
    print_line((arguments[0] / "verdict.md").read_text(encoding="utf-8"))


@command("collect", out="runs/dataset.parquet")
def collect(out: Path) -> None:
    """Writes a Parquet file with 14,400 samples."""
    from stewart_drake.training.paper_network import collect_dataset

    prepare_file(out)
    with progress_bar("nine experiments", 9.0, unit="runs") as advance:
        dataset = collect_dataset(progress=advance, workers=Workers())
    dataset.save(out)
    print_line(f"{len(dataset.inputs)} samples in {out}; next: stewart-drake train {out}")


@command(
    "train",
    dataset="runs/dataset.parquet",
    out="runs/tuner.json",
    tuner=opt.option(
        "paper: the paper's network, on DATASET. policy: by evolution on the closed form, an hour on two cores.",
        click.Choice(["paper", "policy"]),
        default="paper",
    ),
    start=opt.option("Initial policy [default: random].", opt.PATH),
    generations=opt.option("Generations of the policy's training.", click.IntRange(1), default=150),
)
def train(dataset: Path, out: Path, tuner: str, seed: int, start: Path | None, generations: int) -> None:
    """The paper's tuner is the 12-10-2 network, trained on DATASET by back-propagation.

    The policy is trained in the loop, on situations of three robots, on all cores. After an interruption the same
    command continues from the last generation.
    """
    title, rows = (
        _train_policy(out, seed, start, generations) if tuner == "policy" else _train_paper(dataset, out, seed)
    )
    print_table(title, rows)


def _train_policy(out: Path, seed: int, start: Path | None, generations: int) -> tuple[str, list[tuple[str, str]]]:
    from stewart_drake.training.policy_training import PolicyOptions, train_policy

    prepare_file(out)
    options = PolicyOptions(seed=seed, generations=generations, start=None if start is None else str(start))
    state = out.with_name(f"{out.name}.state")
    with progress_bar("policy", float(options.generations), unit="generations") as advance:
        policy = train_policy(options, state, lambda done, word: advance(done, f"policy: {word}"))
    policy.save(out)
    card = policy.provenance
    ratios = {"all kinds": card["J_over_best_fixed"], **card["J_over_best_fixed_by_kind"]}
    title = f"cost J relative to the best fixed setting, on validation; policy in {out}"
    return title, [(name, f"{value:.3f}") for name, value in ratios.items()]


def _train_paper(dataset: Path, out: Path, seed: int) -> tuple[str, list[tuple[str, str]]]:
    from stewart_drake.training.paper_network import TrainingOptions, import_torch, load_dataset, train_network

    import_torch()  # First, so that nothing is read or written without it.
    data, options = load_dataset(dataset), TrainingOptions(seed=seed)
    prepare_file(out)
    with progress_bar("training", float(options.epochs), unit="epochs") as advance:
        result = train_network(data, options, progress=advance)
    result.network.save(out)
    return f"tuner in {out}", [(name, f"{value:.4g}") for name, value in result.scores.items()]
