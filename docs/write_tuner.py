"""Writes docs/results/tuner.md and its picture from a verdict: `make tuner_verdict`.

python docs/write_tuner.py runs/tuner-verdict     # a folder that `stewart-drake tuner judge` made
"""

import shutil
import sys
from pathlib import Path

from stewart_drake.training.benchmark import Baselines
from stewart_drake.training.situations import KINDS, ROBOTS

DOCS = Path(__file__).parent
TEXT = """# What a tuner is worth

`make tuner_verdict` tests the candidates on Drake's plant, in random situations by kind, robot and seed
(`stewart_drake/training/situations.py`). There are {kinds} kinds, {untrained} of them never used in training or search,
with the paper's robot at 1 kHz and Reachy Mini at 100 Hz; all seeds are new. All candidates have the same observer on
noisy encoders, a delay of at least one tick, and the same feedforward. J = sqrt((RMS error / 0.03 deg)^2 +
(RMS error / 0.03 mm)^2 + (RMS change of torque in a millisecond / 0.03 N m)^2) of the second half of a run, and 1000
for a run that failed, that is, was not completed. An error larger than the motion is no failure here
(`bounds.error_ratio: null`); J includes it.

- *best fixed*: the fixed setting with the least mean log J over all kinds used in training, by CMA-ES with
  {evaluations} evaluations of {seeds} runs of each kind on the closed form (`make tuner_baselines`): {best}.
- *policy*: the network of `tuner: policy`; `stewart-drake tuner show` describes it. Another
  file, of a later training, had 0.63 (0.61 to 0.66) here: [how both were trained](tuner_training.md).
- *schedule*: two settings, switched by the innovation; ten numbers found by the same search, {schedule} evaluations.
- *best of the nine pairs*: the paper's omega_Q and omega_R, of 0.1, 1 and 10 each, the best for each robot ({pairs}),
  with the observer of the best fixed setting.
- *the paper's tuner*: the paper's network, with that observer.
- *oracle of each kind*: a fixed setting from the same search, for each kind of each robot, untrained kinds included.

{verdict}
![Cost by kind](../images/tuner_verdict.png)

`make results` recomputes some of these numbers.
"""


def main(folder: Path) -> None:
    """Writes them."""
    found = Baselines.load()
    names = ("speed", "damping", "integral", "disturbance")
    pairs = "; ".join(f"{robot} {' and '.join(map('{:g}'.format, found.pair[robot]))}" for robot in ROBOTS)
    page = TEXT.format(
        kinds=len(KINDS),
        untrained=sum(not kind.trained for kind in KINDS.values()),
        evaluations=f"{found.evaluations['each']:g}",
        schedule=f"{found.evaluations['schedule']:g}",
        seeds=f"{found.evaluations['seeds']:g}",
        best=", ".join(f"{name} {value:g}" for name, value in zip(names, found.best, strict=True))
        + " in decades above the defaults",
        pairs=pairs,
        verdict=(folder / "verdict.md").read_text(),
    )
    (DOCS / "results" / "tuner.md").write_text(page)
    shutil.copyfile(folder / "verdict.png", DOCS / "images" / "tuner_verdict.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
