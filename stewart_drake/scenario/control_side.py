"""The controller's side of a loop: its parts in order, and the signals between them.

Every kind of estimator, controller and tuner gives its parts, see `LoopContext`; this file does not know the kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import join_or
from stewart_drake.control.ball_control import BallControlOptions
from stewart_drake.control.base import LEARNT_SIGNALS, TRACKING_ERROR, AdaptationOptions
from stewart_drake.control.base_reading import informed, level_part
from stewart_drake.control.feedforward import lead_part
from stewart_drake.control.friction_compensation import FrictionCompensation, standing_torque
from stewart_drake.control.observer import SMALLEST_NOISE
from stewart_drake.loop.part import LoopContext, Part
from stewart_drake.safety import safety_part
from stewart_drake.safety.lost_encoder import going_parts
from stewart_drake.safety.stream import StreamReference
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.small_parts import COMMAND, net_torque_part

_UNTURNED = "unturned_"
"""Before the name of a reference's signal, before it is turned against a moving base, or tilted for a ball."""
Signal = str | np.ndarray
"""Name of a signal, or constant numbers in its place."""


class Source(NamedTuple):
    """A signal that is a function of time alone: its name, its size, and times (n,) [s] -> values (n, size)."""

    signal: str
    size: int
    evaluate: Callable[[np.ndarray], np.ndarray]


class ControlSide(NamedTuple):
    """The parts that run on the robot's computer, from a reading to the commanded torque."""

    context: LoopContext
    parts: tuple[Part, ...]  # In order.
    at_end: tuple[Part, ...]  # Parts that run at the end of a tick.
    # `reference` (18,), and where an observer looks ahead `reference_ahead` (18,).
    sources: tuple[Source, ...]
    reading: str  # Name of the reading.
    torque: str  # Name of the signal (6,) [N m] of the commanded torque.
    command: str  # Name of the signal (6,) that goes to the motors, which is that torque where they take one.
    unit: str  # Unit of the command.
    initial_command: np.ndarray  # (6,) until the first one arrives.
    safety: Part | None  # The safety layer, for the signal at `command`.
    logged: Mapping[str, str | np.ndarray]  # Signals by their names in a log; an array stays as it is.

    @property
    def outside(self) -> dict[str, int]:
        """Signals that this side reads, and their sizes."""
        sensors = {"imu": 6, "ball_reading": 2}
        others = {name: size for name, size in sensors.items() if any(name in part.inputs for part in self.parts)}
        sources = {source.signal: source.size for source in self.sources}
        return {self.reading: self.context.reading, **others, **sources}

    @property
    def every_part(self) -> tuple[Part, ...]:
        """All but the safety layer."""
        return (*self.parts, *self.at_end)


def control_side(
    options: ControlOptions,
    split: bool = False,
    reading: str = "reading",
    senses_base: bool = False,
    streams: bool = False,
) -> ControlSide:
    """The controller's side, from its options alone; it reads the signal `reading`, and maybe `base_reading`.

    With `streams` a reference of kind stream is a part, which gets targets from the signal `target`.

    Raises:
        ConfigurationError: A weights file that is missing or corrupt; a user's code that cannot be used; an observer
            that would have to look too far ahead; with `split`, the other solver.
    """
    if split and getattr(options.controller, "solver", None) == "drake":
        allowed = "split, or null for what runs without Drake: the closed form, and Controller"
        raise ConfigurationError("controller.solver", "drake", allowed)
    if options.base_compensation != "none" and not senses_base:
        allowed = "none, for a controller without a simulation: nothing gives it the motion of the base"
        raise ConfigurationError("base_compensation", options.base_compensation, allowed)
    return _wired(options, context_of(options, split), reading, streams)


def context_of(options: ControlOptions, split: bool = False) -> LoopContext:
    """Robot, clock and neighbours for the parts of the controller's side; `split` as in `loop_of`."""
    model, tuner = options.controller_model, options.tuner.opened()
    period, expected = options.controller.period, options.estimator.disturbance_density
    pose, rate = options.start()
    return LoopContext(
        robot=model.robot,
        gravity=model.gravity,
        period=period,
        pose=pose,
        pose_rate=rate,
        initial_torque=standing_torque(model.robot, pose, model.gravity),
        delay=model.delay,
        reading_age=model.reading_age,
        latency=model.reading_age + period * (1 + model.delay) + model.motors.dead_time,
        reading=model.reading_size,
        noise=max(model.noise, SMALLEST_NOISE),
        friction=model.friction or FrictionCompensation(),
        motors=model.motors,
        tuner=tuner,
        disturbance=expected,
        feedback=options.controller.feedback,
        split=split,
        imu=model.imu,
        ball=model.ball,
    )


class _Wiring:
    """Parts of the controller's side, added in the order of signals within a tick; every method adds a stage.

    An attribute of type `Signal` holds a signal's name, or an array where no part gives that signal.
    """

    def __init__(self, options: ControlOptions, context: LoopContext, reading: str) -> None:
        self.options, self.context, self.reading = options, context, reading
        self.parts: list[Part] = []
        self.end: list[Part] = []
        self.logged: dict[str, Signal] = {"reference": "reference"}
        if reading != "plant_pose":
            self.logged["reading" if context.reading == 6 else "pose_reading"] = reading
        self.command = "torque"
        self.used: dict[str, str] = {}

    def add_reference(self, streams: bool) -> None:
        """The reference, as it is when a command acts."""
        self.sources, levels = _references(self.options)
        self.reference = self.sources[-1].signal.removeprefix(_UNTURNED)
        if streams and isinstance(motion := self.options.reference, StreamReference):
            ahead = self.options.preview
            self.parts.append(motion.part(ahead))
            self.sources = (Source("target", 6, lambda times: motion.targets(times + ahead)),)
        self.parts += levels
        if (ball := self.options.ball_control) is not None:
            self._add_ball(ball)
        self.before_estimator = len(self.parts)

    def _add_ball(self, options: BallControlOptions) -> None:
        """What tilts the reference for a ball."""
        preview, motion = self.options.preview, (self.sources[0].signal, self.sources[-1].signal)
        part = options.part(self.context, preview).connected(motion=motion[0], motion_ahead=motion[1])
        self.parts.append(part)
        late = float(part.parameters["params"]["late"][0]) * self.context.period
        self.sources += (Source("ball_target", 10, lambda times: options.target.evaluate(times + late)),)
        self.logged |= {name: name for name in ("ball_target", "ball_estimate")}

    def add_estimator(self) -> None:
        """From a reading to pose and rate, now and when a command will act."""
        period = self.options.estimator.period
        parts = [
            _reporting(part._replace(period=period).connected(reading=self.reading), "sensor_health", self.options)
            for part in self.options.estimator.parts(self.context.ticking(period))
        ]
        self.measurement = self.logged["measurement"] = "measurement" if parts else self.reading
        self.estimator = {part.name for part in parts}
        if any("imu" in part.inputs for part in parts):
            self.logged["imu"] = "imu"
        self.observed = any("predicted" in part.outputs for part in parts)
        if self.observed:
            self.logged["innovation"] = "innovation"
        self.parts += parts

    def add_controller(self) -> None:
        """The tracking error, and the law. A controller without feedback uses neither measurement nor disturbance."""
        controller, reference = self.options.controller, self.reference
        at = {"measurement": "predicted" if self.observed else self.measurement, "reference": reference}
        self.law_inputs: dict[str, Signal] = dict(at)
        if controller.looks_ahead or not controller.feedback:
            at = {"measurement": self.measurement, "reference": "reference"}
        if controller.looks_ahead and self.observed:
            allowed = "one that tells what was read, such as difference, for controller.feedforward motion"
            raise ConfigurationError("estimator.kind", self.options.estimator.kind, allowed)
        if not controller.feedback:
            self.law_inputs["measurement"] = np.zeros(12)
            if self.options.adaptation is not None:
                self.parts.append(lead_part(self.context.period).connected(reference=reference))
                self.law_inputs["reference"] = self.reference = "shifted_reference"
        period = self.context.tuner.period
        self.tuner = [part._replace(period=period) for part in self.context.tuner.parts(self.context.ticking(period))]
        self.law_inputs["weights"] = "weights" if self.tuner else np.array(self.context.tuner.weights)
        (law,) = controller.parts(self.context)
        law = law.connected(**self.law_inputs, reference_now=at["reference"])
        self.has_weights, has_integral = "weights" in law.inputs, "integral" in law.outputs
        self.logged |= {"torque": "torque", "error": "error", "integral": "integral" if has_integral else np.zeros(6)}
        self.parts.append(TRACKING_ERROR.connected(**at))
        self._add_torques(_reporting(law, "controller_health", self.options))

    def _add_torques(self, law: Part) -> None:
        """The law, and torques added to its own: against friction, and against an observed disturbance."""
        corrected = self.observed and self.options.controller.feedback
        friction = self.options.controller_model.friction
        added: dict[str, Signal] = {"friction_torque": np.zeros(6), "disturbance_torque": np.zeros(6)}
        if corrected:
            added["disturbance_torque"] = "disturbance_torque"
        if corrected or friction is not None:
            law = law.named(torque="control_torque")
        self.parts.append(law)
        if friction is not None:
            self.parts.append(friction.part(self.context).connected(**self.law_inputs))
            added["friction_torque"] = "friction_torque"
        if corrected or friction is not None:
            self.parts.append(COMMAND.connected(**added))
        if self.observed:
            limits = self.context.robot.effort_limits
            self.end.append(net_torque_part(limits, self.context.initial_torque).connected(**added))

    def add_motors(self) -> None:
        """The command with which the motors give the torque."""
        motors = self.context.motors
        linked = [part.connected(**self.law_inputs) for part in motors.inverse_parts(self.context)]
        inverse = [_reporting(part, "command_health", self.options) if part.statuses else part for part in linked]
        if inverse and motors.by_torque and self.options.safety is not None:
            takes = f"these take {motors.command_quantity} [{motors.unit}], and have `by_torque`"
            allowed = f"motors that take torque [N m], or whose `gains` tell their torque, with a safety layer; {takes}"
            raise ConfigurationError("motors.kind", motors.kind, allowed)
        if inverse:
            self.command = "command"
            self.logged[f"commanded_{motors.command_quantity}"] = self.command
        self.parts += inverse

    def add_tuner(self) -> None:
        """Densities and tuner, for a law with weights; the tuner may set the disturbance that an observer expects."""
        if not self.has_weights:
            return
        self.parts.append(self.context.tuner.density_part())
        self.logged |= {"density": "density", "weights": self.law_inputs["weights"]}
        for part in self.tuner:
            self.end.append(part.connected(reference=self.reference))
            if "setting" in part.outputs:
                self.logged["setting"] = "setting"
            if "disturbance" in part.outputs:
                setting = {"disturbance": part.signal("disturbance")}
                self.parts = [made.connected(**setting) if made.name in self.estimator else made for made in self.parts]

    def add_safety(self) -> list[Part]:
        """The safety layer, whose input is the command that arrives at the motors; none without `safety`."""
        safety, context = self.options.safety, self.context
        if safety is None:
            return []
        seen = {"measurement": self.measurement}
        if context.reading == 6:
            seen["angles"] = self.reading
        elif self.observed:
            seen["pose_reading"] = self.reading
        seen |= {signal: signal for part in self.parts if (signal := part.signal("health")) != "health"}
        layer = [safety_part(safety, context).connected(**seen).named(torque="safe_torque")]
        period, preview = self.options.reading_period, self.options.preview
        if parts := going_parts(safety, context, period, preview):
            # The first part comes before all that reads, and its signals replace those that it gets.
            first, last = parts
            ahead = "reference_ahead" if preview > 0.0 else "reference"
            used = {self.reading: "used_reading", "reference": "used_reference"}
            self.used = used | {"reference_ahead": "used_reference_ahead"}
            n = self.before_estimator
            rest, layer, self.end = (self.replaced(made) for made in (self.parts[n:], layer, self.end))
            expected: Signal = np.zeros(1)
            for k, part in enumerate(rest):
                if part.name in self.estimator and "disturbance" in part.inputs:
                    expected, rest[k] = part.source("disturbance"), part.connected(disturbance="used_disturbance")
            first = first.connected(reading=self.reading, reference_ahead=ahead, disturbance=expected)
            self.parts = [*self.parts[:n], first, *rest]
            self.end.append(last.connected(measurement=self.measurement))
            layer = [part.connected(parity="parity") for part in layer]
            self.logged |= {"imu": "imu", "reference": "used_reference"}
        return layer

    def replaced(self, parts: Iterable[Part]) -> list[Part]:
        """The parts, with inputs of `used` in the place of the signals that these replace."""
        used = self.used
        inputs = [{port: part.source(port) for port in part.inputs} for part in parts]
        named = [
            {port: used.get(name, name) for port, name in ports.items() if isinstance(name, str)} for ports in inputs
        ]
        return [part.connected(**ports) for part, ports in zip(parts, named, strict=True)]

    def add_writers(self, layer: list[Part]) -> list[Part]:
        """What writes parameters of all these parts: a sensor of the base, and adaptive laws. The changed layer."""
        if self.options.base_compensation != "none":
            (parts, writers), (layer, more), (self.end, others) = map(informed, (self.parts, layer, self.end))
            self.parts = [*writers, *more, *others, *parts]
        if (adaptation := self.options.adaptation) is None:
            return layer
        at = self.law_inputs | {"reading": self.reading, "command": self.command}
        made = [part.connected(**at)._replace(end_of_tick=True) for part in adaptation.parts(self.context)]
        laws = self.replaced(made)
        self.end += laws
        outputs = {output: part.signal(output) for part in laws for output in part.outputs}
        self.logged |= {name: outputs[name] for name in LEARNT_SIGNALS if name in outputs}
        written = _written([*self.parts, *layer], adaptation, laws)
        self.parts = written[: len(self.parts)]
        return written[len(self.parts) :]


def _wired(options: ControlOptions, context: LoopContext, reading: str, streams: bool) -> ControlSide:
    side = _Wiring(options, context, reading)
    side.add_reference(streams)
    side.add_estimator()
    side.add_controller()
    side.add_motors()
    side.add_tuner()
    layer = side.add_writers(side.add_safety())
    motors, last = context.motors, layer[0] if layer else None
    initial, parts, end = motors.initial_command(context), tuple(side.parts), tuple(side.end)
    ends = parts, end, side.sources, reading, "torque", side.command, motors.unit, initial, last
    return ControlSide(context, *ends, side.logged)


def _references(options: ControlOptions) -> tuple[tuple[Source, ...], list[Part]]:
    """The reference as it is now and, where the controller looks ahead, as it is when its command acts.

    With the parts that turn it against a moving base.
    """

    def motion(times: np.ndarray) -> np.ndarray:
        return np.concatenate(options.reference.evaluate(times), axis=-1)

    level = options.base_compensation == "level"
    prefix, preview = _UNTURNED if level or options.ball_control is not None else "", options.preview
    now = Source(f"{prefix}reference", 18, motion)
    ahead = Source(f"{prefix}reference_ahead", 18, lambda times: motion(times + preview))
    sources = (now, ahead) if preview > 0.0 else (now,)
    leads = zip(sources, (0.0, preview), strict=False)
    return sources, [level_part(s.signal, s.signal.removeprefix(prefix), lead) for s, lead in leads if level]


def _reporting(part: Part, health: str, options: ControlOptions) -> Part:
    """A part that reports failed ticks to the safety layer, where there is one."""
    if options.safety is None or part.system is not None:
        return part
    return part._replace(outputs=(*part.outputs, "health"), fault_tolerant=True).named(health=health)


def _written(parts: Sequence[Part], options: AdaptationOptions, laws: Sequence[Part]) -> list[Part]:
    """The parts, with outputs of adaptive laws as the parameters that `options.writes` lists."""
    changed, is_of_use = {part.name: part for part in parts}, False
    known = sorted(f"{part.name}.{parameter}" for part in parts for parameter in part.parameters)
    listed = (
        (law, output, place) for law in laws for output in law.outputs for place in options.writes.get(output, ())
    )
    for law, output, place in listed:
        name, _, parameter = place.partition(".")
        if place in known:
            changed[name].check_signal(parameter, law.initial.dtype[output])
            changed[name], is_of_use = changed[name].connected(**{parameter: law.signal(output)}), True
        elif name in changed and name not in ("controller", "estimator"):  # Some kinds do not use these.
            raise ConfigurationError(f"adaptation.writes.{output}", place, join_or(known))
    if not is_of_use:
        allowed = f"one that writes parameters that are in this loop: {join_or(known)}"
        raise ConfigurationError("adaptation.kind", options.kind, allowed)
    return list(changed.values())
