"""Checks before a run that the motion is within the limits, and ways to make a motion feasible."""

from __future__ import annotations

import dataclasses
import math
from contextlib import suppress

import numpy as np

from stewart_drake.analysis import feasibility
from stewart_drake.base.code import ControllerError, file_digests
from stewart_drake.base.config import Section, to_plain
from stewart_drake.base.errors import ConfigurationError, InfeasibleReferenceError, RunFailure, UnreachablePoseError
from stewart_drake.base.families import user_parts
from stewart_drake.base.tables import AXES
from stewart_drake.base.units import smaller_unit
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
from stewart_drake.robot.gravity import Gravity, gravity_text, gravity_vector
from stewart_drake.safety import SafetyOptions, refuse_motion, refuse_start, sample_times
from stewart_drake.scenario.limits import LimitMargin, ReferenceLimits
from stewart_drake.scenario.scenario import Scenario

_LARGEST = {"rad": math.tau, "m": 2.0}  # Sizes of a motion; larger numbers are perhaps degrees or millimetres.
_MAX_SPEED_STEPS = 100  # Steps of `SEARCH_RTOL` from the result of a bisection to a feasible slowdown.
_MIN_SPEED = 1e-3  # [-] Least share of a motion's speed that is tried.
_FRICTION = ("coulomb", "dry", "N m"), ("break_away", "break-away", "N m"), ("viscous", "viscous", "N m s/rad")
_HINT_SAMPLES = 500  # Samples of a motion for a hint, beside those with the smallest margins.
_SLOW_LOOP_FALL = 0.03  # Free fall over the characteristic length in a slow loop, where a command acts later.
_SLOW_LOOP_TICKS = 30  # A slow loop fails within this number of ticks; assumed.
_PASSED: set[object] = set()  # Checked motions, as a search runs the same one a thousand times.
_MAX_PASSED = 64
_TILTED = 50  # Poses of a motion that are checked with tilts for a ball.


def refuse_unrunnable(scenario: Scenario) -> None:
    """Raises a ConfigurationError for code that is not trusted, and for more steps of the plant than fit in memory."""
    for part in user_parts(scenario):
        part.code.check(part.code_key)
    step = scenario.plant.time_step
    if scenario.duration > MAX_ROWS * step * (1.0 + 1e-9):
        allowed = f"at most {MAX_ROWS * step:g} s at a plant.time_step of {step:g} s"
        raise ConfigurationError("duration", scenario.duration, f"{allowed}: a row for each step is kept in memory")


def check_scenario(scenario: Scenario) -> None:
    """Raises a ConfigurationError if the motion leaves the limits, or the robot cannot hold the start pose."""
    scenario.base.check(scenario.duration)
    setup = (scenario.robot, scenario.controller_model, scenario.limits, scenario.safety, scenario.gravity_in_base)
    motion = (scenario.reference, scenario.duration, scenario.initial_offset, scenario.controller.period)
    files = {"reference": to_plain(scenario.reference), "base": to_plain(scenario.base)}
    others = (scenario.ball_control, scenario.base, scenario.base_compensation)
    key = (*setup, *motion, *others, tuple(file_digests(files).items()))
    # A user's code may give other results the next time.
    repeatable = not user_parts(scenario)
    if not (repeatable and key in _PASSED):
        report = motion_report(scenario)
        try:
            report.raise_if_infeasible()
        except InfeasibleReferenceError as error:
            hints = _unit_hints(scenario.reference) if isinstance(scenario.reference, Section) else []
            hints = hints or _length_hint(scenario) or _base_hint(scenario)
            hints = hints or _remedies(scenario, report, error.limit)
            error.allowed = "; ".join([error.allowed, *hints])
            raise
        _check_rates(scenario)
        _check_tilts(scenario)
        if scenario.safety is not None:
            _check_safety(scenario, scenario.safety)
        if repeatable:
            if len(_PASSED) >= _MAX_PASSED:
                _PASSED.clear()
            _PASSED.add(key)
    with np.errstate(all="ignore"):
        start = scenario.start()[0]
        feasibility.refuse_turns("initial_offset", start[None], np.zeros(1))
        try:
            check_start(scenario.robot, start)
        except RunFailure as failure:
            name, value = "reference", start.tolist()
            if any(scenario.initial_offset):
                name, value = "initial_offset", list(scenario.initial_offset)
            raise ConfigurationError(name, value, f"a start pose that the robot can hold ({failure})") from None


def _length_hint(scenario: Scenario) -> list[str]:
    """A hint for motions of many metres."""
    pose, _, _ = scenario.asked.evaluate(np.linspace(0.0, scenario.duration, 101))
    farthest = float(np.abs(pose[:, 3:]).max())
    return [f"the motion goes to {farthest:.4g} m: are its lengths in mm?"] if farthest > _LARGEST["m"] else []


def _base_hint(scenario: Scenario) -> list[str]:
    """A hint where only the base is in the way of a platform that is kept level."""
    if (
        scenario.base_compensation != "level"
        or not motion_report(scenario.replace({"base_compensation": "none"})).feasible
    ):
        return []
    return ["base.motion is too large for a platform kept level (base_compensation); without that it is feasible"]


def _remedies(scenario: Scenario, report: feasibility.FeasibilityReport, limit: str) -> list[str]:
    """Texts on a feasible size and a feasible speed of the motion, from some samples and those of smallest margin."""
    motion, times = scenario.reference, feasibility.checked_times(scenario.duration)
    worst = [margin.time for margin in report.smallest.values()]
    times = np.union1d(times[:: math.ceil(len(times) / _HINT_SAMPLES)], worst)

    def feasible(scale: float, speed: float) -> bool:
        slower = times / speed
        signals = adjusted(motion, scale, 1.0 / speed).evaluate(slower)
        return feasibility.check_motion(
            scenario.robot, scenario.limits, slower, *signals, scenario.gravity_at(slower)
        ).feasible

    with user_code(scenario), np.errstate(all="ignore"):
        scale = feasibility.largest_share(lambda share: feasible(share, 1.0))
        speed = feasibility.bisect(lambda share: feasible(1.0, share), _MIN_SPEED, 1.0)
    # The command `check` runs no user's code.
    by_scale, by_retime = (
        ("", "") if user_parts(motion) else (" (`stewart-drake check --scale`)", " (`check --retime`)")
    )
    remedies = []
    if scale > 0.0:
        remedies.append(f"about {min(100.0 * scale, 99.0):.2g} % of its size{by_scale}")
    if speed > _MIN_SPEED:
        remedies.append(f"about {max(1.0 / speed, 1.01):.3g} times slower{by_retime}")
    text = f"it can be done at {', or '.join(remedies)}" if remedies else "smaller or slower it cannot be done either"
    jump = limit in ("crank_speed", "torque") and speed < 0.05
    return [text, *(["does it jump, or is one of its numbers in another unit?"] if jump else [])]


def _check_rates(scenario: Scenario) -> None:
    """Refuses a user's motion if its rate or acceleration is not the derivative of its pose or rate."""
    if not user_parts(scenario.reference):
        return
    h = 1e-5
    times = np.linspace(h, max(scenario.duration - h, h), 41)
    with user_code(scenario), np.errstate(all="ignore"):
        here, before, after = (scenario.reference.evaluate(times + shift) for shift in (0.0, -h, h))
    for order, name in ((1, "rate"), (2, "acceleration")):
        difference, given = (after[order - 1] - before[order - 1]) / (2.0 * h), here[order]
        error = np.abs(difference - given)
        wrong = error > 1e-2 * np.abs(given).max(axis=0) + 1e-3
        # A motion may have some corners.
        if wrong.any(axis=1).mean() > 0.2:
            row, axis = np.unravel_index(np.argmax(np.where(wrong, error, 0.0)), error.shape)
            unit = ("rad" if axis < 3 else "m") + ("/s" if order == 1 else "/s^2")
            got = f"{AXES[axis]} {given[row, axis]:.4g} {unit} at t = {times[row]:.3f} s"
            allowed = f"a motion whose {name} is the derivative of its {'pose' if order == 1 else 'rate'}"
            raise ConfigurationError("reference", got, f"{allowed}, there {difference[row, axis]:.4g} {unit}")


def _check_tilts(scenario: Scenario) -> None:
    """Refuses a ball's target off the plate, and tilts for it that the robot cannot go to on its motion."""
    if (options := scenario.ball_control) is None:
        return
    if scenario.ball is not None:
        path = options.target.evaluate(feasibility.checked_times(scenario.duration))[:, :2]
        if (farthest := float(np.linalg.norm(path, axis=1).max())) > (rim := scenario.ball.plate.radius):
            allowed = f"a path on the plate, within {rim:g} m of its centre; it goes {farthest:.4g} m away"
            raise ConfigurationError("ball_control.target", options.target.given(), allowed)
    motion = np.concatenate(scenario.reference.evaluate(np.linspace(0.0, scenario.duration, _TILTED)), axis=-1)
    for key, rows in options.extremes(motion).items():
        signals = rows[:, :6], rows[:, 6:12], rows[:, 12:]
        report = feasibility.check_motion(
            scenario.robot, scenario.limits, np.zeros(len(rows)), *signals, scenario.gravity_in_base
        )
        if (worst := report.first_violation) is not None:
            there = f"{worst.limit} {worst.value:.4g} {worst.unit} for {worst.allowed}"
            allowed = f"less, as the robot cannot do that on its motion: {there}; or other `limits`"
            raise ConfigurationError(f"ball_control.{key}", getattr(options, key), allowed)


def motion_report(scenario: Scenario) -> feasibility.FeasibilityReport:
    """Margins to the limits along the motion, with that of the base."""
    time = feasibility.checked_times(scenario.duration)
    try:
        # Overflows are reported as a violated limit or as a signal that is not finite.
        with user_code(scenario), np.errstate(all="ignore"):
            motion, gravity = scenario.asked.evaluate(time), scenario.gravity_at(time)
            return feasibility.check_motion(scenario.robot, scenario.limits, time, *motion, gravity)
    except ControllerError as error:
        if isinstance(error.__cause__, ConfigurationError):
            raise error.__cause__ from None
        raise ConfigurationError("reference", scenario.reference, f"a motion that does not raise ({error})") from None
    except ConfigurationError as error:
        if error.key not in ("pose", "pose_rate", "pose_acceleration"):
            raise
        raise ConfigurationError("reference", scenario.reference, f"a motion whose {error.key} stays finite") from None


def plant_report(scenario: Scenario) -> feasibility.FeasibilityReport:
    """Smallest torque margin with payload, motor friction, disturbances and torque-speed curves, unlike `limits`.

    Empty if the plant has none of these, or if the robot cannot do the motion at all.
    """
    pushes = [disturbance for disturbance in scenario.disturbances if not user_parts(disturbance)]
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
        pose, rate, _ = motion = scenario.asked.evaluate(time)
        loaded, gravity = plant.loaded(robot), scenario.gravity_at(time)
        if isinstance(gravity, np.ndarray):
            torque = np.array([inverse_dynamics(loaded, *row) for row in zip(*motion, gravity, strict=True)])
        else:
            torque = inverse_dynamics(loaded, *motion, gravity)
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


def _range_text(value: object, unit: str) -> str:
    """Smallest and largest of some numbers with their unit."""
    with suppress(TypeError, ValueError):
        values = np.array(value, dtype=float)
        low, high = np.min(values), np.max(values)
        return f"{low:.4g} {unit}" if low == high else f"{low:.4g} to {high:.4g} {unit}"
    return "its own"


def _motors_text(motors: MotorOptions, key: str) -> str:
    value = motors.to_dict().get(key)
    return "none" if value is None or value == [] else _range_text(value, type(motors).unit_of(key))


def compared_with_model(scenario: Scenario) -> list[tuple[str, str, str]]:
    """Table of the simulated machine and the controller's model: name, true value, value of the model."""
    model, correct, plant, text = scenario.controller_model, scenario.default_model, scenario.plant, _range_text
    simulated, facts = plant.simulated(scenario.robot)
    robot, model_robot = scenario.robot.to_dict() | simulated, model.robot.to_dict()
    robot_rows = [
        (f"robot.{key}", text(robot[key], unit), text(model_robot[key], unit))
        for key, unit in ((key, RobotParameters.unit_of(key)) for key in robot)
        if robot[key] != model_robot[key] or key in simulated
    ]
    friction, model_friction = plant.friction_options.record()[0], (model.friction or FrictionOptions()).record()[0]
    kinds = str(scenario.motors.kind), str(model.motors.kind)
    motors, model_motors = scenario.motors.to_dict(), model.motors.to_dict()
    return [
        *(robot_rows or [("robot", "", "the simulated one")]),
        *((name, text(value, unit), "") for name, value, unit in facts),
        *(
            (f"{words} friction", text(friction[key].tolist(), unit), text(model_friction[key].tolist(), unit))
            for key, words, unit in _FRICTION
        ),
        ("payload", text(plant.payload_mass, "kg"), text(0.0, "kg")),
        ("gravity", f"{gravity_text(scenario.gravity_in_base)} m/s^2", f"{gravity_text(model.gravity)} m/s^2"),
        ("noise of a crank's angle", text(correct.noise, "rad"), text(model.noise, "rad")),
        ("delay of a command [ticks]", str(correct.delay), str(model.delay)),
        ("age of a reading", text(correct.reading_age, "s"), text(model.reading_age, "s")),
        *([] if kinds == ("torque", "torque") else [("motors", *kinds)]),
        *(
            (f"motors.{key}", _motors_text(scenario.motors, key), _motors_text(model.motors, key))
            for key in motors | model_motors
            if key != "kind" and motors.get(key) != model_motors.get(key)
        ),
    ]


def likely_cause(scenario: Scenario, ended: float) -> str:
    """A likely cause why a run was not completed: weak motors, or a slow loop if it `ended` [s] early; else empty."""
    if worst := plant_report(scenario).first_violation:
        return f"{worst.where} needs {worst.value:.4g} N m, its motor has {worst.bound:.4g} N m"
    period, slow = scenario.controller.period, _SLOW_LOOP_FALL * scenario.robot.characteristic_length
    size = float(np.linalg.norm(gravity_vector(scenario.gravity_in_base)))
    fall = 0.5 * size * (period * (1 + scenario.loop_delay)) ** 2
    if (
        ended > _SLOW_LOOP_TICKS * period
        or fall < slow
        or scenario.sensors.faults
        or not (scenario.link.perfect and scenario.motors.perfect)
    ):
        return ""
    return f"a slow loop of {1.0 / period:.4g} Hz: the platform can fall {1e3 * fall:.2g} mm until it reacts"


def _check_safety(scenario: Scenario, safety: SafetyOptions) -> None:
    """Refuses a motion that the safety layer would stop without any fault."""
    model = scenario.controller_model
    robot, gravity = model.robot, model.gravity
    try:
        with user_code(scenario), np.errstate(all="ignore"):
            time = sample_times(scenario.duration, scenario.controller.period)
            _check_parity(scenario, safety.parity, time)
            motion = scenario.asked.evaluate(time)
            refuse_motion(robot, safety, gravity, time, motion, model.motors)
            refuse_start(robot, safety, gravity, *scenario.start(), motion[0][0])
    except ControllerError as error:
        names = ", ".join(safety.monitor_names)
        raise ConfigurationError("safety.monitors", names, f"monitors that do not raise ({error})") from None
    except (UnreachablePoseError, np.linalg.LinAlgError) as failure:
        key = "reference" if scenario.model.robot is None else "model.robot"
        raise ConfigurationError(key, "this motion", f"one that the robot can do ({failure})") from None


def _check_parity(scenario: Scenario, bound: float | None, time: np.ndarray) -> None:
    """Refuses a base that turns, for an inertial sensor on the platform that is compared with encoders on the base."""
    motion = scenario.base.motion
    if motion is None or bound is None or scenario.controller_model.imu is None or scenario.base_compensation != "none":
        return
    largest = float(np.abs(motion.evaluate(time)[0][:, :3]).max())
    if largest > bound:
        allowed = f"less than {bound:.4g} rad, which safety.parity takes for a wrong encoder; or base.sensor with "
        allowed += "base_compensation torques or level; or safety.parity null"
        raise ConfigurationError("base.motion", f"angles of up to {largest:.4g} rad", allowed)


def fit_amplitude(
    robot: RobotParameters, limits: ReferenceLimits, reference: Reference, duration: float, gravity: Gravity
) -> tuple[Reference, float]:
    """The motion scaled about its centre to be feasible, and the scale [-], the largest one to a relative 1e-4."""
    if feasibility.check_reference(robot, limits, reference, duration, gravity).feasible:
        return reference, 1.0
    feasibility.check_reference(robot, limits, adjusted(reference, scale=0.0), duration, gravity).raise_if_infeasible()
    scale = feasibility.largest_scale(robot, limits, lambda scale: adjusted(reference, scale=scale), duration, gravity)
    return adjusted(reference, scale=scale), scale


def fit_speed(
    robot: RobotParameters, limits: ReferenceLimits, reference: Reference, duration: float, gravity: Gravity
) -> tuple[Reference, float]:
    """The motion slowed down to be feasible, and the slowdown >= 1 [-], the smallest one to a relative 1e-4.

    A slowdown k divides the crank speeds at a pose by k, and changes the torques to static + (torque - static) / k^2.
    So if rest is feasible at all poses, all k above a smallest one are feasible, and bisection finds it.
    """
    samples_per_second = 500.0

    def feasible(slowdown: float, rate: float = samples_per_second) -> bool:
        slower = adjusted(reference, slowdown=slowdown)
        return feasibility.check_reference(robot, limits, slower, slowdown * duration, gravity, rate).feasible

    if feasible(1.0):
        return reference, 1.0
    feasibility.check_reference(robot, limits, _AtRest(reference), duration, gravity).raise_if_infeasible()
    # The bisection checks the same poses at all slowdowns; the result is checked at the full rate.
    speed = feasibility.bisect(lambda speed: feasible(1.0 / speed, samples_per_second * speed), 0.0, 1.0)
    if speed > 0.0:
        for slowdown in (1.0 + feasibility.SEARCH_RTOL * np.arange(_MAX_SPEED_STEPS)) / speed:
            if feasible(float(slowdown)):
                return adjusted(reference, slowdown=float(slowdown)), float(slowdown)
    raise ConfigurationError("reference", reference, "a motion that is feasible at some speed above zero")


def adjusted(reference: Reference, scale: float = 1.0, slowdown: float = 1.0) -> AdjustedReference:
    """A motion scaled and slowed down; an `AdjustedReference` is not wrapped again."""
    if isinstance(reference, AdjustedReference):
        return reference.replace(scale=scale * reference.scale, slowdown=slowdown * reference.slowdown)
    return AdjustedReference(motion=reference, scale=scale, slowdown=slowdown)


@dataclasses.dataclass(frozen=True)
class _AtRest:
    """The poses of a motion, all at rest."""

    reference: Reference

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        pose, rate, acceleration = self.reference.evaluate(time)
        return pose, np.zeros_like(rate), np.zeros_like(acceleration)


def _unit_hints(section: Section, key: str = "") -> list[str]:
    """A sentence for each number of a section that is larger than its unit allows, but not in a smaller unit."""
    hints = []
    for name in section.__pydantic_fields__:
        value, units = getattr(section, name), section.unit_of(name).split(", ")
        place = f"{key or section.section_key}.{name}"
        if isinstance(value, Section):
            hints += _unit_hints(value, place)
        if isinstance(value, tuple) and value and isinstance(value[0], Section):
            hints += [hint for k, part in enumerate(value) for hint in _unit_hints(part, f"{place}[{k}]")]
        flat = list(np.ravel(np.array(value, dtype=object))) if isinstance(value, (int, float, tuple)) else []
        length = 6 if len(flat) % 6 == 0 else max(1, len(flat))
        for index, number in enumerate(flat):
            unit = units[index % length * len(units) // length]
            most = _LARGEST.get(unit, math.inf)
            if isinstance(number, (int, float)) and abs(number) > most:
                other = smaller_unit(float(number), unit, lambda size, most=most: abs(size) <= most)  # type: ignore[misc]
                hints.append(f"{place} has {number:g} {unit}{other}")
    return hints
