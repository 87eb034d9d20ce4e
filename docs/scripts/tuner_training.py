"""How trained policies compare on situations that they were neither trained nor chosen on: `make tuner_training`.

python docs/scripts/tuner_training.py FILE...     # policies [default: the shipped one]

Prints a table for docs/results/tuner_training.md: some minutes on two cores for four policies.
"""

import sys
from pathlib import Path

import numpy as np

from stewart_drake.base.markdown import markdown_table
from stewart_drake.cli.terminal import progress_bar
from stewart_drake.training.benchmark import (
    NEVER_WORSE,
    Baselines,
    Benchmark,
    always,
    cases_of,
    cells_for,
    cells_of,
    fixed_rows,
)
from stewart_drake.training.situations import ROBOTS, VALIDATION

SEEDS = VALIDATION[100:120]
"""Of each kind and robot; far from those that a generation is chosen by."""


def main(files: list[str], folder: Path = Path("runs/tuner-training")) -> None:
    """Prints it; what has been run in the folder is not run again."""
    cases = cases_of(cells_for(trained=True), SEEDS)
    policies = {name: {"kind": "policy", "weights_file": str(Path(name).resolve())} for name in files}
    policies = policies or {"shipped": {"kind": "policy"}}
    fixed = fixed_rows(Baselines.load())
    candidates = [*fixed.values(), *(always({"tuner": policy}) for policy in policies.values())]
    with (
        progress_bar("policies", float(len(candidates) * len(cases)), unit="runs") as advance,
        Benchmark(folder, "closed_form", progress=advance) as benchmark,
    ):
        costs = benchmark.log_costs(candidates, cases)
    rows = []
    for name, of_policy in zip(policies, costs[len(fixed) :], strict=True):
        over = of_policy - costs[: len(fixed)]
        means = {cell: over[:, places].mean(axis=1) for cell, places in cells_of(cases).items()}
        of_robot = [[mean[0] for (_, robot), mean in means.items() if robot == each] for each in ROBOTS]
        values = (f"{np.exp(np.mean(each)):.3f}" for each in ([mean[0] for mean in means.values()], *of_robot))
        largest, worst = max((mean[0], cell) for cell, mean in means.items())
        highest, far = max((mean.max(), cell) for cell, mean in means.items())
        of_row = f"{' '.join(far)} {np.exp(highest):.2f} ({list(fixed)[means[far].argmax()]})"
        behind = sum(mean.max() > np.log(NEVER_WORSE) for mean in means.values())
        rows.append([name, *values, f"{' '.join(worst)} {np.exp(largest):.2f}", of_row, f"{behind} of {len(means)}"])
    header = ["policy", "all kinds", *(f"{each} alone" for each in ROBOTS), "worst kind"]
    print(markdown_table([*header, "farthest above what stays", f"kinds above {NEVER_WORSE:g} of it"], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
