"""The paper's claims at both sizes: stewart_drake/paper/claims.csv, and docs/results/reproduction.md from it.

python docs/scripts/write_reproduction.py     # the better part of an hour on two cores; `make results/reproduction`
"""

import csv
from importlib.resources import files
from pathlib import Path

from stewart_drake.base.markdown import markdown_table
from stewart_drake.paper.reproduce import reproduce, rows

TABLE = Path(str(files("stewart_drake.paper").joinpath("claims.csv")))
SIZES = ("quick", "full")
PAGE = Path(__file__).parents[1] / "results" / "reproduction.md"
HEAD = """# The paper, claim by claim

Which claims of *Intelligent Optimal Feed-Back Torque Control of a 6DOF Surgical Rotary Robot* hold?
Command: `stewart-drake reproduce`; `make results/reproduction` writes this page.

Numbers in brackets are the paper's equations, roman numbers its sections. Runs are on (37), (38) unless a row gives
another motion, and followed if they are [completed](../promises.md#outcomes-tell-the-truth). The first two rows of
Fig. 7 have the worst of six starts that differ by 1e-10: without gravity the loop with the network is chaotic. See
also [departures.md](../departures.md) and `notebooks/paper/`.

"""


def main() -> None:
    """Runs both sizes and writes the table and the page; how far a number may move stays as it was."""
    found = {size: [c for result in reproduce(size == "quick").values() for c in result.claims] for size in SIZES}
    with TABLE.open(newline="") as stream:
        within = {row["claim"]: row["within"] for row in csv.DictReader(stream)}
    with TABLE.open("w", newline="") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(("claim", *SIZES, "within"))
        for quick, full in zip(found["quick"], found["full"], strict=True):
            default = f"{1e-3 * max(abs(quick.ours), abs(full.ours)):.1g}"
            table.writerow((full.name, f"{quick.ours:.6g}", f"{full.ours:.6g}", within.get(full.name, default)))
    table = markdown_table(("claim", "paper", "ours", "verdict"), rows(found["full"]))
    PAGE.write_text(HEAD + table + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
