"""Random faults on shipped scenarios: the platform's true travel with the safety layer, with a stop, and without.

`python docs/scripts/random_faults.py` writes docs/results/random_faults.md, on the fast engine: six minutes on
one core.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.markdown import markdown_table
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.scenario import Scenario, load_scenario
from stewart_drake.studies.faults import stopped_at, travel

TARGET = Path(__file__).parents[1] / "results" / "random_faults.md"
BOUNDS = (5.0, 10.0)  # [deg, mm] beyond a stop at the onset, which 95 % of the faults are to keep.
ENCODERS = {"sensors": {"kind": "encoders"}, "command_delay": 1}
SINE = {"reference": {"kind": "sine", "amplitude": [0, 0, 0, 0, 0, 0.004], "angular_frequency": "1 Hz"}}
LOOPS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "exact_breathing": ("exact_breathing", {}),
    "exact_heart": ("exact_heart", {}),
    "exact_fig7 with encoders": ("exact_fig7", ENCODERS),
    "sine of 4 mm": ("exact_breathing", SINE),
}
REACHY: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    name: (name, {}) for name in ("reachy_nod", "reachy_look_around")
}
OBSERVED = (
    {"estimator": {"kind": "observer"}, "tuner": "policy"},
    {"estimator": {"kind": "difference", "rate_cutoff": 150.0}, "tuner": {"kind": "block"}},
)
OF_ENCODERS = ("freeze", "nan", "jump", "late", "drift", "reversed", "inverted", "swapped")
OF_MOTORS = ("dead", "motor reversed", "motors swapped")
DURATION = 2.0


def drawn(number: int, loops: Mapping[str, tuple[str, Mapping[str, Any]]] = LOOPS) -> tuple[str, float, Scenario]:
    """Kind, onset [s] and scenario of a random fault."""
    rng = np.random.default_rng([32, number])
    name, changes = loops[str(rng.choice(list(loops)))]
    kind = str(rng.choice(OF_ENCODERS + OF_MOTORS))
    leg, other = (int(each) for each in rng.permutation(6)[:2])
    onset, observed = round(float(rng.uniform(0.3, 1.3)), 3), OBSERVED[int(rng.integers(2))]
    fault: dict[str, Any] = {"time": onset, "leg": leg}
    low, high = {"jump": (0.005, 0.2), "drift": (0.001, 0.3), "late": (0.002, 0.02)}.get(kind, (1.0, 1.0))
    size = low * (high / low) ** float(rng.random())
    if kind in ("jump", "drift"):
        fault["size"] = size * float(rng.choice((-1.0, 1.0)))
    if kind == "late":
        fault["delay"] = size
    if kind.endswith("swapped"):
        fault["other"] = other
    more: dict[str, Any] = {"sensors.faults": [{"kind": kind, **fault}]}
    if kind == "dead":
        more = {"motors.dead": fault}
    elif kind in OF_MOTORS:
        more = {"motors.faults": [{"kind": kind.split()[1], **fault}]}
    common = {"name": f"fault {number}", "plant.kind": "closed_form", "duration": DURATION, "safety": {}}
    return kind, onset, load_scenario(name).replace({**changes, **common, **observed}).replace(more)


def row(number: int, loops: Mapping[str, tuple[str, Mapping[str, Any]]] = LOOPS) -> dict[str, Any]:
    """Travels [deg, mm] of a fault with the safety layer, with a stop at the onset, and without a safety layer."""
    kind, onset, scenario = drawn(number, loops)
    without = scenario.replace({"safety": None})
    logs = [run(each, check=False) for each in (scenario, stopped_at(scenario, onset), without)]
    ends = [np.array(travel(each, onset)) * (np.degrees(1.0), 1e3) for each in logs]
    trip = logs[0].safety or {"monitor": None, "time": np.nan, "leg": None}
    named = trip["leg"] is None or trip["leg"] in _legs(scenario)
    latency = 1e3 * (trip["time"] - onset)
    return {"kind": kind, "monitor": trip["monitor"], "latency": latency, "named": named, "travel": np.array(ends)}


def _legs(scenario: Scenario) -> set[int]:
    faults = (*scenario.sensors.faults, *scenario.motors.faults, *filter(None, [scenario.motors.dead]))
    return {getattr(each, name, None) for each in faults for name in ("leg", "other")}


def write(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table of some faults, and what is to be said of them."""
    lines = []
    for kind in (*OF_ENCODERS, *OF_MOTORS, "all"):
        own = [each for each in rows if kind in (each["kind"], "all")]
        if not own:
            continue
        ways = np.array([each["travel"] for each in own])
        beyond, largest = ways[:, 0] - ways[:, 1], [_words(each) for each in ways[:, ::2].max(axis=0)]
        latency = [each["latency"] for each in own if each["monitor"] is not None]
        late = f"{np.median(latency):.0f}, {max(latency):.0f}" if latency else "-"
        most = _words(np.quantile(beyond, 0.95, axis=0))
        lines.append((kind, f"{len(latency)} of {len(own)}", late, most, *largest))
    ways, drifts = np.array([each["travel"] for each in rows]), np.array([each["kind"] == "drift" for each in rows])
    beyond, worse = (ways[:, 0] - ways[:, 1] > BOUNDS).any(axis=1), ways[:, 0] - ways[:, 2]
    return TABLE.format(
        runs=len(rows),
        table=markdown_table(HEADER, lines),
        beyond=int(beyond.sum()),
        share=f"{100.0 * beyond.mean():.1f}",
        drifts=int(beyond[drifts].sum()),
        farther=int((worse[:, 1] > 0.1).sum()),
        tilted=int((worse[:, 0] > 0.1).sum()),
        most=f"{worse[:, 0].max():.1f}",
        wrong=sum(not each["named"] for each in rows),
    )


def _words(size: np.ndarray) -> str:
    return f"{size[0]:.1f}, {size[1]:.1f}"


HEADER = (
    "fault",
    "tripped",
    "latency: median, longest [ms]",
    "95 % go farther than a stop by at most [deg], [mm]",
    "largest travel with the layer [deg], [mm]",
    "without [deg], [mm]",
)
TABLE = """{table}

- {beyond} of {runs} faults ({share} %) go more than 5 deg or 10 mm farther than a stop; {drifts} of them are drifts.
- Farther with the layer than without: {farther} by more than 0.1 mm, {tilted} by more than 0.1 deg (at most {most}
  deg).
- Trips that name a wrong leg: {wrong}."""
PAGE = """# Random faults

How far does a platform travel after a fault of any kind, at any time, with the safety layer and without?
Command: `python docs/scripts/random_faults.py`, six minutes on one core.

{paper}

- Kind, leg, size and onset are random, during `exact_breathing`, `exact_heart`, `exact_fig7` with encoders, or a sine
  of 4 mm. Jumps are of 5 to 200 mrad, drifts of 1 to 300 mrad/s; late readings are 2 to 20 ms old.
- *Travel*: how far the true pose goes from the reference, until [brakes](faults.md) hold all cranks. *A stop* is a
  plain stop in the tick of the fault.
- No torque shows a drift: six readings for six degrees of freedom never contradict each other.

## Reachy Mini

The same during `reachy_nod` and `reachy_look_around`. The bus has a tick of 10 ms and the motors have much friction, so
a wrong torque shows later.

{reachy}
"""

if __name__ == "__main__":
    share = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0  # of the faults, for a trial
    studies = {"reachy": (REACHY, 100), "paper": (LOOPS, 500)}
    parts = {
        name: write([row(number, loops) for number in range(int(share * count))])
        for name, (loops, count) in studies.items()
    }
    write_atomically(TARGET, PAGE.format(**parts).encode())
