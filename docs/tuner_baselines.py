"""Searches what a trained tuner has to beat, and keeps it with the package: `make tuner_baselines`.

python docs/tuner_baselines.py runs/tuner-baselines
"""

import sys
from pathlib import Path

from stewart_drake.runs.terminal import ProgressBar
from stewart_drake.training.baselines import SHIPPED, find_baselines


def main(folder: Path) -> None:
    """Writes the file; what has been run in the folder is not run again."""
    with ProgressBar("baselines", 13_000.0, quiet=False, unit="runs") as advance:
        found = find_baselines(folder, tell=lambda what, done: advance(done, f"baselines: {what}"))
    found.save(SHIPPED)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
