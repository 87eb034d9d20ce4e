"""What is checked before a run: that its motion keeps to the limits; and making a motion feasible."""

from __future__ import annotations

import dataclasses
import math
from contextlib import suppress
from typing import Any

import numpy as np

from stewart_drake.analysis import feasibility
from stewart_drake.base.code import ControllerError, file_digests
from stewart_drake.base.config import to_plain, unit_hints
from stewart_drake.base.errors import ConfigurationError, InfeasibleReferenceError, RunFailure, UnreachablePoseError
from stewart_drake.base.families import user_parts
from stewart_drake.base.tables import AXES
from stewart_drake.control.base import check_start
from stewart_drake.control.user_controller import user_code
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.motors import MotorOptions
from stewart_drake.logs.log import MAX_ROWS
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.mechanics.friction import FrictionOptions
from stewart_drake.mechanics.kinematics import pose_rate_to_twist, twist_jacobian
from stewart_drake.references import AdjustedReference, Reference
from stewart_drake.robot import RobotParameters
from stewart_drake.safety import SafetyOptions, refuse_motion, refuse_start, sample_times
from stewart_drake.scenario.limits import LimitMargin, ReferenceLimits
from stewart_drake.scenario.scenario import Scenario

_LARGEST = {"rad": math.tau, "m": 2.0}
"""Of what a motion is made; more was perhaps meant in degrees or millimetres."""
_NUDGES = 100
_SLOWEST = 1e-3  # [-] of its speed at which a motion is tried
_FRICTION = ("coulomb", "dry", "N m"), ("break_away", "break-away", "N m"), ("viscous", "viscous", "N m s/rad")
_FEW = 500  # Samples of a motion, beside its worst ones, that a hint looks at
_FALL = 0.03  # Of the characteristic length, free fall before a command acts: a loop that is slow for its robot.
_SOON = 30  # Ticks; assumed.
_PASSED: set[Any] = set()  # Motions that have passed: a search runs the same one a thousand times.
_KEPT = 64  # Of these.


def refuse_unrunnable(scenario: Scenario) -> None:
    """Refuses code that is not trusted, and a run whose rows, one a step of the plant, are too many for memory."""
    for part in user_parts(scenario):
        part.code.check(part.code_key)
    step = scenario.plant.time_step
    if scenario.duration > MAX_ROWS * step * (1.0 + 1e-9):
        allowed = f"at most {MAX_ROWS * step:g} s at a plant.time_step of {step:g} s"
        raise ConfigurationError("duration", scenario.duration, f"{allowed}: a row for each step is kept in memory")


def check_scenario(scenario: Scenario) -> None:
    """Refuses a run whose reference leaves the limits, or at whose start the robot cannot stand."""
    compared = (scenario.robot, scenario.controller_model, scenario.limits, scenario.safety, scenario.gravity)
    moves = (scenario.reference, scenario.duration, scenario.initial_offset, scenario.controller.period)
    subject = (*compared, *moves, tuple(file_digests({"reference": to_plain(scenario.reference)}).items()))
    # A user's code is asked again.
    known = not user_parts(scenario)
    if not (known and subject in _PASSED):
        report = motion_report(scenario)
        try:
            report.raise_if_infeasible()
        except InfeasibleReferenceError as error:
            hints = unit_hints(scenario.reference, _LARGEST) or _length_hint(scenario)
            hints = hints or _remedies(scenario, report, error.limit)
            error.allowed = "; ".join([error.allowed, *hints])
            raise
        _check_rates(scenario)
        if scenario.safety is not None:
            _check_safety(scenario, scenario.safety)
        if known:
            if len(_PASSED) >= _KEPT:
                _PASSED.clear()
            _PASSED.add(subject)
    with np.errstate(all="ignore"):
        start = scenario.start()[0]
        feasibility.refuse_turns("initial_offset", start[None], np.zeros(1))
        try:
            check_start(scenario.robot, start)
        except RunFailure as failure:
            key, value = "reference", start.tolist()
            if any(scenario.initial_offset):
                key, value = "initial_offset", list(scenario.initial_offset)
            raise ConfigurationError(key, value, f"a start pose that the robot can hold ({failure})") from None


def _length_hint(scenario: Scenario) -> list[str]:
    """What a motion says that goes further than metres."""
    pose, _, _ = scenario.reference.evaluate(np.linspace(0.0, scenario.duration, 101))
    farthest = float(np.abs(pose[:, 3:]).max())
    return [f"the motion goes to {farthest:.4g} m: are its lengths in mm?"] if farthest > _LARGEST["m"] else []


def _remedies(scenario: Scenario, report: feasibility.FeasibilityReport, limit: str) -> list[str]:
    """How much smaller, and how much slower, the motion can be done, from few samples and its worst ones."""
    motion, duration = scenario.reference, scenario.duration
    every = feasibility.checked_times(duration)
    worst = [margin.time for margin in report.smallest.values()]
    times = np.union1d(every[:: math.ceil(len(every) / _FEW)], worst)

    def feasible(scale: float, speed: float) -> bool:
        at, changed = times / speed, adjusted(motion, scale, 1.0 / speed)
        signals = changed.evaluate(at)
        return feasibility.check_motion(scenario.robot, scenario.limits, at, *signals, scenario.gravity).feasible

    with user_code(scenario), np.errstate(all="ignore"):
        scale = feasibility.largest_share(lambda share: feasible(share, 1.0))
        speed = feasibility.bisect(lambda share: feasible(1.0, share), _SLOWEST, 1.0)
    # `check` runs no user's code.
    smaller, slower = ("", "") if user_parts(motion) else (" (`stewart-drake check --scale`)", " (`check --retime`)")
    ways = []
    if scale > 0.0:
        ways.append(f"about {min(100.0 * scale, 99.0):.2g} % of its size{smaller}")
    if speed > _SLOWEST:
        ways.append(f"about {max(1.0 / speed, 1.01):.3g} times slower{slower}")
    possible = f"it can be done at {', or '.join(ways)}" if ways else "smaller or slower it cannot be done either"
    jump = limit in ("crank_speed", "torque") and speed < 0.05
    return [possible, *(["does it jump, or is one of its numbers in another unit?"] if jump else [])]


def _check_rates(scenario: Scenario) -> None:
    """Refuses a user's motion whose rate, or acceleration, is not the derivative of what it belongs to."""
    if not user_parts(scenario.reference):
        return
    h = 1e-5
    times = np.linspace(h, max(scenario.duration - h, h), 41)
    with user_code(scenario), np.errstate(all="ignore"):
        here, before, after = (scenario.reference.evaluate(times + shift) for shift in (0.0, -h, h))
    for order, name in ((1, "rate"), (2, "acceleration")):
        moves, says = (after[order - 1] - before[order - 1]) / (2.0 * h), here[order]
        apart = np.abs(moves - says)
        wrong = apart > 1e-2 * np.abs(says).max(axis=0) + 1e-3
        # Where a motion has a corner nothing is wrong.
        if wrong.any(axis=1).mean() > 0.2:
            row, axis = np.unravel_index(np.argmax(np.where(wrong, apart, 0.0)), apart.shape)
            unit = ("rad" if axis < 3 else "m") + ("/s" if order == 1 else "/s^2")
            got = f"{AXES[axis]} {says[row, axis]:.4g} {unit} at t = {times[row]:.3f} s"
            allowed = f"a motion whose {name} is the derivative of its {'pose' if order == 1 else 'rate'}"
            raise ConfigurationError("reference", got, f"{allowed}, there {moves[row, axis]:.4g} {unit}")


def motion_report(scenario: Scenario) -> feasibility.FeasibilityReport:
    motion = (scenario.robot, scenario.limits, scenario.reference, scenario.duration, scenario.gravity)
    try:
        # Where numbers overflow a limit is broken, or the check names the signal.
        with user_code(scenario), np.errstate(all="ignore"):
            return feasibility.check_reference(*motion)
    except ControllerError as error:
        if isinstance(error.__cause__, ConfigurationError):
            raise error.__cause__ from None
        raise ConfigurationError("reference", scenario.reference, f"a motion that does not raise ({error})") from None
    except ConfigurationError as error:
        if error.key not in ("pose", "pose_rate", "pose_acceleration"):
            raise
        raise ConfigurationError("reference", scenario.reference, f"a motion whose {error.key} stays finite") from None


def plant_report(scenario: Scenario) -> feasibility.FeasibilityReport:
    """The margin of torque with what the limits do not know: payload, motor friction, disturbances, motors as sold.

    Empty where there is nothing of it, or where the robot cannot do the motion at all.
    """
    pushes = [each for each in scenario.disturbances if not user_parts(each)]
    robot, plant, time = scenario.robot, scenario.plant, feasibility.checked_times(scenario.duration)
    friction, names = plant.friction_of(robot)[0], ["disturbances"] * bool(pushes)
    if plant.payload_mass > 0.0:
        names.append(f"payload {plant.payload_mass:g} kg")
    if (friction["break_away"] + friction["viscous"]).any():
        names.append("motor friction")
    if getattr(scenario.motors, "no_load_speed", None) or getattr(scenario.motors, "torque_limit", None):
        names.append(f"{scenario.motors.kind} motors at that speed")
    if not names:
        return feasibility.FeasibilityReport({}, None)
    with user_code(scenario), np.errstate(all="ignore"), suppress(RunFailure, np.linalg.LinAlgError):
        pose, rate, acceleration = scenario.reference.evaluate(time)
        torque = inverse_dynamics(plant.loaded(robot), pose, rate, acceleration, scenario.gravity)
        to_cranks, wrench = twist_jacobian(robot, pose), total_wrench(pushes, time)
        torque -= np.linalg.solve(np.swapaxes(to_cranks, -1, -2), wrench[..., None])[..., 0]
        speed = (to_cranks @ pose_rate_to_twist(pose, rate)[..., None])[..., 0]
        torque += friction["break_away"] * np.sign(speed) + friction["viscous"] * speed
        available = scenario.motors.available(robot, speed)
        margins = available - np.abs(torque)
        sample, leg = divmod(int(margins.argmin()), 6)
        numbers = float(available[sample, leg]), float(margins[sample, leg]), float(time[sample])
        worst = LimitMargin("torque", *numbers, leg, f"leg {leg} with {', '.join(names)}")
        return feasibility.FeasibilityReport({"plant_torque": worst}, worst if worst.margin < 0.0 else None)
    return feasibility.FeasibilityReport({}, None)


def beliefs(scenario: Scenario) -> list[tuple[str, str, str]]:
    """What is simulated of the machine, and what the controller's side believes of it, a row each."""

    def text(value: Any, unit: str) -> str:
        with suppress(TypeError, ValueError):
            low, high = np.min(np.array(value, dtype=float)), np.max(np.array(value, dtype=float))
            return f"{low:.4g} {unit}" if low == high else f"{low:.4g} to {high:.4g} {unit}"
        return "its own"

    belief, nominal, plant = scenario.controller_model, scenario.default_model, scenario.plant
    own, facts = plant.simulated(scenario.robot)
    true, model = scenario.robot.to_dict() | own, belief.robot.to_dict()
    rows = [
        (f"robot.{key}", text(true[key], unit), text(model[key], unit))
        for key, unit in ((key, RobotParameters.unit_of(key)) for key in true)
        if true[key] != model[key] or key in own
    ]
    rubs, believed = plant.friction_options.record()[0], (belief.friction or FrictionOptions()).record()[0]

    def of_motors(motors: MotorOptions, key: str) -> str:
        value = motors.to_dict().get(key)
        return "none" if value is None or value == [] else text(value, type(motors).unit_of(key))

    kinds = str(scenario.motors.kind), str(belief.motors.kind)
    keys = scenario.motors.to_dict() | belief.motors.to_dict()
    apart = [key for key in keys if scenario.motors.to_dict().get(key) != belief.motors.to_dict().get(key)]
    return [
        *(rows or [("robot", "", "the simulated one")]),
        *((name, text(value, unit), "") for name, value, unit in facts),
        *(
            (f"{words} friction", text(rubs[key].tolist(), unit), text(believed[key].tolist(), unit))
            for key, words, unit in _FRICTION
        ),
        ("payload", text(plant.payload_mass, "kg"), text(0.0, "kg")),
        ("gravity", text(scenario.gravity, "m/s^2"), text(belief.gravity, "m/s^2")),
        ("noise of a crank's angle", text(nominal.noise, "rad"), text(belief.noise, "rad")),
        ("delay of a command [ticks]", str(nominal.delay), str(belief.delay)),
        ("age of a reading", text(nominal.reading_age, "s"), text(belief.reading_age, "s")),
        *([] if kinds == ("torque", "torque") else [("motors", *kinds)]),
        *(
            (f"motors.{key}", of_motors(scenario.motors, key), of_motors(belief.motors, key))
            for key in apart
            if key != "kind"
        ),
    ]


def likely_cause(scenario: Scenario, ended: float) -> str:
    """Why a run that ended at a time [s] was perhaps not completed, which its motion does not show; or nothing.

    A loop that is too slow for its robot loses it within `_SOON` ticks.
    """
    if worst := plant_report(scenario).first_violation:
        return f"{worst.where} needs {worst.value:.4g} N m, its motor has {worst.bound:.4g} N m"
    period, slow = scenario.controller.period, _FALL * scenario.robot.characteristic_length
    fall = 0.5 * scenario.gravity * (period * (1 + scenario.loop_delay)) ** 2
    if (
        ended > _SOON * period
        or fall < slow
        or scenario.sensors.faults
        or not (scenario.link.perfect and scenario.motors.perfect)
    ):
        return ""
    return f"a slow loop of {1.0 / period:.4g} Hz: the platform can fall {1e3 * fall:.2g} mm until it reacts"


def _check_safety(scenario: Scenario, safety: SafetyOptions) -> None:
    """Refuses what the safety layer would stop, if everything goes well."""
    robot, gravity, *_ = scenario.controller_model
    try:
        with user_code(scenario), np.errstate(all="ignore"):
            time = sample_times(scenario.duration, scenario.controller.period)
            motion = scenario.reference.evaluate(time)
            refuse_motion(robot, safety, gravity, time, motion)
            refuse_start(robot, safety, gravity, *scenario.start(), motion[0][0])
    except ControllerError as error:
        names = ", ".join(safety.monitor_names)
        raise ConfigurationError("safety.monitors", names, f"monitors that do not raise ({error})") from None
    except (UnreachablePoseError, np.linalg.LinAlgError) as failure:
        key = "reference" if scenario.model.robot is None else "model.robot"
        raise ConfigurationError(key, "this motion", f"one that the robot can do ({failure})") from None


def fit_amplitude(
    robot: RobotParameters, limits: ReferenceLimits, reference: Reference, duration: float, gravity: float
) -> tuple[Reference, float]:
    """The motion made smaller about its centre until it is feasible, and its size [-], to a relative 1e-4."""
    if feasibility.check_reference(robot, limits, reference, duration, gravity).feasible:
        return reference, 1.0
    feasibility.check_reference(robot, limits, adjusted(reference, scale=0.0), duration, gravity).raise_if_infeasible()
    scale = feasibility.largest_scale(robot, limits, lambda scale: adjusted(reference, scale=scale), duration, gravity)
    return adjusted(reference, scale=scale), scale


def fit_speed(
    robot: RobotParameters, limits: ReferenceLimits, reference: Reference, duration: float, gravity: float
) -> tuple[Reference, float]:
    """The motion made slower until it is feasible, and its slowdown >= 1 [-], to a relative 1e-4.

    Slowed by k a crank's speed is 1/k, and its motor's torque static + (torque - static) / k^2, of what it was at the
    same pose: where standing still is feasible, so is every k above the smallest feasible one, and bisection finds it.
    """
    samples_per_second = 500.0

    def feasible(slowdown: float, rate: float = samples_per_second) -> bool:
        slower = adjusted(reference, slowdown=slowdown)
        return feasibility.check_reference(robot, limits, slower, slowdown * duration, gravity, rate).feasible

    if feasible(1.0):
        return reference, 1.0
    feasibility.check_reference(robot, limits, _Still(reference), duration, gravity).raise_if_infeasible()
    # On the way, at the same poses whatever the slowdown; in the end at the full rate.
    speed = feasibility.bisect(lambda speed: feasible(1.0 / speed, samples_per_second * speed), 0.0, 1.0)
    if speed > 0.0:
        for slowdown in (1.0 + feasibility.SEARCH_RTOL * np.arange(_NUDGES)) / speed:
            if feasible(float(slowdown)):
                return adjusted(reference, slowdown=float(slowdown)), float(slowdown)
    raise ConfigurationError("reference", reference, "a motion that is feasible at some speed above zero")


def adjusted(reference: Reference, scale: float = 1.0, slowdown: float = 1.0) -> AdjustedReference:
    """A motion made smaller and slower; one that is adjusted already is not wrapped again."""
    if isinstance(reference, AdjustedReference):
        return dataclasses.replace(reference, scale=scale * reference.scale, slowdown=slowdown * reference.slowdown)
    motion: Any = reference
    return AdjustedReference(motion=motion, scale=scale, slowdown=slowdown)


@dataclasses.dataclass(frozen=True)
class _Still:
    """A motion's poses, at rest."""

    reference: Reference

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pose, rate, acceleration = self.reference.evaluate(time)
        return pose, np.zeros_like(rate), np.zeros_like(acceleration)
