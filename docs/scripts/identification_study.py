"""Measures what an identification is worth, and writes docs/results/identification.md: `make results/identification`.

First many simulated robots: the exact inverse dynamics, friction and noise. Then a few on the Drake plant, each
identified from a run there, and the controller before and after.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from simulated_identification import Setting, coverage, deviating, run_trial

from stewart_drake.estimation.excitation import excite
from stewart_drake.estimation.identification import identify
from stewart_drake.estimation.torques import COULOMB, GAIN, VISCOUS, as_robot, recording_of_log, values_of
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.scenario import load_scenario

OUT = Path(__file__).parents[1] / "results" / "identification.md"
ROBOTS, ON_DRAKE = 200, 3
DIFFERENCES = "estimator={kind: difference, rate_cutoff: 150}"
TWELVE_BITS = ("controller.period=0.01", "sensors.resolution_bits=12", "estimator.rate_cutoff=20")
SERVO = ("controller.kind=computed_torque", "controller.natural_frequency=25", "controller.integral_frequency=2")
ROBOT_OF = {
    # encoders, rate of the logs, noise of torques, Coulomb, viscous; how it runs on Drake, and the motion tracked there
    "paper": (EncoderOptions(resolution_bits=17, noise=2e-5), 1000.0, 0.01, 0.02, 0.01, (), "exact_breathing"),
    "reachy_mini": (
        EncoderOptions(resolution_bits=12),
        100.0,
        0.005,
        0.058,
        0.095,
        (*SERVO, *TWELVE_BITS),
        "reachy_look_around",
    ),
}
TEXT = """# What an identification is worth

How well does `identify` find payload and friction from a log of angles and torques, and how well does the controller
follow with them? Command: `make results/identification`, half an hour.
"""
HEADER = (
    "robot",
    "condition number, of motions at random",
    "payload",
    "Coulomb",
    "viscous",
    "unseen torques by the guess",
    "by what was found",
    "intervals that hold the truth",
)
NOTES = """
- {robots} robots a row. Errors are relative: median, 95th percentile, largest; of friction the worst motor counts.
  *Unseen torques*: those of a random motion that was not used. The 95 % intervals: all, and from the least to the most
  of a kind of parameter.
- In a robot rods, cranks, rotors and torque constants are off by up to 20 %, friction differs between motors by a
  factor of 3 (middle: {friction}), and a payload has 10 to 30 % of the platform's mass. The guess knows nothing of
  this.
- A log has 60 s of the motion of `stewart-drake excite`, from the exact inverse dynamics. `paper`: 1 kHz, 17 bits with
  2e-5 rad of noise, torques with 0.01 N m of noise; `reachy_mini`: 100 Hz, 12 bits, 0.005 N m.
"""
DRAKE = """
## On Drake's plant

{robots} such robots a row, with stiction, identified from a run under a controller that has the guess. Then it follows
{motions}, before and after. Errors are the largest, the RMSE is the median.
"""
DRAKE_HEADER = (
    "robot",
    "payload off",
    "Coulomb, viscous off",
    "unseen torques off",
    "RMSE before [mm], [deg]",
    "RMSE after [mm], [deg]",
)


def header(names):
    """The first two lines of a table."""
    return [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]


def motions(name):
    """The motion of least condition number, and another."""
    robot = load_robot(name)
    limits = load_scenario("exact_breathing", [f"robot={name}"]).limits
    return excite(robot, limits), excite(robot, limits, seed=1, changes=0)


def percent(*values):
    """Numbers as per cent."""
    return ", ".join(f"{100.0 * value:.2g} %" for value in values)


def spread(values):
    """Median, 95th percentile and largest."""
    return percent(np.median(values), np.quantile(values, 0.95), np.max(values))


def study(name, found, other):
    """A row of the first table."""
    encoders, rate, noise, coulomb, viscous, *_ = ROBOT_OF[name]
    guess = load_robot(name)
    setting = Setting(guess, found.reference, other.reference, rate, encoders, noise, coulomb, viscous)
    with ProcessPoolExecutor() as workers:
        trials = list(workers.map(partial(run_trial, setting), range(ROBOTS), chunksize=5))
    of = {field: np.array([getattr(trial, field) for trial in trials]) for field in trials[0]._fields}
    inside = coverage(trials)
    kinds = [share for kind, share in inside.items() if kind != "all" and share > 0]
    row = (
        f"| `{name}` | {found.condition:.3g}, {found.random_condition:.3g} | {spread(of['payload'])} "
        f"| {spread(of['coulomb'])} | {spread(of['viscous'])} "
        f"| {percent(np.median(of['by_guess']))} | {percent(np.median(of['predicted']), of['predicted'].max())} "
        f"| {100 * inside['all']:.1f} % ({100 * min(kinds):.1f} to {100 * max(kinds):.1f} %) |"
    )
    print(row, inside, flush=True)
    return row


def on_drake(name, found, other, seed):
    """Errors of an identification from a run on the Drake plant, and RMSE [mm, deg] before and after."""
    _, _, noise, coulomb, viscous, settings, motion = ROBOT_OF[name]
    guess, rng = load_robot(name), np.random.default_rng(seed)
    truth = deviating(guess, rng, coulomb, viscous)
    robot = as_robot(guess, truth)
    friction = {"coulomb": truth[COULOMB].tolist(), "viscous": truth[VISCOUS].tolist()}
    real = {"robot": robot, "model.robot": guess, "plant.friction": friction}
    # The shipped motion has friction of its own, and an observer, which would have to know the robot; bounds are off,
    # because the guess may follow badly.
    off = (
        *("plant.motor_friction=0", "plant.motor_damping=0", "bounds.position=null", "bounds.rotation=null"),
        *("model.friction=null", "tuner={kind: block}"),
    )

    def log(reference, duration):
        base = load_scenario("exact_breathing", [f"robot={name}", DIFFERENCES, *settings, *off, f"duration={duration}"])
        made = base.replace({**real, "reference": reference.to_dict()})
        recording = recording_of_log(run(made, check=False), f"run {seed}")
        torque = recording.torque * np.exp(-truth[GAIN])
        return replace(recording, torque=torque + noise * rng.standard_normal(torque.shape))

    result = identify(guess, [log(found.reference, 60.0)], validate=[log(other.reference, 20.0)])
    errors = [np.abs(result.values[part] / truth[part] - 1.0).max() for part in (COULOMB, VISCOUS)]
    load = truth - values_of(guess)
    base = load_scenario(motion, [f"robot={name}", DIFFERENCES, *settings, *off, "safety=null"]).replace(real)
    identified = {"coulomb": result.coulomb.tolist(), "viscous": result.viscous.tolist()}
    after = {"model.robot": result.robot, "model.friction": identified}
    rmse = [tracking(each) for each in (base, base.replace(after))]
    payload = abs(result.payload[0] / load[0] - 1.0)
    print(name, seed, payload, errors, result.predictions, rmse, flush=True)
    return payload, *errors, result.predictions[-1].identified, rmse


def tracking(scenario):
    """RMSE [mm, deg] of a run after its first second."""
    log = run(scenario, check=False)
    error = (log["pose"] - log["reference"])[log.time > 1.0]
    size = np.sqrt(np.mean(error**2, axis=0))
    return 1e3 * np.linalg.norm(size[3:]), np.degrees(np.linalg.norm(size[:3]))


def drake_row(name, found, other):
    """A row of the second table."""
    trials = [on_drake(name, found, other, 1000 + seed) for seed in range(ON_DRAKE)]
    worst = np.max([trial[:4] for trial in trials], axis=0)
    sizes = np.median([trial[4] for trial in trials], axis=0)
    before, after = (f"{position:.3g}, {rotation:.3g}" for position, rotation in sizes)
    return f"| `{name}` | {percent(worst[0])} | {percent(*worst[1:3])} | {percent(worst[3])} | {before} | {after} |"


def main():
    """Runs the study."""
    table, drake = [], []
    for name in ROBOT_OF:
        found, other = motions(name)
        table.append(study(name, found, other))
        drake.append(drake_row(name, found, other))
    friction = "; ".join(f"`{name}` {each[3]:g} N m and {each[4]:g} N m s/rad" for name, each in ROBOT_OF.items())
    lines = [
        TEXT,
        *header(HEADER),
        *table,
        NOTES.format(robots=ROBOTS, friction=friction),
        DRAKE.format(robots=ON_DRAKE, motions=" or ".join(f"`{each[6]}`" for each in ROBOT_OF.values())).lstrip(),
        *header(DRAKE_HEADER),
        *drake,
    ]
    OUT.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
