"""The commands `collect` and `train`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from stewart_drake.cli.common_options import out_file, quiet_flag
from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.terminal import ProgressBar, print_table

if TYPE_CHECKING:
    from stewart_drake.training.train import Split


@click.command()
@out_file("runs/dataset.parquet")
@quiet_flag
def collect(out: Path, quiet: bool) -> None:
    """Run the paper's nine experiments and write the tuner's training data (14,400 samples).

    Exit status: 0 done, 2 bad input, 3 an experiment broke, 130 interrupted.
    """
    from stewart_drake.runs.outputs import prepare_file
    from stewart_drake.studies.workers import Workers
    from stewart_drake.training.collect import collect_dataset

    prepare_file(out)
    with ProgressBar("nine experiments", 9.0, quiet, unit="runs") as advance:
        dataset = collect_dataset(progress=advance, workers=Workers())
    dataset.save(out)
    click.echo(f"{len(dataset.inputs)} samples in {out}")


@click.command()
@click.argument("dataset", type=click.Path(dir_okay=False, path_type=Path), required=False)
@out_file("runs/tuner.json")
@click.option(
    "--tuner",
    type=click.Choice(["paper", "policy"]),
    default="paper",
    show_default=True,
    help="paper: the network of the paper, on DATASET. policy: by evolution on the fast engine, an hour on two cores.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of everything that is drawn.")
@click.option("--epochs", type=click.IntRange(1), help="Of the paper's: passes over the data [default: 2000].")
@click.option(
    "--split",
    type=click.Choice(["samples", "runs"]),
    help="Of the paper's: what is held back for validation, samples at random, which leak between runs [default], or "
    "whole runs.",
)
@click.option("--generations", type=click.IntRange(1), help="Of the policy: steps of evolution [default: 150].")
@quiet_flag
def train(
    dataset: Path | None,
    out: Path,
    tuner: Literal["paper", "policy"],
    seed: int,
    epochs: int | None,
    split: Split | None,
    generations: int | None,
    quiet: bool,
) -> None:
    """Train a tuner and write its file.

    The paper's: the 12-10-2 network on DATASET [default: runs/dataset.parquet] by back-propagation. The policy: in the
    loop, on situations of two robots, on all cores; interrupted, the same command goes on from its last generation.

    Exit status: 0 done, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    foreign: dict[str, object] = {"--generations": generations}
    other = "policy"
    if tuner == "policy":
        foreign, other = {"DATASET": dataset, "--split": split, "--epochs": epochs}, "paper"
    for option, given in foreign.items():
        if given is not None:
            raise ConfigurationError(option, str(given), f"nothing: it goes with --tuner {other}")
    if tuner == "policy":
        _train_policy(out, seed, generations or 150, quiet)
    else:
        _train_paper(dataset or Path("runs/dataset.parquet"), out, seed, epochs or 2000, split or "samples", quiet)


def _train_policy(out: Path, seed: int, generations: int, quiet: bool) -> None:
    from stewart_drake.runs.outputs import prepare_file
    from stewart_drake.training.policy_training import PolicyOptions, train_policy

    prepare_file(out)
    options = PolicyOptions(seed=seed, generations=generations)
    with ProgressBar("policy", float(generations), quiet, unit="generations") as advance:
        policy = train_policy(
            options, out.with_name(f"{out.name}.state"), lambda done, word: advance(done, f"policy: {word}")
        )
    policy.save(out)
    if not quiet:
        card = policy.provenance
        ratios = {"all kinds": card["J_over_best_fixed"], **card["J_over_best_fixed_by_kind"]}
        rows = [(name, f"{value:.3f}") for name, value in ratios.items()]
        print_table(f"J over that of the best fixed setting on validation, policy in {out}", rows)


def _train_paper(dataset: Path, out: Path, seed: int, epochs: int, split: Split, quiet: bool) -> None:
    from stewart_drake.runs.outputs import prepare_file
    from stewart_drake.training.collect import load_dataset

    data = load_dataset(dataset)

    from stewart_drake.training.train import TrainingOptions, train_network

    options = TrainingOptions(seed=seed, epochs=epochs, split=split)
    prepare_file(out)
    with ProgressBar("training", float(epochs), quiet, unit="epochs") as advance:
        result = train_network(data, options, progress=advance)
    result.network.save(out)
    if not quiet:
        print_table(f"tuner in {out}", [(name, f"{value:.4g}") for name, value in result.scores.items()])
