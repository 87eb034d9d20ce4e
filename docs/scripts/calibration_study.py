"""Measures what a calibration is worth, and writes docs/results/calibration.md: `make results/calibration`.

For each setting: robots that are off in every parameter, 60 measured poses, other poses to assess it by. Then robots
with hobby servos, by instruments from a tracker to a printed jig.
"""

import time
from pathlib import Path

import numpy as np
from simulated_calibration import change_to, coverage, deviating, gains, measured, placed, run_trial

from stewart_drake.base.markdown import markdown_table
from stewart_drake.estimation.calibration import calibrate
from stewart_drake.estimation.geometry import (
    FITS,
    FRAMES,
    GAIN,
    HOMING,
    KINDS,
    LEG_PARAMETERS,
    OF_ROBOT,
    PER_LEG,
    difference,
    exponential,
    table_names,
    transform,
    transform_of,
)
from stewart_drake.estimation.poses import INSTRUMENTS, MeasurementNoise, Measurements, candidate_poses, plan_poses
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.scenario.scenario import load_scenario

OUT = Path(__file__).parents[1] / "results" / "calibration.md"
ROBOTS = 100
POSES = UNSEEN = 60
SETTINGS = (
    ("paper", "planned", ()),
    ("paper", "at random", ()),
    ("paper", "planned", FRAMES),
    ("servo_hexapod", "planned", ()),
    ("reachy_mini", "planned", ()),
)
SHOWN = (0, 1, 4)
"""Settings with a column of widths."""
NOISE = MeasurementNoise(position=2e-5, rotation=1e-4)
SERVO_ROBOTS, SERVO_POSES = 20, {"jig": 5}
"""Robots a row of the second table, and poses where there are not 40."""
OFFSET, GAIN_ERROR = np.radians(2.0), 0.05
TEXT = """# What a calibration is worth

How exactly does `calibrate` find a robot's geometry, and how far off is the robot then?
Command: `make results/calibration`.

{table}

- {robots} robots a row, off by up to ±1 mm and ±1 mrad (uniform) in each of their {numbers} parameters, are
  calibrated from {poses} poses and tested at {unseen} others: RMS, medians over the robots. The last column is the
  share of the 95 % intervals that hold the truth: over all parameters, and from the least to the most of a kind.
- The tracker has noise of 0.02 mm and 0.1 mrad per coordinate, the encoders have 17 bits.
- *Estimated* frames: the positions of the tracker and of its marker are unknown, and fitted with the geometry. That
  hides a good part of the error before.

Half widths of the 95 % intervals with estimated frames, medians over legs and robots:

{widths}

## Hobby servos, and instruments that people have

{servos}

- {servo_robots} robots a row, `servo_hexapod` with servos off by up to ±2 deg and ±5 % of their angle (uniform);
  with tracker and camera its geometry is off by ±1 mm and ±1 mrad too, otherwise it is as drawn. 40 planned poses, of a
  jig 5 heights.
- Noise: `tracker` 0.02 mm and 0.1 mrad, `camera` 0.5 mm and 5 mrad, `imu` and `tilt` 0.5 deg, `level` 0.1 deg, `jig`
  0.2 mm and 2 mrad. Frames of tracker, camera, IMU and tilt sensor are unknown.
- *Chosen*: by the data, and how often. The pose error is that of {unseen} other poses (RMS, median over the robots),
  the errors of offsets and gains are RMS over legs and robots.
"""
SERVO_HEADER = (
    "instrument",
    "fitted",
    "pose error before [mm], [deg]",
    "after [mm], [deg]",
    "homing offsets [deg]",
    "servo gains [%]",
)
HEADER = (
    "robot",
    "poses",
    "frames",
    "before [mm], [mrad]",
    "after [mm], [mrad]",
    "times smaller: median",
    "worst robot",
    "intervals that hold the truth",
)


def poses(robot, limits, seed):
    """As many poses at random within the limits."""
    pose = candidate_poses(robot, POSES, limits, np.random.default_rng(seed))
    return Measurements(pose, inverse_kinematics(robot, pose))


def rows():
    """A row of the first table for each setting, and the coverage and the widths of each."""
    for name, kind, known in SETTINGS:
        robot, limits = load_robot(name), load_scenario("paper_fig7", [f"robot={name}"]).limits
        start = time.process_time()
        planned = (
            plan_poses(robot, POSES, limits, NOISE, known).targets if kind == "planned" else poses(robot, limits, 1)
        )
        unseen = poses(robot, limits, 2)
        trials = [run_trial(robot, planned, unseen, NOISE, seed, known, "geometry") for seed in range(ROBOTS)]
        before, after = (np.median([getattr(t, when) for t in trials], axis=0) for when in ("before", "after"))
        gain, inside = gains(trials), coverage(trials)
        widths = np.median([t.width for t in trials], axis=(0, 1))
        print(name, kind, known, gain.min(axis=0), inside["all"], f"{time.process_time() - start:.0f} s", flush=True)
        frames = "known" if known else "estimated"
        errors = [f"{1e3 * e[0]:.3f}, {1e3 * e[1]:.2f}" for e in (before, after)]
        least = ", ".join(f"{g:.0f}" for g in gain.min(axis=0))
        middle = ", ".join(f"{g:.0f}" for g in np.median(gain, axis=0))
        kinds = [value for key, value in inside.items() if key != "all"]
        share = f"{100 * inside['all']:.1f} % ({100 * min(kinds):.1f} to {100 * max(kinds):.1f} %)"
        yield (f"`{name}`", kind, frames, *errors, middle, least, share), widths


def planned_with(name, robot, limits):
    """Poses to measure with an instrument."""
    used = INSTRUMENTS[name]
    hold = set(KINDS) - set(FITS[used.fit])
    count = SERVO_POSES.get(name, 40)
    return plan_poses(robot, count, limits, used.noise, used.known_frames, hold, instrument=used).targets


def without_tracker(name, robot, targets, unseen, seed):
    """Errors before and after a calibration, those of the parameters, and what was fitted."""
    used, rng = INSTRUMENTS[name], np.random.default_rng(seed)
    truth = deviating(robot, rng, 0.0, 0.0, OFFSET, GAIN_ERROR)
    if used.known_frames:
        poses = placed(truth, targets, used.noise, rng)
    else:
        heading = transform(exponential(np.array([0.0, 0.0, rng.uniform(-2.0, 2.0)])), np.zeros(3))
        mounting = transform(exponential(rng.uniform(-1.0, 1.0, 3)), np.zeros(3))
        poses = measured(truth, targets, used.noise, rng, heading, mounting)
    found = calibrate(robot, poses.only(used.measured), used.noise, used.known_frames)
    right = transform_of(forward_kinematics(truth, truth.servo_gains * unseen.angles, unseen.pose))
    errors = []
    for one in (robot, found.robot):
        there = transform_of(forward_kinematics(one, one.servo_gains * unseen.angles, unseen.pose))
        off = np.sqrt(np.mean(difference(right, there) ** 2, axis=0))
        errors.append((np.linalg.norm(off[3:]), np.linalg.norm(off[:3])))
    return *errors, (found.change - change_to(robot, truth))[:OF_ROBOT].reshape(-1, PER_LEG), found.fit


def servo_rows():
    """Rows of the second table."""
    robot = load_robot("servo_hexapod")
    limits = load_scenario("paper_fig7", ["robot=servo_hexapod"]).limits
    unseen = poses(robot, limits, 2)
    for name, used in INSTRUMENTS.items():
        targets, start = planned_with(name, robot, limits), time.process_time()
        for fit in ("geometry", None) if used.fit == "all" or name == "camera" else (None,):
            if name in ("tracker", "camera"):
                trials = [
                    run_trial(robot, targets, unseen, used.noise, seed, (), fit, OFFSET, GAIN_ERROR)
                    for seed in range(SERVO_ROBOTS)
                ]
                results = [(t.before, t.after, t.off, t.fit) for t in trials]
            else:
                results = [without_tracker(name, robot, targets, unseen, seed) for seed in range(SERVO_ROBOTS)]
            before, after, off, fits = zip(*results, strict=True)
            counts = [f"{fits.count(each)} {each}" for each in FITS if each in fits]
            fitted = fit or f"chosen: {', '.join(counts)}"
            off = np.sqrt(np.mean(np.square(off), axis=(0, 1)))
            errors = [np.median(e, axis=0) * [1e3, np.degrees(1.0)] for e in (before, after)]
            row = (f"`{name}`", fitted, *(f"{e[0]:.3f}, {e[1]:.3f}" for e in errors))
            yield (*row, f"{np.degrees(off[HOMING]):.2f}", f"{1e2 * off[GAIN]:.2f}")
            print(*row, off[HOMING], off[GAIN], f"{time.process_time() - start:.0f} s", flush=True)


def main():
    """Runs the study."""
    servos = markdown_table(SERVO_HEADER, list(servo_rows()))
    table, widths = zip(*rows(), strict=True)
    # Of the paper's robot by planned and by random poses, and of Reachy Mini, with frames that are estimated.
    columns = [f"`{SETTINGS[at][0]}`, {SETTINGS[at][1]}" for at in SHOWN]
    rows_of_widths = [
        (name, *(f"{LEG_PARAMETERS[place].display[1] * widths[at][place]:.3f}" for at in SHOWN))
        for place, name in enumerate(table_names()[:GAIN])
    ]
    text = TEXT.format(
        robots=ROBOTS,
        numbers=6 * GAIN,
        poses=POSES,
        unseen=UNSEEN,
        table=markdown_table(HEADER, table),
        widths=markdown_table(("", *columns), rows_of_widths),
        servos=servos,
        servo_robots=SERVO_ROBOTS,
    )
    OUT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
