"""Writes docs/results/faults.md from the tables of two fault studies.

stewart-drake faults --out runs/faults
stewart-drake faults --out runs/faults-observer --set estimator.kind=observer
python docs/scripts/write_faults.py runs/faults runs/faults-observer     # some minutes for each study on two cores
"""

import re
import sys
from pathlib import Path
from typing import NamedTuple

from stewart_drake.base.markdown import markdown_table
from stewart_drake.studies.faults import DURATION, FAULTS, ONSET

TARGET = Path(__file__).parents[1] / "results" / "faults.md"
CELL = re.compile(r"[^(:]+?(?: \((?P<monitor>\w+)(?:, (?P<latency>\d+) ms)?(?:, leg \d)?\))?: (?P<end>\w+)")
NOTHING = 0.1
"""[mm] of travel up to which a fault has no row."""
TEXT = """# When something breaks

What does the safety layer do when a part of the robot fails, and how far does the platform travel until it is at rest?
{count} faults, each while the robot holds a pose, breathes, and follows the paper's motion.

Command: `stewart-drake faults`, and the same with `--set estimator.kind=observer`. They write these tables with
all columns, and what every fault is; `docs/scripts/write_faults.py` makes this page of both.

## Faults that end or interrupt a run

{tripped}

- *Trips after*: monitor, and time from the fault to its trip, while the robot holds, breathes and follows the paper's
  motion; one time if it is the same in all. No time: the fault is there from the start, or comes by chance.
- *Travel*: how far the true pose goes from the reference, until brakes hold every crank. They close at the end of a
  safe hold, or 50 ms after the motors were switched off. The worst of the three motions.
- *completed*: the layer held the last good command or pose and gave control back. *stopped*: it brought the robot to a
  safe hold. *failed*: it switched the motors off.
- An encoder that drifts, or that freezes while the robot is at rest, is not noticed: six readings for six degrees of
  freedom never contradict each other; with an [inertial sensor](parity.md) it is.
- With a dead motor the other five cannot carry the platform: they need an external force of {support} N to hold it at
  rest. So brakes must close.

## Faults that the loop tolerates

No monitor trips, and all runs are completed. The platform travels by at most {nothing:g} mm with {still}.

{borne}

Runs of {duration:g} s of the exact-model LQI at 1 kHz with `safety: {{}}`, faults from {onset:g} s on.
"""


class Row(NamedTuple):
    """A fault of a study: its cells by motion, and its travel in words."""

    ends: list[re.Match[str] | None]
    travel: str

    @property
    def outcome(self) -> str:
        """Of the runs, those that differ in the order of the motions."""
        return ", ".join(dict.fromkeys(end["end"] if end else "refused" for end in self.ends))

    @property
    def trips(self) -> str:
        """Monitors and latencies; a monitor that trips again is not repeated."""
        found = {end and end.group("monitor", "latency") for end in self.ends}
        if len(found) == 1:
            return " ".join(filter(None, found.pop() or ())).replace("_", " ") or "-"
        words, last = [], None
        for end in self.ends:
            monitor = end and end["monitor"]
            name = f"{monitor} ".replace("_", " ") if monitor and monitor != last else ""
            words.append(f"{name}{end['latency'] or ''}".strip() if end and monitor else "-")
            last = monitor or last
        return ", ".join(filter(None, words)) if any(word != "-" for word in words) else "-"


def read(page: str) -> dict[str, Row]:
    """The rows of a page that `faults` has written, by fault."""
    found = {}
    for line in page.splitlines():
        name, *cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if line.startswith("|") and name.strip() in FAULTS:
            *motions, travel, _ = cells
            found[name.strip()] = Row([CELL.match(cell) for cell in motions], re.sub(" deg| mm", "", travel.strip()))
    return found


def write(plain: str, observed: str) -> str:
    """The page of two pages that `faults` has written, without an observer and with one."""
    tripped, borne, still, other = [], [], [], read(observed)
    for name, row in read(plain).items():
        seen = other[name]
        if {row.outcome, seen.outcome} == {"completed"} and row.trips == seen.trips == "-":
            found = [float(travel.split(", ")[1]) for travel in (row.travel, seen.travel)]
            if max(found) <= NOTHING:
                still.append(f"`{name}`")
            else:
                borne.append((f"`{name}`", row.travel, seen.travel))
        else:
            outcome = row.outcome if row.outcome == seen.outcome else f"{row.outcome}; observer: {seen.outcome}"
            trips = "same" if seen.trips == row.trips else seen.trips
            tripped.append((f"`{name}`", outcome, row.trips, row.travel, trips, seen.travel))
    support = [float(found) for found in re.findall(r"external force of ([\d.]+) N", plain)]
    header = ("fault", "outcome", "trips after [ms]", "travel [deg], [mm]")
    observer = ("observer: trips after [ms]", "observer: travel [deg], [mm]")
    return TEXT.format(
        count=len(other),
        tripped=markdown_table((*header, *observer), tripped),
        borne=markdown_table((header[0], header[-1], observer[-1]), borne),
        support=f"{min(support):g} to {max(support):g}",
        nothing=NOTHING,
        still=", ".join(still),
        duration=DURATION,
        onset=ONSET,
    )


if __name__ == "__main__":
    pages = ((Path(folder) / "faults.md").read_text(encoding="utf-8") for folder in sys.argv[1:])
    TARGET.write_text(write(*pages), encoding="utf-8")
