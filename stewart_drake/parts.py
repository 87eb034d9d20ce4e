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
from stewart_drake.part import Part, Setup, guarded
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
        still=standing_torque(robot, pose, scenario.gravity),
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
        guarded=scenario.safety is not None,
        split=split,
    )


class _Builder:
    """Adds the parts of a scenario in order; what one adds the next ones connect to by name."""

    def __init__(self, scenario: Scenario, split: bool) -> None:
        self.scenario, self.setup = scenario, setup_of(scenario, split)
        self.parts: list[Part] = []
        self.logged: dict[str, str | np.ndarray] = {"reference": "reference"}
        self.late: list[Part] = []

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
        parts = (*self.parts, *self.late)
        return Loop(parts, tuple(sources), torque, self.reading, len(sensors), last, self.logged)

    def add_estimator(self) -> None:
        """What the controller gets of the readings."""
        parts = [_reading(part, reading=self.reading) for part in self.scenario.estimator.parts(self.setup)]
        self.parts.extend(self._guarded(part, "sensor_health") for part in parts)
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
        part = _reading(part, **self.sees)
        if self.compensated:
            part = part._replace(says={**part.says, "torque": "control_torque"})
        self.weighted = "weights" in part.inputs
        self.parts.append(self._guarded(part, "controller_health"))
        self.logged |= {"torque": "torque", "error": "error", "integral": "integral"}
        if "error" not in part.outputs:
            self.parts.append(_reading(_ERROR, **self.sees))

    def add_command(self) -> None:
        """What is added to a controller's torque: against friction, and against what an observer cannot explain."""
        setup, friction = self.setup, self.scenario.friction_compensation
        if not self.compensated:
            return
        against: dict[str, str | np.ndarray] = {"against_friction": np.zeros(6), "compensation": np.zeros(6)}
        if friction is not None:
            self.parts.append(_reading(friction.part(setup), **self.sees))
            against["against_friction"] = "against_friction"
        if self.observes:
            against["compensation"] = "compensation"
            self.late.append(_reading(_sent_part(setup.robot.effort_limits, setup.still), **against))
        self.parts.append(_reading(_COMMAND, **against))

    def add_tuner(self) -> None:
        """Densities, and the weights that a controller takes; nothing for one that takes none."""
        if not self.weighted:
            return
        self.parts.append(self.setup.tuner.density_part())
        self.logged |= {"density": "density", "weights": self.sees["weights"]}
        for part in self.tuning:
            self.late.append(_reading(part, reference=self.sees["reference"]))
            if "setting" in part.outputs:
                self.logged["setting"] = "setting"
            if "disturbance" in part.outputs:
                # The tuner says what the observer is to expect.
                self.parts = [_reading(each, disturbance=part.signal("disturbance")) for each in self.parts]

    def add_way_to_motors(self) -> str:
        """Delay, link, safety layer and motors; the name of the torque at the plant."""
        scenario, setup = self.scenario, self.setup
        torque, age = "torque", {}
        if scenario.command_delay > 0:
            self.parts.append(delay_part(scenario.command_delay, setup.still)._replace(says={"torque": "delayed"}))
            torque = "delayed"
        if not scenario.link.perfect:
            self.parts.append(_reading(scenario.link.part(setup), torque=torque)._replace(says={"torque": "arrived"}))
            torque, age = "arrived", {"age": "age"}
        if scenario.safety is not None:
            self.parts.append(self._safety(command=torque, **age))
            torque = "guarded"
            self.logged["safety"] = "safety"
        if not scenario.motors.perfect:
            self.parts.append(_reading(scenario.motors.part(), torque=torque)._replace(says={"torque": "driven"}))
            torque = "driven"
        if scenario.safety is None and (scenario.controller.code is not None or scenario.link.faults):
            # The plant would clip an infinite torque to one that looks valid; our own controllers never give one.
            self.parts.append(_reading(_FINITE, torque=torque))
            torque = "checked"
        return torque

    def _safety(self, **reads: str) -> Part:
        scenario, setup = self.scenario, self.setup
        assert scenario.safety is not None
        part = safety_part(scenario.safety, setup)
        reads["measurement"] = self.measurement
        if setup.reading == 6:
            reads["angles"] = self.reading
        if self.observes and setup.reading == 12:
            reads["pose_reading"] = self.reading
        for health in {"sensor_health", "controller_health"} & {each.signal("health") for each in self.parts}:
            reads[health] = health
        return _reading(part, **reads)._replace(says={"torque": "guarded"})

    def _guarded(self, part: Part, health: str) -> Part:
        """A part whose failing ticks the safety layer hears of, where there is one."""
        if not self.setup.guarded or part.system is not None:
            return part
        return guarded(part)._replace(says={**part.says, "health": health})


def _reading(part: Part, **sources: str | np.ndarray) -> Part:
    """The part with these signals, or arrays, at those of its ports that have such a name."""
    return part._replace(reads={**part.reads, **{port: sources[port] for port in sources if port in part.inputs}})


# --- parts that no room has ---


@njit
def _add_torques(control: Any, compensation: Any, friction: Any, states: Any) -> None:
    state = record(states)
    for i in range(6):
        state.torque[i] = control[i] + compensation[i] + friction[i]


_COMMAND = Part(
    "command",
    {"control_torque": 6, "compensation": 6, "against_friction": 6},
    ("torque",),
    new_record(fields(torque=6)),
    _add_torques,
)
"""The torque asked for: a controller's, what an observer adds, and what makes up for friction."""


@njit
def _remember_sent(limit: Any, torque: Any, friction: Any, states: Any) -> None:
    state = record(states)
    for i in range(6):
        state.sent[i] = min(max(torque[i], -limit[i]), limit[i]) - friction[i]


def _sent_part(limit: np.ndarray, still: np.ndarray) -> Part:
    """The command of a tick less what friction takes of it, for the observer at the next one.

    What the motors cannot give is cut by them, or by the safety layer, which has to see it.
    """

    def tick(torque: np.ndarray, against: np.ndarray, state: np.ndarray) -> None:
        _remember_sent(limit, torque, against, state)

    start = new_record(fields(sent=6), sent=still)
    return Part("sent", {"torque": 6, "against_friction": 6}, ("sent",), start, tick, late=True)


def _error_tick(measured: np.ndarray, wanted: np.ndarray, state: np.ndarray) -> None:
    np.subtract(measured[:6], wanted[:6], out=state["error"][0])


_ERROR = Part(
    "tracking_error",
    {"measurement": 12, "reference": 18},
    ("error", "integral"),
    new_record(fields(error=6, integral=6)),
    _error_tick,
)
"""Tracking error of a controller that does not tell its own, and an integral state of zeros."""


def _finite_tick(asked: np.ndarray, state: np.ndarray) -> None:
    if not np.isfinite(asked).all():
        raise NotFiniteError("torque", asked.copy())
    state["checked"][0] = asked


_FINITE = Part("finite", {"torque": 6}, ("checked",), new_record(fields(checked=6)), _finite_tick, every_step=True)
"""Ends a run whose torques are no numbers, where there is no safety layer."""
