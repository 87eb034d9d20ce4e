"""Random faults on shipped scenarios: the platform's true travel with the safety layer, with a plain stop, and without.

`python docs/random_faults.py [N]` writes docs/results/random_faults.md: 500 faults, on the fast engine.
"""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from stewart_drake.files.whole import write_atomically
from stewart_drake.logs.log import SimulationLog
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.studies.faults import stopped_at, travel
from stewart_drake.studies.study import markdown

PAGE = Path(__file__).parent / "results" / "random_faults.md"
ENCODERS = {"sensors": {"kind": "encoders", "rate_cutoff": 150.0}, "command_delay": 1}
SINE = {"reference": {"kind": "sine", "amplitude": [0, 0, 0, 0, 0, 0.004], "angular_frequency": "1 Hz"}}
LOOPS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "exact_breathing": ("exact_breathing", {}),
    "exact_heart": ("exact_heart", {}),
    "exact_fig7 with encoders": ("exact_fig7", ENCODERS),
    "sine of 4 mm": ("exact_breathing", SINE),
}
OBSERVED = ({"estimator": {"kind": "observer"}, "tuner": "policy"}, {"estimator": {"kind": "difference"}, "tuner": {"kind": "block"}})
OF_ENCODERS = ("freeze", "nan", "jump", "late", "drift", "reversed", "inverted", "swapped")
OF_MOTORS = ("dead", "motor reversed", "motors swapped")
DURATION = 2.0


def drawn(number: int) -> tuple[str, float, Scenario]:
    """Kind, onset [s] and scenario of a random fault."""
    rng = np.random.default_rng([32, number])
    name, changes = LOOPS[str(rng.choice(list(LOOPS)))]
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
    common = {"name": f"fault {number}", "plant.engine": "reduced", "duration": DURATION, "safety": {}}
    return kind, onset, load_scenario(name).replace({**changes, **common, **observed}).replace(more)


def row(number: int) -> dict[str, Any]:
    kind, onset, scenario = drawn(number)
    log = run(scenario, check=False)
    logs: list[SimulationLog] = [log]
    logs += [run(each, check=False) for each in (stopped_at(scenario, onset), scenario.replace({"safety": None}))]
    ends = np.array([travel(each, onset) for each in logs]) * (np.degrees(1.0), 1e3)
    trip = log.safety or {}
    return {"number": number, "kind": kind, "trip": trip.get("monitor"), "leg": trip.get("leg"), "at": trip.get("time"),
            "onset": onset, "status": [each.status for each in logs], "name": scenario.name, "ends": ends}  # fmt: skip


def main(count: int = 500) -> None:
    rows = [row(number) for number in (range(count) if len(sys.argv) < 3 else map(int, sys.argv[2:]))]
    lines = []
    for kind in (*OF_ENCODERS, *OF_MOTORS, "all"):
        own = np.array([each["ends"] for each in rows if kind in (each["kind"], "all")])
        if not len(own):
            continue
        beyond, worse = own[:, 0] - own[:, 1], own[:, 0] - np.maximum(own[:, 1], own[:, 2])
        most = [f"{np.quantile(beyond[:, k], q):.1f}" for q in (0.95, 1.0) for k in range(2)]
        largest = [f"{own[:, at].max(axis=0)[0]:.0f} deg, {own[:, at].max(axis=0)[1]:.0f} mm" for at in range(3)]
        lines.append((kind, str(len(own)), *most, f"{(beyond > (5.0, 10.0)).any(axis=1).sum()}", f"{(worse > (0.5, 1.0)).any(axis=1).sum()}", *largest))
    header = ("fault", "runs", "95 % deg", "95 % mm", "worst deg", "worst mm", "beyond 5 deg or 10 mm", "worse than both", "with", "stop", "without")
    print("\n".join(markdown(header, lines)))
    return rows


if __name__ == "__main__":
    import pickle
    rows = main(int(sys.argv[1]) if len(sys.argv) > 1 else 500)
    pickle.dump(rows, open("/tmp/rows.pkl", "wb"))
    for each in rows:
        if ((each["ends"][0] - each["ends"][1]) > (5.0, 10.0)).any():
            print(each["number"], each["kind"], each["trip"], each["leg"], each["at"] and round(each["at"]-each["onset"], 3), each["status"], each["ends"].round(1).tolist())
