"""Robots of unknown motors that learn them, docs/results/adaptation.md: `make adaptation`, half an hour on two cores.

`--robots 500` draws more; `--many` prints the table of many robots alone, ten minutes.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import servo_identification_study as servos
from servo_identification_study import GUESS, NOMINAL, PLAIN, SERVO, Hidden, spread, three_of
from strange_robots import LateServos, LoadedFriction
from write_reachy import MAKERS

from stewart_drake import Scenario, load_scenario, run, run_metrics
from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.markdown import markdown_table
from stewart_drake.control.adaptation import last_learnt, model_of
from stewart_drake.control.base import heave_inertia
from stewart_drake.logs.log import SimulationLog
from stewart_drake.robot import RobotParameters
from stewart_drake.studies.comparison import load_comparison

OUT = Path(__file__).parents[1] / "results" / "adaptation.md"
STEP = 0.001  # [s] of the plant.
AGE = servos.NOMINAL_AGE
MOTIONS = {"nod": (20.0, "rmse_norm_deg"), "look": (24.0, "rmse_norm_deg"), "breathing": (20.0, "rmse_norm_mm")}
"""Duration [s], of which the second half counts, and metric."""
FIGURES = ("nod [deg]", "look around [deg]", "breathing [mm]", "its ripple [mm/s]", "its ripple [deg/s]")
SCHEMES = {
    "plain": "angles of the inverse kinematics",
    "nominal": "exact model, nominal constants",
    "learning": "the same, learning",
    "told": "the same, learning, age of the readings told",
    "second": "a second run with what was kept of a first one, age told",
    "truth": "exact model, truth known",
}
LOAD_SHARE, JITTER = 0.27, 0.005
"""[-] of a motor's torque by which its dry friction grows; [s] by which a command may come late."""
STRANGE: dict[str, Callable[[int], dict[str, Any]]] = {
    "as above": lambda _: {},
    "stiction of 1.5 times the Coulomb friction": lambda seed: {
        "plant.friction.break_away": (1.5 * servos.hidden(seed).coulomb).tolist()
    },
    "friction that grows by 0.27 of the motor's torque": lambda seed: {"plant": loaded_friction(seed)},
    "play of 0.2 deg in each gear": lambda _: {"motors.backlash": np.radians(0.2).item()},
    "commands come up to 5 ms late": lambda seed: {"motors": late_servos(seed)},
    "one message in fifty is lost": lambda _: {"link": {"drop_probability": 0.02, "seed": 1}},
    "noise of 1 mrad in each reading": lambda _: {"sensors.noise": 0.001},
    "a load of 50 g on the head, 36 mm beside its middle": lambda _: {"plant.payload_mass": 0.05, **BESIDE},
    "the same, `center_of_mass: false`": lambda _: {
        "plant.payload_mass": 0.05,
        **BESIDE,
        "adaptation.center_of_mass": False,
    },
}
BESIDE = {"plant.payload_position": [0.03, 0.02, 0.05]}
ROBOTS, SLOW_ROBOTS = 24, 60
FEW = 8  # Robots of the table above.
MANY, FIRST_OF_MANY, SHORT = 500, 2000, 10.0
"""Further robots, that only nod, their first seed, and for how long [s]."""
SHIPPED_SLOW = "torque at 100 Hz, as in `reachy_slow_bus`"
MANY_BUSES = {"": "servos at 50 Hz", "learning": "currents at 100 Hz", "careful": SHIPPED_SLOW}
"""Robots of `many`, by their scheme at 100 Hz."""
NOMINAL_DRY, NOMINAL_VISCOUS = 0.058, 0.095  # [N m], [N m s/rad] of `reachy_nod`.
CORNERS, FALLEN = 8, 10.0  # The first robots are the corners; [deg] of an error from which on a robot is lost.
AT_REST = 0.1  # [mm/s] of ripple.
AT_100_HZ = {
    "shipped": "LQI, observer, policy, as in `reachy_nod`",
    "nominal": "PID for slow buses, nominal constants",
    "learning": "PID for slow buses, learning",
    "careful": "the same, `cautious`, by torque with safety layer, as in `reachy_slow_bus`",
    "truth": "PID for slow buses, truth known",
}
SLOW_FIGURES = ("nod [deg]", "its ripple [mm/s]", "breathing [mm]", "its ripple [mm/s]", "ripple at rest [mm/s]")
BELIEFS = ("exact model, 50 Hz", "stiffness believed 1.3 times", "friction believed twice", "delay not believed")
DRY = 0.08  # [N m] of the motors at 1 kHz, believed 0.01.
PUSHED = {"disturbances": [{"kind": "step", "wrench": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0], "time": 3.0, "until": 60.0}]}
LOADED: dict[str, Any] = {"plant.payload_mass": 0.3, **BESIDE}
AT_1_KHZ: dict[str, dict[str, Any]] = {
    "believed 0.01 N m": {},
    "believed 0.01 N m, learning": {"adaptation": "regression"},
    "truth known": {"model.friction.coulomb": DRY},
    "with a load of 0.3 kg, believed 0.01 N m": LOADED,
    "with that load, learning": {"adaptation": "regression", **LOADED},
    "pushed from 3 s on, truth known": {"model.friction.coulomb": DRY, **PUSHED},
    "pushed from 3 s on, learning": {"adaptation": "regression", **PUSHED},
}


def hidden(seed: int) -> tuple[Hidden, np.ndarray]:
    """Constants at random, and the stiffness of each motor over its mean."""
    return servos.hidden(seed), np.random.default_rng([seed, 1]).uniform(0.95, 1.05, 6)


def references() -> dict[str, Any]:
    """The motions of `compare reachy`, as plain values; looking around goes on and on."""
    found = servos.references()
    look, times = found["look"], int(MOTIONS["look"][0] / 6.0)
    poses = [look["poses"][0], *(look["poses"][1:] * times)]
    found["look"] = {**look, "poses": poses, "durations": look["durations"] * times, "dwell": look["dwell"] * times}
    return found


def scenario(seed: int, scheme: str, motion: str, belief: dict[str, Any] | None = None) -> Scenario:
    """A motion of a robot under a scheme; `belief` is what a first run has kept."""
    real, ratios = hidden(seed)
    truth = {
        "robot": real.robot,
        "motors": {**SERVO, "stiffness": real.stiffness, "damping": real.damping, "delay": real.delay}
        | {"ratios": ratios.tolist()},
        "friction": {"coulomb": real.coulomb.tolist(), "viscous": real.viscous.tolist(), "width": 0.004},
    }
    believed = {"plain": PLAIN, "truth": truth}.get(scheme, NOMINAL) if belief is None else belief
    changes: dict[str, Any] = {"motors.ratios": ratios.tolist(), "plant.time_step": STEP}
    if scheme in ("learning", "told", "second"):
        changes |= {"adaptation": "regression", "model.reading_age": AGE if scheme == "learning" else real.age}
    made = servos.scenario(real, believed, references()[motion], MOTIONS[motion][0], scheme == "plain")
    return made.replace(changes)


def kept(log: SimulationLog) -> dict[str, Any]:
    """`model` with what a run has learnt, as `run --keep-model` leaves it."""
    return model_of(last_learnt(log), log.scenario.controller_model)


def figures(seed: int, scheme: str, changes: dict[str, Any] | None = None) -> list[float]:
    """A robot's `FIGURES`, perhaps with some changes of it; infinite where it is lost."""
    found = []
    belief = kept(run(scenario(seed, "told", "look"), check=False)) if scheme == "second" else None
    for motion, (_, metric) in MOTIONS.items():
        log = run(scenario(seed, scheme, motion, belief).replace(changes or {}), check=False)
        measured = run_metrics(log) if log.status == "completed" else {}
        found.append(measured.get(metric, np.inf))
        if motion == "breathing":
            found += [measured.get(name, np.inf) for name in ("ripple_mm_s", "ripple_deg_s")]
    return found


def ripple_at_rest(seed: int) -> float:
    """[mm/s] of a robot with servos that rests, and could learn."""
    rests = {"reference": {"kind": "hold", "pose": GUESS.home_pose.tolist()}}
    return float(run_metrics(run(scenario(seed, "learning", "nod").replace(rests), check=False))["ripple_mm_s"])


def trial(seed: int) -> list[list[float]]:
    """Figures of a robot under every scheme."""
    rows = [figures(seed, scheme) for scheme in SCHEMES]
    print(seed, np.round(rows, 3).tolist(), flush=True)
    return rows


def strange(name: str, seed: int) -> list[float]:
    """Figures of a robot that learns with something that the model does not have."""
    return figures(seed, "learning", STRANGE[name](seed))


def loaded_friction(seed: int) -> dict[str, Any]:
    """`plant` of a robot whose dry friction grows with the load."""
    options = scenario(seed, "learning", "nod").plant.to_dict()
    return {"kind": LoadedFriction, "time_step": STEP, "arguments": {"share": LOAD_SHARE, "options": options}}


def late_servos(seed: int) -> dict[str, Any]:
    """`motors` of a robot whose bus jitters."""
    options = scenario(seed, "learning", "nod").motors.to_dict()
    return {"kind": LateServos, "arguments": {"servos": options, "jitter": JITTER, "seed": seed}}


def at_1_khz(plant: str, motion: str, scheme: str) -> list[float]:
    """RMS error [mm] and [deg] over the second half of 20 s, of a motion of the paper's robot with motors that rub."""
    changes = {"plant.kind": plant, "plant.motor_friction": DRY, "duration": 20.0, **AT_1_KHZ[scheme]}
    measured = run_metrics(run(load_scenario(f"exact_{motion}").replace(changes), check=False))
    return [measured["rmse_norm_mm"], measured["rmse_norm_deg"]]


def weighed() -> tuple[float, float]:
    """What 20 s of breathing on Drake's plant make of the load, and the half width of its 95 % interval [kg]."""
    changes = {
        **LOADED,
        "plant.kind": "drake",
        "plant.motor_friction": DRY,
        "duration": 20.0,
        "adaptation": "regression",
    }
    log = run(load_scenario("exact_breathing").replace(changes), check=False)
    return float(log["learnt"][-1, 0] - log.scenario.controller_model.robot.platform_mass), float(
        log["learnt_half_width"][-1, 0]
    )


def slow_bus(seed: int, scheme: str, motion: str, changes: dict[str, Any] | None = None) -> Scenario:
    """A motion at 100 Hz by current, one tick late, of a robot whose friction, motors and head are drawn."""
    dry, viscous, constant, head = constants(seed)
    friction = {"coulomb": dry, "viscous": viscous, "width": 0.004}
    robot, motors = GUESS.replace(**GUESS.heavier(head)), {"kind": "current", "torque_constant": constant}
    nominal = {"robot": GUESS, "motors": {"kind": "current"}}
    nominal["friction"] = {"coulomb": NOMINAL_DRY, "viscous": NOMINAL_VISCOUS, "width": 0.004}
    truth = {"robot": robot, "motors": motors, "friction": friction}
    keys: dict[str, Any] = {
        "robot": robot,
        "plant": {"kind": "closed_form", "integrator": "rk4", "time_step": 0.0005}
        | {"friction": {"coulomb": dry, "viscous": viscous}},
        "motors": motors,
        "model": truth if scheme == "truth" else nominal,
        "duration": 20.0,
        "bounds": dict.fromkeys(("rotation", "position", "motion_ratio", "error_ratio")),
        "safety": None,
        "adaptation": "regression" if scheme == "learning" else None,
    }
    if motion == "breathing":
        keys["reference"] = servos.references()["breathing"]
    elif motion == "rest":
        keys["reference"] = {"kind": "hold", "pose": GUESS.home_pose.tolist()}
    if scheme == "careful":
        careful = {"safety": {}, "adaptation": {"kind": "regression", "cautious": True}}
        keys |= {"motors": "torque", "model": {**nominal, "motors": {"kind": "torque"}}, **careful}
    if scheme != "shipped":
        keys |= {"controller": slow_controller(keys["model"]["robot"]), "estimator": "difference", "tuner": "block"}
    base = "reachy_slow_bus" if scheme == "careful" else "reachy_nod"
    return load_scenario(base).replace(keys | (changes or {}))


def slow_controller(believed: RobotParameters) -> dict[str, Any]:
    """The controller of `reachy_slow_bus`, its gains in proportion to the inertia that is believed."""
    keys, share = load_scenario("reachy_slow_bus").controller.to_dict(), heave_inertia(believed) / heave_inertia(GUESS)
    return keys | {name: share * keys[name] for name in ("kp", "ki", "kd")}


def constants(seed: int) -> tuple[float, float, float, float]:
    """Coulomb [N m] and viscous friction [N m s/rad], torque constant [-], share of the head; first the corners."""
    rng = np.random.default_rng([seed, 2])
    if seed < CORNERS:
        rubs = 2.0 * (seed & 1)
        return rubs * NOMINAL_DRY, rubs * NOMINAL_VISCOUS, (0.7, 1.3)[seed >> 1 & 1], (0.8, 1.2)[seed >> 2 & 1]
    dry, viscous = rng.uniform(0.0, 2.0, 2) * (NOMINAL_DRY, NOMINAL_VISCOUS)
    return float(dry), float(viscous), float(rng.uniform(0.7, 1.3)), float(rng.uniform(0.8, 1.2))


def slow_figures(seed: int, scheme: str) -> list[float]:
    """Nod [deg], breathing [mm] and ripples [mm/s] of both and at rest; infinite where the robot is lost."""
    found = []
    for motion, metric in (("nod", "rmse_norm_deg"), ("breathing", "rmse_norm_mm"), ("rest", "")):
        log = run(slow_bus(seed, scheme, motion), check=False)
        measured = run_metrics(log)
        lost = log.status != "completed" or measured["peak_norm_deg"] > FALLEN
        found += [np.inf if lost else measured[name] for name in (metric, "ripple_mm_s") if name]
    return found


def slow_trial(seed: int) -> list[list[float]]:
    """`slow_figures` of a robot under every scheme."""
    rows = [slow_figures(seed, scheme) for scheme in AT_100_HZ]
    print(seed, np.round(rows, 3).tolist(), flush=True)
    return rows


def one_of_many(slow: str, seed: int) -> float:
    """Nod [deg] of a robot that learns, under a scheme at 100 Hz or with servos; infinite where it is lost."""
    made = slow_bus(seed, slow, "nod") if slow else scenario(seed, "learning", "nod")
    log = run(made.replace({"duration": SHORT}), check=False)
    measured = run_metrics(log)
    lost = log.status != "completed" or measured["peak_norm_deg"] > FALLEN
    return float(np.inf if lost else measured["rmse_norm_deg"])


def many_nods(workers: ProcessPoolExecutor) -> dict[str, np.ndarray]:
    """Nods [deg] of robots that only nod, by their bus."""
    seeds = range(FIRST_OF_MANY, FIRST_OF_MANY + MANY)
    return {
        name: np.array(list(workers.map(partial(one_of_many, slow), seeds, chunksize=5)))
        for slow, name in MANY_BUSES.items()
    }


def table_of_many(nods: dict[str, np.ndarray]) -> str:
    """`many_nods` as a table."""
    return markdown_table(["", "nod [deg]", "lost"], [[name, *table(of[:, None])] for name, of in nods.items()])


def on_makers_model(belief: str) -> list[float]:
    """Nod, looking around [deg] and breathing [mm] on the maker's model, without and with learning."""
    found = []
    for motion, (duration, metric) in MOTIONS.items():
        labels = {"controller": belief, "reference": motion.replace("look", "look around"), "condition": MAKERS}
        (trial,) = (each for each in load_comparison("reachy").trials if labels.items() <= each.labels.items())
        for adaptation in (None, "regression"):
            changes = {"duration": duration, "adaptation": adaptation}
            changes |= {"reference": references()["look"]} if motion == "look" else {}
            found.append(run_metrics(run(trial.scenario().replace(changes), check=False))[metric])
    return found


def asked(
    trials: np.ndarray, load: float, slow: np.ndarray, nods: dict[str, np.ndarray], torque: dict[str, Any]
) -> str:
    """A table of what was asked for.

    Args:
        trials: Servos (robots, schemes, figures).
        load: [kg] that was weighed.
        slow: At 100 Hz, likewise.
        nods: See `many_nods`.
        torque: Errors [mm] of breathing and heart at 1 kHz, by scheme.
    """
    careful = slow[:, list(AT_100_HZ).index("careful")]
    learning, told, second, truth = (
        trials[:, list(SCHEMES).index(name)] for name in ("learning", "told", "second", "truth")
    )
    rows = [
        ("nod, median", 0.2, np.median(learning[:, 0]), "deg"),
        ("nod, largest", 0.6, learning[:, 0].max(), "deg"),
        ("nod, largest, age of the readings told", 0.3, told[:, 0].max(), "deg"),
        ("look around, largest", 0.4, learning[:, 1].max(), "deg"),
        ("breathing, largest", 0.035, learning[:, 2].max(), "mm"),
        ("its ripple, largest", 0.25, learning[:, 3].max(), "mm/s"),
        *(
            (
                f"second run over truth known, {motion}, median",
                1.2,
                np.median(second[:, k]) / np.median(truth[:, k]),
                "",
            )
            for k, motion in enumerate(("nod", "look around", "breathing"))
        ),
        ("a load of 0.3 kg, after 20 s of breathing: off by", 3.0, abs(load / 0.3 - 1.0) * 100.0, "%"),
        *(
            (f"at 1 kHz, {motion}", most, errors[0], "mm")
            for (motion, most), errors in zip(
                {"breathing": 0.0022, "heart": 0.0026}.items(), torque["believed 0.01 N m, learning"], strict=True
            )
        ),
        *(
            (f"at 100 Hz, `cautious`, {motion}, {words}", most, reached, unit)
            for motion, column, limits, unit in (
                ("nod", 0, (0.05, 0.15, 0.4), "deg"),
                ("breathing", 2, (0.02, 0.03, 0.2), "mm"),
            )
            for words, most, reached in zip(
                ("median", "95th percentile", "largest"), limits, three_of(careful[:, column]), strict=True
            )
        ),
        ("at 100 Hz, `cautious`, not still at rest", 5.0, 100.0 * np.mean(careful[:, -1] >= AT_REST), "%"),
        *((f"of {MANY} below, lost: {name}", 0, np.isinf(of).sum(), "") for name, of in nods.items()),
    ]
    shown = [
        [what, f"{most:g} {unit}", f"{reached:.3g} {unit}", "yes" if reached <= most else "**no**"]
        for what, most, reached, unit in rows
    ]
    return markdown_table(["", "asked for, at most", "reached", ""], shown)


def table(rows: np.ndarray) -> list[str]:
    """Cells of figures (robots, n) of a scheme, and how many robots were lost."""
    return [*(spread(column) for column in rows.T), str(int(np.isinf(rows).any(axis=1).sum()))]


TEXT = """# Robots that learn their motors

`make adaptation` simulates {robots} Reachy Minis whose servos take angles (XL330-M288, P gain 300), on the closed form
with steps of 1 ms. Each has constants that nobody tells: stiffness 0.7 to 1.3 times (each motor 5 % apart) and
damping 0.8 to 1.2 times the nominal, Coulomb and viscous friction 0 to 3 times (each motor 15 % apart), a delay of the
commands of 10 to 50 ms (believed: 30), readings 0 to 20 ms old (believed: 10), a head of 0.8 to 1.2 times the mass.
Commands go out at 50 Hz, encoders and servos have 12 bits. A robot's seed is its number; gains and thresholds were
chosen on seeds from 100 on, and at 100 Hz on the first eight robots.

The robot nods (15 deg at 1 Hz), looks around again and again, and breathes (5 mm at 0.1 Hz), each from a cold start.
Figures are RMS errors after the first half of 20 s (look around: 24 s): median / 95th percentile / largest of the
robots. Ripple is the RMS error of the velocity above 2 Hz. Lost is a robot that does not complete a motion. The second
run starts with the `model` that `--keep-model` left after a first one that looked around.

{table}

- Learning, the ripple of breathing is below that of the angles of the inverse kinematics in {quieter} of {robots}
  robots [mm/s]. In deg/s it is {rolls:.3g} in the median, and {plain_rolls:.3g} there.
- At rest servos ripple by at most {rest_servos:.2g} mm/s.

## Asked for and reached

{asked}

- The age of the readings cannot be told from the delay by commands and angles: 10 ms of it are 0.66 deg of a nod. That
  is what keeps a nod above what was asked for. Tell it (`model.reading_age`).
- To weigh the load, the motors' torques are taken for exact.
- {wander} robots at 100 Hz are not still at rest. They have no friction, see below.
- With it told, learning does in the median what the truth does. The largest nod is {told_nod:.3f} deg off, in a second
  run {second_nod:.3f}; with the truth known {truth_nod:.3f}.

## The first robot

{first}

## What is not in the model

{few} of these robots, learning, with something that the model does not have.

{strange}

Stiction is the worst of these for ripple: a crank that sticks harder than it slides jumps, and a command every 20 ms
comes too late to stop that. Friction that grows with the load is not one number for a motor, but another in each part
of the motion; that, and a bus that jitters, are [a plant and motors of one's own](../your_own_loop.md), in
`docs/scripts/strange_robots.py`.

## On the maker's model

Reachy Mini in the MuJoCo model of `reachy_mini` 1.13.0, with ball joints that turn freely. Rows are those of
`stewart-drake compare reachy`, in longer runs, without and with learning from a cold start: RMS errors after the first
half of 20 s (look around: 24 s).

{maker}

## By torque at 1 kHz

`exact_breathing` and `exact_heart` on Drake's plant with 17 bits, an observer and one tick of delay, and a friction of
0.08 N m in each motor: RMS errors after the first half of 20 s. The load is 36 mm beside the platform's middle and
50 mm above. The push is 1 N from the side.

{torque}

Of the load, 20 s of breathing find {load:.4f} kg (95 % interval: +-{load_width:.2g} kg).

## By torque at 100 Hz

The same robot with motors that take currents, one tick late, and a controller for slow buses, `controller: {{kind:
pid, inertia: robot}}`, on the closed form. Coulomb friction 0 to 2 times 0.058 N m, viscous friction 0 to 2 times
0.095 N m s/rad, torque constant 0.7 to 1.3 times what is believed, and a head of 0.8 to 1.2 times the mass. The first 8
of {slow_robots} robots have each of these at its least or its most. The row `cautious` has motors that take torque, so
its torque constant is right, the safety layer, which the others do not have, and a nod that fades in over 2 s, where
theirs does in 1 s. None has bounds. Errors after the first half of 20 s. Lost: the run ends, or the head is more than
10 deg off after 10 s.

{slow}

- By torque at 100 Hz it is exact and noisy: a motor with a fast loop of its own is quieter.
- At rest {still} of all {slow_robots} robots ripple by less than {rest:g} mm/s while they learn, {still_shipped} in the
  row `cautious`. The others have no friction at all: they wander between two steps of the encoders.

## Many robots

{many} more robots of each kind, drawn as in these rows above, that learn while they nod for {short:g} s from a cold
start: RMS error of the second half, median / 95th percentile / largest.

{of_many}

`make results` recomputes some of these numbers.
"""


def main() -> None:
    """Runs the trials and writes the page."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=int, default=ROBOTS)
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--many", action="store_true")
    given = parser.parse_args()
    if given.many:
        with ProcessPoolExecutor(given.workers) as workers:
            print(table_of_many(many_nods(workers)))
        return
    with ProcessPoolExecutor(given.workers) as workers:
        load = workers.submit(weighed)
        trials = np.array(list(workers.map(trial, range(given.robots))))
        others = {name: np.array(list(workers.map(partial(strange, name), range(FEW)))) for name in STRANGE}
        slow = np.array(list(workers.map(slow_trial, range(max(given.robots, SLOW_ROBOTS)))))
        nods = many_nods(workers)
        rest_servos = max(workers.map(ripple_at_rest, range(given.robots)))
        maker = list(workers.map(on_makers_model, BELIEFS))
        torque = {
            scheme: [list(workers.map(partial(at_1_khz, "drake", scheme=scheme), ("breathing", "heart")))]
            for scheme in AT_1_KHZ
        }
    resting = slow[:, :, SLOW_FIGURES.index("ripple at rest [mm/s]")] < AT_REST
    still = {name: int(count) for name, count in zip(AT_100_HZ, resting.sum(axis=0), strict=True)}
    plain, learning = (trials[:, list(SCHEMES).index(name)] for name in ("plain", "learning"))
    header = ["", *FIGURES, "lost"]
    words = [f"{motion} [{unit}]" for motion in ("breathing", "heart") for unit in ("mm", "deg")]
    text = TEXT.format(
        robots=given.robots,
        slow_robots=len(slow),
        few=FEW,
        table=markdown_table(header, [[name, *table(trials[:, k])] for k, name in enumerate(SCHEMES.values())]),
        strange=markdown_table(header, [[name, *table(rows)] for name, rows in others.items()]),
        first=markdown_table(
            ["", *FIGURES], [[name, *(f"{x:.3g}" for x in trials[0, k])] for k, name in enumerate(SCHEMES.values())]
        ),
        many=MANY,
        short=SHORT,
        of_many=table_of_many(nods),
        maker=markdown_table(
            ["", "nod [deg]", "learning", "look around [deg]", "learning", "breathing [mm]", "learning"],
            [[name, *(f"{x:.3g}" for x in row)] for name, row in zip(BELIEFS, maker, strict=True)],
        ),
        still=still["learning"],
        still_shipped=still["careful"],
        wander=len(slow) - still["careful"],
        rest=AT_REST,
        rest_servos=rest_servos,
        quieter=int((learning[:, 3] < plain[:, 3]).sum()),
        rolls=np.median(learning[:, 4]),
        plain_rolls=np.median(plain[:, 4]),
        **{f"{name}_nod": trials[:, list(SCHEMES).index(name), 0].max() for name in ("told", "second", "truth")},
        asked=asked(trials, load.result()[0], slow, nods, {name: rows[0] for name, rows in torque.items()}),
        load=load.result()[0],
        load_width=load.result()[1],
        slow=markdown_table(
            ["", *SLOW_FIGURES, "lost"],
            [[name, *table(slow[:, k])] for k, name in enumerate(AT_100_HZ.values())],
        ),
        torque=markdown_table(
            ["", *words], [[name, *(f"{x:.3g}" for x in np.ravel(rows))] for name, rows in torque.items()]
        ),
    )
    write_atomically(OUT, text.encode())


if __name__ == "__main__":
    main()
