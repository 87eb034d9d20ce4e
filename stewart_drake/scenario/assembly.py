"""From a scenario to its loop: the ordered list of parts, and what they are connected by.

The order is that in which signals run within a tick: sensors, estimator, controller, what is added to its torque,
densities, delay, link, safety layer, motors; then, late, what acts from the next tick on. Each kind of sensor,
estimator, controller and tuner gives its own parts, see `LoopContext`; nothing here knows how many kinds there are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.base.errors import ConfigurationError, NotFiniteError
from stewart_drake.base.jit import fields, new_record, njit, record
from stewart_drake.base.keys import join_or
from stewart_drake.control.base import LEARNT_SIGNALS, TRACKING_ERROR
from stewart_drake.control.feedforward import lead_part
from stewart_drake.control.friction_compensation import standing_torque
from stewart_drake.control.observer import SMALLEST_NOISE
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.motors import delay_part, within_limit
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.mechanics.friction import BELIEVED
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry
from stewart_drake.safety import SafetyOptions, safety_part
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.scenario import Scenario


class Source(NamedTuple):
    """A signal that is a function of time alone: its name, its size, and times (n,) [s] -> values (n, size)."""

    signal: str
    size: int
    evaluate: Callable[[np.ndarray], np.ndarray]


class ControlSide(NamedTuple):
    """What runs on the computer beside a robot, from a reading to the torque that is asked for."""

    context: LoopContext
    parts: tuple[Part, ...]  # In order.
    at_end: tuple[Part, ...]  # Those that run at the end of a tick.
    # `reference` (18,), and where an observer looks ahead `reference_ahead` (18,).
    sources: tuple[Source, ...]
    reading: str  # Name of what it reads.
    torque: str  # Name of the signal (6,) [N m] that it asks for.
    command: str  # Name of the signal (6,) that goes to the motors, which is that torque where they take one.
    unit: str  # Of that command.
    initial_command: np.ndarray  # (6,) until the first one arrives.
    safety: Part | None  # The safety layer, for the signal at `command`.
    logged: Mapping[str, str | np.ndarray]  # Signals by their names in a log; an array stays as it is.

    @property
    def every_part(self) -> tuple[Part, ...]:
        """All but the safety layer."""
        return (*self.parts, *self.at_end)


class Loop(NamedTuple):
    """The loop of a scenario.

    The plant gives the signals `plant_pose` (12,), pose [rad, m] and rate, and `crank_state` (12,), angles [rad] and
    their rates.
    """

    parts: tuple[Part, ...]  # In order.
    sources: tuple[Source, ...]  # Those of the controller's side, and with disturbances `wrench` (6,).
    torque: str  # Name of the signal (6,) [N m] that the motors give the plant.
    logged: Mapping[str, str | np.ndarray]  # As of `ControlSide`.


def loop_of(scenario: Scenario, split: bool = False) -> Loop:
    """The loop of a scenario: sensors, the controller's side, and what carries its command to the motors.

    With `split` an LQI takes the compiled solution of its Riccati equation in any case. Raises as `control_side`.
    """
    sensors = sensor_parts(scenario)
    side = control_side(scenario, split, "reading" if sensors else "plant_pose")
    sources, logged = [*side.sources], dict(side.logged)
    if scenario.disturbances:
        sources.append(Source("wrench", 6, lambda times: total_wrench(scenario.disturbances, times)))
        logged["disturbance"] = "wrench"
    way = _way_to_motors(scenario, side)
    logged["torque_applied"] = "motor_torque"
    if side.safety is not None:
        logged["safety"] = "safety"
    return Loop((*sensors, *side.parts, *way, *side.at_end), tuple(sources), "motor_torque", logged)


def sensor_parts(scenario: Scenario) -> list[Part]:
    """What makes the signal `reading`; nothing where that is the pose of the plant itself."""
    period, step = scenario.reading_period, scenario.plant.time_step
    parts = [part._replace(period=period) for part in scenario.sensors.parts(period)]
    if (steps := round(scenario.sensors.delay / step)) == 0:
        return parts
    pose, rate = scenario.start()
    legs = leg_geometry(scenario.robot, pose)
    cranks = legs.crank_angles, crank_rates(scenario.robot, legs, pose, rate)
    true = {"plant_pose": np.concatenate([pose, rate]), "crank_state": np.concatenate(cranks)}
    late: dict[str, str] = {}
    delays: list[Part] = []
    for source, first in true.items():
        if any(source == part.source(port) for part in parts for port in part.inputs):
            late[source] = f"late_{source}"
        elif not parts and source == "plant_pose":
            late[source] = "reading"
        else:
            continue
        delay = delay_part(steps, first, f"{source}_delay")._replace(period=step)
        delays.append(delay.connected(value=source).named(value=late[source]))

    def delayed(part: Part) -> Part:
        ports = {port: part.source(port) for port in part.inputs}
        return part.connected(**{port: late[str(source)] for port, source in ports.items() if source in late})

    return [*delays, *map(delayed, parts)]


def _way_to_motors(scenario: Scenario, side: ControlSide) -> list[Part]:
    """Delay, link, safety layer and motors."""
    parts: list[Part] = []
    context, step, command, age = side.context, scenario.plant.time_step, side.command, {}
    if scenario.command_delay > 0:
        delay = delay_part(scenario.command_delay, side.initial_command)
        parts.append(delay.connected(value=command).named(value="delayed"))
        command = "delayed"
    if (steps := round(scenario.motors.dead_time / step)) > 0:
        delay = delay_part(steps, side.initial_command, "motor_delay")._replace(period=step)
        parts.append(delay.connected(value=command).named(value="delayed_in_motors"))
        command = "delayed_in_motors"
    if not scenario.link.perfect:
        link = scenario.link.part(context.period, step, side.initial_command)
        parts.append(link.connected(torque=command).named(torque="arrived"))
        command, age = "arrived", {"age": "age"}
    if side.safety is not None:
        parts.append(side.safety.connected(command=command, **age))
        command = "safe_torque"
    elif scenario.controller.code is not None or scenario.link.faults:
        # Motors would cut an infinite torque to one that looks valid; our own controllers never give one.
        finite = _FINITE._replace(constants={"what": scenario.motors.takes}, period=step)
        parts.append(finite.connected(command=command))
        command = "checked"
    motors = scenario.motors.part(scenario.robot, step)
    return [*parts, motors.connected(command=command).named(torque="motor_torque")]


def control_side(options: ControlOptions, split: bool = False, reading: str = "reading") -> ControlSide:
    """The controller's side, from its own options alone; it reads the signal `reading`.

    Raises:
        ConfigurationError: A weights file that is missing or corrupt; a user's code that cannot be used; an observer
            that would have to look too far ahead; with `split`, the other solver.
    """
    if split and getattr(options.controller, "solver", None) == "drake":
        allowed = "split, or null for what runs without Drake: the closed form, and Controller"
        raise ConfigurationError("controller.solver", "drake", allowed)
    return _Builder(options, split, reading).side()


def context_of(options: ControlOptions, split: bool = False) -> LoopContext:
    """What the parts of the controller's side are made for; `split` as in `loop_of`."""
    belief, tuner = options.belief, options.tuner.opened()
    friction, period, expected = belief.friction, options.controller.period, options.estimator.disturbance_density
    pose, rate = options.start()
    return LoopContext(
        robot=belief.robot,
        gravity=belief.gravity,
        period=period,
        pose=pose,
        pose_rate=rate,
        initial_torque=standing_torque(belief.robot, pose, belief.gravity),
        delay=belief.delay,
        reading_age=belief.reading_age,
        latency=belief.reading_age + period * (1 + belief.delay) + belief.motors.dead_time,
        reading=belief.reading_size,
        noise=max(belief.noise, SMALLEST_NOISE),
        friction=np.zeros(1, BELIEVED) if friction is None else friction.record(),
        motors=belief.motors,
        compensation=friction,
        tuner=tuner,
        disturbance=expected,
        feedback=options.controller.feedback,
        split=split,
    )


class _Builder:
    """Adds the parts of the controller's side in order; what one adds the next ones connect to by name."""

    def __init__(self, options: ControlOptions, split: bool, reading: str) -> None:
        self.options, self.context, self.reading = options, context_of(options, split), reading
        self.friction = options.belief.friction
        self.parts: list[Part] = []
        self.logged: dict[str, str | np.ndarray] = {"reference": "reference"}
        if reading != "plant_pose":
            self.logged["reading" if self.context.reading == 6 else "pose_reading"] = reading
        self.at_end: list[Part] = []

    def side(self) -> ControlSide:
        options, context = self.options, self.context

        def motion(times: np.ndarray) -> np.ndarray:
            return np.concatenate(options.reference.evaluate(times), axis=-1)

        sources = [Source("reference", 18, motion)]
        if options.preview > 0.0:
            shift = options.preview
            sources.append(Source("reference_ahead", 18, lambda times: motion(times + shift)))
        self.add_estimator()
        self.add_controller()
        self.add_command()
        command = self.add_inverse()
        self.add_tuner()
        learnt = self.add_adaptation(command)
        safety = None if options.safety is None else self.safety(options.safety).connected(**learnt)
        parts, at_end, initial = tuple(self.parts), tuple(self.at_end), options.belief.motors.initial_command(context)
        names = self.reading, "torque", command, options.belief.motors.unit
        return ControlSide(context, parts, at_end, tuple(sources), *names, initial, safety, self.logged)

    def add_estimator(self) -> None:
        """What the controller gets of the readings."""
        options = self.options.estimator
        parts = [
            part._replace(period=options.period).connected(reading=self.reading)
            for part in options.parts(self.context.ticking(options.period))
        ]
        self.parts.extend(self._fault_tolerant(part, "sensor_health") for part in parts)
        self.measurement = "measurement" if parts else self.reading
        self.logged["measurement"] = self.measurement
        self.observes = any("predicted" in part.outputs for part in parts)
        if self.observes:
            self.logged["innovation"] = "innovation"

    def add_controller(self) -> None:
        """From measurement and reference to a torque."""
        context = self.context
        slower = context.tuner.period
        self.tuning = [part._replace(period=slower) for part in context.tuner.parts(context.ticking(slower))]
        self.sees: dict[str, str | np.ndarray] = {
            "measurement": "predicted" if self.observes else self.measurement,
            "reference": "reference_ahead" if self.options.preview > 0.0 else "reference",
            "weights": "weights" if self.tuning else np.array(context.tuner.weights),
        }
        now = self.sees.copy()
        if self.options.controller.looks_ahead:
            if self.observes:
                allowed = "one that tells what was read, such as difference, for controller.feedforward motion"
                raise ConfigurationError("estimator.kind", self.options.estimator.kind, allowed)
            now = {"measurement": self.sees["measurement"]}
        if not self.options.controller.feedback:
            now, self.sees["measurement"] = {"measurement": self.measurement}, np.zeros(12)
            if self.options.adaptation is not None:
                self.parts.append(lead_part(context.period).connected(reference=self.sees["reference"]))
                self.sees["reference"] = "aimed"
        # Without feedback what an observer finds stays in the log.
        self.corrects = self.observes and self.options.controller.feedback
        self.compensated = self.corrects or self.friction is not None
        (part,) = self.options.controller.parts(context)
        part = part.connected(reference_now=now.get("reference", "reference"), **self.sees)
        if self.compensated:
            part = part.named(torque="control_torque")
        self.weighted = "weights" in part.inputs
        self.parts += TRACKING_ERROR.connected(**now), self._fault_tolerant(part, "controller_health")
        integral = "integral" if "integral" in part.outputs else np.zeros(6)
        self.logged |= {"torque": "torque", "error": "error", "integral": integral}

    def add_command(self) -> None:
        """What is added to a controller's torque: against friction, and against what an observer cannot explain."""
        context, friction = self.context, self.friction
        added: dict[str, str | np.ndarray] = {"friction_torque": np.zeros(6), "disturbance_torque": np.zeros(6)}
        if friction is not None:
            self.parts.append(friction.part(context).connected(**self.sees))
            added["friction_torque"] = "friction_torque"
        if self.corrects:
            added["disturbance_torque"] = "disturbance_torque"
        if self.observes:
            self.at_end.append(_net_torque_part(context.robot.effort_limits, context.initial_torque).connected(**added))
        if self.compensated:
            self.parts.append(_COMMAND.connected(**added))

    def add_inverse(self) -> str:
        """What the motors must be told to give the torque that is wanted; the name of that command."""
        motors = self.options.belief.motors
        inverse = motors.inverse_parts(self.context)
        if inverse and self.options.safety is not None:
            # It stands behind the link, and looks at torques.
            allowed = f"motors that take torque [N m], with a safety layer; these take {motors.takes} [{motors.unit}]"
            raise ConfigurationError("motors.kind", motors.kind, allowed)
        self.parts.extend(part.connected(**self.sees) for part in inverse)
        if not inverse:
            return "torque"
        self.logged[f"commanded_{motors.takes}"] = "command"
        return "command"

    def add_tuner(self) -> None:
        """Densities, and the weights that a controller takes; nothing for one that takes none."""
        if not self.weighted:
            return
        self.parts.append(self.context.tuner.density_part())
        self.logged |= {"density": "density", "weights": self.sees["weights"]}
        for part in self.tuning:
            self.at_end.append(part.connected(reference=self.sees["reference"]))
            if "setting" in part.outputs:
                self.logged["setting"] = "setting"
            if "disturbance" in part.outputs:
                # The tuner says what the observer is to expect.
                self.parts = [each.connected(disturbance=part.signal("disturbance")) for each in self.parts]

    def add_adaptation(self, command: str) -> dict[str, str]:
        """What learns while it runs; its outputs, which take the places of constants that have their names."""
        options = self.options.adaptation
        if options is None:
            return {}
        at = self.sees | {"reading": self.reading, "command": command}
        parts = [part.connected(**at) for part in options.parts(self.context)]
        learnt = {output: part.signal(output) for part in parts for output in part.outputs}
        places = {name for part in (*self.parts, *self.at_end) for name in part.constants}
        if not learnt.keys() & places:
            allowed = f"one of whose outputs is called as a constant of a part of this loop: {join_or(sorted(places))}"
            raise ConfigurationError("adaptation.kind", options.kind, allowed)
        self.parts = [
            part.connected(**{name: learnt[name] for name in part.constants if name in learnt}) for part in self.parts
        ]
        self.at_end.extend(part._replace(end_of_tick=True) for part in parts)
        self.logged |= {name: learnt[name] for name in LEARNT_SIGNALS if name in learnt}
        return learnt

    def safety(self, options: SafetyOptions) -> Part:
        """The safety layer, which gets the command that arrives at the motors."""
        sources: dict[str, str | np.ndarray] = {"measurement": self.measurement}
        if self.context.reading == 6:
            sources["angles"] = self.reading
        if self.observes and self.context.reading == 12:
            sources["pose_reading"] = self.reading
        for health in {"sensor_health", "controller_health"} & {each.signal("health") for each in self.parts}:
            sources[health] = health
        return safety_part(options, self.context).connected(**sources).named(torque="safe_torque")

    def _fault_tolerant(self, part: Part, health: str) -> Part:
        """A part whose failing ticks the safety layer hears of, where there is one."""
        if self.options.safety is None or part.system is not None:
            return part
        return part._replace(outputs=(*part.outputs, "health"), fault_tolerant=True).named(health=health)


# --- parts that no room has ---


@njit
def _add_torques(control: Any, disturbance_torque: Any, friction: Any, states: Any) -> None:
    state = record(states)
    for i in range(6):
        state.torque[i] = control[i] + disturbance_torque[i] + friction[i]


_COMMAND = Part(
    "command",
    _add_torques,
    {},
    {"control_torque": 6, "disturbance_torque": 6, "friction_torque": 6},
    ("torque",),
    new_record(fields(torque=6)),
)
"""The torque asked for: a controller's, what an observer adds, and what makes up for friction."""


@njit
def _store_net_torque(limit: Any, torque: Any, friction: Any, states: Any) -> None:
    record(states).net_torque[:] = within_limit(torque, limit) - friction


def _net_torque_part(limit: np.ndarray, initial: np.ndarray) -> Part:
    """The command of a tick less what friction takes of it, for the observer at the next one.

    What the motors cannot give is cut by them, or by the safety layer, which has to see it.
    """
    first, inputs = new_record(fields(net_torque=6), net_torque=initial), {"torque": 6, "friction_torque": 6}
    return Part("net_torque", _store_net_torque, {"limit": limit}, inputs, ("net_torque",), first, end_of_tick=True)


def _finite_tick(what: str, asked: np.ndarray, state: np.ndarray) -> None:
    if not np.isfinite(asked).all():
        raise NotFiniteError(what, asked.copy())
    state["checked"][0] = asked


_FINITE = Part("finite", _finite_tick, {"what": "torque"}, {"command": 6}, ("checked",), new_record(fields(checked=6)))
"""Ends a run whose commands, `what` they are, are no numbers, where there is no safety layer."""
