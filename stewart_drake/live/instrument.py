"""Tools of the live page: sliders for keys, springs to pull with, test motions, a recorder."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.analysis.response import sine_response, step_figures
from stewart_drake.base.atomic_files import write_together
from stewart_drake.base.config import Section
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.tables import COORDINATES, POSE, numbers_to_csv
from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.live.ball import BallHand
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.rows import Rows, row_layout
from stewart_drake.logs.signals import DISPLAY_UNITS, SCALES
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import pose_jacobian, rotation_matrix
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.scenario.scenario import Scenario

_PULL_LENGTH = 0.15  # [characteristic lengths] stretch of a spring at its largest force.
_FORCE_SHARE = 0.2  # Largest force or moment of a spring, as a share of the result of `largest`.
_PULL_ANGLE = 0.3  # [rad] turn of a spring at its largest moment.
_STEP_DURATION = 2.0  # [s]
_DRAWN = 2000
_PERIODS = 3  # Evaluated periods of a sine, after one that is left out.
_RECORDED = 120.0  # [s] that a recorder keeps.
_RECORD_PERIOD = 0.001  # [s]


# --- sliders of keys ---


class Slider(NamedTuple):
    """A slider of the panel: its group, key, label, unit and range."""

    group: str
    key: str
    label: str
    unit: str
    low: float
    high: float
    logarithmic: bool = False
    whole: bool = False


def for_live_page(scenario: Scenario) -> Scenario:
    """The scenario with explicit gains and model; otherwise a slider of the machine would change them."""
    given = {name: getattr(scenario, name).to_dict() for name in ("controller", "tuner", "estimator")}
    given |= {
        "model.delay": scenario.controller_model.delay,
        "model.reading_age": scenario.controller_model.reading_age,
    }
    if scenario.motors.knobs and scenario.model.motors is None:
        given["model.motors"] = scenario.controller_model.motors.to_dict()
    return scenario.replace(given)


_GAIN_RANGE, _MOTOR_RANGE = 10.0**1.5, 10.0**0.5  # Factor from the initial value to the ends of a slider.


def sliders_of(scenario: Scenario, begun: Scenario) -> list[Slider]:
    """The sliders of a scenario; ranges of gains are about their initial values."""
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
        around("Gains", name, getattr(scenario, name), getattr(begun, name), _GAIN_RANGE)
    high = 0.2 * float(scenario.robot.effort_limits.min())
    found.append(Slider("Machine", "plant.motor_friction", "friction", "N m", 0.0, high))
    found.append(Slider("Machine", "command_delay", "delay", "ticks", 0, 8, whole=True))
    found.append(Slider("Model", "model.friction.coulomb", "friction", "N m", 0.0, high))
    found.append(Slider("Model", "model.delay", "delay", "ticks", 0, 8, whole=True))
    around("Machine", "motors", scenario.motors, begun.motors, _MOTOR_RANGE)
    if scenario.model.motors is not None:
        around("Model", "model.motors", scenario.model.motors, begun.motors, _MOTOR_RANGE)
    return found


def slider_value(scenario: Scenario, slider: Slider) -> float:
    """Value of a slider: the largest of six motors; 0 if the section is missing."""
    value: object = scenario
    for name in slider.key.split("."):
        value = getattr(value, name, 0.0)
    return float(np.max(np.asarray(value, dtype=float)))


def changes_of_slider(scenario: Scenario, slider: Slider, value: float) -> dict[str, object]:
    """Changes of the scenario for a slider at a value, clipped to its range."""
    value = min(max(value, slider.low), slider.high)
    if slider.key.startswith("model.friction.") and scenario.model.friction is None:
        return {"model.friction": {"coulomb": value}}
    return {slider.key: round(value) if slider.whole else value}


# --- springs ---


class Spring(NamedTuple):
    """Pulls a point of the platform, (3,) [m] in P, towards a place (3,) [m] in B, with a bounded force."""

    point: np.ndarray
    place: np.ndarray
    largest: float  # [N]
    length: float  # [m] stretch at the largest force.

    def force(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place (3,) [m] of the point, and the force (3,) [N] there, in B."""
        at = pose[3:] + rotation_matrix(pose[:3]) @ self.point
        return at, _spring_force(self.place - at, self.length, self.largest)

    def wrench(self, pose: np.ndarray) -> np.ndarray:
        """(6,) [N m, N] about P, in B."""
        at, force = self.force(pose)
        return np.concatenate([np.cross(at - pose[3:], force), force])


class TurningSpring(NamedTuple):
    """Turns the platform towards an orientation R_BP (3, 3) with a pure, bounded moment; `held` is where it began."""

    held: np.ndarray
    target: np.ndarray
    largest: float  # [N m]

    def moment(self, pose: np.ndarray) -> np.ndarray:
        """(3,) [N m] in B."""
        off = self.target @ rotation_matrix(pose[:3]).T
        axis = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
        sine = float(np.linalg.norm(axis))
        angle = math.atan2(sine, 0.5 * (off[0, 0] + off[1, 1] + off[2, 2] - 1.0))
        return _spring_force(axis * (angle / sine if sine else 1.0), _PULL_ANGLE, self.largest)

    def wrench(self, pose: np.ndarray) -> np.ndarray:
        """(6,) [N m, N] about P, in B."""
        return np.concatenate([self.moment(pose), np.zeros(3)])


def _spring_force(stretch: np.ndarray, length: float, largest: float) -> np.ndarray:
    """Force (3,) in proportion to a stretch (3,), up to `largest` at `length`."""
    size = float(np.linalg.norm(stretch))
    return np.asarray(stretch * (largest / length) * min(1.0, length / size if size else 1.0))


def spring(robot: RobotParameters, gravity: Gravity, point: np.ndarray, place: np.ndarray) -> Spring:
    """A spring to pull with that does not trip the safety layer."""
    force = _FORCE_SHARE * largest(robot, gravity, FORCE)
    return Spring(point, place, force, _PULL_LENGTH * robot.characteristic_length)


def turning_spring(robot: RobotParameters, gravity: Gravity, held: np.ndarray, turn: np.ndarray) -> TurningSpring:
    """A spring that turns by a rotation vector (3,) [rad] in B."""
    target = Rotation.from_rotvec(turn).as_matrix() @ held
    return TurningSpring(held, target, _FORCE_SHARE * largest(robot, gravity, MOMENT))


MOMENT, FORCE = slice(0, 3), slice(3, 6)  # Of a wrench.


def largest(robot: RobotParameters, gravity: Gravity, axes: slice) -> float:
    """Half of what the motors can bear at home along the strongest axis: `MOMENT` [N m] or `FORCE` [N], two digits."""
    holds = static_torque(robot, robot.home_pose, gravity)
    per_unit = np.linalg.inv(pose_jacobian(robot, robot.home_pose)).T[:, axes]
    room = (robot.effort_limits - np.abs(holds))[:, None] / np.maximum(np.abs(per_unit), 1e-12)
    return float(f"{max(0.5 * float(room.min(axis=0).max()), 1e-3):.2g}")


# --- tests: a step, a sine ---


class TestMotion:
    """A step or a sine that is added to the reference of one coordinate, and the response.

    `text` names it, and has its figures once it is complete.
    """

    __test__ = False  # Not a test of pytest.

    def __init__(self, kind: str, axis: int, size: float, frequency: float, start: float) -> None:
        self.kind, self.axis, self.size, self.start = kind, axis, size, start
        self.frequency = 2.0 * math.pi * frequency
        self.duration = _STEP_DURATION if kind == "step" else (_PERIODS + 1) / frequency
        self.times: list[float] = []
        self.values: list[float] = []
        at = f", {frequency:.3g} Hz" if kind == "sine" else ""
        what = f"{kind} of {COORDINATES[axis]}, {SCALES[axis] * size:.3g} {DISPLAY_UNITS[axis]}{at}"
        self.complete, self._what, self.text = False, what, f"{what}: under way"

    def added(self, time: float) -> np.ndarray:
        """Pose, rate and acceleration (18,) to be added at a time [s]; a step has a pose only."""
        out, t = np.zeros(18), time - self.start
        if not 0.0 <= t <= self.duration:
            return out
        if self.kind == "step":
            out[self.axis] = self.size
            return out
        w = self.frequency
        # Grows over the first quarter of a period; the rate of this growth is left out.
        share = min(1.0, 4.0 * t * w / (2.0 * math.pi))
        out[self.axis] = share * self.size * math.sin(w * t)
        out[6 + self.axis] = share * self.size * w * math.cos(w * t)
        out[12 + self.axis] = -share * self.size * w * w * math.sin(w * t)
        return out

    def watch(self, time: float, pose: np.ndarray, rest: float) -> None:
        """Takes a pose (6,) of the response; `rest` is the reference of the coordinate without the test."""
        if self.complete or time < self.start:
            return
        self.times.append(time - self.start)
        self.values.append((float(pose[self.axis]) - rest) / self.size)
        if time - self.start >= self.duration:
            self.complete, self.text = True, f"{self._what}: {self._figures()}"

    def give_up(self) -> None:
        """Ends it without figures, as the robot no longer follows."""
        if not self.complete:
            self.complete, self.text = True, f"{self._what}: not finished"

    def curves(self) -> dict[str, object]:
        """Time from the start [s], reference and response [rad, m] of the coordinate, in up to `_DRAWN` rows."""
        count = len(self.values)
        rows = range(0, count, 1 + count // _DRAWN)
        reference = [float(self.added(self.start + self.times[row])[self.axis]) for row in rows]
        response = [self.size * self.values[row] for row in rows]
        return {"time": [self.times[row] for row in rows], "reference": reference, "response": response}

    def _figures(self) -> str:
        t, y = np.array(self.times), np.array(self.values)
        if self.kind == "step":
            found = step_figures(t, y)
            rise, settling = (
                f"{1e3 * time:.0f} ms" if np.isfinite(time) else "-" for time in (found.rise_time, found.settling_time)
            )
            return f"rise {rise}, overshoot {100.0 * found.overshoot:.0f} %, settled after {settling}"
        frequency = self.frequency / (2.0 * math.pi)
        last = t >= t[-1] - _PERIODS / frequency
        ratio, _ = sine_response(t[last], np.sin(self.frequency * t[last]), y[last], frequency)
        phase = math.degrees(cmath.phase(ratio))
        return f"gain {abs(ratio):.3f}, phase {phase:z.1f} deg"


# --- recording ---


@dataclass
class Push:
    """A push while the loop runs."""

    wrench: list[float]  # (6,) [N m, N] moment about P and force, in B.
    time: float  # [s]
    until: float  # [s]


class Recorder:
    """Records the last `_RECORDED` s of motion, torque, ball, pushes and changes; `step` [s] is the plant's."""

    def __init__(self, step: float, ball: BallHand | None = None) -> None:
        self.every, self._ball = max(1, round(_RECORD_PERIOD / step)), ball
        columns = _COLUMNS if ball is None else {**_COLUMNS, "ball": (2,), "ball_velocity": (2,)}
        self.rows = Rows(row_layout(columns), round(_RECORDED / (self.every * step)))
        self.pushes: list[Push] = []
        self.changes: list[tuple[float, Mapping[str, object]]] = []

    def add(self, *values: float | np.ndarray) -> None:
        """Adds a row of `_COLUMNS`; to be called every `every` steps of the plant."""
        self.rows.append(np.hstack(values))

    def save(self, folder: Path, scenario: Scenario) -> None:
        """Writes log.csv, motion.csv and a scenario.yaml that repeats reference, pushes, dead motors, frozen encoders.

        All other keys have their present values.
        """
        if not self.rows:
            raise ConfigurationError("save", "a loop at its start", "a loop that has run")
        signals = self.rows.columns()
        begin, end = signals["time"][[0, -1]].tolist()
        signals["time"] -= begin
        # 100 rows per second, for a spline.
        rows = np.column_stack([signals["time"], signals["reference"]])
        rows = rows[:: max(1, round(0.01 / max(1e-6, float(np.median(np.diff(rows[:, 0]))))))]
        pushes = [
            {"kind": "step", "wrench": push.wrench, "time": push.time - begin, "until": until - begin}
            for push in self.pushes
            if push.time >= begin and (until := min(push.until, end)) > push.time
        ]
        changed = scenario.replace({"duration": float(max(end - begin, 0.1)), "disturbances": pushes})
        data = changed.to_dict()
        data["reference"] = {"kind": "recorded", "motion_file": "motion.csv", "cutoff": None}
        began = {key: max(time - begin, 0.0) for time, change in self.changes for key in change}
        dead, frozen = data["motors"].get("dead"), data["sensors"].get("faults", [])
        for key, switched in (("motors.dead", [dead] if dead else []), ("sensors.faults", frozen)):
            for fault in switched:
                fault["time"] = began.get(key, fault["time"])
        lines = ["# Recorded by hand. Keys have their values at the end:"]
        if (ball := self._ball) is not None:
            given = [(throw["time"], throw["velocity"]) for throw in data["ball"]["throws"]]
            throws = [{"time": time - begin, "velocity": v} for time, v in given + ball.thrown if time >= begin]
            start, velocity = (signals[name][0].tolist() for name in ("ball", "ball_velocity"))
            data["ball"] |= {"start": start, "velocity": velocity, "throws": throws}
            lines += ["# A hand held the ball, which this does not repeat."] if ball.touched else []
        lines += [f"# At {time - begin:.2f} s: {dict(change)}" for time, change in self.changes if time >= begin]
        files = {
            "log.csv": SimulationLog(changed, signals).to_csv(),
            "motion.csv": numbers_to_csv([("time", "s"), *POSE], rows).encode(),
            "scenario.yaml": "\n".join([*lines, to_yaml(data)]).encode(),
        }
        folder.mkdir(parents=True, exist_ok=True)
        write_together({folder / name: content for name, content in files.items()})


_COLUMNS = {"time": (), "reference": (6,), "pose": (6,), "torque_applied": (6,), "crank_angle": (6,)}
