"""From a scenario to its loop: the ordered list of parts, and the signals between them.

The order is that in which signals run within a tick: sensors, estimator, controller, torques added to its own,
densities, delay, link, safety layer, motors; at last the parts that act from the next tick on. Every kind of sensor,
estimator, controller and tuner gives its parts, see `LoopContext`; this file does not know the kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import join_or
from stewart_drake.control.base import LEARNT_SIGNALS, TRACKING_ERROR, AdaptationOptions
from stewart_drake.control.base_reading import informed, level_part
from stewart_drake.control.feedforward import lead_part
from stewart_drake.control.friction_compensation import FrictionCompensation, standing_torque
from stewart_drake.control.observer import SMALLEST_NOISE
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.imu import imu_parts
from stewart_drake.hardware.motors import delay_part
from stewart_drake.hardware.moving_base import base_signal
from stewart_drake.loop.part import NOTHING, LoopContext, Part
from stewart_drake.mechanics.kinematics import crank_rates, leg_geometry
from stewart_drake.safety import SafetyOptions, safety_part
from stewart_drake.safety.parity import parity_part
from stewart_drake.safety.stream import StreamReference
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.scenario.small_parts import COMMAND, FINITE, net_torque_part, scaled

_UNTURNED = "unturned_"
"""Before the name of a reference's signal, before it is turned against a moving base."""
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
        imu = {"imu": 6} if any("imu" in part.inputs for part in self.parts) else {}
        return {self.reading: self.context.reading, **imu, **{source.signal: source.size for source in self.sources}}

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
    sources: tuple[Source, ...]  # Of the controller's side; `wrench`, `base`.
    torque: str  # Name of the signal (6,) [N m] that the motors give the plant.
    logged: Mapping[str, str | np.ndarray]  # See `ControlSide.logged`.
    inputs: Mapping[str, np.ndarray] = NOTHING  # Signals from outside, with their first values.


def loop_of(scenario: Scenario, split: bool = False) -> Loop:
    """The loop of a scenario: sensors, the controller's side, and the path of its command to the motors.

    With `split` an LQI takes the compiled solution of its Riccati equation in any case. Raises as `control_side`.
    """
    sensors = sensor_parts(scenario)
    side = control_side(scenario, split, "reading" if sensors else "plant_pose", scenario.base.sensor is not None)
    outside, logged = _outside(scenario), dict(side.logged)
    names = {"wrench": "disturbance", "base_motion": "base_motion"}
    logged |= {names[source.signal]: source.signal for source in outside if source.signal in names}
    way = command_path(scenario, side.command, side.initial_command, side.context.period, side.safety)
    logged["torque_applied"] = "motor_torque"
    if scenario.sensors.imu is not None:
        logged["imu"] = "imu"
    if side.safety is not None:
        logged["safety"] = "safety"
    of_base = scenario.base.sensor_parts(scenario.gravity_in_base, side.context.period, scenario.plant.time_step)
    parts = *sensors, *of_base, *side.parts, *way, *side.at_end
    return Loop(parts, (*side.sources, *outside), "motor_torque", logged)


def machine_side(scenario: Scenario) -> Loop:
    """All but the controller's side: from an input `command` (6,), which may change at any step, to the reading.

    Sensors run at the beginning of a step of the plant, what takes the command at its end.
    """
    sensors, step = sensor_parts(scenario), scenario.plant.time_step
    first = scenario.controller_model.motors.initial_command(context_of(scenario, split=True))
    way = [part._replace(end_of_tick=True) for part in command_path(scenario, "command", first, step)]
    reading = {"reading": "reading" if sensors else "plant_pose"}
    if scenario.sensors.imu is not None:
        reading["imu"] = "imu"
    return Loop((*sensors, *way), _outside(scenario), "motor_torque", reading, {"command": first})


def _outside(scenario: Scenario) -> tuple[Source, ...]:
    """External wrenches; and the motion of the base, `base` in the middle of a step of the plant."""
    pushes, base, sources = scenario.disturbances, scenario.base, list[Source]()
    if pushes:
        sources.append(Source("wrench", 6, lambda times: total_wrench(pushes, times)))
    if (motion := base.motion) is not None:
        gravity, half = scenario.gravity_in_base, 0.5 * scenario.plant.time_step
        sources.append(Source("base", 9, lambda times: base_signal(motion, gravity, times + half)[:, :9]))
        sources.append(Source("base_motion", 12, lambda times: base_signal(motion, gravity, times)))
    return tuple(sources)


def sensor_parts(scenario: Scenario) -> list[Part]:
    """Parts that compute the signals `reading`, none if it is the pose of the plant, and `imu`, if there is one."""
    imu, parts, gravity = scenario.sensors.imu, _reading_parts(scenario), scenario.gravity_in_base
    if imu is None:
        return parts
    first = {"plant_pose": np.concatenate(scenario.start())}
    if (motion := scenario.base.motion) is not None:
        first["base_motion"] = base_signal(motion, gravity, np.zeros(1))[0]
    return [*parts, *imu_parts(imu, gravity, scenario.plant.time_step, scenario.reading_period, first)]


def _reading_parts(scenario: Scenario) -> list[Part]:
    period, step = scenario.reading_period, scenario.plant.time_step
    parts = [part._replace(period=period) for part in scenario.sensors.parts(period)]
    gain = servo_gain_error(scenario)
    if scenario.sensors.reading == "angles" and (gain != 1.0).any():
        parts = [
            part.named(reading="servo_reading")
            if "reading" in part.outputs and part.signal("reading") == "reading"
            else part
            for part in parts
        ]
        parts.append(scaled(1.0 / gain, "servo_reading", "reading")._replace(period=period))
    if (steps := round(scenario.sensors.delay / step)) == 0:
        return parts
    pose, rate = scenario.start()
    legs = leg_geometry(scenario.robot, pose)
    cranks = legs.crank_angles, crank_rates(scenario.robot, legs, pose, rate)
    true = {"plant_pose": np.concatenate([pose, rate]), "crank_state": np.concatenate(cranks)}
    read = {str(part.source(port)) for part in parts for port in part.inputs} if parts else {"plant_pose"}
    late = {source: f"late_{source}" if parts else "reading" for source in true if source in read}
    delays = [
        delay_part(steps, true[source], f"{source}_delay")
        ._replace(period=step)
        .connected(value=source)
        .named(value=name)
        for source, name in late.items()
    ]
    ports = [{port: str(part.source(port)) for port in part.inputs} for part in parts]
    moved = [{port: late[source] for port, source in inputs.items() if source in late} for inputs in ports]
    return [*delays, *(part.connected(**inputs) for part, inputs in zip(parts, moved, strict=True))]


def servo_gain_error(scenario: Scenario) -> np.ndarray:
    """(6,) [-] angles of the cranks over those that the controller's side commands and reads.

    Commands and readings on that side are corrected by the model's gains; the servos have the simulated robot's.
    """
    return np.asarray(scenario.robot.servo_gains / scenario.controller_model.robot.servo_gains)


def command_path(
    scenario: Scenario, command: str, first: np.ndarray, period: float, safety: Part | None = None, bus: bool = True
) -> list[Part]:
    """Delay, link, safety layer and motors: from the signal `command` (6,), new in every period [s], to `motor_torque`.

    Until the first command arrives it is `first` (6,). Without `bus` there are the motors alone, with their dead time.
    """
    parts: list[Part] = []
    tick, step, age = scenario.controller.period, scenario.plant.time_step, {}
    dead, late = scenario.motors.dead_time, scenario.command_delay * tick if bus else 0.0
    for name, ticks, clock in (("command_delay", late / period, period), ("motor_delay", dead / step, step)):
        if round(ticks) > 0:
            delay = delay_part(round(ticks), first, name)._replace(period=clock)
            parts.append(delay.connected(value=command).named(value=name))
            command = name
    if bus and not scenario.link.perfect:
        parts.append(scenario.link.part(tick, step, first).connected(torque=command).named(torque="arrived"))
        command, age = "arrived", {"age": "age"}
    if safety is not None:
        parts.append(safety.connected(command=command, **age))
        command = "safe_torque"
    elif scenario.controller.code is not None or scenario.link.faults:
        # Motors would cut an infinite torque to one that looks valid. The package's controllers never give one.
        finite = FINITE._replace(constants={"what": scenario.motors.command_quantity}, period=step)
        parts.append(finite.connected(command=command))
        command = "checked"
    gain = servo_gain_error(scenario)
    if scenario.motors.holds and (gain != 1.0).any():
        parts.append(scaled(gain, command, "turned_command")._replace(period=step))
        command = "turned_command"
    motors = scenario.motors.part(scenario.robot, step)
    return [*parts, motors.connected(command=command).named(torque="motor_torque")]


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
    return wire(options, context_of(options, split), reading, streams)


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
    )


def wire(options: ControlOptions, context: LoopContext, reading: str = "reading", streams: bool = False) -> ControlSide:
    """Parts of the controller's side in the order of signals within a tick, then those of its end.

    It is one function so that the names of signals are its variables: a variable called like a signal holds the
    signal's name, or an array where no part gives that signal.
    """
    robot, motors, safety, adaptation = context.robot, context.motors, options.safety, options.adaptation
    logged: dict[str, Signal] = {"reference": "reference"}
    if reading != "plant_pose":
        logged["reading" if context.reading == 6 else "pose_reading"] = reading

    (sources, levels), stream = _references(options), list[Part]()
    reference = sources[-1].signal.removeprefix(_UNTURNED)
    if streams and isinstance(motion := options.reference, StreamReference):
        ahead = options.preview
        stream = [motion.part(ahead)]
        sources = (Source("target", 6, lambda times: motion.targets(times + ahead)),)

    # Estimator: from a reading to pose and rate, now and when a command will act.
    period = options.estimator.period
    estimator = [
        _reporting(part._replace(period=period).connected(reading=reading), "sensor_health", safety)
        for part in options.estimator.parts(context.ticking(period))
    ]
    measurement = "measurement" if estimator else reading
    logged["measurement"] = measurement
    if any("imu" in part.inputs for part in estimator):
        logged["imu"] = "imu"
    observed = any("predicted" in part.outputs for part in estimator)
    if observed:
        logged["innovation"] = "innovation"

    # Controller, and the tracking error. A controller without feedback uses neither measurement nor disturbance.
    controller, lead = options.controller, []
    error_inputs = {"measurement": "predicted" if observed else measurement, "reference": reference}
    law_inputs: dict[str, Signal] = dict(error_inputs)
    if controller.looks_ahead or not controller.feedback:
        error_inputs = {"measurement": measurement, "reference": "reference"}
    if controller.looks_ahead and observed:
        allowed = "one that tells what was read, such as difference, for controller.feedforward motion"
        raise ConfigurationError("estimator.kind", options.estimator.kind, allowed)
    if not controller.feedback:
        law_inputs["measurement"] = np.zeros(12)
        if adaptation is not None:
            lead = [lead_part(context.period).connected(reference=reference)]
            law_inputs["reference"] = reference = "shifted_reference"
    period = context.tuner.period
    tuner = [part._replace(period=period) for part in context.tuner.parts(context.ticking(period))]
    law_inputs["weights"] = "weights" if tuner else np.array(context.tuner.weights)
    (law,) = controller.parts(context)
    law = law.connected(**law_inputs, reference_now=error_inputs["reference"])
    tracking_error = TRACKING_ERROR.connected(**error_inputs)
    logged |= {
        "torque": "torque",
        "error": "error",
        "integral": "integral" if "integral" in law.outputs else np.zeros(6),
    }

    # Torques added to that of the controller: against friction, and against an observed disturbance.
    corrected, friction = observed and controller.feedback, options.controller_model.friction
    added: dict[str, Signal] = {"friction_torque": np.zeros(6), "disturbance_torque": np.zeros(6)}
    additions, end = [], []
    if friction is not None:
        additions.append(friction.part(context).connected(**law_inputs))
        added["friction_torque"] = "friction_torque"
    if corrected:
        added["disturbance_torque"] = "disturbance_torque"
    if corrected or friction is not None:
        law = law.named(torque="control_torque")
        additions.append(COMMAND.connected(**added))
    if observed:
        end.append(net_torque_part(robot.effort_limits, context.initial_torque).connected(**added))

    # Command with which the motors give that torque.
    inverse = [part.connected(**law_inputs) for part in motors.inverse_parts(context)]
    if inverse and safety is not None:
        # The layer is behind the link, and its limits are torques.
        allowed = (
            f"motors that take torque [N m], with a safety layer; these take {motors.command_quantity} [{motors.unit}]"
        )
        raise ConfigurationError("motors.kind", motors.kind, allowed)
    command = "command" if inverse else "torque"
    if inverse:
        logged[f"commanded_{motors.command_quantity}"] = command

    # Densities and tuner, for a controller with weights; the tuner may set the disturbance that an observer expects.
    density = []
    if "weights" in law.inputs:
        density = [context.tuner.density_part()]
        logged |= {"density": "density", "weights": law_inputs["weights"]}
        for part in tuner:
            end.append(part.connected(reference=reference))
            if "setting" in part.outputs:
                logged["setting"] = "setting"
            if "disturbance" in part.outputs:
                estimator = [made.connected(disturbance=part.signal("disturbance")) for made in estimator]

    law = _reporting(law, "controller_health", safety)
    parts = [*stream, *levels, *estimator, *lead, tracking_error, law, *additions, *inverse, *density]

    # Safety layer: its input is the command that arrives at the motors.
    layer = []
    if safety is not None:
        seen = {"measurement": measurement}
        if context.reading == 6:
            seen["angles"] = reading
        elif observed:
            seen["pose_reading"] = reading
        seen |= {signal: signal for part in parts if (signal := part.signal("health")) != "health"}
        if safety.parity is not None and context.imu is not None and context.reading == 6:
            parts.append(
                parity_part(context, context.imu, safety.parity).connected(reading=reading, reference=reference)
            )
            seen["parity"], logged["imu"] = "parity", "imu"
        layer = [safety_part(safety, context).connected(**seen).named(torque="safe_torque")]

    # A sensor of the base writes parameters of all these parts, and so do adaptive laws.
    if options.base_compensation != "none":
        (parts, writers), (layer, more), (end, others) = informed(parts), informed(layer), informed(end)
        parts = [*writers, *more, *others, *parts]
    if adaptation is not None:
        at = law_inputs | {"reading": reading, "command": command}
        laws = [part.connected(**at)._replace(end_of_tick=True) for part in adaptation.parts(context)]
        end += laws
        outputs = {output: part.signal(output) for part in laws for output in part.outputs}
        logged |= {name: outputs[name] for name in LEARNT_SIGNALS if name in outputs}
        written = _written([*parts, *layer], adaptation, laws)
        parts, layer = written[: len(parts)], written[len(parts) :]

    initial, last = motors.initial_command(context), layer[0] if layer else None
    ends = tuple(parts), tuple(end), sources, reading, "torque", command, motors.unit, initial, last
    return ControlSide(context, *ends, logged)


def _references(options: ControlOptions) -> tuple[tuple[Source, ...], list[Part]]:
    """The reference as it is now and, where the controller looks ahead, as it is when its command acts.

    With the parts that turn it against a moving base.
    """

    def motion(times: np.ndarray) -> np.ndarray:
        return np.concatenate(options.reference.evaluate(times), axis=-1)

    level = options.base_compensation == "level"
    prefix, preview = _UNTURNED if level else "", options.preview
    now = Source(f"{prefix}reference", 18, motion)
    ahead = Source(f"{prefix}reference_ahead", 18, lambda times: motion(times + preview))
    sources = (now, ahead) if preview > 0.0 else (now,)
    leads = zip(sources, (0.0, preview), strict=False)
    return sources, [level_part(s.signal, s.signal.removeprefix(prefix), lead) for s, lead in leads if level]


def _reporting(part: Part, health: str, safety: SafetyOptions | None) -> Part:
    """A part that reports failed ticks to the safety layer, where there is one."""
    if safety is None or part.system is not None:
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
