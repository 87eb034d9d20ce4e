"""From a scenario to its loop: the ordered list of parts, and what they are connected by.

The order is that in which signals run within a tick: sensors, estimator, controller, what is added to its torque,
densities, delay, link, safety layer, motors; then, late, what acts from the next tick on. Each kind of sensor,
estimator, controller and tuner gives its own parts, see `Setup`; nothing here knows how many kinds there are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.errors import ConfigurationError, NotFiniteError
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.motors import delay_part, standing_torque
from stewart_drake.hardware.observer import SMALLEST_NOISE
from stewart_drake.jit import fields, new_record, njit, record
from stewart_drake.part import Part, Setup
from stewart_drake.safety import safety_part
from stewart_drake.sampling import on_grid
from stewart_drake.scenario import Scenario


class Source(NamedTuple):
    """A signal that is a function of time alone: its name, its size, and times (n,) [s] -> values (n, size)."""

    signal: str
    size: int
    evaluate: Callable[[np.ndarray], np.ndarray]


class Loop(NamedTuple):
    """The loop of a scenario.

    The plant gives the signals `plant_pose` (12,), pose [rad, m] and rate, and `crank_state` (12,), angles [rad] and
    their rates.
    """

    parts: tuple[Part, ...]  # In order.
    # `reference` (18,), where an observer looks ahead `reference_ahead` (18,), with disturbances `wrench` (6,).
    sources: tuple[Source, ...]
    torque: str  # Name of the signal (6,) [N m] that the plant gets.
    reading: str  # Name of what the controller's side reads: `reading`, or `plant_pose` itself.
    first: int  # Index of the controller's first part; those before it are sensors.
    last: int  # Index after its last part but the late ones; those behind carry the command to the motors.
    logged: Mapping[str, str | np.ndarray]  # Signals by their names in a log; an array stays as it is.


def loop_of(scenario: Scenario, split: bool = False) -> Loop:
    """The loop of a scenario; with `split` an LQI takes the compiled solution of its Riccati equation in any case.

    Raises:
        ConfigurationError: A weights file that is missing or corrupt; a user's code that cannot be used; an observer
            that would have to look too far ahead; with `split`, the other solver.
    """
    if split and getattr(scenario.controller, "solver", None) == "drake":
        allowed = "split, or null for what runs without Drake: the reduced engine, and Controller"
        raise ConfigurationError("controller.solver", "drake", allowed)
    return _Builder(scenario, split).loop()


def controllers_side(loop: Loop) -> list[Part]:
    """The parts of a loop that run on a computer beside the robot: without sensors, delay, link, motors and safety."""
    return [*loop.parts[loop.first : loop.last], *(part for part in loop.parts[loop.last :] if part.end_of_tick)]


def setup_of(scenario: Scenario, split: bool = False) -> Setup:
    """What the parts of a scenario are made for; `split` as in `loop_of`."""
    robot, friction, tuner = scenario.believed_robot, scenario.friction_compensation, scenario.tuner.opened()
    pose, rate = scenario.start()
    return Setup(
        robot=robot,
        gravity=scenario.gravity,
        period=scenario.controller.period,
        time_step=scenario.plant.time_step,
        pose=pose,
        pose_rate=rate,
        initial_torque=standing_torque(robot, pose, scenario.gravity),
        delay=scenario.command_delay,
        ahead=scenario.ahead,
        latency=scenario.controller.period * (1 + scenario.estimator.ahead(scenario.command_delay)),
        sensors=scenario.sensors,
        reading=scenario.sensors.reading_size,
        noise=max(scenario.sensors.reading_noise, SMALLEST_NOISE),
        friction=0.0 if friction is None else max(friction.levels[1]),
        viscous=(0.0,) * 6 if friction is None else friction.levels[3],
        tuner=tuner,
        disturbance=scenario.estimator.expected,
        fault_tolerant=scenario.safety is not None,
        split=split,
    )


class _Builder:
    """Adds the parts of a scenario in order; what one adds the next ones connect to by name."""

    def __init__(self, scenario: Scenario, split: bool) -> None:
        self.scenario, self.setup = scenario, setup_of(scenario, split)
        self.parts: list[Part] = []
        self.logged: dict[str, str | np.ndarray] = {"reference": "reference"}
        self.at_end: list[Part] = []

    def loop(self) -> Loop:
        scenario, setup = self.scenario, self.setup

        def motion(times: np.ndarray) -> np.ndarray:
            return np.concatenate(scenario.reference.evaluate(times), axis=-1)

        sources = [Source("reference", 18, motion)]
        if scenario.disturbances:
            sources.append(Source("wrench", 6, lambda times: total_wrench(scenario.disturbances, times)))
            self.logged["disturbance"] = "wrench"
        if setup.ahead > 0:
            shift = setup.ahead * on_grid(setup.period)
            sources.append(Source("reference_ahead", 18, lambda times: motion(times + shift)))
        sensors = scenario.sensors.parts(setup)
        self.parts.extend(sensors)
        self.reading = "reading" if sensors else "plant_pose"
        self.add_estimator()
        self.add_controller()
        self.add_command()
        self.add_tuner()
        last = len(self.parts)
        torque = self.add_way_to_motors()
        if torque != "torque":
            self.logged["torque_applied"] = torque
        parts = (*self.parts, *self.at_end)
        return Loop(parts, tuple(sources), torque, self.reading, len(sensors), last, self.logged)

    def add_estimator(self) -> None:
        """What the controller gets of the readings."""
        parts = [part.connected(reading=self.reading) for part in self.scenario.estimator.parts(self.setup)]
        self.parts.extend(self._fault_tolerant(part, "sensor_health") for part in parts)
        self.measurement = "measurement" if parts else self.reading
        self.logged["measurement"] = self.measurement
        self.observes = any("ahead" in part.outputs for part in parts)
        if self.observes:
            self.logged["innovation"] = "innovation"

    def add_controller(self) -> None:
        """From measurement and reference to a torque."""
        setup = self.setup
        self.tuning = setup.tuner.parts(setup)
        self.sees: dict[str, str | np.ndarray] = {
            "measurement": "ahead" if self.observes else self.measurement,
            "reference": "reference_ahead" if setup.ahead > 0 else "reference",
            "weights": "weights" if self.tuning else np.array(setup.tuner.weights),
        }
        self.compensated = self.observes or self.scenario.friction_compensation is not None
        (part,) = self.scenario.controller.parts(setup)
        part = part.connected(**self.sees)
        if self.compensated:
            part = part.named(torque="control_torque")
        self.weighted = "weights" in part.inputs
        self.parts.append(self._fault_tolerant(part, "controller_health"))
        self.logged |= {"torque": "torque", "error": "error", "integral": "integral"}
        if "error" not in part.outputs:
            self.parts.append(_ERROR.connected(**self.sees))

    def add_command(self) -> None:
        """What is added to a controller's torque: against friction, and against what an observer cannot explain."""
        setup, friction = self.setup, self.scenario.friction_compensation
        if not self.compensated:
            return
        added: dict[str, str | np.ndarray] = {"friction_torque": np.zeros(6), "compensation": np.zeros(6)}
        if friction is not None:
            self.parts.append(friction.part(setup).connected(**self.sees))
            added["friction_torque"] = "friction_torque"
        if self.observes:
            added["compensation"] = "compensation"
            self.at_end.append(_sent_part(setup.robot.effort_limits, setup.initial_torque).connected(**added))
        self.parts.append(_COMMAND.connected(**added))

    def add_tuner(self) -> None:
        """Densities, and the weights that a controller takes; nothing for one that takes none."""
        if not self.weighted:
            return
        self.parts.append(self.setup.tuner.density_part())
        self.logged |= {"density": "density", "weights": self.sees["weights"]}
        for part in self.tuning:
            self.at_end.append(part.connected(reference=self.sees["reference"]))
            if "setting" in part.outputs:
                self.logged["setting"] = "setting"
            if "disturbance" in part.outputs:
                # The tuner says what the observer is to expect.
                self.parts = [each.connected(disturbance=part.signal("disturbance")) for each in self.parts]

    def add_way_to_motors(self) -> str:
        """Delay, link, safety layer and motors; the name of the torque at the plant."""
        scenario, setup = self.scenario, self.setup
        torque, age = "torque", {}
        if scenario.command_delay > 0:
            self.parts.append(delay_part(scenario.command_delay, setup.initial_torque).named(torque="delayed"))
            torque = "delayed"
        if not scenario.link.perfect:
            self.parts.append(scenario.link.part(setup).connected(torque=torque).named(torque="arrived"))
            torque, age = "arrived", {"age": "age"}
        if scenario.safety is not None:
            self.parts.append(self._safety(command=torque, **age))
            torque = "safe_torque"
            self.logged["safety"] = "safety"
        if not scenario.motors.perfect:
            self.parts.append(scenario.motors.part(setup).connected(torque=torque).named(torque="driven"))
            torque = "driven"
        if scenario.safety is None and (scenario.controller.code is not None or scenario.link.faults):
            # The plant would clip an infinite torque to one that looks valid; our own controllers never give one.
            self.parts.append(_FINITE._replace(period=setup.time_step).connected(torque=torque))
            torque = "checked"
        return torque

    def _safety(self, **sources: str) -> Part:
        scenario, setup = self.scenario, self.setup
        assert scenario.safety is not None
        part = safety_part(scenario.safety, setup)
        sources["measurement"] = self.measurement
        if setup.reading == 6:
            sources["angles"] = self.reading
        if self.observes and setup.reading == 12:
            sources["pose_reading"] = self.reading
        for health in {"sensor_health", "controller_health"} & {each.signal("health") for each in self.parts}:
            sources[health] = health
        return part.connected(**sources).named(torque="safe_torque")

    def _fault_tolerant(self, part: Part, health: str) -> Part:
        """A part whose failing ticks the safety layer hears of, where there is one."""
        if not self.setup.fault_tolerant or part.system is not None:
            return part
        return part._replace(outputs=(*part.outputs, "health"), fault_tolerant=True).named(health=health)


# --- parts that no room has ---


@njit
def _add_torques(control: Any, compensation: Any, friction: Any, states: Any) -> None:
    state = record(states)
    for i in range(6):
        state.torque[i] = control[i] + compensation[i] + friction[i]


_COMMAND = Part(
    "command",
    _add_torques,
    {},
    {"control_torque": 6, "compensation": 6, "friction_torque": 6},
    ("torque",),
    new_record(fields(torque=6)),
)
"""The torque asked for: a controller's, what an observer adds, and what makes up for friction."""


@njit
def _remember_sent(limit: Any, torque: Any, friction: Any, states: Any) -> None:
    state = record(states)
    for i in range(6):
        state.sent[i] = min(max(torque[i], -limit[i]), limit[i]) - friction[i]


def _sent_part(limit: np.ndarray, initial: np.ndarray) -> Part:
    """The command of a tick less what friction takes of it, for the observer at the next one.

    What the motors cannot give is cut by them, or by the safety layer, which has to see it.
    """
    first, inputs = new_record(fields(sent=6), sent=initial), {"torque": 6, "friction_torque": 6}
    return Part("sent", _remember_sent, {"limit": limit}, inputs, ("sent",), first, end_of_tick=True)


def _error_tick(measured: np.ndarray, wanted: np.ndarray, state: np.ndarray) -> None:
    np.subtract(measured[:6], wanted[:6], out=state["error"][0])


_ERROR = Part(
    "tracking_error",
    _error_tick,
    {},
    {"measurement": 12, "reference": 18},
    ("error", "integral"),
    new_record(fields(error=6, integral=6)),
)
"""Tracking error of a controller that does not tell its own, and an integral state of zeros."""


def _finite_tick(asked: np.ndarray, state: np.ndarray) -> None:
    if not np.isfinite(asked).all():
        raise NotFiniteError("torque", asked.copy())
    state["checked"][0] = asked


_FINITE = Part("finite", _finite_tick, {}, {"torque": 6}, ("checked",), new_record(fields(checked=6)))
"""Ends a run whose torques are no numbers, where there is no safety layer."""
