"""What an owner of Reachy Mini has and can have: docs/results/reachy.md and its picture, `make reachy`, two minutes.

Needs the packages `reachy_mini` and `reachy_mini_dances_library` of its maker.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from stewart_drake import run
from stewart_drake.base.markdown import markdown_table
from stewart_drake.base.yaml_files import find_file, read_mapping
from stewart_drake.plotting.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    legend_below,
    logarithmic,
    panels,
    save_figure,
    styled,
)
from stewart_drake.studies.comparison import Comparison
from stewart_drake.studies.experiment import run_experiment

FILE = find_file("comparison", "reachy")
sys.path.insert(0, str(FILE.parent))
from reachy_dance import moves

OUT, RUNS = Path(__file__).parent / "results", Path("runs/reachy")
OURS, MAKERS = "our plant", "maker's model"
MOTIONS, DANCE = ("nod", "look around", "breathing"), "dance groovy_sway_and_roll"

# Moves that jump, or nearly, are averaged over this [s]; two go where the cranks cannot and are made smaller.
SMOOTHED = dict.fromkeys(
    ("sharp_side_tilt", "side_peekaboo", "yeah_nod", "neck_recoil", "chicken_peck", "grid_snap", "jackson_square"), 0.04
)
SMALLER = {"headbanger_combo": 0.75, "jackson_square": 0.6}

# What the MJCF has of motors: class -> dry friction [N m], viscous friction [N m s/rad], rotor [kg m^2]; and the
# width [rad/s] over which MuJoCo reverses that dry friction, the best of 0.004, 0.02, 0.05 and 0.1.
CLASSES = {"xc330m288t": (0.058, 0.095, 0.0018, 0.02), "perfect_actuator": (0.1, 0.15, 0.001, 0.1)}
FREE = {"passive_friction": 0, "passive_armature": 0}


def altered(**keys: object) -> Comparison:
    """The comparison `reachy` with other keys."""
    return Comparison.from_dict({**read_mapping("comparison", FILE, 80), **keys}, FILE.parent)


def makers_servos() -> Comparison:
    """Motors as the maker's MJCF has them, on its model: with ball joints that turn freely, and as it is."""
    controllers, conditions, runs = {}, {}, []
    for name, (coulomb, viscous, rotor, width) in CLASSES.items():
        friction = {"coulomb": coulomb, "viscous": viscous, "width": width}
        servo, loop = {"kind": "position", "preset": name}, {"kind": "feedforward", "period": 0.01}
        rigid = {**servo, "damping": 0.0, "resolution_bits": None}
        rows = {
            "angles": {"controller": {**loop, "feedforward": "none"}, "model.motors": rigid},
            "exact model": {"controller": loop},
        }
        rows = {row: {"motors": {**servo, "delay": 0.01}, **keys} for row, keys in rows.items()}
        if name == "xc330m288t":
            rows |= {f"torque, {tuner}": {"motors": "torque", "tuner": tuner} for tuner in ("block", "policy")}
        believed = {"model.friction": friction, "model.robot": {"rotor_inertia": rotor}}
        made = {f"{name}: {row}": {**believed, **keys} for row, keys in rows.items()}
        plant = {"kind": "mujoco", "model_file": "reachy_mini", "motor_class": name}
        under = {f"{name}, free": {"plant": {**plant, **FREE}}, f"{name}, as it is": {"plant": plant}}
        runs += [{"controllers": [*made], "references": [*MOTIONS], "conditions": [each]} for each in under]
        controllers |= made
        conditions |= under
    references = {name: read_mapping("comparison", FILE, 80)["references"][name] for name in MOTIONS}
    return altered(controllers=controllers, conditions=conditions, runs=runs, references=references)


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


Rows = dict[tuple[str, str, str], dict]


def rows_of(comparison: Comparison, name: str) -> Rows:
    """Figures by controller, motion and condition; kept in runs/reachy/NAME."""
    rows = run_experiment(comparison, RUNS / name).rows["comparison"]
    return {(row["controller"], row["reference"], row["condition"]): row for row in rows}


def shown(row: dict, *columns: str) -> str:
    """Numbers of two digits, or how the run ended."""
    return " / ".join(f"{row[name]:.2g}" for name in columns) if row["status"] == "completed" else row["status"]


DEG, MM, RIPPLE = "rmse_norm_deg", "rmse_norm_mm", "ripple_mm_s"
LARGEST = ("torque_peak", "crank_speed_peak_deg_s")
IN_PICTURE = {
    "angles, 50 Hz": ("the angles of the inverse kinematics, as sent today", ORANGE, "s"),
    "stiffness believed 1.3 times": ("exact model, but stiffness believed 1.3 times", GREY, "D"),
    "torque, 100 Hz, policy": ("by torque, 100 Hz", GREEN, "^"),
    "exact model, 50 Hz": ("exact model through the same servos, 50 Hz", BLUE, "o"),
}


def expected(rows: Rows) -> str:
    """The comparison of the file on the maker's model, a line a controller."""
    lines = []
    for name in dict.fromkeys(key[0] for key in rows):
        at = {motion: rows[name, motion, MAKERS] for motion in (*MOTIONS, DANCE)}
        figures = (shown(at["nod"], DEG), shown(at["look around"], DEG), shown(at["breathing"], MM, RIPPLE))
        most = (f"{max(row[column] for row in at.values()):.2g}" for column in LARGEST)
        lines.append((name, *figures, shown(at[DANCE], DEG, MM), *most))
    header = ("", "nod [deg]", "look around [deg]", "breathing [mm], its ripple [mm/s]")
    return markdown_table((*header, "dance [deg], [mm]", "peak torque [N m]", "peak speed [deg/s]"), lines)


def apart(rows: Rows) -> float:
    """How much more or less the largest error of a motion is on our plant, the worst of all lines, as a share."""
    shares = []
    for (name, motion, condition), row in rows.items():
        other, column = rows[name, motion, OURS], MM if motion == "breathing" else DEG
        if condition == MAKERS and motion in (*MOTIONS, DANCE):
            shares.append(abs(other[column] / row[column] - 1.0))
    return max(shares)


def of_makers_servos(rows: Rows) -> tuple[str, str]:
    """Tables of motions: with ball joints that turn freely, and on the model as it is."""
    tables = []
    for free, under in ((True, "free"), (False, "as it is")):
        names = [key[::2] for key in rows if key[1] == "nod" and key[2].endswith(under)]
        if not free:
            names = [name for name in names if "torque" not in name[0]]
        lines = []
        for motion, columns in (("nod", (DEG,)), ("look around", (DEG,)), ("breathing", (MM, RIPPLE))):
            unit = "deg" if columns == (DEG,) else "mm, ripple mm/s"
            lines.append((f"{motion} [{unit}]", *(shown(rows[name, motion, at], *columns) for name, at in names)))
        tables.append(markdown_table(("", *(name for name, _ in names)), lines))
    return tables[0], tables[1]


def of_dances(rows: Rows) -> str:
    """A line a move."""
    lines = []
    for name in dict.fromkeys(key[1] for key in rows):
        old, new = (rows[way, name, MAKERS] for way in ("angles, 50 Hz", "exact model, 50 Hz"))
        how = [f"{100.0 * SMALLER[name]:g} % of its size"] if name in SMALLER else []
        how += [f"averaged over {1e3 * SMOOTHED[name]:g} ms"] if name in SMOOTHED else []
        most = (f"{new[column]:.2g}" for column in LARGEST)
        lines.append((f"`{name}`", ", ".join(how), shown(old, DEG, MM), shown(new, DEG, MM), *most))
    header = ("move", "made possible by", "angles [deg], [mm]", "exact model [deg], [mm]")
    return markdown_table((*header, "torque [N m]", "speed [deg/s]"), lines)


@styled
def draw(comparison: Comparison, rows: Rows) -> Figure:
    """A nod over time, and the errors of all motions."""
    figure, ((left, right),) = panels(1, 2, 4.6, 11.0, width_ratios=(1.0, 1.25))
    names = [
        tuple(trial.labels[key] for key in ("controller", "reference", "condition")) for trial in comparison.trials
    ]
    for name in ("angles, 50 Hz", "exact model, 50 Hz"):
        log = run(comparison.scenario(names.index((name, "nod", MAKERS))), check=False)
        _, color, _ = IN_PICTURE[name]
        late = log.time >= 3.0
        if name.startswith("angles"):
            left.plot(log.time[late], np.degrees(log["reference"][late, 1]), color="black", lw=5.0, alpha=0.25)
        left.plot(log.time[late], np.degrees(log["pose"][late, 1]), color=color, lw=1.5)
    left.set(title="A nod of 15 deg, once a second", xlabel="time [s]", ylabel="pitch [deg]")
    motions = (*MOTIONS, DANCE)
    for label, color, marker in IN_PICTURE.values():
        right.plot([], [], marker, color=color, label=label)
    for place, motion in enumerate(reversed(motions)):
        for name, (_, color, marker) in IN_PICTURE.items():
            right.plot(rows[name, motion, MAKERS]["pose_rmse_mm"], place, marker, color=color, ms=8.0)
    right.set_yticks(range(len(motions)), [name.removeprefix("dance ").replace("_", " ") for name in reversed(motions)])
    right.set(title="Error of the head", xlabel="RMS error 30 mm from its centre [mm]", ylim=(-0.6, len(motions) - 0.4))
    logarithmic(right, "x")
    legend_below(figure, [*right.get_legend_handles_labels()[0], Patch(color="0.75", label="wanted")], columns=2)
    return figure


def main() -> None:
    """Writes the page and its picture."""
    comparison = altered()
    rows = rows_of(comparison, "compare")
    free, as_it_is = of_makers_servos(rows_of(makers_servos(), "servos"))
    page = TEXT.format(
        expected=expected(rows), apart=f"{100.0 * apart(rows):.0f}", free=free, as_it_is=as_it_is,
        dances=of_dances(rows_of(dances(), "dances")),
    )  # fmt: skip
    save_figure(draw(comparison, rows), OUT / "reachy.png")
    (OUT / "reachy.md").write_text(page, encoding="utf-8")


TEXT = """# What an owner of Reachy Mini can expect

{expected}

{apart}

![x](reachy.png)

{free}

{as_it_is}

{dances}

`make results` recomputes some of these numbers.
"""

if __name__ == "__main__":
    main()
