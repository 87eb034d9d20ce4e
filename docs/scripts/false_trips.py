"""Healthy readings for the comparison of encoders and inertial sensor: how often does it trip? For `parity_study.py`.

The motion of a minute is periodic and is repeated; noise, offsets and their drift are new all the time.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from joblib import Parallel, delayed

from stewart_drake import load_scenario, run
from stewart_drake.mechanics import kinematics_laws as laws
from stewart_drake.mechanics.kinematics import inverse_kinematics, rotation_matrix
from stewart_drake.safety.parity import ParityState, parity_part, parity_rows
from stewart_drake.scenario.assembly import context_of
from stewart_drake.scenario.scenario import Scenario

BOUND = np.radians(1.0)  # [rad] the default of `safety.parity`.
LENGTH, FINE = 60.0, 4  # [s] of a motion; steps of its grid in a period.
HOMING, MOUNTING, TILT = 0.002, np.radians(0.3), np.radians(1.0)  # [rad] standard deviations; largest tilt of the base
MOUNTED = {"position": [0.02, -0.01, 0.015], "rotation": [0.3, -0.2, 1.0]}
PRESETS = ("bmi088", "bno085", "mpu6050")


class Kind(NamedTuple):
    """A robot with a bus, and how many motions it gets, each for some time [s]."""

    title: str
    scenario: str
    period: float  # [s]
    bits: int
    motions: int
    time: float = 1000.0


KINDS = (
    Kind("paper's robot, 100 Hz", "exact_breathing", 0.01, 17, 300),
    Kind("paper's robot, 1 kHz", "exact_breathing", 0.001, 17, 50, 240.0),
    Kind("Reachy Mini, 100 Hz", "reachy_nod", 0.01, 12, 240),
    Kind("Reachy Mini, 50 Hz", "reachy_nod", 0.02, 12, 448),
)


class Minute(NamedTuple):
    """True readings of a minute, (n, 6) each."""

    angles: np.ndarray
    imu: np.ndarray
    reference: np.ndarray


def skewed(rotations: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) [rad] of small rotations (n, 3, 3)."""
    return 0.5 * np.stack([rotations[:, i, k] - rotations[:, k, i] for i, k in ((2, 1), (0, 2), (1, 0))], axis=1)


def minute(
    scenario: Scenario, period: float, rng: np.random.Generator, still: bool = False, base: np.ndarray | None = None
) -> Minute:
    """A random motion with blows; `base` (n FINE, 3) [m] moves the base, which nobody knows."""
    robot, count = scenario.robot, FINE * round(LENGTH / period)
    time, h = np.arange(count) * period / FINE, period / FINE
    pose, size = np.tile(robot.home_pose, (count, 1)), robot.characteristic_length
    largest = np.array([0.15, 0.15, 0.2, *(0.06 * size,) * 3]) * (0.0 if still else rng.uniform(0.0, 1.0))
    for turns in rng.integers(2, 60, size=4):
        amplitude = largest * rng.normal(size=6) * min(1.0, 20.0 / turns) / 4.0
        pose += amplitude * np.sin(2 * np.pi * turns * time[:, None] / LENGTH + rng.uniform(0.0, 6.3, size=6))
    for start in rng.uniform(5.0, 50.0, size=4):  # A blow: an oscillation that the loop takes back.
        after, scale = np.maximum(0.0, time - start), np.array([0.01, 0.01, 0.01, *(0.01 * size,) * 3])
        bump = after**2 * np.exp(-after * rng.uniform(8.0, 20.0)) * np.sin(2 * np.pi * rng.uniform(1.0, 5.0) * after)
        pose += scale * rng.normal(size=6) * (bump / np.abs(bump).max())[:, None]
    turn = rotation_matrix(pose[:, :3])
    at = pose[:, 3:] + turn @ MOUNTED["position"] + (0.0 if base is None else base)
    velocity = (np.roll(at, -1, axis=0) - np.roll(at, 1, axis=0)) / (2 * h)
    now = np.arange(0, count, FINE)
    force = (velocity[now] - velocity[now - FINE]) / period
    lean = rng.uniform(-TILT, TILT, size=2)
    force -= rotation_matrix(np.array([*lean, 0.0])) @ [0.0, 0.0, -9.81]
    axes = turn @ rotation_matrix(np.array(MOUNTED["rotation"]) + rng.normal(size=3) * MOUNTING)
    steps = [skewed(np.swapaxes(axes[now - k - 1], 1, 2) @ axes[now - k]) for k in range(FINE)]
    imu = np.hstack([sum(steps) / period, np.einsum("nij,ni->nj", axes[now - FINE // 2], force)])
    reference = np.hstack([pose[now], np.zeros((len(now), 12))])
    return Minute(inverse_kinematics(robot, pose[now]), imu, reference)


def scenario_of(kind: Kind, preset: str) -> Scenario:
    """The scenario with this bus and this sensor."""
    imu = {"preset": preset, **MOUNTED}
    return load_scenario(kind.scenario).replace(
        {"sensors": {"kind": "encoders", "resolution_bits": kind.bits, "imu": imu}, "controller.period": kind.period}
    )


def trips(scenario: Scenario, kind: Kind, motion: Minute, time: float, rng: np.random.Generator) -> float:
    """[s] from the start to a trip; infinite for none."""
    options, context = scenario.sensors.imu.nominal, context_of(scenario)._replace(period=kind.period)
    params = parity_part(context, options, BOUND).parameters["params"]
    robot, legs, state = laws.robot_record(scenario.robot), laws.Legs.empty(), ParityState.new(parity=[0.0, -1.0])
    offset, count = options.by_channel("bias") * rng.normal(size=6), len(motion.angles)
    scale = 1.0 + options.scale_error * rng.normal(size=6)
    homing, step = HOMING * rng.normal(size=6), 2 * np.pi / 2**kind.bits
    out, drift = np.empty((count, 3)), options.by_channel("drift") * np.sqrt(kind.period)
    for number in range(max(1, round(time / LENGTH))):
        offsets = offset + np.cumsum(drift * rng.standard_normal((count, 6)), axis=0)
        offset = offsets[-1]
        imu = scale * motion.imu + offsets + options.noise(kind.period) * rng.standard_normal((count, 6))
        imu = np.clip(
            np.rint(imu / options.quantum) * options.quantum, -options.by_channel("range"), options.by_channel("range")
        )
        angles = np.rint((motion.angles + homing) / step) * step
        row = parity_rows(robot, params, angles, imu, motion.reference, legs, state, out)
        if row >= 0:
            return number * LENGTH + row * kind.period
    return float("inf")


def one(number: int, kind: Kind, index: int) -> tuple[float, float]:
    """[s] of a motion that were run, and until its trip."""
    rng = np.random.default_rng([7, index, number])
    scenario = scenario_of(kind, PRESETS[number % len(PRESETS)])
    motion = minute(scenario, kind.period, rng, still=number % 4 == 0)
    return max(LENGTH, round(kind.time / LENGTH) * LENGTH), trips(scenario, kind, motion, kind.time, rng)


def kernel_rows(share: float, jobs: int) -> list[list[str]]:
    """Of the kinds: their time, motions and trips, for a share of the motions."""
    rows = []
    for index, kind in enumerate(KINDS):
        motions = max(1, round(share * kind.motions))
        found = Parallel(n_jobs=jobs)(delayed(one)(number, kind, index) for number in range(motions))
        tripped = [(number, when) for number, (_, when) in enumerate(found) if np.isfinite(when)]
        rows.append([f"readings: {kind.title}", f"{sum(t for t, _ in found):.3g}", str(motions), str(len(tripped))])
        print(rows[-1], tripped[:10], flush=True)
    return rows


LOOPS: Mapping[str, tuple[str, dict[str, Any], int]] = {
    "paper's robot, 1 kHz": ("exact_breathing", {"plant": "closed_form"}, 20),
    "Reachy Mini, 100 Hz": ("reachy_nod", {}, 40),
    "Reachy Mini, 50 Hz": ("reachy_look_around", {"controller.period": 0.02}, 40),
}


def loop(number: int, name: str, changes: dict[str, Any], time: float) -> str:
    """The monitor of a healthy loop with a push, a payload and a wrong friction; empty for none."""
    rng, scenario = np.random.default_rng([8, number]), load_scenario(name)
    plant = {
        "kind": "closed_form",
        **{key: scenario.plant.to_dict()[key] for key in ("motor_damping", "motor_friction")},
    }
    weight = 9.81 * scenario.robot.platform_mass
    force = (0.1 * weight * rng.normal(size=3)).tolist()
    push = {
        "kind": "step",
        "time": 3.0,
        "until": 4.0,
        "wrench": [0, 0, 0, *force],
    }
    load = {"kind": "constant", "wrench": [0, 0, 0, 0, 0, -0.2 * weight * rng.uniform()]}
    plant["motor_friction"] *= rng.uniform(0.7, 1.2)
    sensors = {**scenario.sensors.to_dict(), "kind": "encoders"}
    sensors["imu"] = {"preset": PRESETS[number % 3], **MOUNTED, "noise_seed": number}
    given = {**changes, "plant": plant, "disturbances": [push, load], "sensors": sensors, "safety": {}}
    log = run(scenario.replace({**given, "duration": time}), check=False)
    return "" if log.safety is None else str(log.safety["monitor"])


def loop_rows(share: float, jobs: int, time: float = 30.0) -> list[list[str]]:
    """The same for complete loops."""
    rows = []
    for title, (name, changes, count) in LOOPS.items():
        runs = max(1, round(share * count))
        found = Parallel(n_jobs=jobs)(delayed(loop)(number, name, changes, time) for number in range(runs))
        seen = [(number, monitor) for number, monitor in enumerate(found) if monitor]
        parity = sum(monitor == "parity" for _, monitor in seen)
        rows.append([f"loops: {title}", f"{runs * time:.3g}", str(runs), str(parity)])
        print(rows[-1], seen[:10], flush=True)
    return rows


def shaken(frequency: float, kind: Kind = KINDS[0]) -> float:
    """[m] largest amplitude of the base along x that does not trip in a minute at rest."""
    scenario, low, high = scenario_of(kind, "bmi088"), 0.0, 20.0 / (2 * np.pi * frequency) ** 2
    time = np.arange(FINE * round(LENGTH / kind.period)) * kind.period / FINE
    while high - low > 0.05 * high:
        middle = 0.5 * (low + high)
        base = np.outer(np.sin(2 * np.pi * frequency * time), [middle, 0.0, 0.0])
        rng = np.random.default_rng(9)
        motion = minute(scenario, kind.period, rng, True, base)
        low, high = (middle, high) if np.isinf(trips(scenario, kind, motion, LENGTH, rng)) else (low, middle)
    return low


def shaken_rows() -> list[list[str]]:
    """The largest motion of the base by frequency."""
    rows = []
    for frequency in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0):
        size = shaken(frequency)
        rows.append([f"{frequency:g}", f"{1e3 * size:.2g}", f"{size * (2 * np.pi * frequency) ** 2:.2g}"])
        print(rows[-1], flush=True)
    return rows
