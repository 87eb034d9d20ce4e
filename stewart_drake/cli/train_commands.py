"""The commands `collect` and `train`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from stewart_drake.cli.options import IN_FILE, cli, out_file, quiet_flag
from stewart_drake.cli.terminal import print_table, progress_bar
from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.outputs import prepare_file
from stewart_drake.studies.workers import Workers


@cli.command()
@out_file("runs/dataset.parquet")
@quiet_flag
def collect(out: Path, quiet: bool) -> None:
    """Run the paper's nine experiments and write the tuner's training data (14,400 samples).

    Exit status: 0 done, 2 bad input, 3 an experiment broke, 130 interrupted.
    """
    from stewart_drake.training.collect import collect_dataset

    prepare_file(out)
    with progress_bar("nine experiments", 9.0, quiet, unit="runs") as advance:
        dataset = collect_dataset(progress=advance, workers=Workers())
    dataset.save(out)
    click.echo(f"{len(dataset.inputs)} samples in {out}")


@cli.command()
@click.argument("dataset", type=IN_FILE, required=False)
@out_file("runs/tuner.json")
@click.option(
    "--tuner",
    type=click.Choice(["paper", "policy"]),
    default="paper",
    help="paper: the network of the paper, on DATASET. policy: by evolution on the fast engine, an hour on two cores.",
)
@click.option("--seed", type=click.IntRange(0), default=0, help="Of everything that is drawn.")
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
    split: Literal["samples", "runs"] | None,
    generations: int | None,
    quiet: bool,
) -> None:
    """Train a tuner and write its file.

    The paper's: the 12-10-2 network on DATASET [default: runs/dataset.parquet] by back-propagation. The policy: in the
    loop, on situations of two robots, on all cores; interrupted, the same command goes on from its last generation.

    Exit status: 0 done, 2 bad input, 3 no workers are left, 130 interrupted.
    """
    foreign: dict[str, object] = {"--generations": generations}
    if tuner == "policy":
        foreign = {"DATASET": dataset, "--split": split, "--epochs": epochs}
    other = "paper" if tuner == "policy" else "policy"
    for option, given in foreign.items():
        if given is not None:
            raise ConfigurationError(option, str(given), f"nothing: it goes with --tuner {other}")
    if tuner == "policy":
        title, rows = _train_policy(out, seed, generations or 150, quiet)
    else:
        title, rows = _train_paper(dataset or Path("runs/dataset.parquet"), out, seed, epochs or 2000, split, quiet)
    if not quiet:
        print_table(title, rows)


def _train_policy(out: Path, seed: int, generations: int, quiet: bool) -> tuple[str, list[tuple[str, str]]]:
    from stewart_drake.training.policy_training import PolicyOptions, train_policy

    prepare_file(out)
    options, state = PolicyOptions(seed=seed, generations=generations), out.with_name(f"{out.name}.state")
    with progress_bar("policy", float(generations), quiet, unit="generations") as advance:
        policy = train_policy(options, state, lambda done, word: advance(done, f"policy: {word}"))
    policy.save(out)
    card = policy.provenance
    ratios = {"all kinds": card["J_over_best_fixed"], **card["J_over_best_fixed_by_kind"]}
    title = f"J over that of the best fixed setting on validation, policy in {out}"
    return title, [(name, f"{value:.3f}") for name, value in ratios.items()]


def _train_paper(
    dataset: Path, out: Path, seed: int, epochs: int, split: Literal["samples", "runs"] | None, quiet: bool
) -> tuple[str, list[tuple[str, str]]]:
    from stewart_drake.training.collect import load_dataset

    data = load_dataset(dataset)

    from stewart_drake.training.train import TrainingOptions, train_network

    options = TrainingOptions(seed=seed, epochs=epochs, split=split or "samples")
    prepare_file(out)
    with progress_bar("training", float(epochs), quiet, unit="epochs") as advance:
        result = train_network(data, options, progress=advance)
    result.network.save(out)
    return f"tuner in {out}", [(name, f"{value:.4g}") for name, value in result.scores.items()]
