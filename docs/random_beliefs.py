"""Robots of wrong beliefs that are pushed and fail, with learning and without, docs/results/random_beliefs.md.

`python docs/random_beliefs.py [NUMBER]`: 1000, a quarter of an hour on two cores.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import adaptation_study as study
import numpy as np

from stewart_drake import Scenario, load_scenario, run
from stewart_drake.base.atomic_files import write_atomically
from stewart_drake.base.markdown import markdown_table

OUT = Path(__file__).parent / "results" / "random_beliefs.md"
MANY, SECONDS, DRAKE_EVERY = 1000, 6.0, 20
LOST = 10.0  # [deg] of an error, after a second, from which on a robot is lost.
BUSES = ("servos at 50 Hz", "currents at 100 Hz", "torque at 1 kHz")
FAULTS = ("freeze", "nan", "jump", "dead")
PAGE = """# Random situations with wrong beliefs

`python docs/random_beliefs.py` draws {many} situations by seed, of three kinds of motor: Reachy Mini's servos that take
angles at 50 Hz, its motors by current at 100 Hz (`decoupled_pid`), and the paper's robot by torque at 1 kHz
(`exact_breathing`, `exact_heart`, `exact_fig7` with observer and policy). Friction is 0 to 3 times what is believed,
stiffness or torque constant 0.7 to 1.3 times, a head 0.8 to 1.2 times as heavy or a payload of up to 0.3 kg. Half are
pushed, by up to 3 N and 0.1 N m (the paper's robot: 7 N and 0.2 N m), from 2 or 3 s on for up to 2 s. In a quarter an
encoder freezes, jumps by up to 0.1 rad or gives nothing, or, by torque, a motor is dead, from 2 or 3 s on. Half of
those by torque have the safety layer. Each runs for {seconds:g} s with `adaptation: regression` from a cold start, and
without; every {every}th on Drake's plant, the others on the closed form.

Lost: the run fails or is lost, or the head is more than {lost:g} deg off after the first second. A run that the safety
layer stops is lost only by the latter.

| motors | fault | situations | kept by both | lost by both | lost without learning alone | lost with learning alone |
| --- | --- | --- | --- | --- | --- | --- |
{table}

{worse}

`make results` recomputes some of these numbers.
"""


class Outcome(NamedTuple):
    """Of a situation."""

    bus: str
    fault: str
    lost: tuple[bool, bool]  # With learning, and without.


def drawn(number: int) -> tuple[str, str, tuple[Scenario, Scenario]]:
    """Motors, fault or none, and scenarios with learning and without."""
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
            "sensors": {"kind": "encoders", "resolution_bits": 17},
            "command_delay": 1,
            "estimator": "observer",
            "tuner": "policy",
            "safety": {} if safe else None,
        } | {key: value for key, value in more.items() if key.startswith("sensors.")}
        base = base.replace({"plant.kind": "closed_form"})
        made = [base.replace({"adaptation": kind}) for kind in ("regression", None)]
    more |= {f"bounds.{key}": None for key in ("rotation", "position", "motion_ratio", "error_ratio")}
    learning, without = (each.replace(more) for each in made)
    if number % DRAKE_EVERY == 0:
        learning, without = on_drake(learning), on_drake(without)
    return bus, fault, (learning, without)


def on_drake(scenario: Scenario) -> Scenario:
    """The same on Drake's plant with steps of 1 ms."""
    plant = {key: value for key, value in scenario.plant.given().items() if key != "integrator"}
    return scenario.replace({"plant": {**plant, "kind": "drake", "time_step": 0.001}})


def is_lost(scenario: Scenario) -> bool:
    """Whether a robot is lost."""
    log = run(scenario, check=False)
    if log.status in ("failed", "lost"):
        return True
    return bool(log.error_norms[0][log.time > 1.0].max(initial=0.0) > LOST)


def outcome(number: int) -> Outcome:
    """Of a situation, by its number."""
    bus, fault, made = drawn(number)
    found = Outcome(bus, fault, (is_lost(made[0]), is_lost(made[1])))
    if found.lost[0] and not found.lost[1]:
        print(number, found, flush=True)
    return found


def main() -> None:
    """Runs them and writes the page."""
    many = int(sys.argv[1]) if len(sys.argv) > 1 else MANY
    with ProcessPoolExecutor() as workers:
        found = list(workers.map(outcome, range(many), chunksize=4))
    rows = []
    for bus in BUSES:
        for words, faulty in (("none", False), ("one", True)):
            own = [each.lost for each in found if each.bus == bus and bool(each.fault) == faulty]
            counts = [own.count(case) for case in ((False, False), (True, True), (False, True), (True, False))]
            rows.append([bus, words, len(own), *counts])
    worse = [k for k, each in enumerate(found) if each.lost == (True, False)]
    told = f"Lost with learning alone: numbers {', '.join(map(str, worse))}." if worse else "Learning loses none."
    table = markdown_table([""] * 7, rows).split("\n", 2)[2]
    text = PAGE.format(many=many, seconds=SECONDS, every=DRAKE_EVERY, lost=LOST, table=table, worse=told)
    write_atomically(OUT, text.encode())


if __name__ == "__main__":
    main()
