"""What makes a live loop an instrument: sliders of keys, a spring to pull with, tests, a record of what was done."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.analysis.response import sine_response, step_figures
from stewart_drake.base.atomic_files import write_together
from stewart_drake.base.config import Section
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import COORDINATES, POSE, numbers_to_csv
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.rows import Rows, side_by_side
from stewart_drake.logs.signals import DISPLAY_UNITS, SCALES
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import pose_jacobian, rotation_matrix
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.scenario import Scenario

_PULL = 0.15, 0.2  # [-] of the characteristic length, where the spring has its largest force, as a share of `largest`.
_TURN = 0.3  # [rad] at which a spring that turns has its largest moment, the same share of `largest`.
_WATCHED = 2.0  # [s] of a step.
_PERIODS = 3  # Of a sine, after one that is left out.
_RECORDED, _EVERY = 120.0, 0.001  # [s] that a recorder keeps, and between two of its rows.


# --- sliders of keys ---


class Slider(NamedTuple):
    """A key that a slider sets: where it stands, what the panel calls it, and its range."""

    group: str
    key: str
    label: str
    unit: str
    low: float
    high: float
    logarithmic: bool = False
    whole: bool = False


def for_live_page(scenario: Scenario) -> Scenario:
    """The scenario with its gains and beliefs said: else they would follow where a slider changes the machine."""
    said = {name: getattr(scenario, name).to_dict() for name in ("controller", "tuner", "estimator")}
    said |= {"model.delay": scenario.belief.delay, "model.reading_age": scenario.belief.reading_age}
    if scenario.motors.knobs and scenario.model.motors is None:
        said["model.motors"] = scenario.belief.motors.to_dict()
    return scenario.replace(said)


_SPREAD, _MOTORS_SPREAD = 10.0**1.5, 10.0**0.5  # Of a slider's ends, from where it began.


def knobs_of(scenario: Scenario, begun: Scenario) -> list[Slider]:
    """The sliders of a scenario as it is now; gains go around where they began."""
    found: list[Slider] = []

    def around(group: str, place: str, options: Section, first: Section, spread: float) -> None:
        if getattr(first, "kind", "") != getattr(options, "kind", ""):
            first = options
        for key, label in options.knobs:
            if (centre := float(np.max(getattr(first, key)))) > 0.0:
                ends = centre / spread, centre * spread
                found.append(Slider(group, f"{place}.{key}", label, options.unit_of(key), *ends, logarithmic=True))

    tuner = ("tuner",) if scenario.controller.weighted else ()
    for name in ("controller", *tuner, "estimator"):
        around("Gains", name, getattr(scenario, name), getattr(begun, name), _SPREAD)
    most = 0.2 * float(scenario.robot.effort_limits.min())
    found.append(Slider("Machine", "plant.motor_friction", "friction", "N m", 0.0, most))
    found.append(Slider("Machine", "command_delay", "delay", "ticks", 0, 8, whole=True))
    found.append(Slider("Belief", "model.friction.coulomb", "friction", "N m", 0.0, most))
    found.append(Slider("Belief", "model.delay", "delay", "ticks", 0, 8, whole=True))
    around("Machine", "motors", scenario.motors, begun.motors, _MOTORS_SPREAD)
    if scenario.model.motors is not None:
        around("Belief", "model.motors", scenario.model.motors, begun.motors, _MOTORS_SPREAD)
    return found


def knob_value(scenario: Scenario, knob: Slider) -> float:
    """Where a slider stands; of six motors the largest, and 0 where the section is not there."""
    value: Any = scenario
    for name in knob.key.split("."):
        value = getattr(value, name, 0.0)
    return float(np.max(value))


def changes_of_slider(scenario: Scenario, knob: Slider, value: float) -> dict[str, Any]:
    """What to change in the scenario where a slider goes to a value, which its range bounds."""
    value = min(max(value, knob.low), knob.high)
    if knob.key.startswith("model.friction.") and scenario.model.friction is None:
        return {"model.friction": {"coulomb": value}}
    return {knob.key: round(value) if knob.whole else value}


# --- springs ---


class Spring(NamedTuple):
    """Pulls a point of the platform, (3,) [m] in P, towards a place (3,) [m] in B; the force has a largest size [N]."""

    point: np.ndarray
    place: np.ndarray
    most: float
    length: float  # [m] at which it has its largest force.

    def force(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place (3,) [m] of the point, and the force (3,) [N] there, in B."""
        at = pose[3:] + rotation_matrix(pose[:3]) @ self.point
        return at, _stretched(self.place - at, self.length, self.most)

    def wrench(self, pose: np.ndarray) -> np.ndarray:
        """(6,) [N m, N] about P, in B."""
        at, force = self.force(pose)
        return np.concatenate([np.cross(at - pose[3:], force), force])


class TurningSpring(NamedTuple):
    """Turns the platform from how it was held, R_BP (3, 3), to another orientation, (3, 3), with a pure moment."""

    held: np.ndarray
    wanted: np.ndarray
    most: float  # [N m] of the moment.

    def moment(self, pose: np.ndarray) -> np.ndarray:
        """(3,) [N m] in B."""
        off = self.wanted @ rotation_matrix(pose[:3]).T
        way = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
        sine = float(np.linalg.norm(way))
        angle = math.atan2(sine, 0.5 * (off[0, 0] + off[1, 1] + off[2, 2] - 1.0))
        return _stretched(way * (angle / sine if sine else 1.0), _TURN, self.most)

    def wrench(self, pose: np.ndarray) -> np.ndarray:
        """(6,) [N m, N] about P, in B."""
        return np.concatenate([self.moment(pose), np.zeros(3)])


def _stretched(way: np.ndarray, length: float, most: float) -> np.ndarray:
    """Force (3,) of a spring along a way (3,), in proportion to it up to a length."""
    size = float(np.linalg.norm(way))
    return np.asarray(way * (most / length) * min(1.0, length / size if size else 1.0))


def spring(robot: RobotParameters, gravity: float, point: np.ndarray, place: np.ndarray) -> Spring:
    """A spring with which a hand can play without tripping the safety layer."""
    stretch, share = _PULL
    return Spring(point, place, share * largest(robot, gravity, FORCE), stretch * robot.characteristic_length)


def turning_spring(robot: RobotParameters, gravity: float, held: np.ndarray, turn: np.ndarray) -> TurningSpring:
    """The same, which turns by a rotation vector (3,) [rad] in B."""
    wanted = Rotation.from_rotvec(turn).as_matrix() @ held
    return TurningSpring(held, wanted, _PULL[1] * largest(robot, gravity, MOMENT))


MOMENT, FORCE = slice(0, 3), slice(3, 6)  # Of a wrench.


def largest(robot: RobotParameters, gravity: float, axes: slice) -> float:
    """`MOMENT` [N m] or `FORCE` [N] along one axis at home for which motors have room, half of it left; two digits."""
    holds = static_torque(robot, robot.home_pose, gravity)
    per_unit = np.linalg.inv(pose_jacobian(robot, robot.home_pose)).T[:, axes]
    room = (robot.effort_limits - np.abs(holds))[:, None] / np.maximum(np.abs(per_unit), 1e-12)
    return float(f"{max(0.5 * float(room.min(axis=0).max()), 1e-3):.2g}")


# --- tests: a step, a sine ---


class AddedMotion:
    """A step or a sine that is added to the reference of one coordinate, and what the loop made of it.

    `result` is a sentence once it is over.
    """

    def __init__(self, kind: str, axis: int, size: float, frequency: float, start: float) -> None:
        self.kind, self.axis, self.size, self.start = kind, axis, size, start
        self.frequency = 2.0 * math.pi * frequency
        self.duration = _WATCHED if kind == "step" else (_PERIODS + 1) / frequency
        self.times: list[float] = []
        self.values: list[float] = []
        self.result = ""

    def added(self, time: float) -> np.ndarray:
        """Pose, rate and acceleration (18,) that it adds at a time [s]; of a step only the pose."""
        out, t = np.zeros(18), time - self.start
        if not 0.0 <= t <= self.duration:
            return out
        if self.kind == "step":
            out[self.axis] = self.size
            return out
        w = self.frequency
        # Over the first quarter of a period it grows, with a rate and an acceleration of its own left out.
        share = min(1.0, 4.0 * t * w / (2.0 * math.pi))
        out[self.axis] = share * self.size * math.sin(w * t)
        out[6 + self.axis] = share * self.size * w * math.cos(w * t)
        out[12 + self.axis] = -share * self.size * w * w * math.sin(w * t)
        return out

    def watch(self, time: float, pose: np.ndarray, rest: float) -> None:
        """Notes a pose (6,); `rest` is what is wanted of the coordinate without the test."""
        if self.result or time < self.start:
            return
        self.times.append(time - self.start)
        self.values.append((float(pose[self.axis]) - rest) / self.size)
        if time - self.start >= self.duration:
            self.result = self._sentence()

    def _sentence(self) -> str:
        t, y = np.array(self.times), np.array(self.values)
        size = f"{SCALES[self.axis] * self.size:.2g} {DISPLAY_UNITS[self.axis]}"
        what = f"{self.kind} of {COORDINATES[self.axis]}, {size}"
        if self.kind == "step":
            found = step_figures(t, y)
            rise, settling = (
                f"{1e3 * each:.0f} ms" if np.isfinite(each) else "-" for each in (found.rise_time, found.settling_time)
            )
            return f"{what}: rise {rise}, overshoot {100.0 * found.overshoot:.0f} %, settled after {settling}"
        frequency = self.frequency / (2.0 * math.pi)
        last = t >= t[-1] - _PERIODS / frequency
        ratio, _ = sine_response(t[last], np.sin(self.frequency * t[last]), y[last], frequency)
        phase = math.degrees(cmath.phase(ratio))
        return f"{what}, {frequency:.3g} Hz: gain {abs(ratio):.3f}, phase {phase:.1f} deg"


# --- what was done ---


class Recorder:
    """What was wanted and what came lately, and the pushes and changes meanwhile; `step` is the plant's [s]."""

    def __init__(self, step: float) -> None:
        self.every = max(1, round(_EVERY / step))
        self.rows = Rows(side_by_side(_COLUMNS), round(_RECORDED / (self.every * step)))
        self.pushes: list[dict[str, Any]] = []
        self.changes: list[tuple[float, Mapping[str, Any]]] = []

    def add(self, *values: Any) -> None:
        """The `_COLUMNS` at every so many steps of the plant."""
        self.rows.append(np.hstack(values))

    def save(self, folder: Path, scenario: Scenario) -> None:
        """log.csv, motion.csv, and a scenario.yaml that repeats reference, pushes, dead motors and frozen encoders.

        Its other keys are as they are now.
        """
        if not self.rows:
            raise ConfigurationError("save", "no row", "a loop that has run")
        signals = self.rows.columns()
        begin, end = signals["time"][[0, -1]].tolist()
        signals["time"] -= begin
        # The motion at a hundred rows a second: a spline goes through them.
        rows = np.column_stack([signals["time"], signals["reference"]])
        rows = rows[:: max(1, round(0.01 / max(1e-6, float(np.median(np.diff(rows[:, 0]))))))]
        pushes = [
            {"kind": "step", "wrench": each["wrench"], "time": each["time"] - begin, "until": until - begin}
            for each in self.pushes
            if each["time"] >= begin and (until := min(each["until"], end)) > each["time"]
        ]
        changed = scenario.replace({"duration": float(max(end - begin, 0.1)), "disturbances": pushes})
        data = changed.to_dict()
        data["reference"] = {"kind": "recorded", "motion_file": "motion.csv", "cutoff": None}
        began = {key: max(time - begin, 0.0) for time, change in self.changes for key in change}
        dead, frozen = data["motors"].get("dead"), data["sensors"].get("faults", [])
        for key, switched in (("motors.dead", [dead] if dead else []), ("sensors.faults", frozen)):
            for each in switched:
                each["time"] = began.get(key, each["time"])
        lines = ["# What was done by hand. Keys are as they were at the end:"]
        lines += [f"# At {time - begin:.2f} s: {dict(change)}" for time, change in self.changes if time >= begin]
        files = {
            "log.csv": SimulationLog(changed, signals).to_csv(),
            "motion.csv": numbers_to_csv([("time", "s"), *POSE], rows).encode(),
            "scenario.yaml": "\n".join([*lines, to_yaml(data)]).encode(),
        }
        folder.mkdir(parents=True, exist_ok=True)
        write_together({folder / name: content for name, content in files.items()})


_COLUMNS = {"time": (), "reference": (6,), "pose": (6,), "torque_applied": (6,), "crank_angle": (6,)}
