"""The controller's side as one object: readings in, commands out; no plant, no simulator, no Drake."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from numbers import Real

import numpy as np

from stewart_drake.base.atomic_files import Document
from stewart_drake.base.errors import ConfigurationError, NotFiniteError, RunFailure
from stewart_drake.base.keys import join_or
from stewart_drake.base.sampling import InBlocks
from stewart_drake.control.user_controller import failure_of
from stewart_drake.hardware.motors import within_limit
from stewart_drake.loop.part import LoopRunner, Part
from stewart_drake.mechanics.linear_algebra import all_finite
from stewart_drake.safety import LEVELS, Stillness, first_trip
from stewart_drake.scenario.control_options import ControlOptions
from stewart_drake.scenario.control_side import ControlSide, control_side


class Controller:
    """Estimator, controller, tuner and safety layer, for a real machine or another simulator.

        controller = Controller(load_scenario("exact_fig7"))  # or load_controller("my_robot.yaml")
        torque = np.empty(6)
        controller.step(angles, time, torque)  # every controller.period seconds

    The same parts run here as in a Diagram, without sensors, delay, link and motors: those are the machine's, and
    `model` describes them. The Riccati equation of an LQI is solved by the compiled split solution.

    Args:
        options: Model of the machine, reference, controller, tuner, estimator and safety layer; a Scenario has them.
        sources: What takes the place of signals of time: `reference` (18,), and `reference_ahead`, at a time [s]; or
            `target` (6,), the newest pose that a reference of kind stream is to follow.

    Raises:
        ConfigurationError: A controller that is a LeafSystem, which needs a Diagram; as `loop_of`.

    Attributes:
        period: [s] between two steps, that of the controller or a shorter one of its estimator.
        reading: Numbers in a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate.
        unit: Of the commands: N m, or what `model.motors` take: rad, A.
        logged: Name in a log -> name for `signal`, or a constant.
    """

    def __init__(
        self, options: ControlOptions, sources: Mapping[str, Callable[[float], np.ndarray]] | None = None
    ) -> None:
        given = dict(sources or {})
        side = control_side(options, split=True, streams="target" in given)
        self._age, self._options = np.zeros(1), options
        parts, self._safe = controller_parts(options, side, self._age), side.safety is not None
        self.period, self._tick, self.reading = options.reading_period, side.context.period, side.context.reading
        self._running = LoopRunner(parts, side.outside, period=side.context.period, step=self.period)
        evaluated: dict[str, Callable[[float], np.ndarray]] = {
            source.signal: InBlocks(source.evaluate, self.period).at_time for source in side.sources
        }
        # A controller that does not look ahead needs no reference_ahead.
        unknown = given.keys() - evaluated.keys() - ({"reference_ahead"} if "reference" in evaluated else set())
        if unknown:
            also = "; target is for a reference of kind stream" if "target" in unknown else ""
            raise ConfigurationError("sources", ", ".join(sorted(unknown)), f"{join_or([*evaluated])}{also}")
        evaluated |= {name: evaluate for name, evaluate in given.items() if name in evaluated}
        self._sources = [(name, self._running.signal(name), evaluate) for name, evaluate in evaluated.items()]
        there = self._running.places
        self.logged = {name: of for name, of in side.logged.items() if not isinstance(of, str) or of in there}
        self._monitors = () if options.safety is None else options.safety.monitor_names
        if self._safe:
            self.logged["safety"] = "safety"
        self._reading = self._running.signal(side.reading)
        self._others = {name: self._running.signal(name) for name in ("imu", "ball_reading") if name in side.outside}
        self._command, self.unit = self._running.signal("safe_torque" if self._safe else side.command), side.unit
        # Commands that are no torques have their limit in the motor.
        self._limits = side.context.robot.effort_limits if side.command == side.torque else np.inf
        self._stillness = None if self._safe else Stillness(side.context.robot, self.period)
        self._last, self._ticks = -np.inf, 0

    def step(
        self,
        readings: np.ndarray,
        time: float,
        out: np.ndarray,
        age: float = 0.0,
        imu: np.ndarray | None = None,
        ball: np.ndarray | None = None,
    ) -> None:
        """One tick.

        Args:
            readings: (6,) [rad] angles of the cranks, or (12,) pose [rad, m] and its rate, see `reading`. A controller
                without feedback, `feedforward`, takes anything.
            time: [s] of the motion, later than at the step before; fastest at multiples of the period.
            out: (6,) out, commands for the motors in `unit`: float64; torques are within the robot's effort limits.
            age: [s] of the readings beyond that of the scenario; the safety layer's `deadline` refers to it.
            imu: (6,) rates [rad/s] and specific force [m/s^2] in the axes of `model.imu`; None, or NaN, where there is
                no new reading. A controller whose estimator does not use it ignores it.
            ball: (2,) [m] place of the ball on the plate, x and y in P, for `ball_control`; None or NaN likewise. It is
                used at the controller's ticks.

        Raises:
            ConfigurationError: An argument of another shape, type or range; nothing has changed then.
            RunFailure: A part has failed, or the safety layer gives the robot up; `reason` and `leg` say why.
        """
        try:
            given = np.asarray(readings)
        except Exception:  # rows of several lengths, or whatever an object makes of it
            given = np.asarray(None)
        if given.shape != self._reading.shape or given.dtype.kind not in "fiu":
            allowed = f"an array of shape ({self.reading},) of real numbers"
            raise ConfigurationError("readings", f"{given.shape} of {given.dtype}", allowed)
        if not (isinstance(out, np.ndarray) and out.dtype == np.float64 and out.shape == (6,) and out.flags.writeable):
            raise ConfigurationError("out", out, "a writable array of shape (6,), dtype float64")
        if not self._last < (now := _number(time)) < np.inf:
            raise ConfigurationError("time", time, f"a finite time later than that of the step before, {self._last} s")
        if not (late := _number(age)) >= 0.0:
            raise ConfigurationError("age", age, "a number that is not negative [s]")
        others = {"imu": _optional("imu", imu, 6), "ball_reading": _optional("ball", ball, 2)}
        for name, signal in self._others.items():
            signal[:] = others[name]
        self._reading[:] = given
        self._age[0] = late / self._tick
        self._running.time[0] = self._last = now
        try:
            self._run(now, out)
        except RunFailure:
            raise
        except (Exception, SystemExit) as error:
            raise failure_of(error, self._options) from error

    def _run(self, now: float, out: np.ndarray) -> None:
        for name, signal, evaluate in self._sources:
            values = np.asarray(evaluate(now))
            if values.shape != signal.shape:
                allowed = f"a function that returns an array of shape {signal.shape}"
                raise ConfigurationError(f"sources: {name}", f"one of shape {values.shape}", allowed)
            signal[:] = values
        self._running.run(self._ticks)
        if not all_finite(self._command):
            raise NotFiniteError("command", self._command.copy())
        out[:] = within_limit(self._command, self._limits)
        self._running.end(self._ticks)
        self._ticks += 1
        if self._stillness is not None:
            self._stillness.look(self._reading, self._running.signal("reference"))

    def reset(self) -> None:
        """Resets the state to that before the first step."""
        self._running.reset()
        if self._stillness is not None:
            self._stillness.reset()
        self._last, self._ticks = -np.inf, 0

    def signal(self, name: str) -> np.ndarray:
        """A signal of the last step by its name, such as `torque`, `error` or `measurement`; a view.

        The tuner's `weights` or `setting` apply from the next step on.
        """
        return self._running.signal(name)

    @property
    def first_trip(self) -> Document | None:
        """The first trip of the safety layer, as in a log; None for none, or without a layer."""
        return first_trip(self._running.state("safety"), self._tick, self._monitors) if self._safe else None

    @property
    def standstill(self) -> tuple[str, int | None] | None:
        """Cranks at rest while the reference moves: `not_moving` or `reading_stuck`, and the leg or None for all six.

        None where all is well, and with a safety layer, which trips instead. Readings that are not finite are left out.
        """
        return None if self._stillness is None else self._stillness.latest

    @property
    def status(self) -> str:
        """Level of the safety layer: `none` where all is well, then `hold`, `ramp`, `safe_hold`, `end`."""
        return LEVELS[int(self._running.signal("safety")[0])] if self._safe else LEVELS[0]


def _optional(name: str, value: object, size: int) -> np.ndarray | float:
    """A reading (n,) that may be missing, which is then NaN."""
    if value is None:
        return np.nan
    given = np.asarray(value)
    if given.shape != (size,) or given.dtype.kind not in "fiu":
        allowed = f"None, or an array of shape ({size},) of real numbers"
        raise ConfigurationError(name, f"{given.shape} of {given.dtype}", allowed)
    return given


def _number(value: object) -> float:
    """NaN for what is no number."""
    try:
        # `Real` comes last: Python asks it slowly.
        return float(value) if isinstance(value, (float, np.ndarray, Real)) else np.nan
    except Exception:
        return np.nan


def controller_parts(options: ControlOptions, side: ControlSide, age: np.ndarray) -> list[Part]:
    """The parts of a controller in their order; `age` (1,) [ticks] of its readings, for the safety layer."""
    parts = list(side.every_part)
    if any(part.system is not None for part in parts):
        raise ConfigurationError(
            "controller", options.controller.kind, "a controller that is no LeafSystem, to run without a plant"
        )
    if side.safety is not None:
        parts.append(side.safety.connected(command=side.torque, age=age))
    elif not options.controller.feedback:
        # Adaptive laws need readings; without them the rest still runs.
        parts = [*_without([*side.parts], {side.reading}), *side.at_end]
    return parts


def _without(parts: list[Part], signals: set[str]) -> list[Part]:
    """The parts that depend on none of some signals."""
    kept = []
    for part in parts:
        if signals.intersection(source for port in part.inputs if isinstance(source := part.source(port), str)):
            signals |= {part.signal(output) for output in part.outputs}
        else:
            kept.append(part)
    return kept
