"""Going on with five encoders and an inertial sensor, docs/results/lost_encoder.md: `make results/lost_encoder`."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from stewart_drake import RobotParameters, Scenario, load_robot, load_scenario
from stewart_drake.base.errors import RunFailure, UnreachablePoseError
from stewart_drake.base.markdown import markdown_table
from stewart_drake.mechanics.kinematics import rotation_angle, rotation_matrix, twist_jacobian
from stewart_drake.scenario.stepped_loop import SteppedLoop

PAGE = Path(__file__).parents[1] / "results" / "lost_encoder.md"
ONSET, LEG, LONG = 2.0, 2, 60.0  # [s], [s]
IMU = {"preset": "bmi088"}
PAPER = {"plant": "closed_form", "safety": {}, "estimator": "observer"}
SENSORS = {"kind": "encoders", "resolution_bits": 17, "noise": 2e-5, "imu": IMU}
FRICTION = {"kind": "closed_form", "motor_damping": 0.095, "motor_friction": 0.058}
MINI = {"plant": FRICTION, "safety": {}, "sensors.imu": IMU}
SETUPS = {
    "paper, breathing": ("exact_breathing", {**PAPER, "sensors": SENSORS}),
    "paper, at rest": ("exact_breathing", {**PAPER, "sensors": SENSORS, "reference": {"kind": "hold"}}),
    "paper, Fig. 7": ("exact_fig7", {**PAPER, "sensors": SENSORS}),
    "paper, breathing, sensor 3 ms late": (
        "exact_breathing",
        {**PAPER, "sensors": SENSORS, "sensors.imu.delay": 0.003},
    ),
    "paper, breathing, MPU-6050 200 Hz, 5 ms late": (
        "exact_breathing",
        {**PAPER, "sensors": {**SENSORS, "imu": {"preset": "mpu6050", "period": 0.005, "delay": 0.005}}},
    ),
    "Reachy Mini, 100 Hz": ("reachy_nod", MINI),
    "Reachy Mini, 100 Hz, sensor 50 Hz": ("reachy_nod", {**MINI, "sensors.imu.period": 0.02}),
    "Reachy Mini, 50 Hz": (
        "reachy_nod",
        {**MINI, "controller.period": 0.02, "reference.motion.angular_frequency": 3.1416},
    ),
}
FAULTS = {
    "drifts by 0.3 rad/s": {"kind": "drift", "size": 0.3},
    "drifts by 0.01 rad/s": {"kind": "drift", "size": 0.01},
    "freezes": {"kind": "freeze"},
    "gives no number": {"kind": "nan"},
    "jumps by 0.1 rad": {"kind": "jump", "size": 0.1},
}
ROBOTS, POSES, TILT = ("paper", "reachy_mini", "servo_hexapod"), 200, np.radians(0.3)
TEXT = """# One encoder lost: held, or led home, on the five others

Encoder {leg} is wrong from {onset:g} s on. How far does the robot go before it is at rest, and while it is held on five
encoders and an inertial sensor (BMI088) on the platform? Command: `make results/lost_encoder`.

{runs}

- *Found*: the monitor, and the time after the onset. A crank whose encoder
  freezes at rest is no longer held: it creeps until the tilt shows it.
- *To rest*, *held*: farthest true pose from the reference, which comes to rest in 0.1 s; then for {long:g} s
  (`safety: {{on_lost_encoder: hold, safe_hold_time: {long:g}}}`). *To rest* includes what the motion is off without a
  fault, {healthy}.
- *Home in*: from the fault found to rest at home with `on_lost_encoder: home`; and how far from home it then is.
- The later a sensor, the slower the observer is made while an encoder is lost. *Not held*: the sensor is too late for
  a loop at 1 kHz, and a second monitor stops the robot; or torques alone showed the fault.

How well do five encoders and an orientation know the sixth crank? {poses} random poses, up to 20 deg about each axis
and 0.2 characteristic lengths along it, any of the six legs; the orientation is off by 0.3 deg, or its tilt alone is
known.

{map}

- *Orientation*: error of the crank (median, largest), and of the platform. *Tilt alone*: after minutes, when the
  gyroscopes no longer tell the turn around gravity; here the five encoders' part of it is not used.
"""


class Held(NamedTuple):
    """A run after its fault."""

    found: str
    to_rest: tuple[float, float]  # [deg], [mm]
    held: tuple[float, float]
    home_in: float  # [s]
    off_home: tuple[float, float]
    failure: str


def apart(pose: np.ndarray, other: np.ndarray) -> np.ndarray:
    """[deg], [mm] between two poses."""
    turn = rotation_matrix(pose[:3]).T @ rotation_matrix(other[:3])
    return np.array([np.degrees(rotation_angle(turn)), 1e3 * np.linalg.norm(pose[3:6] - other[3:6])])


def after(scenario: Scenario) -> Held:
    """Runs a scenario to its end."""
    loop, failure, at_rest, found = SteppedLoop(scenario), "", -1.0, -1.0
    wanted, safety = loop.runner.signal("used_reference"), loop.runner.signal("safety")
    to_rest, held = np.zeros(2), np.zeros(2)
    loop.begin()
    while loop.time < scenario.duration and not failure:
        try:
            loop.run_parts()
            loop.move()
        except RunFailure as stop:
            failure = str(stop)
        if found < 0.0 and safety[0] >= 2.0:
            found = loop.time
        if safety[0] < 3.0:
            at_rest = -1.0
        elif at_rest < 0.0:
            at_rest = loop.time
        if loop.time > ONSET and loop.now % 5 == 0:
            far = apart(wanted, loop.pose)
            # The replaced reading is the true one 0.3 s after the fault.
            if found < 0.0 or loop.time < found + 0.4:
                to_rest = np.maximum(to_rest, far)
            else:
                held = np.maximum(held, far)
    name = scenario.safety.monitor_names[int(safety[1])] if found > 0.0 else "none"
    text = f"{name}, {found - ONSET:.2f} s" if found > 0.0 else "-"
    off = apart(loop.pose, scenario.robot.home_pose)
    return Held(text, tuple(to_rest), tuple(held), at_rest - found, tuple(off), failure)


def row(setup: str, fault: str) -> list[str]:
    """A row of the first table."""
    name, changes = SETUPS[setup]
    cells = []
    for reaction, hold in (("hold", LONG), ("home", 1.0)):
        keys = {"safety.on_lost_encoder": reaction, "safety.safe_hold_time": hold, "duration": ONSET + hold + 40.0}
        keys["sensors.faults"] = [{**FAULTS[fault], "time": ONSET, "leg": LEG}]
        held = after(load_scenario(name).replace({**changes, **keys}))
        pair = "{:.2g} deg, {:.2g} mm".format
        went_on = "five encoders" in held.failure
        if reaction == "hold":
            cells += [
                held.found,
                pair(*held.to_rest),
                pair(*held.held) if went_on else "not held",
            ]
        else:
            cells.append(f"{held.home_in:.1f} s; {pair(*held.off_home)}" if went_on else "-")
    return [setup, fault, *cells]


def errors(robot: RobotParameters) -> list[str]:
    """What an orientation leaves unknown, at random poses."""
    random, found = np.random.default_rng(0), []
    box = np.repeat([0.35, 0.2 * robot.characteristic_length], 3)
    while len(found) < POSES:
        pose = robot.home_pose + random.uniform(-1.0, 1.0, 6) * box
        try:
            found.append(np.linalg.inv(twist_jacobian(robot, pose)))  # Twists of the platform, per radian of a crank.
        except UnreachablePoseError:
            continue
    twists = np.array(found)
    crank = TILT / np.linalg.norm(twists[:, :3], axis=1)
    by_tilt = TILT / np.linalg.norm(twists[:, :2], axis=1)
    travel = 1e3 * np.linalg.norm(twists[:, 3:], axis=1)
    pair = lambda values, unit: f"{np.median(values):.2g}, {values.max():.2g} {unit}"  # noqa: E731
    return [
        pair(crank, "rad"),
        pair(crank * travel, "mm"),
        f"{100.0 * np.mean(crank < 0.01):.0f} %",
        pair(by_tilt, "rad"),
        pair(by_tilt * travel, "mm"),
    ]


def main() -> None:
    """Runs, and writes the page."""
    rows = []
    for setup in SETUPS:
        for fault in FAULTS:
            rows.append(row(setup, fault))
            print(rows[-1], flush=True)
    name, changes = SETUPS["Reachy Mini, 100 Hz"]
    healthy = after(load_scenario(name).replace({**changes, "duration": 8.0})).to_rest
    head = ["robot, motion", f"encoder {LEG}", "found", "to rest", f"held {LONG:g} s", "home in"]
    heads = ["robot", "crank", "platform", "crank within 0.01 rad", "tilt alone: crank", "platform"]
    known = markdown_table(heads, [[name, *errors(load_robot(name))] for name in ROBOTS])
    words = {"leg": LEG, "onset": ONSET, "long": LONG, "poses": POSES, "runs": markdown_table(head, rows).strip()}
    off = f"{healthy[0]:.2g} deg on Reachy Mini at 100 Hz"
    PAGE.write_text(TEXT.format(**words, map=known.strip(), healthy=off), encoding="utf-8")


if __name__ == "__main__":
    main()
