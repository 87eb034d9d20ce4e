"""Where we leave the print, and where each departure can be seen or is tested."""

from __future__ import annotations

from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study

_CLAIM = "The paper's equations and tables as printed are the model and the controller."

DEPARTURES: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    (
        "Table I, crank inertia",
        "Ixx + Iyy < Izz by 1e-6 kg m^2: no body has that; a rounding in the print.",
        "Izz = 5.9e-5 kg m^2, the nearest value that a body can have.",
        ("robot.py", "tests/test_robot.py"),
    ),
    (
        "Joint positions",
        "Not given.",
        "Our own layout: three coaxial pairs of shafts, 120 deg apart; all of it parameters.",
        ("robot.py", "sdf/README.md", "workspace"),
    ),
    (
        "Limits of joints and links",
        "Not given. (37), (38) turns the universal joint of leg 2 by 63.1 deg on our layout.",
        "Assumed, each a parameter: swing of every joint up to 65 deg; 60 deg would refuse the paper's own motion.",
        ("planning/limits.py", "sdf/README.md", "tests/planning/test_feasibility.py", "workspace"),
    ),
    (
        "Balls at both ends of a rod",
        "Each rod is then free to spin about itself: six modes that nothing controls.",
        "Universal joint at the crank, ball at the platform; `plant.rod_joint: ball` gives the literal joints.",
        ("plant/sdf_model.py", "tests/plant/test_plant.py"),
    ),
    (
        "(3)",
        "Entry (3,1) has cos theta where cos phi belongs; the matrix is no rotation. It is also the passive matrix.",
        "The rotation that is meant: R_BP = Rz Ry Rx.",
        ("kinematics",),
    ),
    (
        "(5)",
        "The bracket turns the translation G as well.",
        "(2) is right and is used.",
        ("kinematics",),
    ),
    (
        "(6)",
        "One branch, in degrees, with A, B, C left open.",
        "Both branches in closed form, with a margin per leg; out of reach is an error, never NaN.",
        ("kinematics",),
    ),
    (
        "(9)",
        "Euler second derivatives stand for angular acceleration, and inertia in P meets moments in B.",
        "Kept in the paper's controller; the exact model uses w = E(q) q'.",
        ("force_map",),
    ),
    (
        "(11)-(14), e_M",
        "The arm p_i is left in P while the rod is in B.",
        "e_M = (R^-1 p_i) x e_l.",
        ("force_map",),
    ),
    (
        "(15), (16)",
        "Rod force = (e_l . e_N) T / |a|.",
        "Statics give T / (|a| (e_l . e_N)); both are offered, `statics` is the default.",
        ("force_map", "nine_experiments"),
    ),
    (
        "(7)-(18), what is left out",
        "Gravity, masses of rods and cranks, gyroscopic terms are missing from the model.",
        "They act as the disturbance d of (19); `feedforward: gravity` removes the largest of them.",
        ("nine_experiments",),
    ),
    (
        "(20)",
        "The error dynamics drop the reference's own acceleration.",
        "It is part of d; `feedforward: platform` adds M q''_d.",
        ("state_space", "nine_experiments"),
    ),
    ("(22)", "tau stands where (10) demands M^-1 tau.", "M^-1 tau.", ("state_space",)),
    (
        "(28), (29)",
        "Tests for lambda <= 0 and a count of columns of B.",
        "Hautus ranks for Re(lambda) >= 0, computed.",
        ("state_space",),
    ),
    (
        "(30)",
        "u = K e.",
        "u = -K e, as (34) has it.",
        ("state_space",),
    ),
    (
        "(31), (32), time",
        "Continuous A, B in discrete equations.",
        "Exact zero-order hold of (25), a polynomial because A^3 = 0.",
        ("state_space",),
    ),
    (
        "(32), form",
        "C^T Q C has sizes that do not fit; the factor B^T P A is missing.",
        "The standard discrete Riccati equation with Q of (27), by Drake.",
        ("state_space", "control/riccati.py", "tests/control/test_riccati.py"),
    ),
    (
        "(27)",
        "Nine pairs of weights are treated as nine controllers.",
        "Kept, and shown: only the ratio acts, so they are five.",
        ("nine_experiments", "training"),
    ),
    (
        "(35), (36)",
        "The sum of signed samples in the denominator can be zero; m is not given.",
        "`magnitude` densities by default, `signed` ones held within +-(m + 1); m = 49 ticks.",
        ("control/density.py", "dataset", "training", "sensitivity"),
    ),
    (
        "III.D, title",
        "Announces an ANFIS; the text describes an ANN.",
        "The ANN: 12-10-2. Its answers are log10 of the weights, so that none comes out negative, and are held "
        "within the range of the labels, 0.1 to 10.",
        ("control/network.py", "training"),
    ),
    (
        "III.D, amplitudes",
        "pi/6 and 0.3 m at 1 to 5 Hz: 0.3 m at 5 Hz is 296 m/s^2.",
        "Largest feasible amplitudes per axis and frequency.",
        ("dataset",),
    ),
    (
        "III.D, split",
        "Random samples: neighbours in time fall on both sides.",
        "Kept for the tuner; a split by whole runs stands beside it.",
        ("training",),
    ),
    (
        "IV, gravity",
        "The model has none; the multibody model has.",
        "Three scenarios: compensated, absent, and uncompensated as printed, with the time to failure.",
        ("nine_experiments",),
    ),
    (
        "IV, sample time and start",
        "Not given.",
        "5 ms control on a 1 ms plant, started on the reference's pose and velocity; other periods are reported.",
        ("nine_experiments", "sensitivity"),
    ),
    (
        "IV, references",
        "The text cites (30), (31) for the reference.",
        "(37), (38).",
        ("in_the_loop",),
    ),
)
"""Equation or place; what is printed; what we do; where it shows: sections of the report, files of the project."""


def make(study: Study) -> Section:
    """The section; see the module."""
    section = Section("departures", "Departures from the print", _CLAIM)
    rows = [(where, printed, ours, "; ".join(map(_place, places))) for where, printed, ours, places in DEPARTURES]
    section.table("Every departure", ("where", "as printed", "what we do", "shown in"), rows)
    section.numbers = {"departures": len(DEPARTURES)}
    section.verdict = (
        f"Does not hold: {len(DEPARTURES)} departures, each named here with the place where it is shown or tested."
    )
    study.progress(1.0)
    return section


TITLES = {
    "kinematics": "Kinematics",
    "force_map": "Force map",
    "state_space": "State space and LQI",
    "nine_experiments": "The nine experiments",
    "dataset": "The data",
    "training": "The network",
    "in_the_loop": "The tuner in the loop",
    "sensitivity": "Sensitivity and robustness",
    "workspace": "Workspace",
}
"""First words of the sections' titles, by which a reader finds them."""


def _place(name: str) -> str:
    return f"`{name}`" if "." in name else f"section *{TITLES[name]}*"
