"""The policy from stiff to quiet against settings that stay: `make tuner_front`.

python docs/scripts/tuner_front.py runs/tuner-front [FILE]     # FILE: a policy [default: the shipped one]

Writes docs/results/tuner_front.md and docs/images/tuner_front.png; what has been run in the folder is not run again.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.ticker import LogLocator
from scipy.stats import qmc

from stewart_drake.base.markdown import markdown_table
from stewart_drake.cli.terminal import progress_bar
from stewart_drake.control.features import CostScales
from stewart_drake.plotting import save_figure
from stewart_drake.plotting import style as look
from stewart_drake.training.benchmark import (
    HIGHEST,
    LOWEST,
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

DOCS = Path(__file__).parents[1]
KAPPAS = (-1.0, -0.5, 0.0, 0.5, 1.0)
SETTINGS = 8
"""Fixed ones, of a Sobol sequence in the box of the searches; beside them those that the searches found."""
SEEDS = 2
LEAST = 1e-6
"""[mm], [N m] smaller ones count as this."""
TEXT = """# From stiff to quiet: one policy, one number

`make tuner_front` runs the paper's robot in {kinds} kinds of situations, {seeds} of each, with new seeds, on the
closed form. `tuner.kappa` weighs changes of torque against errors: in J the scale of torques is 0.03 N m times
10^-kappa. It is an input of the policy, and one policy serves all values. It is compared with {settings} fixed
settings: {drawn} drawn uniformly from the range of the searches, and the searches' results. All are geometric means
over the kinds. *best fixed* is the fixed setting with the least cost at that kappa in these very runs, which favours
it.

{table}

![Error against change of torque](../images/tuner_front.png)

`make results` recomputes some of these numbers.
"""


def front(folder, policy, settings):
    """Means over the kinds of log error [mm] and log change of torque [N m], (candidates, 2), and of log J by kappa.

    The candidates are the settings, then the policy at each kappa.
    """
    # One robot: errors of several could not be told in millimetres together.
    cases = cases_of(cells_for("paper"), HELD_OUT[:SEEDS])
    candidates = [*map(with_setting, settings), *(always({"tuner": {**policy, "kappa": kappa}}) for kappa in KAPPAS)]
    with (
        progress_bar("front", float(len(candidates) * len(cases)), unit="runs") as advance,
        Benchmark(folder, "closed_form", progress=advance) as benchmark,
    ):
        rows = benchmark.run(candidates, cases)
    scales = [CostScales().at(kappa) for kappa in KAPPAS]
    values = [[_log_error(row), _log_change(row), *(log_cost(row, each) for each in scales)] for row in rows]
    means = mean_over_cells(np.moveaxis(np.reshape(values, (len(candidates), len(cases), -1)), -1, 1), cases)
    return means[:, :2], means[:, 2:]


def _log_error(row):
    return np.log(max(row["rmse_norm_mm"], LEAST))


def _log_change(row):
    return np.log(max(row["torque_change_rms"] * 1e-3 / row["period"], LEAST))


@look.styled
def picture(cloud, policy, fixed):
    """Error [mm] against change of torque [N m], (n, 2) each: settings that stay, the policy, the best of them."""
    figure, ((panel,),) = look.panels(1, 1, 5.0)
    panel.plot(cloud[:, 1], cloud[:, 0], ".", color=look.GREY, markersize=6.0, label="settings that stay")
    panel.plot(
        fixed[:, 1], fixed[:, 0], "D", color=look.ORANGE, markersize=6.0, label="the best of them at a smoothness"
    )
    panel.plot(policy[:, 1], policy[:, 0], "o-", color=look.BLUE, label="policy")
    for kappa, (error, change) in zip(KAPPAS, policy, strict=True):
        place = {"textcoords": "offset points", "ha": "right", "va": "top"}
        panel.annotate(f"{kappa:g}", (change, error), (-4, -8), color=look.BLUE, fontsize=9, **place)
    look.logarithmic(panel, "xy")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.set(title="From stiff (-1) to quiet (1)", ylabel="error [mm] RMS")
    panel.set(xlabel="change of torque in a millisecond [N m] RMS")
    panel.legend()
    return figure


def main(folder: Path, weights: str | None = None) -> None:
    """Writes them."""
    found = Baselines.load()
    drawn = LOWEST + (HIGHEST - LOWEST) * qmc.Sobol(len(LOWEST), seed=0).random(SETTINGS)
    settings = [found.best, found.stiff, *found.best_of_robot.values(), *found.best_of_kind["paper"].values(), *drawn]
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
        table=markdown_table(header, rows),
    )
    (DOCS / "results" / "tuner_front.md").write_text(text, encoding="utf-8")
    save_figure(picture(shown[:count], shown[count:], shown[best]), DOCS / "images/tuner_front.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
