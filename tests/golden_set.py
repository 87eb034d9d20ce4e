"""Records what the package computes, and compares two recordings: for changes of shape that must change no number.

    python tests/golden_set.py record FOLDER      # by whichever stewart_drake Python finds
    python tests/golden_set.py compare OLD NEW

Twelve short runs over all controllers, tuners, sensors, safety and faults; a sweep; a comparison; the quick report.
`record --no-report` leaves out the report, which takes minutes. It uses public names and the command line alone, so
that it runs on any revision.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import yaml

EXACT = {
    "period": 0.001,
    "model": "exact",
    "feedforward": "full",
    "feedforward_at": "reference",
    "weight_length": 0.11,
    "solver": "split",
    "compiled": True,
    "saturation": "back_calculation",
    "hold_ticks": 10,
}
BLOCK = {"kind": "block", "q_pose": 4.0e5, "q_rate": 30.0, "q_integral": 4.0e7, "r": 1.0}
ENCODERS = {"kind": "encoders", "resolution_bits": 17, "rate_cutoff": 150.0, "noise": 2e-5, "noise_seed": 3}
BREATHING = {
    "kind": "sine",
    "amplitude": [0.05, 0, 0, 0, 0, 0.01],
    "angular_frequency": [1.9, 1.9, 1.9, 1.9, 1.9, 1.9],
}
SCENARIOS = {
    "ann": {"duration": 1.0},
    "fixed_no_gravity": {"gravity": 0.0, "duration": 1.0, "tuner": {"kind": "fixed", "omega_q": 10.0}},
    "falls": {"duration": 2.0, "tuner": {"kind": "fixed"}, "controller": {"feedforward": "none"}},
    "signed": {"duration": 0.6, "tuner": {"kind": "fixed", "density": "signed", "window": 9}},
    "exact": {"duration": 1.0, "controller": EXACT, "tuner": BLOCK, "reference": BREATHING},
    "exact_numpy": {
        "duration": 0.3,
        "controller": {**EXACT, "compiled": False},
        "tuner": BLOCK,
        "reference": BREATHING,
    },
    "encoders": {
        "duration": 1.0,
        "controller": EXACT,
        "tuner": BLOCK,
        "reference": BREATHING,
        "sensors": ENCODERS,
        "command_delay": 1,
        "plant": {"motor_friction": 0.01},
    },
    "pid": {"duration": 0.6, "controller": {"kind": "pid", "period": 0.001}, "reference": BREATHING},
    "computed_torque": {
        "duration": 0.6,
        "controller": {"kind": "computed_torque", "period": 0.001},
        "reference": {"kind": "heartbeat"},
        "initial_offset": [0.01, 0, 0, 0, 0.001, 0],
    },
    "payload_push": {
        "duration": 0.8,
        "controller": EXACT,
        "tuner": BLOCK,
        "reference": {"kind": "hold"},
        "plant": {"payload_mass": 0.3},
        "motors": {"ripple": 0.01},
        "disturbances": [{"kind": "step", "wrench": [0, 0, 0, 3.0, -2.0, -4.0], "time": 0.2, "until": 0.5}],
    },
    "safety": {
        "duration": 1.0,
        "controller": EXACT,
        "tuner": BLOCK,
        "reference": BREATHING,
        "sensors": ENCODERS,
        "safety": {},
        "link": {"stop_time": 0.5},
    },
    "faulty_encoder": {
        "duration": 0.8,
        "controller": EXACT,
        "tuner": BLOCK,
        "reference": BREATHING,
        "sensors": {**ENCODERS, "faults": [{"leg": 2, "kind": "freeze", "time": 0.4}]},
        "safety": {},
    },
}
SWEEP = {
    "scenario": "paper_fig7",
    "runs": 4,
    "seed": 5,
    "mismatch": True,
    "set": {"duration": 0.4, "tuner": {"kind": "fixed", "omega_q": 10.0}},
    "distributions": {
        "robot.platform_mass": {"kind": "uniform", "low": 0.8, "high": 1.2, "factor": True},
        "initial_offset[0]": {"kind": "normal", "mean": 0.0, "std": 0.01},
    },
}
COMPARISON = {
    "scenario": "exact_fig7",
    "set": {"duration": 0.5},
    "controllers": {"exact": {}, "pid": {"controller": {"kind": "pid"}}, "fixed": {"tuner": {"kind": "fixed"}}},
    "references": {"(37), (38)": {}, "breathing": {"reference": BREATHING}},
    "conditions": {"ideal": {}, "encoders": {"sensors": ENCODERS}},
    "runs": [
        {
            "controllers": ["exact", "pid", "fixed"],
            "references": ["(37), (38)", "breathing"],
            "conditions": ["ideal", "encoders"],
        }
    ],
}


def record(folder, report=True):
    """Writes NAME.npz and NAME.json of each run, and the folders sweep, comparison and report."""
    from stewart_drake import Scenario, run, run_metrics

    folder.mkdir(parents=True)
    for name, data in SCENARIOS.items():
        log = run(Scenario.from_dict(data), check=False)
        np.savez(folder / f"{name}.npz", **log.signals)
        (folder / f"{name}.json").write_text(json.dumps(run_metrics(log), indent=1))
    (folder / "sweep.yaml").write_text(yaml.safe_dump(SWEEP))
    (folder / "comparison.yaml").write_text(yaml.safe_dump(COMPARISON, sort_keys=False))
    command(folder, "sweep", "sweep", str(folder / "sweep.yaml"))
    command(folder, "comparison", "compare", str(folder / "comparison.yaml"))
    if report:
        command(folder, "report", "reproduce", "--quick")


def command(folder, name, *arguments):
    out = ["--out", str(folder / name), "--quiet"]
    subprocess.run([sys.executable, "-m", "stewart_drake", *arguments, *out], check=True)


def numbers(folder):
    """Name -> array or plain value of everything recorded."""
    found = {}
    for path in sorted(folder.glob("*.npz")):
        found |= {f"{path.stem}.{name}": value for name, value in np.load(path).items()}
    for path in [*sorted(folder.glob("*.json")), folder / "report" / "report.json"]:
        if path.is_file():
            document = json.loads(path.read_text())
            flatten(path.stem, document.get("numbers", document), found)
    for path in sorted(folder.glob("*/*.parquet")):
        for column, values in pq.read_table(path).to_pydict().items():
            flatten(f"{path.parent.name}.{path.stem}.{column}", values, found)
    return found


def flatten(key, value, found):
    if isinstance(value, dict):
        for name, inner in value.items():
            flatten(f"{key}.{name}", inner, found)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            flatten(f"{key}[{index}]", inner, found)
    else:
        found[key] = value


TELLS_ABOUT_THE_MACHINE = (
    "versions",
    "wall",
    "files",
    "seconds",
    "git_revision",
    "source",
    "_s[",
    "worker",
    "real_time_factor",
)


def compare(old, new):
    """Prints what differs, the largest relative difference first; ends with status 1 if anything does."""
    one, two = numbers(old), numbers(new)
    differ = []
    for key in sorted(one.keys() | two.keys()):
        if any(word in key for word in TELLS_ABOUT_THE_MACHINE):
            continue
        a, b = one.get(key, "not there"), two.get(key, "not there")
        try:
            a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
            if np.array_equal(a, b, equal_nan=True):
                continue
            scale = max(float(np.nanmax(np.abs(a))), 1e-300)
            differ.append((float(np.nanmax(np.abs(a - b))) / scale if a.shape == b.shape else np.inf, key, ""))
        except (TypeError, ValueError):
            if str(a) != str(b):
                differ.append((np.inf, key, f"{str(a)[:60]} | {str(b)[:60]}"))
    for size, key, text in sorted(differ, reverse=True):
        print(f"{size:.2e}  {key}  {text}")
    print(f"{len(differ)} of {len(one)} differ")
    return bool(differ)


if __name__ == "__main__":
    what, *rest = sys.argv[1:]
    if what == "record":
        record(Path(rest[0]), "--no-report" not in rest)
    else:
        sys.exit(compare(Path(rest[0]), Path(rest[1])))
