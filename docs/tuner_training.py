"""How trained policies compare on situations that they were neither trained nor chosen on: `make tuner_training`.

python docs/tuner_training.py FILE...     # policies [default: the shipped one]

Prints a table for docs/results/tuner_training.md: some minutes on two cores for four policies.
"""

import sys
from pathlib import Path

import numpy as np

from stewart_drake.base.markdown import markdown_table
from stewart_drake.cli.terminal import progress_bar
from stewart_drake.training.benchmark import Baselines, Benchmark, always, cases_of, cells_for, cells_of, with_setting
from stewart_drake.training.situations import ROBOTS, VALIDATION

SEEDS = VALIDATION[100:120]
"""Of each kind and robot; far from those that a generation is chosen by."""


def main(files: list[str], folder: Path = Path("runs/tuner-training")) -> None:
    """Prints it; what has been run in the folder is not run again."""
    cases = cases_of(cells_for(trained=True), SEEDS)
    policies = {name: {"kind": "policy", "weights_file": str(Path(name).resolve())} for name in files}
    policies = policies or {"shipped": {"kind": "policy"}}
    candidates = [with_setting(Baselines.load().best), *(always({"tuner": policy}) for policy in policies.values())]
    with (
        progress_bar("policies", float(len(candidates) * len(cases)), unit="runs") as advance,
        Benchmark(folder, "closed_form", progress=advance) as benchmark,
    ):
        fixed, *others = benchmark.log_costs(candidates, cases)
    rows = []
    for name, costs in zip(policies, others, strict=True):
        means = {cell: (costs - fixed)[places].mean() for cell, places in cells_of(cases).items()}
        of_robot = [[mean for (_, robot), mean in means.items() if robot == each] for each in ROBOTS]
        worst = max(means, key=lambda cell: means[cell])
        values = (f"{np.exp(np.mean(each)):.3f}" for each in (list(means.values()), *of_robot))
        rows.append([name, *values, f"{' '.join(worst)} {np.exp(means[worst]):.2f}"])
    print(markdown_table(["policy", "all kinds", *(f"{each} alone" for each in ROBOTS), "worst kind"], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
