"""Robots of wrong beliefs that are pushed and fail, with learning and without, docs/results/random_beliefs.md.

`python docs/scripts/random_beliefs.py [NUMBER]`: 5000, an hour and a half on two cores.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import adaptation_study as study
import numpy as np
from servo_identification_study import spread

from stewart_drake import Scenario, load_scenario, run
from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.markdown import markdown_table
from stewart_drake.studies.faults import stopped_at, travel

OUT = Path(__file__).parents[1] / "results" / "random_beliefs.md"
MANY, SECONDS, DRAKE_EVERY = 5000, 6.0, 50
LOST = 10.0  # [deg] of an error in the last second, or of what a robot travels after a stop, from which on it is lost.
BUSES = ("servos at 50 Hz", "currents at 100 Hz", "torque at 1 kHz")
FAULTS = ("freeze", "nan", "jump", "dead")
PAGE = """# Random situations with wrong beliefs

`make random_beliefs` draws {many} situations by seed, of three kinds of motor: Reachy Mini's servos that take
angles at 50 Hz, its motors by current at 100 Hz (the PID for slow buses), and the paper's robot by torque at 1 kHz
(`exact_breathing`, `exact_heart`, `exact_fig7` with observer and policy). Friction is 0 to 3 times what is believed,
stiffness or torque constant 0.7 to 1.3 times (not at 1 kHz), a head 0.8 to 1.2 times as heavy or a payload of up to
0.3 kg. Half are pushed, by up to 3 N and 0.1 N m (the paper's robot: 7 N and 0.2 N m), from 2 to 3 s on for up to 2 s.
In a quarter an encoder freezes, jumps by up to 0.1 rad or gives nothing, or, by torque, a motor is dead, from 2 to 3 s
on. Half of those by torque have the safety layer, which only such motors can have. Each runs for {seconds:g} s with
`adaptation: regression` from a cold start, and without; every {every}th on Drake's plant, the others on the closed
form.

A robot is *kept* where its run completes and the head is at most {lost:g} deg off in the last second. It is *stopped*
where the safety layer ends the run, and the head then moves at most {lost:g} deg until the brakes hold it. Else it is
*lost*. With the truth told, the controller knows robot, motors and friction from the start and learns nothing.

## With learning against without

{table}

Worse with learning: {worse}. Beside a stop stands how far the head moves after it.

{told}

Commands of angles do not answer a push: what it does to a head depends on where that stands.

## Stops

Of situations that both stop, how far the head moves after the layer took over: median / 95th percentile / largest
[deg].

{stops}

Robots lost with learning and safety layer that a plain stop at the push or the fault, with sensors that work, keeps:
{fallen}. Lost without learning too: {alike}.

`make results` recomputes some of these numbers.
"""


class Outcome(NamedTuple):
    """Of a situation, with learning, without, and with the truth told."""

    bus: str
    fault: str
    ends: tuple[str, str, str]  # "kept", "stopped" or "lost"; the last is "" where the others are alike.
    travels: tuple[float, float, float]  # [deg] after a stop, 0 where there was none.
    held: bool  # Whether a plain stop at the push or fault, with sensors that work, keeps the one that learns.


def drawn(number: int) -> tuple[str, str, tuple[Scenario, Scenario], float]:
    """Motors, fault or none, scenarios with learning and without, and time [s] of push and fault."""
    rng = np.random.default_rng([36, number])
    bus = BUSES[int(rng.integers(len(BUSES)))]
    begin, leg = round(float(rng.uniform(2.0, 3.0)), 2), int(rng.integers(6))
    more: dict[str, Any] = {"duration": SECONDS}
    if rng.random() < 0.5:
        size = np.array([0.2, 7.0] if bus == BUSES[2] else [0.1, 3.0])
        wrench = (np.repeat(size, 3) * rng.uniform(-1.0, 1.0, 6) / np.sqrt(3.0)).tolist()
        until = round(begin + float(rng.uniform(0.05, 2.0)), 2)
        more["disturbances"] = [{"kind": "step", "wrench": wrench, "time": begin, "until": until}]
    fault = str(rng.choice(FAULTS if bus == BUSES[2] else FAULTS[:-1])) if rng.random() < 0.25 else ""
    if fault == "dead":
        more["motors.dead"] = {"leg": leg, "time": begin}
    elif fault:
        size = {"size": float(rng.uniform(-0.1, 0.1))} if fault == "jump" else {}
        more["sensors.faults"] = [{"kind": fault, "leg": leg, "time": begin, **size}]
    safe = bool(rng.random() < 0.5)
    if bus == BUSES[0]:
        motion = str(rng.choice(["nod", "look", "breathing"]))
        made = [study.scenario(number, scheme, motion) for scheme in ("learning", "nominal")]
    elif bus == BUSES[1]:
        motion = str(rng.choice(["nod", "breathing"]))
        rubs = rng.uniform(0.0, 3.0, 2) * (study.NOMINAL_DRY, study.NOMINAL_VISCOUS)
        friction = {"coulomb": float(rubs[0]), "viscous": float(rubs[1])}
        more["plant.friction"] = friction
        made = [study.slow_bus(number, scheme, motion) for scheme in ("learning", "nominal")]
    else:
        base = load_scenario(str(rng.choice(["exact_breathing", "exact_heart", "exact_fig7"])))
        more |= {
            "plant.motor_friction": float(rng.uniform(0.0, 0.24)),
            "plant.payload_mass": float(rng.uniform(0.0, 0.3)),
            "model.friction": {"coulomb": 0.08},
            "command_delay": 1,
            "estimator": "observer",
            "tuner": "policy",
            "safety": {} if safe else None,
        }
        base = base.replace({"plant.kind": "closed_form", "sensors": {"kind": "encoders", "resolution_bits": 17}})
        made = [base.replace({"adaptation": kind}) for kind in ("regression", None)]
    more |= {f"bounds.{key}": None for key in ("rotation", "position", "motion_ratio", "error_ratio")}
    learning, without = (each.replace(more) for each in made)
    if number % DRAKE_EVERY == 0:
        learning, without = on_drake(learning), on_drake(without)
    return bus, fault, (learning, without), begin


def on_drake(scenario: Scenario) -> Scenario:
    """The same on Drake's plant with steps of 1 ms."""
    plant = {key: value for key, value in scenario.plant.given().items() if key != "integrator"}
    return scenario.replace({"plant": {**plant, "kind": "drake", "time_step": 0.001}})


def end_of(scenario: Scenario) -> tuple[str, float]:
    """How a run ends, and how far the head moves after a stop [deg]."""
    log = run(scenario, check=False)
    if log.status == "stopped":
        moved = float(np.degrees(travel(log, log.safety["time"])[0]))
        return ("lost" if moved > LOST else "stopped"), moved
    late = log.error_norms[0][log.time > SECONDS - 1.0]
    return ("kept" if log.status == "completed" and late.max() <= LOST else "lost"), 0.0


def with_truth(scenario: Scenario) -> Scenario:
    """A scenario where the controller knows the robot, its motors and their friction, and of a payload the mass."""
    real, levels = scenario.robot, scenario.plant.friction_options
    robot = real.replace(platform_mass=real.platform_mass + scenario.plant.payload_mass)
    friction = {"coulomb": levels.coulomb, "viscous": levels.viscous, "width": scenario.controller_model.friction.width}
    known = {"robot": robot, "motors": scenario.motors.nominal, "friction": friction}
    return scenario.replace({"robot": robot, "plant.payload_mass": 0.0, "model": known, "adaptation": None})


def outcome(number: int) -> Outcome:
    """Of a situation, by its number."""
    bus, fault, made, since = drawn(number)
    (learning, moved), (without, moved_without) = (end_of(each) for each in made)
    held, told = False, ("", 0.0)
    if learning == without == "stopped" or ENDS.index(learning) > ENDS.index(without):
        told = end_of(with_truth(made[1]))
    if learning == "lost" and made[0].safety is not None:
        log = run(stopped_at(made[0], since), check=False)
        held = float(np.degrees(travel(log, since)[0])) <= LOST
    found = Outcome(bus, fault, (learning, without, told[0]), (moved, moved_without, told[1]), held)
    if learning != "kept" and learning != without:
        print(number, found, flush=True)
    return found


ENDS = ("kept", "stopped", "lost")
HEADER = (
    "motors", "fault", "situations", *(f"{end} by both" for end in ENDS), "better with learning", "worse with learning",
)  # fmt: skip
OF_STOPS = ("stopped by both", "learning", "without", "truth told", "1 deg farther with", "1 deg farther without")


def main() -> None:
    """Runs them and writes the page."""
    many = int(sys.argv[1]) if len(sys.argv) > 1 else MANY
    with ProcessPoolExecutor() as workers:
        found = list(workers.map(outcome, range(many), chunksize=4))
    rows, stops = [], []
    for bus in BUSES:
        for words, faulty in (("none", False), ("one", True)):
            own = [each for each in found if each.bus == bus and bool(each.fault) == faulty]
            ends = [(ENDS.index(each.ends[0]), ENDS.index(each.ends[1])) for each in own]
            alike = [ends.count((k, k)) for k in range(len(ENDS))]
            rows.append([bus, words, len(own), *alike, sum(a < b for a, b in ends), sum(a > b for a, b in ends)])
        both = np.array([each.travels for each in found if each.bus == bus and each.ends[:2] == ("stopped", "stopped")])
        if len(both):
            farther = int((both[:, 0] > both[:, 1] + 1.0).sum()), int((both[:, 1] > both[:, 0] + 1.0).sum())
            stops.append([len(both), *map(spread, both.T), *farther])
    worse = [k for k, each in enumerate(found) if ENDS.index(each.ends[0]) > ENDS.index(each.ends[1])]
    fallen = [k for k, each in enumerate(found) if each.held]
    text = PAGE.format(
        many=many,
        seconds=SECONDS,
        every=DRAKE_EVERY,
        lost=LOST,
        table=markdown_table(HEADER, rows),
        worse=numbers(worse),
        told=markdown_table(
            ("number", "motors", "push", "fault", "with learning", "without", "truth told"),
            [[k, found[k].bus, push_of(k), found[k].fault or "none", *ended(found[k])] for k in worse],
        ),
        stops=markdown_table(OF_STOPS, stops),
        fallen=numbers(fallen),
        alike=numbers([k for k in fallen if found[k].ends[1] == "lost"]),
    )
    write_atomically(OUT, text.encode())


def ended(found: Outcome) -> list[str]:
    """The three ends of a situation, with how far the head moves after a stop."""
    return [f"{end}, {moved:.1f} deg" if moved else end for end, moved in zip(found.ends, found.travels, strict=True)]


def push_of(number: int) -> str:
    """Of a situation, in words."""
    _, _, (scenario, _), _ = drawn(number)
    return " and ".join(f"{np.linalg.norm(each.wrench[3:]):.1f} N" for each in scenario.disturbances) or "none"


def numbers(found: Sequence[int]) -> str:
    """Situations, by their numbers."""
    return ", ".join(map(str, found)) if found else "none"


if __name__ == "__main__":
    main()
