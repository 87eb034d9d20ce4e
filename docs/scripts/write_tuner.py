"""Writes docs/results/tuner.md and its picture from a verdict: `make results/tuner`.

python docs/scripts/write_tuner.py runs/tuner-fast runs/tuner-drake   # of `stewart-drake tuner judge` on these plants
"""

import shutil
import sys
from pathlib import Path

import pyarrow.parquet as pq
from tuner_baselines import ROUGH

from stewart_drake.base.markdown import markdown_table
from stewart_drake.training.benchmark import BEST_FIXED, NEVER_WORSE
from stewart_drake.training.situations import KINDS, ROBOTS

DOCS = Path(__file__).parents[1]
AT_REST = [("kind", "=", "hold"), ("robot", "=", "reachy_mini")]
TEXT = """# What a tuner is worth

A tuner changes the weights of the regulator while the robot moves. How much does the shipped one, `tuner: policy`, save
against settings that stay fixed? Command: `make results/tuner`.

{fast}

- Each number is the cost J over that of *best fixed* in the same situation, with its 95 % interval: geometric means
  over {pairs} pairs of kind and robot. Of {kinds} kinds of situations {untrained} are never used in training or search.
- J is the cost of [the training](../tuner.md#how-it-was-trained), over the second half of a run: errors in units of
  0.03 deg and 0.03 mm, changes of torque in units of 0.03 N m in a millisecond. A run that fails costs 1000.
- `paper` runs at 1 kHz, `reachy_mini` at 100 Hz, `reachy_200hz` at 200 Hz, all with noisy encoders, the same observer,
  a delay of at least one tick, and [learning](../adaptation.md) from a cold start. All seeds are new.
- *best fixed* is one setting for all kinds, *stiff* one for {rough}.
  *schedule* changes between two settings. *best of the nine pairs* has the paper's omega_Q and omega_R. *oracle* has a
  setting for each kind and robot. All are in `stewart_drake/weights/baselines.yaml`
  (`python docs/scripts/tuner_baselines.py runs/tuner-baselines`).

## By kind

J of the policy over that of *best fixed*, by robot. The last column has J of the policy over that of the fixed setting
that is best for this kind, without the oracle; one number for every robot of the row, in the same order.

{by_kind}

![Cost by kind](../images/tuner_verdict.png)

- The policy helps most where the best setting changes during a run: at rest, under pushes, near the motors' limits.
- It is not better everywhere: in {above} pairs the last column is above 1.05.
- Under blows to the paper's robot the policy reacts late, like a loop that becomes stiff 100 ms after the blow: the
  innovation is a mean over 10 ms, and a setting changes by at most 3 % of its range in a tick.

## On Drake's plant

{drake}

With Reachy Mini at 100 Hz the policy gains less there. Under pushes it costs {pushes}, at
rest {hold}: motors with dry friction stay {rest:.2g} deg off (median) whatever the setting.

## The key kappa, stability, training

- `tuner.kappa` goes from stiff, -1, to quiet, 1. At -1 the error is 0.0060 mm with torque changes of 0.0096 N m, at 1
  it is 0.0081 mm with 0.0034 N m. The cost is 0.63 to 0.73 of that of the best of 32 fixed settings (paper's robot,
  measured at commit 11e7483a).
- All loops are stable at 1000 poses with 41 constant settings from the policy's range: the paper's robot with 0 to 4
  ticks of delay, Reachy Mini with one (measured at commit 0765a7dd). The smallest disk margins are 0.178 and 0.057; see
  [margins](margins.md).
- A newer training with a wider range cost 0.62 of *best fixed* where the shipped policy cost 0.65 (measured at commit
  da6aa01c). But it cost more for the paper's robot and in kinds that it was never trained on. So the older policy
  stays.
"""
COLUMNS = {
    "candidate": "tuner",
    "all kinds": "all kinds",
    **{f"{robot} alone": robot for robot in ROBOTS},
    "worst kind": "worst kind",
    "failed": "failed",
}
"""Columns of a verdict that are shown, and their heads."""


def of_candidates(text: str, *left_out: str) -> str:
    """The first table of a verdict, with the columns that are shown."""
    shown = {name: head for name, head in COLUMNS.items() if name not in left_out}
    table = next(part for part in text.split("\n\n") if part.startswith("| candidate"))
    header, _, *rows = [line.strip("| ").split(" | ") for line in table.strip().split("\n")]
    places = [header.index(name) for name in shown]
    return markdown_table(shown.values(), [[row[place] for place in places] for row in rows if row[0] != BEST_FIXED])


Rows = dict[tuple[str, str], list[str]]


def by_kind(text: str) -> tuple[Rows, Rows]:
    """Cells of a verdict by kind and robot: ratios of all candidates, and of the policy over what stays."""
    found = []
    for table in (part for part in text.split("\n\n") if part.startswith("| kind")):
        cells = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.strip().split("\n")[2:]]
        found.append({(kind.partition(" (")[0], robot): rest for kind, robot, *rest in cells})
    ratios, of_policy = found
    return ratios, of_policy


def mean_of(cell: str) -> float:
    """The mean in a cell, before its interval."""
    return float(cell.split()[0])


def worst_ratios(text: str) -> dict[tuple[str, str], float]:
    """The largest mean of the policy's J over that of a fixed setting, by kind and robot."""
    ratios, of_policy = by_kind(text)
    return {key: max(map(mean_of, (ratios[key][1], *of_policy[key][2:-1]))) for key in of_policy}


def above(text: str) -> str:
    """In how many pairs of kind and robot the policy costs more than a fixed setting."""
    most = worst_ratios(text).values()
    return f"{sum(mean > NEVER_WORSE for mean in most)} of {len(most)}"


def policy_by_kind(text: str) -> str:
    """The policy's J over best fixed, a line a kind: every robot, and the largest mean over a fixed setting."""
    ratios, worst = by_kind(text)[0], worst_ratios(text)
    rows = [
        [kind, *(ratios[kind, robot][1].split()[0] if (kind, robot) in ratios else "" for robot in ROBOTS)]
        + [", ".join(f"{worst[kind, robot]:.2f}" for robot in ROBOTS if (kind, robot) in worst)]
        for kind in dict.fromkeys(kind for kind, _ in ratios)
    ]
    return markdown_table(["kind", *ROBOTS, "over the best fixed setting of the kind"], rows)


def compared(drake: str, fast: str, kind: str) -> str:
    """The policy's J over best fixed in a kind of Reachy Mini, on both plants."""
    here, there = (mean_of(by_kind(text)[0][kind, "reachy_mini"][1]) for text in (drake, fast))
    return f"{here:.2f} of *best fixed* instead of {there:.2f}"


def main(fast: Path, drake: Path) -> None:
    """Writes them."""
    of_fast, of_drake = ((each / "verdict.md").read_text(encoding="utf-8") for each in (fast, drake))
    rest = pq.read_table(drake / "verdict.parquet", filters=AT_REST)["rmse_norm_deg"].to_pandas().median()
    (DOCS / "results" / "tuner.md").write_text(page(of_fast, of_drake, rest), encoding="utf-8")
    shutil.copyfile(fast / "verdict.png", DOCS / "images" / "tuner_verdict.png")


def page(of_fast: str, of_drake: str, rest: float) -> str:
    """The page of two verdicts, and of the error of Reachy Mini at rest [deg]."""
    return TEXT.format(
        pairs=len(by_kind(of_fast)[0]),
        kinds=len(KINDS),
        untrained=sum(not kind.trained for kind in KINDS.values()),
        rough=", ".join(ROUGH),
        fast=of_candidates(of_fast),
        by_kind=policy_by_kind(of_fast),
        above=above(of_fast),
        rest=rest,
        hold=compared(of_drake, of_fast, "hold"),
        pushes=compared(of_drake, of_fast, "pushes"),
        drake=of_candidates(of_drake, "worst kind", "failed"),
    )


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
