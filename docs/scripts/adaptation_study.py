"""Robots that learn their unknown motors, docs/results/adaptation.md: `make results/adaptation`, half an hour.

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
from servo_identification_study import GUESS, NOMINAL, PLAIN, SERVO, Hidden, spread
from strange_robots import LateServos, LoadedFriction

from stewart_drake import Scenario, load_scenario, run, run_metrics
from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.markdown import markdown_table
from stewart_drake.control.adaptation import last_learnt, model_of
from stewart_drake.control.base import heave_inertia
from stewart_drake.logs.log import SimulationLog
from stewart_drake.robot import RobotParameters

OUT = Path(__file__).parents[1] / "results" / "adaptation.md"
STEP = 0.001  # [s] of the plant.
AGE = servos.NOMINAL_AGE
MOTIONS = {"nod": (20.0, "rmse_norm_deg"), "look": (24.0, "rmse_norm_deg"), "breathing": (20.0, "rmse_norm_mm")}
"""Duration [s], of which the second half counts, and metric."""
FIGURES = ("nod [deg]", "look around [deg]", "breathing [mm]", "its ripple [mm/s]")
SHORT_FIGURES = (0, 2, 3)
"""Of these, those of robots with something that the model does not have."""
FIRST = "nod of the first robot [deg]"
SCHEMES = {
    "plain": "angles of the inverse kinematics",
    "nominal": "exact model, nominal constants",
    "learning": "the same, learning",
    "told": "the same, learning, age of the readings known",
    "second": "a second run, age of the readings known",
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
SLOW_FIGURES = ("nod [deg]", "its ripple [mm/s]", "breathing [mm]", "ripple at rest [mm/s]")
SLOW_METRICS = {"nod": ("rmse_norm_deg", "ripple_mm_s"), "breathing": ("rmse_norm_mm",), "rest": ("ripple_mm_s",)}
DRY = 0.08  # [N m] of the motors at 1 kHz, believed 0.01.
PUSHED = {"disturbances": [{"kind": "step", "wrench": [0.0, 0.0, 0.0, 1.0, 0.0, 0.0], "time": 3.0, "until": 60.0}]}
LOADED: dict[str, Any] = {"plant.payload_mass": 0.3, **BESIDE}
AT_1_KHZ: dict[str, dict[str, Any]] = {
    "model: 0.01 N m": {},
    "model: 0.01 N m, learning": {"adaptation": "regression"},
    "truth known": {"model.friction.coulomb": DRY},
    "with a load of 0.3 kg, model: 0.01 N m": LOADED,
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
            found.append(measured.get("ripple_mm_s", np.inf))
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
    robot, motors = GUESS.replace(**GUESS.scaled_masses(head)), {"kind": "current", "torque_constant": constant}
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
    """Nod [deg] and its ripple [mm/s], breathing [mm], ripple at rest [mm/s]; infinite where the robot is lost."""
    found = []
    for motion, metrics in SLOW_METRICS.items():
        log = run(slow_bus(seed, scheme, motion), check=False)
        measured = run_metrics(log)
        lost = log.status != "completed" or measured["peak_norm_deg"] > FALLEN
        found += [np.inf if lost else measured[name] for name in metrics]
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


def table(rows: np.ndarray) -> list[str]:
    """Cells of figures (robots, n) of a scheme, and how many robots were lost."""
    return [*(spread(column) for column in rows.T), str(int(np.isinf(rows).any(axis=1).sum()))]


def ends(column: np.ndarray) -> str:
    """Median and largest of a few robots."""
    middle, _, most = spread(column).split(", ")
    return f"{middle}, {most}"


TEXT = """# Robots that learn their motors

How far off is a robot whose motors nobody has measured, if it learns them while it moves?
Command: `make results/adaptation`,
half an hour on two cores.

{table}

- {robots} Reachy Minis with servos that take angles at 50 Hz (XL330-M288, 12 bits), from a cold start. RMS errors of
  the second half of 20 s (look around: 24 s): median, 95th percentile, largest robot. Ripple: RMS error of the
  velocity above 2 Hz. A nod is 15 deg at 1 Hz, breathing 5 mm at 0.1 Hz.
- At random, unknown to the controller: stiffness 0.7 to 1.3 times the nominal, damping 0.8 to 1.2, Coulomb and viscous
  friction 0 to 3, head 0.8 to 1.2 times; commands 10 to 50 ms late (model: 30), readings 0 to 20 ms old (model: 10).
- With the age of the readings known, learning is as good as the truth. Commands and angles cannot show that age, and
  10 ms of it are 0.66 deg of a nod: measure it and set `model.reading_age`.
- *Second run*: with the model that `--keep-model` left after a first run that looked around. At rest servos ripple by
  at most {rest_servos:.2g} mm/s.

## What is not in the model

{few} of these robots, learning: median, largest.

{strange}

A crank that sticks harder than it slides jumps, and a command every 20 ms comes too late to stop that. Two rows are
[a plant and motors of one's own](../your_own_loop.md), in `docs/scripts/strange_robots.py`.

## By torque at 1 kHz

The paper's robot on Drake's plant: 17 bits, observer, one tick of delay, and friction of 0.08 N m where the model has
0.01 N m. The load is 36 mm beside the middle of the platform; the push is 1 N from the side.

{torque}

Of the load, 20 s of breathing find {load:.4f} kg (95 % interval: +-{load_width:.2g} kg).

## By torque at 100 Hz

{slow_robots} Reachy Minis, motors that take currents, one tick late, and `controller: {{kind: pid, inertia: robot}}`.
At random: friction 0 to 2 times that of the model, torque constant 0.7 to 1.3 times, head 0.8 to 1.2 times.

{slow}

*cautious*: motors that take torque, with the safety layer. *Lost*: the run ends, or the head is more than 10 deg off.
At rest {still} of {slow_robots} robots ripple by less than {rest:g} mm/s; the others have no friction at all and wander
between two steps of the encoders.

## Many robots

{many} more of each kind, learning while they nod for {short:g} s from a cold start.

{of_many}

## Random situations

5000 robots with wrong models, pushes and faults of encoders or motors, measured at commit 52302213:
learning saves 91 that are lost without it, and loses four. In three a push moves a head on servos, which do not answer
a push. In the fourth an encoder freezes 2.3 s after a cold start: the safety layer finds that late, and the head moves
20.6 deg instead of 7.5 deg.
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
        torque = {
            scheme: [list(workers.map(partial(at_1_khz, "drake", scheme=scheme), ("breathing", "heart")))]
            for scheme in AT_1_KHZ
        }
    text = TEXT.format(
        robots=given.robots,
        slow_robots=len(slow),
        few=FEW,
        table=markdown_table(
            ["", *FIGURES, "lost", FIRST],
            [[name, *table(trials[:, k]), f"{trials[0, k, 0]:.3g}"] for k, name in enumerate(SCHEMES.values())],
        ),
        strange=markdown_table(
            ["", *(FIGURES[k] for k in SHORT_FIGURES)],
            [[name, *(ends(rows[:, k]) for k in SHORT_FIGURES)] for name, rows in others.items()],
        ),
        many=MANY,
        short=SHORT,
        of_many=table_of_many(nods),
        still=int((slow[:, list(AT_100_HZ).index("learning"), -1] < AT_REST).sum()),
        rest=AT_REST,
        rest_servos=rest_servos,
        load=load.result()[0],
        load_width=load.result()[1],
        slow=markdown_table(
            ["", *SLOW_FIGURES, "lost"],
            [[name, *table(slow[:, k])] for k, name in enumerate(AT_100_HZ.values())],
        ),
        torque=markdown_table(
            ["", "breathing [mm]", "heart [mm]"],
            [[name, *(f"{position:.3g}" for position, _ in rows[0])] for name, rows in torque.items()],
        ),
    )
    write_atomically(OUT, text.encode())


if __name__ == "__main__":
    main()
