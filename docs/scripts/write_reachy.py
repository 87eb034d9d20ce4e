"""What an owner of Reachy Mini has and can have: docs/results/reachy.md and its picture, `make reachy`, two minutes.

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
    return " / ".join(two(row[name]) for name in columns) if row["rmse_norm_deg"] < 90.0 else "turns over"


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
        most = (two(max(row[column] for row in at.values())) for column in LARGEST)
        lines.append((name, *figures, shown(at[DANCE], DEG, MM), *most))
    header = ("", "nod [deg]", "look around [deg]", "breathing [mm], its ripple [mm/s]")
    return markdown_table((*header, "dance [deg], [mm]", "peak torque [N m]", "peak speed [deg/s]"), lines)


def apart(rows: Rows) -> str:
    """By what share errors of motions are others on our plant, in words."""
    shares = []
    for (name, motion, condition), row in rows.items():
        column = MM if motion == "breathing" else DEG
        if condition == MAKERS and motion in (*MOTIONS, DANCE):
            shares.append(100.0 * abs(rows[name, motion, OURS][column] / row[column] - 1.0))
    return f"{np.median(shares):.2g} % (median), at most {max(shares):.2g} %"


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
        most = (two(new[column]) for column in LARGEST)
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
    free, as_it_is = of_makers_servos(rows_of(makers_servos(), "servos"))
    page = TEXT.format(
        expected=expected(rows), apart=apart(rows), free=free, as_it_is=as_it_is,
        dances=of_dances(rows_of(dances(), "dances")),
    )  # fmt: skip
    save_figure(draw(comparison, rows), OUT / "reachy.png")
    (OUT / "reachy.md").write_text(page, encoding="utf-8")


TEXT = """# What an owner of Reachy Mini can expect

Simulated: no head has been measured. The plant is the MuJoCo model that the maker ships, with ball joints that turn
freely; the servos are XL330-M288 at 5 V, with the constants of the preset `xl330_m288`; a command acts a period and
10 ms after it was sent. RMS errors over the second half of a run, lag included. On our own plant they differ by
{apart}.

**What you have.** The head's own software sends the angles of the inverse kinematics, 50 times a second. Its servos are
springs: they lag, swing and hang.

**What you can have.** The same servos, bus and 50 Hz, but angles that the exact model corrects
(`controller: {{kind: feedforward}}`): each angle is that of the time when it acts, plus what makes the servo give the
torque that the head's weight, inertia and friction ask for. It needs no reading.

![A nod over time, and errors of all motions](reachy.png)

{expected}

*dance*: `groovy_sway_and_roll` of the maker's library. *fixed weights*: `tuner: block`. Peaks are those of these four
motions, of 0.52 N m and 618 deg/s that the servo has.

**What it depends on.**

- *Four numbers of a motor*: stiffness, damping, delay and friction. Three lines have one of them wrong.
  Nobody publishes them, and the stiffness of one and the same XL330 is 0.6 to 1.7 N m/rad by who computes it.
  [Learning](adaptation.md#on-the-makers-model) brings them back to the exact model: the next three lines, each from a
  cold start.
- *The loop.* That of the head's daemon has 50 Hz. A loop of your own at 100 Hz makes the slow motion quieter, and
  little else better.
- *The kind of command.* Torques need servos in current mode, and 100 Hz. They do not depend on the servo's stiffness,
  and tremble more.

Command: `stewart-drake compare reachy`, after `pip install mujoco` and
`pip install --no-deps reachy_mini==1.13.0 reachy_mini_dances_library==0.2.1`.

## With the motors of the maker's files

The MJCF has two motors: `xc330m288t`, of stiffness kp 2.54, which it calls "probably wrong", and `perfect_actuator`, of
kp 10, with which its simulation runs. 100 Hz, each with its own friction and inertia, ball joints that turn freely:

{free}

As the file is, its ball joints have a motor's dry friction of 0.1 N m and damping of 0.15 N m s/rad. No law that knows
the motors alone can help there; a real head has hardly such joints.

{as_it_is}

## The maker's dances

All moves of `reachy_mini_dances_library` 0.2.1, repeated, 50 Hz, with the XL330 of the first table; torque and speed
are the largest of the exact model. `diagrams/comparisons/reachy_dance.py` plays them in any scenario. Some jump, or
turn a corner too fast for 0.52 N m, until they are averaged over some time (a Gaussian's standard deviation); two go
beyond the cranks' range or speed at full size. `run` refuses them as they are and says how much smaller they can be.

{dances}

Made by `make reachy`, two minutes. `make results` recomputes some of these numbers.
"""

if __name__ == "__main__":
    main()
