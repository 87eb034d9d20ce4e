"""What an owner of Reachy Mini has and can have, docs/results/reachy.md: `make results/reachy`, two minutes.

Needs the packages `reachy_mini` and `reachy_mini_dances_library` of its maker.
"""

from decimal import Decimal
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
from stewart_drake.reachy.moves import dances as makers_dances
from stewart_drake.studies.comparison import Comparison
from stewart_drake.studies.experiment import run_experiment

FILE = find_file("comparison", "reachy")
OUT, RUNS = Path(__file__).parents[1] / "results", Path("runs/reachy")
OURS, MAKERS = "our plant", "maker's model"
MOTIONS, DANCE = ("nod", "look around", "breathing"), "dance groovy_sway_and_roll"

# Moves that jump, or nearly, are averaged over this [s]; two go where the cranks cannot and are made smaller.
SMOOTHED = dict.fromkeys(
    ("sharp_side_tilt", "side_peekaboo", "yeah_nod", "neck_recoil", "chicken_peck", "grid_snap", "jackson_square"), 0.04
)
SMALLER = {"headbanger_combo": 0.75, "jackson_square": 0.6}

# What the MJCF has of motors: class -> stiffness [N m/rad], dry friction [N m], viscous friction [N m s/rad], rotor
# [kg m^2]; and the width [rad/s] over which MuJoCo reverses that dry friction, the best of 0.004, 0.02, 0.05 and 0.1.
CLASSES = {"xc330m288t": (2.54, 0.058, 0.095, 0.0018, 0.02), "perfect_actuator": (10, 0.1, 0.15, 0.001, 0.1)}
FREE = {"passive_friction": 0, "passive_armature": 0}


def altered(**keys: object) -> Comparison:
    """The comparison `reachy` with other keys."""
    return Comparison.from_dict({**read_mapping("comparison", FILE, 80), **keys}, FILE.parent)


def makers_servos() -> Comparison:
    """Motors as the maker's MJCF has them, on its model: with ball joints that turn freely, and as it is."""
    controllers, conditions, runs = {}, {}, []
    for name, (stiffness, coulomb, viscous, rotor, width) in CLASSES.items():
        friction = {"coulomb": coulomb, "viscous": viscous, "width": width}
        servo, loop = {"kind": "position", "preset": name}, {"kind": "feedforward", "period": 0.01}
        rigid = {**servo, "damping": 0.0, "resolution_bits": None}
        plain = {"model.friction": None, "model.delay": 0, "model.motors": rigid}
        rows = {
            "angles": {"controller": {**loop, "feedforward": "none"}, **plain},
            "exact model": {"controller": loop},
        }
        rows = {row: {"motors": {**servo, "delay": 0.01}, **keys} for row, keys in rows.items()}
        if name == "xc330m288t":
            ways = {"fixed weights": "block", "policy": "policy"}
            rows |= {f"torque, {way}": {"motors": "torque", "tuner": tuner} for way, tuner in ways.items()}
        believed = {"model.friction": friction, "model.robot": {"rotor_inertia": rotor}}
        made = {
            f"kp {stiffness}, {row}".replace("kp 2.54, torque", "torque"): {**believed, **keys}
            for row, keys in rows.items()
        }
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
    for name, (_, _, facts) in makers_dances().items():
        period = facts["default_duration_beats"] * 60.0 / 114.0
        arguments = {"move": name, "smoothing": SMOOTHED.get(name, 0.0)}
        motion = {"kind": "reachy_dance.py:Dance", "arguments": arguments}
        reference = {"kind": "adjusted", "fade_in": 1.0, "center": [0, 0, 0, 0, 0, 0.177], "motion": motion}
        reference["scale"] = SMALLER.get(name, 1.0)
        references[name] = {"duration": round(2.0 * max(3.0, period), 2), "reference": reference}
    return altered(controllers=controllers, references=references, conditions={MAKERS: file["conditions"][MAKERS]})


Rows = dict[tuple[str, str, str], dict]


def rows_of(comparison: Comparison, name: str) -> Rows:
    """Figures by controller, motion and condition; results go to runs/reachy/NAME."""
    rows = run_experiment(comparison, RUNS / name, restart=True).rows["comparison"]
    return {(row["controller"], row["reference"], row["condition"]): row for row in rows}


def two(value: float) -> str:
    """Two significant digits, without an exponent."""
    return format(Decimal(f"{value:.1e}"), "f")


def shown(row: dict, *columns: str) -> str:
    """Numbers, or that the head has turned over."""
    return ", ".join(two(row[name]) for name in columns) if row["rmse_norm_deg"] < 90.0 else "turns over"


DEG, MM, RIPPLE = "rmse_norm_deg", "rmse_norm_mm", "ripple_mm_s"
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
        lines.append((name, *figures, shown(at[DANCE], DEG, MM)))
    header = ("", "nod [deg]", "look around [deg]", "breathing [mm], its ripple [mm/s]", "dance [deg], [mm]")
    return markdown_table(header, lines)


def apart(rows: Rows) -> str:
    """By what share errors of motions are others on our plant, in words."""
    shares = []
    for (name, motion, condition), row in rows.items():
        column = MM if motion == "breathing" else DEG
        if condition == MAKERS and motion in (*MOTIONS, DANCE):
            shares.append(100.0 * abs(rows[name, motion, OURS][column] / row[column] - 1.0))
    return f"{np.median(shares):.2g} % (median), at most {max(shares):.2g} %"


def of_makers_servos(rows: Rows) -> str:
    """A table of motions, with ball joints that turn freely."""
    names = [key[::2] for key in rows if key[1] == "nod" and key[2].endswith("free")]
    lines = []
    for motion, columns in (("nod", (DEG,)), ("look around", (DEG,)), ("breathing", (MM, RIPPLE))):
        unit = "deg" if columns == (DEG,) else "mm, ripple mm/s"
        lines.append((f"{motion} [{unit}]", *(shown(rows[name, motion, at], *columns) for name, at in names)))
    return markdown_table(("", *(name for name, _ in names)), lines)


def of_dances(rows: Rows) -> str:
    """A line a move that had to be changed, and one for the largest of all others."""
    lines, others = [], []
    for name in dict.fromkeys(key[1] for key in rows):
        old, new = (rows[way, name, MAKERS] for way in ("angles, 50 Hz", "exact model, 50 Hz"))
        if name not in SMALLER and name not in SMOOTHED:
            others.append((old, new))
            continue
        how = [f"{100.0 * SMALLER[name]:g} % of its size"] if name in SMALLER else []
        how += [f"averaged over {1e3 * SMOOTHED[name]:g} ms"] if name in SMOOTHED else []
        lines.append((f"`{name}`", ", ".join(how), shown(old, DEG, MM), shown(new, DEG, MM)))
    most = (", ".join(two(max(pair[way][column] for pair in others)) for column in (DEG, MM)) for way in (0, 1))
    lines.append((f"the other {len(others)}, largest", "", *most))
    return markdown_table(("move", "changed", "angles [deg], [mm]", "exact model [deg], [mm]"), lines)


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
    left.set(title="A nod of 15 deg at 1 Hz", xlabel="time [s]", ylabel="pitch [deg]")
    motions = (*MOTIONS, DANCE)
    for label, color, marker in IN_PICTURE.values():
        right.plot([], [], marker, color=color, label=label)
    for place, motion in enumerate(reversed(motions)):
        for name, (_, color, marker) in IN_PICTURE.items():
            right.plot(rows[name, motion, MAKERS]["pose_rmse_mm"], place, marker, color=color, ms=8.0)
    right.set_yticks(range(len(motions)), [name.replace("_", " ") for name in reversed(motions)])
    right.set(title="Error of the head", xlabel="RMS error 30 mm from its centre [mm]", ylim=(-0.6, len(motions) - 0.4))
    logarithmic(right, "x")
    legend_below(figure, [*right.get_legend_handles_labels()[0], Patch(color="0.75", label="wanted")], columns=2)
    return figure


def main() -> None:
    """Writes the page and its picture."""
    comparison = altered()
    rows = rows_of(comparison, "compare")
    servos = rows_of(makers_servos(), "servos")
    page = TEXT.format(
        expected=expected(rows),
        apart=apart(rows),
        free=of_makers_servos(servos),
        rubbing=shown(servos["kp 2.54, exact model", "nod", "xc330m288t, as it is"], DEG),
        dances=of_dances(rows_of(dances(), "dances")),
    )
    save_figure(draw(comparison, rows), OUT / "reachy.png")
    (OUT / "reachy.md").write_text(page, encoding="utf-8")


TEXT = """# What an owner of Reachy Mini can expect

How far is the head from where it should be, with the angles that its software sends today, and with angles that the
exact model corrects (`controller: {{kind: feedforward}}`)? Simulated: no head has been measured.

Command: `stewart-drake compare reachy`, after `pip install mujoco` and
`pip install --no-deps reachy_mini==1.13.0 reachy_mini_dances_library==0.2.1`. `make results/reachy` writes this page.

![A nod over time, and errors of all motions](reachy.png)

{expected}

- *Angles*: those of the inverse kinematics, as today. *Exact model*: the angle of the time at which the command acts,
  plus what makes the servo give the torque for weight, inertia and friction. It needs no reading.
- The MuJoCo model that the maker ships, with ball joints that turn freely; servos XL330-M288 at 5 V (preset
  `xl330_m288`); a command acts a period and 10 ms after it was sent. RMS errors of the second half, lag included. On
  our own plant they differ by {apart}. *dance*: `groovy_sway_and_roll`. *fixed weights*: `tuner: block`.
- It depends on four numbers of a motor: stiffness, damping, delay, friction. Nobody publishes them, and the stiffness
  of the XL330 is 0.6 to 1.7 N m/rad by who computes it. [Learning](adaptation.md) corrects them.
- A loop of your own at 100 Hz makes slow motion quieter, and little else better. Torques need servos in current mode at
  100 Hz; they do not depend on the servo's stiffness, and tremble more.

## With the motors of the maker's files

The MJCF has two motors: `xc330m288t` with kp 2.54, which it calls "probably wrong", and `perfect_actuator` with kp 10,
with which its simulation runs. 100 Hz, friction and inertia of the file, ball joints that turn freely:

{free}

In the file ball joints have a motor's dry friction of 0.1 N m and damping of 0.15 N m s/rad. With these a nod by kp
2.54 and the exact model is {rubbing} deg off. A real head hardly has such joints.

## The maker's dances

All moves of `reachy_mini_dances_library` 0.2.1 at 50 Hz with the XL330. *changed*: moves that jump, or turn
too fast for 0.52 N m, are averaged (standard deviation of a Gaussian); two that go beyond the cranks' range or speed
are made smaller. `diagrams/comparisons/reachy_dance.py` plays them in any scenario.

{dances}
"""

if __name__ == "__main__":
    main()
