r"""Writes docs/results/faults.md from the tables of three fault studies.

stewart-drake faults --out runs/faults
stewart-drake faults --out runs/faults-observer --set estimator.kind=observer
stewart-drake faults --out runs/faults-sensor --set estimator.kind=observer --set sensors.kind=encoders \
    --set sensors.imu.preset=bmi088 --set command_delay=1
python docs/scripts/write_faults.py runs/faults runs/faults-observer runs/faults-sensor     # five minutes on two cores
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
SENSOR = re.compile(r"encoder|homing|imu_|gyro_|accelerometer_")
"""Names of the faults in which an inertial sensor matters."""
TEXT = """# When something breaks

What does the safety layer do when a part of the robot fails, and how far does the platform travel until it is at rest?
{count} faults, each while the robot holds a pose, breathes, and follows the paper's motion.

Command: `stewart-drake faults`, the same with `--set estimator.kind=observer`, and that with
`--set sensors.kind=encoders --set sensors.imu.preset=bmi088 --set command_delay=1`. They write these tables with
all columns, and what every fault is; `docs/scripts/write_faults.py` makes this page of the three.

## Faults of encoders, and of an inertial sensor

**With an inertial sensor on the platform {unnoticed}.**
Without it {without}: six readings for six degrees of freedom never
contradict each other, and the platform follows the wrong one.

{sensors}

- *unnoticed*: no monitor trips, and the true pose goes farther from the reference than `safety.following_error` allows.
  *tolerated*: no monitor trips, and it stays within that.
- Both columns are with the observer.
- *stopped*, with the sensor: the robot came to rest and was held on five encoders and the sensor, or on all six if none
  is wrong, to the end of the safe hold ([how long it can be](lost_encoder.md)). Then brakes close. A slow drift is
  found when it has turned the platform by about a degree.

## Other faults that end or interrupt a run

Without an inertial sensor, which {others}.

{tripped}

- *Trips after*: monitor, and time from the fault to its trip, while the robot holds, breathes and follows the paper's
  motion; one time if it is the same in all. No time: the fault is there from the start, or comes by chance.
- *Travel*: how far the true pose goes from the reference, until brakes hold every crank. They close at the end of a
  safe hold, or 50 ms after the motors were switched off. The worst of the three motions.
- *completed*: the layer held the last good command or pose and gave control back. *stopped*: it brought the robot to a
  safe hold. *failed*: it switched the motors off.
- With a dead motor the other five cannot carry the platform: they need an external force of {support} N to hold it at
  rest. So brakes must close.

## Other faults that the loop tolerates

No monitor trips, and all runs are completed. The platform travels by at most {nothing:g} mm with {still}.

{borne}

Runs of {duration:g} s of the exact-model LQI at 1 kHz with `safety: {{}}`, faults from {onset:g} s on.
"""


class Row(NamedTuple):
    """A fault of a study: its cells by motion, and its travel in words."""

    ends: list[re.Match[str] | None]
    travel: str
    reactions: list[str]

    @property
    def outcome(self) -> str:
        """Of the runs, those that differ in the order of the motions."""
        return ", ".join(dict.fromkeys(end["end"] if end else "refused" for end in self.ends))

    @property
    def reaction(self) -> str:
        """How the layer reacted, without the details of a trip."""
        named = {"ridden through": "tolerated", "ramped": "stopped"}
        return ", ".join(dict.fromkeys(named.get(word, word) for word in self.reactions))

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
            words = [re.split(r" \(|:", cell)[0] for cell in motions]
            numbers = re.sub(" deg| mm", "", travel.strip())
            found[name.strip()] = Row([CELL.match(cell) for cell in motions], numbers, words)
    return found


def unnoticed(rows: dict[str, Row]) -> list[str]:
    """Faults that are unnoticed in a motion."""
    return [f"`{name}`" for name, row in rows.items() if "unnoticed" in row.reactions]


def sensor_table(plain: dict[str, Row], sensor: dict[str, Row]) -> str:
    """What becomes of the faults in which the sensor matters, without it and with it."""
    rows = []
    if raised := [name for name, row in sensor.items() if "raised" in row.reactions]:
        raise SystemExit(f"runs of {', '.join(raised)} raised an error; expected none: repeat the study")
    for name, row in sensor.items():
        if SENSOR.match(name):
            before = plain.get(name)
            cells = ("-",) * 3 if before is None else (before.reaction, before.trips, before.travel)
            rows.append((f"`{name}`", *cells, row.reaction, row.trips, row.travel))
    names = ("outcome", "trips after [ms]", "travel [deg], [mm]")
    return markdown_table(("fault", *names, *(f"sensor: {name}" for name in names)), rows)


def compared(observed: dict[str, Row], sensor: dict[str, Row]) -> str:
    """How the other faults differ with the sensor, in words."""
    other = []
    for name, row in observed.items():
        new = sensor[name]
        if not SENSOR.match(name) and row.travel != "-" and new.travel != "-":
            before, now = ([float(number) for number in each.travel.split(", ")] for each in (row, new))
            if now[0] > before[0] + 1.0 or now[1] > before[1] + 5.0:
                other.append(f"`{name}` {new.travel} instead of {row.travel} with the observer")
    return "changes them little" + (f", but for travel with {'; '.join(other)}" if other else "")


def write(plain: str, observed: str, sensed: str) -> str:
    """The page of three pages of `faults`: without an observer, with one, and with an inertial sensor as well."""
    tripped, borne, still, first, other, sensor = [], [], [], read(plain), read(observed), read(sensed)
    for name, row in first.items():
        seen = other[name]
        if SENSOR.match(name):
            continue
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
    found, lost = unnoticed(sensor), dict.fromkeys(unnoticed(first) + unnoticed(other))
    return TEXT.format(
        count=len(sensor),
        unnoticed=f"{', '.join(found)} go unnoticed" if found else "no fault goes unnoticed",
        without=f"{' and '.join(lost)} do" if lost else "none does either",
        sensors=sensor_table(other, sensor),
        others=compared(other, sensor),
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
