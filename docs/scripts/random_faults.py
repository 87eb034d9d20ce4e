"""Random faults on shipped scenarios, without an inertial sensor and with one: the platform's true travel.

`python docs/scripts/random_faults.py` writes docs/results/random_faults.md, on the fast engine: ten minutes on two
cores. A number is the share of the faults, for a trial.
"""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from joblib import Parallel, delayed

from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.markdown import markdown_table
from stewart_drake.hardware.presets import PRESETS
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
SENSOR = {"sensors.imu": {"preset": "bmi088"}}


class Setup(NamedTuple):
    """A robot with its motions, and how many faults it gets."""

    title: str
    loops: Mapping[str, tuple[str, Mapping[str, Any]]]
    count: int
    changes: Mapping[str, Any] = {}  # Of all loops.
    takes_angles: bool = False


_SERVO = PRESETS["xl330_m288"]
SERVOS: Mapping[str, Any] = {
    "plant": {"kind": "closed_form", "motor_damping": _SERVO.viscous, "motor_friction": _SERVO.coulomb},
    "controller": {"kind": "feedforward", "period": 0.02},
    "estimator": {"kind": "difference"},
    "tuner": "block",
    "motors": {"kind": "position", "preset": "xl330_m288", "delay": 0.02},
    "model": {"delay": 0, "friction": {"viscous": _SERVO.viscous, "coulomb": _SERVO.coulomb, "width": 0.004}},
    "command_delay": 0,
}
SETUPS = (
    Setup("The paper's robot, 1 kHz", LOOPS, 500),
    Setup("Reachy Mini by torque, 100 Hz", REACHY, 200),
    Setup("Reachy Mini by torque, 50 Hz", REACHY, 200, {"controller.period": 0.02}),
    Setup("Reachy Mini by angle, 50 Hz", REACHY, 200, SERVOS, takes_angles=True),
)
OBSERVED = (
    {"estimator": {"kind": "observer"}, "tuner": "policy"},
    {"estimator": {"kind": "difference", "rate_cutoff": 150.0}, "tuner": {"kind": "block"}},
)
OF_ENCODERS = ("freeze", "nan", "jump", "late", "drift", "reversed", "inverted", "swapped")
OF_MOTORS = ("dead", "motor reversed", "motors swapped")
DURATION = 2.0


def drawn(number: int, setup: Setup = SETUPS[0]) -> tuple[str, float, Scenario]:
    """Kind, onset [s] and scenario of a random fault."""
    rng = np.random.default_rng([32, number])
    name, changes = setup.loops[str(rng.choice(list(setup.loops)))]
    kind = str(rng.choice(OF_ENCODERS if setup.takes_angles else OF_ENCODERS + OF_MOTORS))
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
    if setup.takes_angles:
        fault["in_servo"] = bool(rng.random() < 0.5)
    more: dict[str, Any] = {"sensors.faults": [{"kind": kind, **fault}]}
    if kind == "dead":
        more = {"motors.dead": fault}
    elif kind in OF_MOTORS:
        more = {"motors.faults": [{"kind": kind.split()[1], **fault}]}
    common = {"name": f"fault {number}", "plant.kind": "closed_form", "duration": DURATION, "safety": {}}
    scenario = load_scenario(name).replace({**changes, **common, **observed})
    return kind, onset, scenario.replace(setup.changes).replace(more)


def row(number: int, setup: Setup = SETUPS[0]) -> dict[str, Any]:
    """Travels [deg, mm] of a fault without the sensor, with it, with a stop at the onset, and without a layer."""
    kind, onset, scenario = drawn(number, setup)
    scenarios = (scenario, scenario.replace(SENSOR), stopped_at(scenario, onset), scenario.replace({"safety": None}))
    logs = [run(each, check=False) for each in scenarios]
    ends = [np.array(travel(each, onset)) * (np.degrees(1.0), 1e3) for each in logs]
    trips = [log.safety or {"monitor": None, "time": np.nan, "leg": None} for log in logs[:2]]
    legs = _legs(scenario)
    return {
        "kind": kind,
        "monitor": [trip["monitor"] for trip in trips],
        "latency": [1e3 * (trip["time"] - onset) for trip in trips],
        "named": [trip["leg"] is None or trip["leg"] in legs for trip in trips],
        "travel": np.array(ends),
    }


def _legs(scenario: Scenario) -> set[int]:
    faults = (*scenario.sensors.faults, *getattr(scenario.motors, "faults", ()), *filter(None, [scenario.motors.dead]))
    return {getattr(each, name, None) for each in faults for name in ("leg", "other")}


def write(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table of some faults, and what is to be said of them."""
    lines = []
    for kind in (*OF_ENCODERS, *OF_MOTORS, "all"):
        own = [each for each in rows if kind in (each["kind"], "all")]
        if not own:
            continue
        ways, cells = np.array([each["travel"] for each in own]), []
        for with_it in range(2):
            latency = [each["latency"][with_it] for each in own if each["monitor"][with_it] is not None]
            late = f"{len(latency)}; {np.median(latency):.0f}, {max(latency):.0f}" if latency else "0"
            most = _words(np.quantile(ways[:, with_it] - ways[:, 2], 0.95, axis=0))
            beyond = int((ways[:, with_it] - ways[:, 2] > BOUNDS).any(axis=1).sum())
            cells += [late, most, _words(ways[:, with_it].max(axis=0)), str(beyond)]
        lines.append((f"{kind}, {len(own)}", *cells))
    ways, encoder = np.array([each["travel"] for each in rows]), [each["kind"] in OF_ENCODERS for each in rows]
    beyond, worse = ways[:, 1] - ways[:, 2] > BOUNDS, ways[:, 0] - ways[:, 3]
    return TABLE.format(
        runs=len(rows),
        table=markdown_table(HEADER, lines),
        share=" and ".join(_share(ways[:, each] - ways[:, 2]) for each in range(2)),
        encoders=int(beyond.any(axis=1)[encoder].sum()),
        farther=int((worse[:, 1] > 0.1).sum()),
        tilted=int((worse[:, 0] > 0.1).sum()),
        most=f"{worse[:, 0].max():.1f}",
        wrong=" and ".join(str(sum(not each["named"][with_it] for each in rows)) for with_it in range(2)),
    )


def _share(beyond: np.ndarray) -> str:
    return f"{100.0 * (beyond > BOUNDS).any(axis=1).mean():.1f} %"


def _words(size: np.ndarray) -> str:
    return f"{size[0]:.1f}, {size[1]:.1f}"


COLUMNS = ("trips; median, longest [ms]", "95 % beyond a stop by at most", "largest travel", "beyond")
HEADER = ("fault", *COLUMNS, *(f"sensor: {name}" for name in COLUMNS))
TABLE = """{table}

- *Beyond* by more than 5 deg or 10 mm: {share} of {runs} faults, without the sensor and with it; with it {encoders} of
  them are faults of encoders.
- Farther with the layer than without a layer: {farther} by more than 0.1 mm, {tilted} by more than 0.1 deg (at most
  {most} deg).
- Trips that name a wrong leg: {wrong}, without the sensor and with it.
"""
PAGE = """# Random faults

How far does a platform travel after a fault of any kind, at any time? With the safety layer, without and with an
[inertial sensor](parity.md) (BMI088) on the platform. Command: `python docs/scripts/random_faults.py`, ten minutes on
two cores.

- Kind, leg, size and onset are random. Jumps are of 5 to 200 mrad, drifts of 1 to 300 mrad/s; late readings are 2 to
  20 ms old. Half of the loops have the observer, the others differences of readings, which use the sensor only to
  compare.
- *Travel* in deg and mm: how far the true pose goes from the reference, until [brakes](faults.md) hold all cranks.
  *A stop* is a plain stop in the tick of the fault; *beyond* counts those that go 5 deg or 10 mm farther.
- Paper's robot: `exact_breathing`, `exact_heart`, `exact_fig7` with encoders, or a sine of 4 mm. Reachy Mini:
  `reachy_nod` and `reachy_look_around`.
- *By angle*: servos with a loop of their own; half of the faults are of the servo's own sensor, and move the crank.
- Six readings for six degrees of freedom never contradict each other: without the sensor no drift is found.

{parts}
## What the sensor cannot do

It does not see a motor. On Reachy Mini friction takes half of a motor's torque, so a wrong torque shows late: of a dead
or swapped motor the other half must be missing first. At 50 Hz the robot is then 5.7 deg away, where
`safety.following_error` stops it. A faster bus helps.

It does not stop a servo. One whose own sensor counts backwards, or is that of another crank, runs away by its own loop,
whatever it is commanded; almost all faults by angle that go far are of this kind. Its power must be cut.
"""

if __name__ == "__main__":
    share = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0  # of the faults, for a trial
    parts = []
    for setup in SETUPS:
        rows = Parallel(2)(delayed(row)(number, setup) for number in range(int(share * setup.count)))
        parts.append(f"## {setup.title}\n\n{write(rows)}")
    write_atomically(TARGET, PAGE.format(parts="\n".join(parts)).encode())
