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

`make tuner_verdict`, Drake's plant: candidates in situations drawn by kind, robot and seed
(`stewart_drake/training/situations.py`): {kinds} kinds, of which {untrained} were never trained or searched on, with
the paper's robot at 1 kHz and Reachy Mini at 100 Hz, and seeds that nobody had trained or searched on. All have the
same observer on noisy encoders, a tick of delay and more, and the same feedforward. J = sqrt((RMS error / 0.03 deg)^2 +
(RMS error / 0.03 mm)^2 + (RMS change of torque in a millisecond / 0.03 N m)^2) of the second half of a run, and 1000
for one that failed: that was not completed. An error larger than its motion is no failure here
(`bounds.error_ratio: null`); J says how large it is.

- *best fixed*: the setting of least mean log J over all kinds that are trained on, by CMA-ES with {evaluations}
  evaluations of {seeds} runs of each kind on the reduced engine (`make tuner_baselines`): {best}.
- *policy*: the network of `tuner: policy`; `stewart-drake tuner show` prints its card. The file before it, of another
  training, had 0.61 (0.59 to 0.64) here: [how both were trained](tuner_training.md).
- *schedule*: two settings, switched by the innovation; ten numbers found by the same search, {schedule} evaluations.
- *best of the nine pairs*: the paper's omega_Q and omega_R, of 0.1, 1 and 10 each, the best for each robot ({pairs}),
  with the observer of the best fixed setting.
- *the paper's tuner*: its network as printed, with that observer.
- *oracle of each kind*: a setting searched likewise for each kind of each robot, also for those that nobody else saw.

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
