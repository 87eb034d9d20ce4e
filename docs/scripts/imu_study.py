"""What an inertial sensor adds to the observer: `python docs/scripts/imu_study.py`, `make results/imu`, five minutes.

Writes docs/results/imu.md. All runs are on the closed form; 100 random robots are those of the tests.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import chi2

from stewart_drake import Controller, load_scenario
from stewart_drake.base.errors import StewartDrakeError
from stewart_drake.mechanics.kinematics import inverse_kinematics, pose_rate_to_twist, reach_margin
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.scenario.stepped_loop import SteppedLoop

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))
from random_robots import random_robot  # noqa: E402

SENSORS: dict[str, dict[str, Any] | None] = {
    "none": None,
    "BMI088": {"preset": "bmi088"},
    "BNO085": {"preset": "bno085"},
    "MPU-6050": {"preset": "mpu6050"},
    "BMI088, 10 ms late": {"preset": "bmi088", "delay": 0.01},
    "BMI088 at 50 Hz": {"preset": "bmi088", "period": 0.02},
}
MOUNTED = {"position": [0.02, -0.01, 0.015], "rotation": [0.3, -0.2, 1.0]}
CORNERS = np.array(list(product((-1.0, 1.0), repeat=6)))  # of the box in which the platform moves
FREQUENCIES = [3.0, 5.0, 4.0, 4.5, 3.5, 5.5]  # [rad/s]
PUSHED = "none", "BMI088", "MPU-6050"
SECONDS, SETTLED = 2.0, 1.0  # [s] of a run, and without its beginning.
PUSH_AT, PUSH = 1.5, 0.1  # [s], and force over the platform's weight.


def scenario_of(robot: RobotParameters, bits: int, period: float, imu: dict[str, Any] | None, seed: int) -> Scenario:
    """A run with a payload of 5 % that nobody knows; the mounting of the sensor is known, its faults are not."""
    size, sensors = robot.characteristic_length, {"kind": "encoders", "resolution_bits": bits, "noise_seed": seed}
    place = [size * x / 0.1 for x in MOUNTED["position"]]
    mounted = None if imu is None else {**MOUNTED, "position": place, "noise_seed": seed, **imu}
    amplitude = np.array([0.08, 0.06, 0.08, 0.06 * size, 0.08 * size, 0.06 * size])
    while reach_margin(robot, robot.home_pose + amplitude * CORNERS).min() < 0.1:
        amplitude *= 0.8
    return Scenario.from_dict({
        "robot": robot.to_dict(),
        "plant": {"kind": "closed_form", "integrator": "rk4", "payload_mass": 0.05 * robot.platform_mass},
        "sensors": {**sensors, "imu": mounted},
        "estimator": "observer",
        "controller": {"kind": "lqi", "period": period},
        "tuner": "fixed",
        "reference": {"kind": "sine", "amplitude": amplitude.tolist(), "angular_frequency": FREQUENCIES},
        "duration": SECONDS,
    })  # fmt: skip


def velocity_error(scenario: Scenario) -> tuple[float, np.ndarray]:
    """RMS error [m/s] of the estimated rate, rotations times the robot's length; the estimated disturbances."""
    loop, robot, step = SteppedLoop(scenario), scenario.robot, scenario.plant.time_step
    weight = np.array([robot.characteristic_length] * 3 + [1.0] * 3)
    every, errors, pushes = round(scenario.controller.period / step), list[np.ndarray](), list[np.ndarray]()
    loop.begin()
    for k in range(round(SECONDS / step)):
        loop.run_parts()
        if k % every == 0:
            seen, true = loop.runner.signal("measurement"), loop.measured
            off = pose_rate_to_twist(seen[:6], seen[6:]) - pose_rate_to_twist(true[:6], true[6:12])
            errors.append(weight * off)
            pushes.append(loop.runner.state("observer")["disturbance"][0].copy())
        loop.move()
    settled = np.array(errors)[round(SETTLED / scenario.controller.period) :]
    return float(np.sqrt(np.square(settled).sum(axis=1).mean())), np.array(pushes)


def ticks_until_felt(scenario: Scenario) -> float:
    """Ticks from a push to an estimated disturbance that is beyond 99.99 % of what it is without one."""
    weight = scenario.robot.platform_mass * scenario.gravity
    wrench = {"kind": "step", "wrench": [0.0, 0.0, 0.0, PUSH * weight, 0.0, -PUSH * weight], "time": PUSH_AT}
    calm = velocity_error(scenario)[1]
    pushed = velocity_error(scenario.replace({"disturbances": [wrench]}))[1]
    tick = round(PUSH_AT / scenario.controller.period)
    noise = calm[tick // 2 :] - calm[tick // 2 :].mean(axis=0)
    against = np.linalg.norm((pushed - calm)[tick:] / noise.std(axis=0), axis=1)
    felt = np.flatnonzero(against > np.sqrt(chi2.ppf(0.9999, 6)))
    return float(felt[0]) if len(felt) else np.inf


def row_of(seed: int, bits: int, period: float) -> dict[str, tuple[float, float]]:
    """Velocity error, and ticks until a push is felt, of one robot by sensor; NaN where it cannot follow."""
    row = {}
    for name, imu in SENSORS.items():
        try:
            scenario = scenario_of(random_robot(seed), bits, period, imu, seed)
            row[name] = velocity_error(scenario)[0], ticks_until_felt(scenario) if name in PUSHED else np.nan
        except StewartDrakeError as error:
            print(seed, name, error)
            row[name] = np.nan, np.nan
    return row


def table_of_robots(count: int, bits: int, period: float, jobs: int) -> list[str]:
    """Medians over random robots."""
    rows = Parallel(n_jobs=jobs)(delayed(row_of)(seed, bits, period) for seed in range(count))
    lines = [
        "| sensor | velocity error | 90 % of the robots | worse than without | ticks until a push is felt |",
        "| --- | --- | --- | --- | --- |",
    ]
    none = np.array([row["none"][0] for row in rows])
    for name in SENSORS:
        values = np.array([row[name] for row in rows])
        ratio, worse = values[:, 0] / none, int((values[:, 0] > 1.02 * none).sum())
        high, felt = np.nanquantile(ratio, 0.9), f"{np.nanmedian(values[:, 1]):.0f}" if name in PUSHED else ""
        lines.append(f"| {name} | {np.nanmedian(ratio):.2f} | {high:.2f} | {worse} | {felt} |")
    lines.append(f"\n{int(np.isfinite(none).sum())} of {count} robots follow the motion without the sensor.\n")
    return lines


def surgical(kind: str, imu: dict[str, Any] | None) -> tuple[float, float]:
    """RMS error [deg], [mm] of the second half of 10 s, as in docs/results/observer.md, with friction in the model."""
    sine = {"kind": "sine", "amplitude": [0.05, 0, 0, 0, 0, 0.01], "angular_frequency": "0.3 Hz"}
    parts = [
        {"kind": "sine", "amplitude": [0, 0, 0, 0.003, 0, 0.005], "angular_frequency": "1.5 Hz"},
        {"kind": "sine", "amplitude": [0, 0, 0, 0, 0, 0.01], "angular_frequency": "0.3 Hz"},
    ]
    scenario = load_scenario("exact_breathing").replace({
        "duration": 10.0,
        "reference": sine if kind == "breathing" else {"kind": "sum", "parts": parts},
        "tuner": {"kind": "block", "q_pose": 8.0e5, "q_rate": 150.0, "q_integral": 5.0e6},
        "estimator": "observer",
        "model.friction": {"coulomb": 0.01},
        "sensors": {"kind": "encoders", "resolution_bits": 17, "noise": 2.0e-5, "imu": imu},
        "command_delay": 1,
        "plant": {"kind": "closed_form", "motor_friction": 0.01},
    })  # fmt: skip
    loop, errors = SteppedLoop(scenario), []
    loop.begin()
    for k in range(round(10.0 / scenario.plant.time_step)):
        loop.run_parts()
        if k >= round(5.0 / scenario.plant.time_step):
            errors.append(loop.pose - loop.runner.signal("reference")[:6])
        loop.move()
    size = np.sqrt(np.square(errors).mean(axis=0).reshape(2, 3).sum(axis=1))
    return float(np.degrees(size[0])), float(1e3 * size[1])


def cost(imu: dict[str, Any] | None, ticks: int = 20_000) -> float:
    """[us] of a step of a controller at rest: the least of ten batches."""
    scenario = scenario_of(load_scenario("exact_fig7").robot, 17, 0.001, imu, 0)
    controller, out = Controller(scenario.replace({"reference": "hold"})), np.empty(6)
    angles = inverse_kinematics(scenario.robot, scenario.robot.home_pose)
    reading = None if imu is None else np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81])
    least = np.inf
    for batch in range(10):
        begun = time.perf_counter()
        for k in range(ticks // 10):
            controller.step(angles, 0.001 * (batch * ticks // 10 + k), out, 0.0, reading)
        least = min(least, time.perf_counter() - begun)
    return 1e6 * least / (ticks // 10)


def main() -> None:
    """Writes the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "imu.md")
    given = parser.parse_args()
    lines = [
        "# What an inertial sensor adds",
        "",
        "An [inertial sensor](../observer.md#an-inertial-sensor) on the platform, and the observer that takes it.",
        "Command: `python docs/scripts/imu_study.py`.",
        "",
        f"Medians of {given.robots} random robots that move in all six axes with a payload of 5 % that nobody knows.",
        "The velocity error is relative to that of the same robot without the sensor. A push, a tenth of the weight",
        "sideways and down, counts as felt when the estimated disturbance is beyond 99.99 % of its noise.",
        "",
    ]
    for bits, period in ((12, 0.01), (17, 0.001)):
        lines += [f"## {bits} bits, {1.0 / period:g} Hz", "", *table_of_robots(given.robots, bits, period, given.jobs)]
    lines += ["## Breathing and heart", "", "The rows of [the observer](observer.md) with friction in the model,", ""]
    lines[-2] += " on the closed form, in mm."
    lines += ["| motion | without | BMI088 | MPU-6050 |", "| --- | --- | --- | --- |"]
    for kind in ("breathing", "heart"):
        errors = [surgical(kind, SENSORS[name])[1] for name in ("none", "BMI088", "MPU-6050")]
        lines.append(f"| {kind} | " + " | ".join(f"{error:.5f}" for error in errors) + " |")
    given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
    print(f"a step of Controller [us]: {cost(None):.1f} without, {cost(SENSORS['BMI088']):.1f} with")


if __name__ == "__main__":
    main()
