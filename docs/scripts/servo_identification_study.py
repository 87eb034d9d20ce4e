"""Blind trials of `identify` on servos: `make results/servo_identification`, ten minutes.

Each robot is a Reachy Mini with constants that nobody is told. It plays 20 s of commands; from these and its angles its
constants are identified, and then it nods, looks around and breathes with what is believed then.
"""

from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from identification_study import DIFFERENCES, ROBOT_OF
from identification_study import motions as excitations

from stewart_drake import Scenario, identify, identify_servos, load_robot, load_scenario, run, run_metrics
from stewart_drake.base.markdown import markdown_table
from stewart_drake.estimation import torques
from stewart_drake.estimation.excitation import SERVO_ROOM, excite
from stewart_drake.estimation.servos import COULOMB, DELAY, PARAMETERS, STIFFNESS
from stewart_drake.logs.log import SimulationLog

OUT = Path(__file__).parents[1] / "results" / "servo_identification.md"
ROBOTS, DURATION = 20, 20.0
RUBBING = 5  # A robot with friction of 1.4 times the nominal.
GUESS = load_robot("reachy_mini")
SERVO = {"kind": "position", "preset": "xl330_m288"}
FRICTION = {"coulomb": 0.0128, "viscous": 0.0037, "width": 0.004}
NOMINAL_DELAY, NOMINAL_AGE = 0.03, 0.01  # [s] believed.
STEP = 0.00025  # [s] of the plant.
PLAIN = {"motors": {**SERVO, "damping": 0.0, "resolution_bits": None}, "friction": None, "delay": 0}
"""What makes commands of the angles of the inverse kinematics alone."""
NOMINAL = {"robot": GUESS, "motors": {**SERVO, "delay": NOMINAL_DELAY}, "friction": FRICTION}
MOTIONS = {"nod": (8.0, "rmse_norm_deg"), "look": (6.0, "rmse_norm_deg"), "breathing": (22.0, "rmse_norm_mm")}
"""Duration [s] and metric of a motion."""
BREATH = {"kind": "sine", "amplitude": [0.0, 0.0, 0.0, 0.0, 0.0, 0.005], "angular_frequency": "0.1 Hz"}
SCHEMES = {
    "plain": "angles of the inverse kinematics",
    "before": "exact model, nominal constants",
    "after": "exact model, identified, 10 ms of age assumed",
    "told": "exact model, identified, age of the readings known",
    "truth": "exact model, truth known",
}
FIGURES = ("nod [deg]", "look around [deg]", "breathing [mm]", "its ripple [mm/s]")
CONSTANTS = ("", "error: median, largest", "95 % interval, half width", "intervals that hold the truth")
FIRST = "nod of the first robot [deg]"
STRANGE: dict[str, dict[str, Any]] = {
    "as above": {},
    "stiction of 1.4 times the Coulomb friction": {"plant.friction.break_away": 1.4},
    "play of 0.5 deg in each gear": {"motors.backlash": np.radians(0.5).item()},
    "a dead band of 0.27 deg": {"motors.dead_band": np.radians(0.27).item()},
    "noise of 1 mrad in each reading": {"sensors.noise": 0.001},
}
"""Changes of a robot; break-away torque relative to the dry friction."""
KINDS = {"stiffness": 1.0, "delay": 1e3, "platform_mass": 1e3, "damping": 1e3, "coulomb": 1e3}
"""Kind of parameter, and factor to its unit in the table."""
UNITS = ("N m/rad", "ms", "g", "mN m s/rad", "mN m")
TEXT = """# Servos, identified from commands and angles alone

How well does a robot follow after `identify` has found the constants of its servos from 20 s of commands and angles?
Command: `make results/servo_identification`, a quarter of an hour on two cores.

{table}

- {robots} Reachy Minis with servos that take angles at 50 Hz (XL330-M288, 12 bits). RMS errors of the second half:
  median, 95th percentile, largest robot. Ripple: RMS error of the velocity above 2 Hz.
- At random, unknown: stiffness 0.7 to 1.3 times the nominal, damping 0.8 to 1.2, friction 0 to 3, head 0.8 to 1.2
  times; commands 10 to 50 ms late (model: 30), readings 0 to 20 ms old (model: 10).
- The motion is that of `stewart-drake excite --robot reachy_mini --motors xl330_m288`.
- Commands and angles show only the sum of the readings' age and the delay. A time stamp of the bus, or one filmed
  motion, shows the age; with it the robot follows as with the true constants.

## What was identified

Errors of the constants of all motors, the age of the readings known. Damping is that of the servo and its viscous
friction, which act as one.

{constants}

## What is not in the model

One robot (seed 5, friction 1.4 times the nominal) with something that `identify` knows nothing of.

{strange}

## By torque, on the maker's model

The MuJoCo model of Reachy Mini with motors that take torque, 60 s at 100 Hz. `identify` gets angles, torques and a
guess that has no friction. Of the motors: their mean, and the one farthest from it.

{mujoco}

Errors are up to five times the intervals: these do not include that dry friction is soft in MuJoCo.
"""
MUJOCO = {"kind": "mujoco", "model_file": "reachy_mini", "motor_class": "xc330m288t"} | dict.fromkeys(
    ("passive_friction", "passive_armature"), 0.0
)


class Hidden(NamedTuple):
    """Constants of a robot.

    Attributes:
        stiffness: [N m/rad].
        damping: [N m s/rad] of the servo.
        coulomb: (6,) [N m].
        viscous: (6,) [N m s/rad].
        delay: [s] of the commands.
        age: [s] of the readings.
        head: [-] mass of the head over the nominal.
    """

    stiffness: float
    damping: float
    coulomb: np.ndarray
    viscous: np.ndarray
    delay: float
    age: float
    head: float

    @property
    def robot(self) -> Any:
        """With its own head."""
        names = ("platform_mass", "platform_inertia", "platform_products")
        return GUESS.replace(**{name: (self.head * np.array(getattr(GUESS, name))).tolist() for name in names})

    @property
    def values(self) -> np.ndarray:
        """(21,) of `servos.PARAMETERS`."""
        of_motors = [*[self.stiffness] * 6, *(self.damping + self.viscous), *self.coulomb]
        return np.array([*of_motors, self.delay, self.head * GUESS.platform_mass, GUESS.rotor_inertia])


def hidden(seed: int) -> Hidden:
    """Constants at random."""
    rng = np.random.default_rng(seed)

    def each(nominal: float) -> np.ndarray:
        return nominal * rng.uniform(0.0, 3.0) * rng.uniform(0.85, 1.15, 6)

    def late(least: float, most: float, step: float) -> float:
        return step * round(rng.uniform(least, most) / step)

    stiffness, damping = rng.uniform(0.7, 1.3), 0.04 * rng.uniform(0.8, 1.2)
    coulomb, viscous = each(FRICTION["coulomb"]), each(FRICTION["viscous"])
    # A servo hears a command at a step of its own loop, of 1 ms.
    delay, age = late(0.01, 0.05, 0.001), late(0.0, 0.02, STEP)
    return Hidden(stiffness, damping, coulomb, viscous, delay, age, rng.uniform(0.8, 1.2))


def scenario(real: Hidden, belief: dict[str, Any], reference: Any, duration: float, plain: bool = False) -> Scenario:
    """A motion of a robot under what is believed of it."""
    # How far off it is, not whether that counts.
    bounds = "bounds={rotation: null, position: null, motion_ratio: null, error_ratio: null}"
    off = ("safety=null", "estimator={kind: difference}", "tuner=block", bounds)
    friction = {"coulomb": real.coulomb.tolist(), "viscous": real.viscous.tolist()}
    return load_scenario("reachy_nod", off).replace(
        {
            "robot": real.robot,
            "reference": reference,
            "duration": duration,
            "plant": {"kind": "closed_form", "integrator": "rk4", "time_step": STEP, "friction": friction},
            "motors": {**SERVO, "stiffness": real.stiffness, "damping": real.damping, "delay": real.delay},
            "sensors": {"kind": "encoders", "resolution_bits": 12, "delay": real.age},
            "controller": {"kind": "feedforward", "period": 0.02, "feedforward": "none" if plain else "full"},
            "command_delay": 0,
            "model": belief,
        }
    )


def motion() -> Any:
    """The reference that `excite` designs, as plain values."""
    limits = load_scenario("exact_breathing", ["robot=reachy_mini"]).limits
    return excite(GUESS, limits, room=SERVO_ROOM).reference.to_dict()


def logged(seed: int, reference: Any) -> SimulationLog:
    """What a robot says while it plays a motion with nominal constants."""
    return run(scenario(hidden(seed), NOMINAL, reference, DURATION), check=False)


def references() -> dict[str, Any]:
    """The motions of `compare reachy`, as plain values."""
    nod, look = (load_scenario(name).reference.to_dict() for name in ("reachy_nod", "reachy_look_around"))
    return {"nod": nod, "look": look, "breathing": {"kind": "adjusted", "fade_in": 2.0, "motion": BREATH}}


def beliefs(seed: int, log: SimulationLog) -> tuple[dict[str, Any], Any]:
    """What is believed under each scheme, and the identification with the age told."""
    real = hidden(seed)
    guessed, told = (identify_servos(GUESS, [log], reading_age=age) for age in (NOMINAL_AGE, real.age))
    true = {
        "robot": real.robot,
        "motors": {**SERVO, "stiffness": real.stiffness, "damping": real.damping, "delay": real.delay},
        "friction": {"coulomb": real.coulomb.tolist(), "viscous": real.viscous.tolist(), "width": FRICTION["width"]},
    }
    identified = [{"robot": each.robot, "motors": each.motors, "friction": each.friction} for each in (guessed, told)]
    return dict(zip(SCHEMES, (PLAIN, NOMINAL, *identified, true), strict=True)), told


def figures(
    seed: int, scheme: str, belief: dict[str, Any], motions: dict[str, Any], changes: dict[str, Any] | None = None
) -> list[float]:
    """A robot's `FIGURES`, perhaps with some changes of it; infinite where it is lost."""
    found = []
    for name, reference in motions.items():
        duration, metric = MOTIONS[name]
        moving = scenario(hidden(seed), belief, reference, duration, scheme == "plain").replace(changes or {})
        log = run(moving, check=False)
        measured = run_metrics(log) if log.status == "completed" else {}
        found.append(measured.get(metric, np.inf))
        if name == "breathing":
            found.append(measured.get("ripple_mm_s", np.inf))
    return found


def trial(seed: int, reference: Any, motions: dict[str, Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Figures (schemes, 4), and errors (21,) and half widths (21,) of what was identified."""
    believed, told = beliefs(seed, logged(seed, reference))
    rows = [figures(seed, scheme, belief, motions) for scheme, belief in believed.items()]
    print(seed, np.round(rows, 3).tolist(), flush=True)
    return np.array(rows), told.values - hidden(seed).values, told.half_width


def three_of(values: np.ndarray) -> tuple[float, float, float]:
    """Median, 95th percentile and largest."""
    return float(np.median(values)), float(np.quantile(values, 0.95, method="nearest")), float(values.max())


def spread(values: np.ndarray) -> str:
    """`three_of`, in words."""
    return ", ".join("lost" if np.isinf(value) else f"{value:.3g}" for value in three_of(values))


def page(
    trials: list[tuple[np.ndarray, np.ndarray, np.ndarray]], others: list[list[str]], maker: list[list[str]]
) -> str:
    """The page, of the trials and the rows of `strange` and `in_mujoco`."""
    rows, errors, widths = (np.array(column) for column in zip(*trials, strict=True))
    table = [
        [
            words,
            *(spread(rows[:, at, column]) for column in range(4)),
            f"{rows[0, at, 0]:.3g}",
        ]
        for at, words in enumerate(SCHEMES.values())
    ]
    constants = []
    for (kind, factor), unit in zip(KINDS.items(), UNITS, strict=True):
        own = [at for at, parameter in enumerate(PARAMETERS) if parameter.kind == kind]
        off, width = np.abs(factor * errors[:, own]).ravel(), factor * widths[:, own].ravel()
        inside = f"{100.0 * np.mean(off <= width):.0f} %"
        name = f"{kind.replace('_', ' ')} [{unit}]"
        constants.append([name, f"{np.median(off):.2g}, {off.max():.2g}", f"{np.median(width):.2g}", inside])
    return TEXT.format(
        robots=len(trials),
        table=markdown_table(["commands", *FIGURES, FIRST], table),
        constants=markdown_table(CONSTANTS, constants),
        strange=markdown_table(["", "stiffness", "delay", "Coulomb, worst", *FIGURES], others),
        mujoco=markdown_table(["", "in the model", "guess", "identified"], maker),
    )


def strange(reference: Any, motions: dict[str, Any]) -> list[list[str]]:
    """Rows of a table for `STRANGE`."""
    real, rows = hidden(RUBBING), []
    for words, changes in STRANGE.items():
        more = {key: value for key, value in changes.items() if "break_away" not in key}
        if more != changes:
            more = {"plant.friction.break_away": (changes["plant.friction.break_away"] * real.coulomb).tolist()}
        log = run(scenario(real, NOMINAL, reference, DURATION).replace(more), check=False)
        told = identify_servos(GUESS, [log], reading_age=real.age)
        off = told.values - real.values
        dry = np.abs(1e3 * off[COULOMB]).max()
        errors = (
            f"{100 * off[STIFFNESS].mean() / real.stiffness:+.1f} %",
            f"{1e3 * off[DELAY]:+.2f} ms",
            f"{dry:.2g} mN m",
        )
        belief = {"robot": told.robot, "motors": told.motors, "friction": told.friction}
        rows.append([words, *errors, *(f"{value:.3g}" for value in figures(RUBBING, "told", belief, motions, more))])
    return rows


def in_mujoco(duration: float = 60.0) -> list[list[str]]:
    """What the maker's model has, what a controller believed of it, and what was identified by torque."""
    believed = GUESS.replace(platform_mass=0.8 * GUESS.platform_mass)
    found, _ = excitations("reachy_mini")
    off = ("bounds.position=null", "bounds.rotation=null", "tuner={kind: block}", "safety=null", "command_delay=0")
    keys = ("robot=reachy_mini", DIFFERENCES, *ROBOT_OF["reachy_mini"][5], *off, f"duration={duration}")
    played = load_scenario("exact_breathing", keys).replace(
        {"plant": MUJOCO, "reference": found.reference.to_dict(), "model": {"robot": believed, "friction": None}}
    )
    result = identify(believed, [run(played, check=False)])
    (model, _), friction = played.plant.simulated(GUESS), played.plant.friction_options
    width = dict(zip(map(str, torques.PARAMETERS), result.half_width, strict=True))

    def motor(kind: str, values: np.ndarray) -> str:
        middle = values.mean()
        farthest = values[np.abs(values - middle).argmax()]
        return f"{middle:.4f}, {farthest:.4f} ± {max(width[f'{kind} motor {leg}'] for leg in range(6)):.2g}"

    def one(kind: str) -> str:
        return f"{getattr(result.robot, kind):.5g} ± {width[kind]:.2g}"

    rotor = float(np.mean(model["rotor_inertia"]))
    return [
        ["head [kg]", f"{model['platform_mass']:.5g}", f"{believed.platform_mass:.5g}", one("platform_mass")],
        ["rotor and gear [kg m^2]", f"{rotor:.5g}", f"{believed.rotor_inertia:.5g}", one("rotor_inertia")],
        ["Coulomb [N m]", f"{friction.coulomb[0]:.4f}", "0", motor("coulomb", result.coulomb)],
        ["viscous [N m s/rad]", f"{friction.viscous[0]:.4f}", "0", motor("viscous", result.viscous)],
    ]


def main() -> None:
    """Runs the trials."""
    reference, motions = motion(), references()
    with ProcessPoolExecutor() as workers:
        jobs = [workers.submit(trial, seed, reference, motions) for seed in range(ROBOTS)]
        trials = [job.result() for job in jobs]
    OUT.write_text(page(trials, strange(reference, motions), in_mujoco()), encoding="utf-8")


if __name__ == "__main__":
    main()
