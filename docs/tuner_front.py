"""The policy from stiff to quiet against settings that stay: `make tuner_front`.

Writes docs/results/tuner_front.md and docs/images/tuner_front.png.
"""

import sys
from pathlib import Path

from stewart_drake.plotting import draw
from stewart_drake.plotting.tuner_plots import plot_front
from stewart_drake.runs.terminal import ProgressBar
from stewart_drake.training.baselines import Baselines
from stewart_drake.training.contest import cells_for
from stewart_drake.training.front import SEEDS, SETTINGS, TASTES, find_front, table

DOCS = Path(__file__).parent
TEXT = """# From stiff to quiet: one policy, one number

`make tuner_front`: the paper's robot in {kinds} kinds of situations, {seeds} of each, of seeds that nothing was trained
on, on the reduced engine. `tuner.kappa` says how much a change of torque counts against an error: in J the scale of
torques is 0.03 N m times 10^-kappa. The policy hears it and serves all tastes. Against it {settings} settings that
stay: {drawn} drawn evenly from the box of the searches, and those that the searches found. Geometric means over the
kinds; *best fixed* is the setting among all of these that costs least at that taste in these very runs, which flatters
it.

{table}

![Error against change of torque](../images/tuner_front.png)
"""


def main(folder: Path, weights: str | None = None) -> None:
    """Writes them."""
    found = Baselines.load()
    given = [found.best, *found.best_of_robot.values(), *found.best_of_kind["paper"].values()]
    policy = {"kind": "policy", **({} if weights is None else {"weights_file": weights})}
    kinds = len([robot for _, robot in cells_for() if robot == "paper"])
    total = (len(given) + SETTINGS + len(TASTES)) * kinds * SEEDS
    with ProgressBar("front", float(total), quiet=False, unit="runs") as advance:
        front = find_front(lambda taste: {"tuner": {**policy, "kappa": taste}}, folder, given, tell=advance)
    drawn = draw(
        lambda: plot_front(front.cloud, front.tuner, TASTES, front.cloud[front.best]), DOCS / "images/tuner_front.png"
    )
    text = TEXT.format(
        kinds=kinds, seeds=SEEDS, settings=len(front.settings), drawn=SETTINGS, table="\n".join(table(front))
    )
    (DOCS / "results" / "tuner_front.md").write_text(text)
    if drawn is not None:
        sys.exit(drawn)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
