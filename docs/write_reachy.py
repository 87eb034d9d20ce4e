"""What an owner of Reachy Mini has and can have: docs/results/reachy.md and its picture, `make reachy`, two minutes.

Needs the packages `reachy_mini` and `reachy_mini_dances_library` of its maker.
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

from stewart_drake import run
from stewart_drake.base.markdown import markdown_table, number
from stewart_drake.base.yaml_files import find_file, read_mapping
from stewart_drake.plotting.style import BLUE, GREEN, GREY, ORANGE, logarithmic, panels, save_figure, styled
from stewart_drake.studies.comparison import Comparison
from stewart_drake.studies.experiment import run_experiment

FILE = find_file("comparison", "reachy")
sys.path.insert(0, str(FILE.parent))
from reachy_dance import moves

OUT, RUNS = Path(__file__).parent / "results", Path("runs/reachy")
OURS, MAKERS = "our plant", "maker's model"
MOTIONS = ("nod", "look around", "breathing")

# Moves that jump, or nearly, are averaged over this [s]; two go where the cranks cannot and are made smaller.
SMOOTHED = dict.fromkeys(
    ("sharp_side_tilt", "side_peekaboo", "yeah_nod", "neck_recoil", "chicken_peck", "grid_snap", "jackson_square"), 0.04
)
SMALLER = {"headbanger_combo": 0.75, "jackson_square": 0.6}

# What the MJCF has of motors: class -> dry friction [N m], viscous friction [N m s/rad], rotor [kg m^2].
CLASSES = {"xc330m288t": (0.058, 0.095, 0.0018), "perfect_actuator": (0.1, 0.15, 0.001)}
FREE = {"passive_friction": 0, "passive_armature": 0}


def altered(**keys: object) -> Comparison:
    """The comparison `reachy` with other keys."""
    return Comparison.from_dict({**read_mapping("comparison", FILE, 80), **keys}, FILE.parent)


def makers_servos() -> Comparison:
    """Motors as the maker's MJCF has them, on its model: with ball joints that turn freely, and as it is."""
    file = read_mapping("comparison", FILE, 80)
    controllers, conditions, runs = {}, {}, []
    for name, (coulomb, viscous, rotor) in CLASSES.items():
        believed = {
            "model.friction": {"coulomb": coulomb, "viscous": viscous, "width": 0.004},
            "model.robot": {"rotor_inertia": rotor},
        }
        servo = {"kind": "position", "preset": name}
        loop = {"kind": "feedforward", "period": 0.01}
        rigid = {**servo, "damping": 0.0, "resolution_bits": None}
        rows = {
            f"{name}, angles": {"controller": {**loop, "feedforward": "none"}, "model.motors": rigid},
            f"{name}, exact model": {"controller": loop},
        }
        rows = {row: {**believed, "motors": {**servo, "delay": 0.01}, **keys} for row, keys in rows.items()}
        if name == "xc330m288t":
            rows |= {f"torque, {tuner}": {**believed, "motors": "torque", "tuner": tuner} for tuner in ("block", "policy")}
        controllers |= rows
        plant = {"kind": "mujoco", "model_file": "reachy_mini", "motor_class": name}
        conditions |= {f"{name}, free": {"plant": {**plant, **FREE}}, f"{name}, as it is": {"plant": plant}}
        for condition in (f"{name}, free", f"{name}, as it is"):
            runs.append({"controllers": list(rows), "references": list(MOTIONS), "conditions": [condition]})
    return altered(controllers=controllers, conditions=conditions, runs=runs, references={name: file["references"][name] for name in MOTIONS})


def dances() -> Comparison:
    """Every move of the library, by angles and by the exact model, 50 Hz, on the maker's model."""
    file = read_mapping("comparison", FILE, 80)
    controllers = {name: file["controllers"][name] for name in ("angles, 50 Hz", "exact model, 50 Hz")}
    references = {}
    for name, (_, _, facts) in moves().items():
        period = facts["default_duration_beats"] * 60.0 / 114.0
        arguments = {"move": name, "smoothing": SMOOTHED.get(name, 0.0)}
        motion = {"kind": "reachy_dance.py:Dance", "arguments": arguments}
        reference = {"kind": "adjusted", "fade_in": 1.0, "center": [0, 0, 0, 0, 0, 0.177], "motion": motion}
        reference["scale"] = SMALLER.get(name, 1.0)
        references[name] = {"duration": round(2.0 * max(3.0, period), 2), "reference": reference}
    return altered(controllers=controllers, references=references, conditions={MAKERS: file["conditions"][MAKERS]})


def rows_of(comparison: Comparison, name: str) -> dict[tuple[str, str, str], dict]:
    rows = run_experiment(comparison, RUNS / name).rows["comparison"]
    return {(row["controller"], row["reference"], row["condition"]): row for row in rows}


if __name__ == "__main__":
    for name, made in (("servos", makers_servos()), ("dances", dances())):
        for key, row in rows_of(made, name).items():
            print(*key, row["status"], row["message"] and row["message"][:150], *(number(row[k]) for k in ("rmse_norm_deg","rmse_norm_mm","ripple_deg_s","ripple_mm_s","torque_peak","crank_speed_peak_deg_s")))
