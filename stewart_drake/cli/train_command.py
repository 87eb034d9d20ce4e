"""The commands `collect` and `train`: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from stewart_drake.cli.common_options import out_file, quiet_flag
from stewart_drake.errors import ConfigurationError
from stewart_drake.runs.terminal import ProgressBar, print_table

if TYPE_CHECKING:
    from stewart_drake.training.policy_options import Method
    from stewart_drake.training.train import Split

_PAPER_EPOCHS = 2000


@click.command()
@out_file("runs/dataset.parquet")
@quiet_flag
def collect(out: Path, quiet: bool) -> None:
    """Run the paper's nine experiments and write the tuner's training data (14,400 samples).

    Exit status: 0 done, 2 bad input, 3 an experiment broke, 130 interrupted.
    """
    from stewart_drake.campaigns.executors import LocalProcesses
    from stewart_drake.runs.outputs import SPACE, prepare_file
    from stewart_drake.training.collect import collect_dataset

    prepare_file(out, SPACE)
    with ProgressBar("nine experiments", 9.0, quiet, unit="runs") as advance:
        dataset = collect_dataset(progress=advance, where=LocalProcesses())
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
    help="paper: the network of the paper, on DATASET. policy: in the loop, in ten minutes, with --start in twenty.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of first weights, split, tastes.")
@click.option(
    "--epochs",
    type=click.IntRange(1),
    help=f"Passes over the data [default: {_PAPER_EPOCHS}], or over the situations [default: 3; of "
    "evolution 20, with --start 10].",
)
@click.option(
    "--split",
    type=click.Choice(["samples", "runs"]),
    help="Of the paper's: what is held back for validation, samples at random, which leak between runs [default], or "
    "whole runs.",
)
@click.option(
    "--method",
    type=click.Choice(["gradient", "evolution"]),
    help="Of the policy: backpropagation through the loops [default], or an evolution strategy.",
)
@click.option(
    "--start",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Of the policy: a file to go on from, by evolution in small steps.",
)
@quiet_flag
def train(
    dataset: Path | None,
    out: Path,
    tuner: Literal["paper", "policy"],
    seed: int,
    epochs: int | None,
    split: Split | None,
    method: Method | None,
    start: Path | None,
    quiet: bool,
) -> None:
    """Train a tuner and write its file.

    The paper's: the 12-10-2 network on DATASET [default: runs/dataset.parquet] by back-propagation. The policy: in the
    loop, on situations of two robots; interrupted, the same command goes on from its last epoch.

    Exit status: 0 done, 2 bad input, 130 interrupted.
    """
    from stewart_drake.runs.outputs import SPACE, prepare_file

    foreign: dict[str, Any] = {"--method": method, "--start": start}
    other = "policy"
    if tuner == "policy":
        foreign, other = {"DATASET": dataset, "--split": split}, "paper"
    for option, given in foreign.items():
        if given is not None:
            raise ConfigurationError(option, str(given), f"nothing: it goes with --tuner {other}")
    if start is not None and method == "gradient":
        raise ConfigurationError("--method", method, "evolution, with --start")
    if tuner == "paper":
        _train_paper(
            dataset or Path("runs/dataset.parquet"), out, seed, epochs or _PAPER_EPOCHS, split or "samples", quiet
        )
        return

    from stewart_drake.control.policy import load_policy
    from stewart_drake.training.policy_options import EVOLUTION, POLISH, Box, PolicyOptions
    from stewart_drake.training.policy_training import Training, train_policy

    first = None if start is None else load_policy(start)
    asked = {"seed": seed, "epochs": epochs, "method": method}
    more = EVOLUTION if method == "evolution" else {}
    if first is not None:
        more = {**POLISH, "hidden": len(first.layers.hidden)}
    options = PolicyOptions.from_dict({**more, **{key: value for key, value in asked.items() if value is not None}})
    prepare_file(out, SPACE)
    checkpoint = out.with_name(f"{out.name}.checkpoint")
    with ProgressBar("policy: situations", float(options.epochs), quiet, unit="epochs") as advance:
        tell = lambda done, word: advance(done, f"policy: {word}")  # noqa: E731
        policy = train_policy(Training(options, None if first is None else Box.of(first)), checkpoint, tell, first)
    policy.save(out)
    if not quiet:
        ratios = policy.provenance["J_over_best_fixed_in_training"].items()
        print_table(f"J over that of the best fixed setting, policy in {out}", [(k, f"{v:.3f}") for k, v in ratios])


def _train_paper(dataset: Path, out: Path, seed: int, epochs: int, split: Split, quiet: bool) -> None:
    from stewart_drake.runs.outputs import SPACE, prepare_file
    from stewart_drake.training.dataset import load_dataset

    data = load_dataset(dataset)

    from stewart_drake.training.train import TrainingOptions, train_network

    options = TrainingOptions(seed=seed, epochs=epochs, split=split)
    prepare_file(out, SPACE)
    with ProgressBar("training", float(epochs), quiet, unit="epochs") as advance:
        result = train_network(data, options, progress=advance)
    result.network.save(out)
    if not quiet:
        print_table(f"tuner in {out}", [(name, f"{value:.4g}") for name, value in result.scores.items()])
