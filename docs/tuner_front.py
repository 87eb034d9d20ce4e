"""The policy from stiff to quiet against settings that stay: `make tuner_front`.

python docs/tuner_front.py runs/tuner-front [FILE]     # FILE: a policy [default: the shipped one]

Writes docs/results/tuner_front.md and docs/images/tuner_front.png; what has been run in the folder is not run again.
"""

import sys
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from stewart_drake.control.features import CostScales
from stewart_drake.plotting import draw
from stewart_drake.plotting.tuner_plots import plot_front
from stewart_drake.runs.terminal import ProgressBar
from stewart_drake.studies.study import markdown
from stewart_drake.training.benchmark import (
    Baselines,
    Benchmark,
    always,
    cases_of,
    cells_for,
    log_cost,
    mean_over_cells,
    with_setting,
)
from stewart_drake.training.situations import HELD_OUT

DOCS = Path(__file__).parent
KAPPAS = (-1.0, -0.5, 0.0, 0.5, 1.0)
SETTINGS = 64
"""Fixed ones, of a Sobol sequence in the box of the searches; beside them those that the searches found."""
LOW, HIGH = np.array([-0.3, -0.6, -1.2, -1.9]), np.array([0.4, 0.4, 0.7, 0.6])
"""That box, see docs/tuner_baselines.py."""
SEEDS = 3
LEAST = 1e-6
"""[mm], [N m] smaller ones count as this."""
TEXT = """# From stiff to quiet: one policy, one number

`make tuner_front`: the paper's robot in {kinds} kinds of situations, {seeds} of each, of seeds that nothing was trained
on, on the reduced engine. `tuner.kappa` says how much a change of torque counts against an error: in J the scale of
torques is 0.03 N m times 10^-kappa. The policy gets it as an input and serves all values. Against it {settings}
settings that stay: {drawn} drawn evenly from the box of the searches, and those that the searches found. Geometric
means over the kinds; *best fixed* is the setting among all of these that costs least at that kappa in these very runs,
which flatters it.

{table}

![Error against change of torque](../images/tuner_front.png)
"""


def front(folder, policy, settings, seeds=SEEDS):
    """Means over the kinds of log error [mm] and log change of torque [N m], (candidates, 2), and of log J by kappa.

    The candidates are the settings, then the policy at each kappa.
    """
    # One robot: errors of several could not be told in millimetres together.
    cases = cases_of(cells_for("paper"), HELD_OUT[:seeds])
    entered = [*map(with_setting, settings), *(always({"tuner": {**policy, "kappa": kappa}}) for kappa in KAPPAS)]
    with (
        ProgressBar("front", float(len(entered) * len(cases)), quiet=False, unit="runs") as advance,
        Benchmark(folder, "reduced", tell=advance) as benchmark,
    ):
        rows = benchmark.run(entered, cases)
    scales = [CostScales().at(kappa) for kappa in KAPPAS]
    values = [[_log_error(row), _log_change(row), *(log_cost(row, each) for each in scales)] for row in rows]
    means = mean_over_cells(np.moveaxis(np.reshape(values, (len(entered), len(cases), -1)), -1, 1), cases)
    return means[:, :2], means[:, 2:]


def _log_error(row):
    return np.log(max(row["rmse_norm_mm"], LEAST))


def _log_change(row):
    return np.log(max(row["torque_change_rms"] * 1e-3 / row["period"], LEAST))


def main(folder: Path, weights: str | None = None) -> None:
    """Writes them."""
    found = Baselines.load()
    drawn = LOW + (HIGH - LOW) * qmc.Sobol(len(LOW), seed=0).random(SETTINGS)
    settings = [found.best, *found.best_of_robot.values(), *found.best_of_kind["paper"].values(), *drawn]
    policy = {"kind": "policy", **({} if weights is None else {"weights_file": weights})}
    logs, costs = front(folder, policy, settings)
    shown, count = np.exp(logs), len(settings)
    best = np.argmin(costs[:count], axis=0)
    ratios = np.exp(np.diag(costs[count:]) - costs[best, range(len(KAPPAS))])
    rows = [
        [f"{kappa:g}", *(f"{value:.4f}" for value in (*shown[count + k], *shown[best[k]])), f"{ratios[k]:.2f}"]
        for k, kappa in enumerate(KAPPAS)
    ]
    header = ("kappa", "error [mm]", "torque [N m]", "best fixed: error", "torque", "J over its")
    text = TEXT.format(
        kinds=len(cells_for("paper")),
        seeds=SEEDS,
        settings=count,
        drawn=SETTINGS,
        table="\n".join(markdown(header, rows)),
    )
    (DOCS / "results" / "tuner_front.md").write_text(text)
    warning = draw(
        lambda: plot_front(shown[:count], shown[count:], KAPPAS, shown[best]), DOCS / "images/tuner_front.png"
    )
    if warning is not None:
        sys.exit(warning)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
