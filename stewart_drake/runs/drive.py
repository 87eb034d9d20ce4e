"""A controller on a machine: from where it stands to the motion, along it, and to rest, with a log as of a run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.analysis.feasibility import check_reference
from stewart_drake.base.errors import ConfigurationError, InfeasibleReferenceError, RunFailure, StewartDrakeError
from stewart_drake.base.real_time import Pace, real_time
from stewart_drake.control.user_controller import failure_of
from stewart_drake.logs.journal import Journal
from stewart_drake.logs.log import MAX_ROWS, SimulationLog
from stewart_drake.machines.machine import Machine, Reading, check_takes
from stewart_drake.machines.tick_clock import TickClock
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics
from stewart_drake.references.paced import RAMP, PacedMotion
from stewart_drake.robot import RobotParameters
from stewart_drake.safety import LEVELS, standstill_text
from stewart_drake.scenario.controller import Controller
from stewart_drake.scenario.scenario import Scenario

APPROACH_SPEED = 0.5
"""[rad/s] of the fastest crank on the way to the motion."""
STALE, STALE_HELD = 0.1, 0.5
"""[s] age of a reading from which on the robot slows down and stops, and with motors that hold their angles alone."""
WAITS = 0.1
"""[s] without a tick from which on the motion waits, and goes on from where it was."""
AT_STOP = 0.02
"""[rad] beyond a stop that may be read of a crank that rests on it."""
CLOCKS_APART, CLOCKS_APART_HELD = (0.95, 1.05), (0.6, 3.0)
"""Of the controller's period, what the tick of a machine that sets the pace may be, likewise; it is the period then."""
SAME_TICK = 1e-3  # Share of the period by which a tick may differ that counts as that.
_FRESH = 10  # Readings at most until the first that is used.
SHORTEST = 0.1  # [s] of a motion.
HOLD = 0.3
"""[s] for which it is held at the end before it is let go."""
ON_THE_WAY = 0.03
"""[s] for which a command may be on its way, three ticks where that is longer: a command that is an angle is no farther
from the last one that has arrived than the path goes in this time, and `APPROACH_SPEED` besides."""
FAR = 2
"""Readings in a row that are too far from where they should be: one alone may be wrong, and is not commanded."""
HELD = "not_following", "not_moving", "holding"
"""Reasons for which the robot is held where it reads itself, not slowed down on its path: it is not on it."""


def as_logged(scenario: Scenario) -> Scenario:
    """The scenario of a log of `drive`, but for its duration: its robot is the believed one."""
    return scenario if scenario.model.robot is None else scenario.replace(robot=scenario.controller_model.robot)


class Start(NamedTuple):
    """Where a machine stands, and how it comes to the motion."""

    angles: np.ndarray  # (6,) [rad] that it reads.
    pose: np.ndarray  # (6,) [rad, m] of the platform there.
    motion: PacedMotion
    duration: float  # [s] from now until it rests again.


def connected(scenario: Scenario, machine: Machine, seconds: float | None = None) -> Start:
    """Connects a machine, and plans the way from where it stands, the motion for some seconds, and the end.

    Raises:
        ConfigurationError: So many seconds give no log; the machine takes something else than the model's motors, has
            another rate, tells no angles to learn from, or stands where the believed robot cannot; the way to the
            motion leaves the limits.
        MachineError: It cannot be reached.
    """
    motors, reference, longest = (
        scenario.controller_model.motors,
        scenario.reference,
        MAX_ROWS * scenario.reading_period,
    )
    seconds = scenario.duration if seconds is None else seconds
    if not SHORTEST <= seconds <= longest:
        raise ConfigurationError("--for", seconds, f"from {SHORTEST} to {longest:g} s of the motion, {MAX_ROWS} ticks")
    check_takes(scenario, machine.takes, "the machine")
    machine.connect()
    adaptation = scenario.adaptation
    if adaptation is not None and not machine.reads and not getattr(adaptation, "frozen", False):
        raise ConfigurationError("adaptation", adaptation.kind, "null: this machine does not tell its angles")
    period, own = scenario.reading_period, machine.period
    shortest, most = CLOCKS_APART_HELD if motors.holds else CLOCKS_APART
    if machine.paced and own is not None and not shortest * period < own < most * period:
        allowed = f"about {own:.4g} s, that of the machine, which sets the pace"
        raise ConfigurationError("controller.period", period, allowed)
    motion = PacedMotion(reference, reference.evaluate(0.0)[0], RAMP)
    start = planned(scenario, machine, motion, machine.read().angles, seconds)
    whole = check_reference(scenario.controller_model.robot, scenario.limits, motion, start.duration, scenario.gravity)
    whole.raise_if_infeasible()
    return start


def planned(scenario: Scenario, machine: Machine, motion: PacedMotion, angles: np.ndarray, seconds: float) -> Start:
    """Plans the way from where a machine reads itself, (6,) [rad], to some seconds of a motion, which begins there."""
    robot, begin = scenario.controller_model.robot, motion.goal
    try:
        pose = _standing(robot, angles, scenario.controller_model.home)
    except ConfigurationError:
        if machine.reads:
            raise
        # Motors that tell nothing, and were told nothing, go to the motion's beginning by themselves.
        pose = begin
    far = float(np.abs(inverse_kinematics(robot, begin) - inverse_kinematics(robot, pose)).max())
    # The fastest instant of the way is 1.875 times as fast as its mean.
    motion.begin(pose, max(RAMP, 1.875 * far / APPROACH_SPEED))
    try:
        check_reference(robot, scenario.limits, motion, motion.approach, scenario.gravity).raise_if_infeasible()
    except InfeasibleReferenceError as error:
        allowed = f"a pose from which the motion can be reached ({error}){getattr(machine, 'first', '')}"
        raise ConfigurationError("start", np.round(pose, 4).tolist(), allowed) from None
    return Start(angles, pose, motion, motion.duration(seconds))


def measured_home(robot: RobotParameters, angles: np.ndarray, home: Sequence[float]) -> np.ndarray:
    """`model.home` (6,) [rad] of a robot that stands in its home pose and reads crank angles (6,) [rad] with a home."""
    return np.round(inverse_kinematics(robot, robot.home_pose) - angles + np.array(home), 4) + 0.0


def _standing(robot: RobotParameters, angles: np.ndarray, home: Sequence[float]) -> np.ndarray:
    """Pose (6,) of a robot that stands at crank angles (6,) [rad]."""
    measured = f"in its home pose its model.home is {measured_home(robot, angles, home).tolist()}"
    for leg, (angle, (low, high)) in enumerate(zip(angles, robot.crank_angle_ranges, strict=True)):
        if not low - AT_STOP <= angle <= high + AT_STOP:
            allowed = f"within {low:.4g} to {high:.4g} rad, its stops: is its zero that of the model? {measured}"
            raise ConfigurationError(f"angle of leg {leg}", f"{angle:.4g} rad", allowed)
    try:
        pose = forward_kinematics(robot, angles)
    except StewartDrakeError as error:
        allowed = f"angles that the believed robot can stand at ({error}): are leg order, signs and zeros its own? "
        allowed += measured
        raise ConfigurationError("angles", np.round(angles, 4).tolist(), allowed) from None
    # A pose tells no turns, and a motor would make them.
    turns = np.round((angles - inverse_kinematics(robot, pose)) / (2.0 * np.pi))
    if turns.any():
        leg, without = int(np.abs(turns).argmax()), np.round(np.array(home) - 2.0 * np.pi * turns, 4) + 0.0
        allowed = (
            f"{angles[leg] - 2.0 * np.pi * turns[leg]:.4g} rad, without whole turns, or model.home={without.tolist()}"
        )
        raise ConfigurationError(f"angle of leg {leg}", f"{angles[leg]:.4g} rad, {turns[leg]:g} turns on", allowed)
    return pose


def held_controller(
    scenario: Scenario, pose: np.ndarray, motion: PacedMotion | None = None, tick: float | None = None
) -> Controller:
    """The controller of a drive that begins at a pose (6,); it reads angles, whatever a simulation would.

    Its period is the `tick` [s] that was measured, where there is one and an estimator does not run between its ticks.

    Without a `motion` it holds the pose, for a first step: what is compiled or loaded in that must come before a
    machine waits for it.
    """
    here: dict[str, Any] = {"reference": {"kind": "hold", "pose": pose.tolist()}, "initial_offset": [0.0] * 6}
    period = scenario.controller.period
    if tick is not None and scenario.reading_period == period and abs(tick - period) > SAME_TICK * period:
        here["controller.period"] = tick
    held = scenario.control().replace({**here, "model.reading": "angles"})
    if motion is not None:
        ahead = scenario.preview
        return Controller(held, {"reference": motion.row, "reference_ahead": lambda now: motion.row(now + ahead)})
    controller = Controller(held)
    controller.step(inverse_kinematics(scenario.controller_model.robot, pose), 0.0, np.empty(6))
    return controller


class Tick(NamedTuple):
    """What a tick has read, wanted and sent."""

    time: float  # [s].
    angles: np.ndarray  # (6,) [rad] read.
    reference: np.ndarray  # (6,) [rad, m] pose.
    sent: np.ndarray  # (6,) commands.


class Drive:
    """The loop of a controller on a connected machine.

    With a paced machine a tick is one of its own; else ticks have absolute deadlines on the monotonic clock. Rows go to
    the file `journal` as they come, if it is given: what a killed process leaves. `most` limits those in the log.

    Attributes:
        latest: The latest tick for whoever shows it, from any thread.
    """

    def __init__(
        self, scenario: Scenario, machine: Machine, start: Start, journal: Path | None = None, most: int | None = None
    ) -> None:
        self._machine, self._motion, self._driven = machine, start.motion, scenario
        self._robot, self._following = scenario.controller_model.robot, scenario.bounds.crank_angle or np.inf
        self._ahead, self._command, self._holds = scenario.preview, np.empty(6), scenario.controller_model.motors.holds
        self._stale = STALE_HELD if self._holds else STALE
        self._journal, self._last = (journal, most), -1
        self._expected, self._measured = scenario.reading_period, machine.period if machine.paced else None
        self._begin(start)
        self._period = self._controller.period
        self._clock, self._now = TickClock(self._period), 0.0
        self._on_the_way = max(ON_THE_WAY, 3.0 * self._period)
        self._held: np.ndarray | None = None  # (6,) [rad] at which the robot is held.
        self._gives_up = np.inf  # [s] on the monotonic clock.
        self._holding = self._far = 0  # Ticks in a row in which the machine followed nothing, was too far away.
        self._behind = 0  # Ticks by which the motion's clock is behind that of the machine.
        self._pace, self._origin = Pace(self._period), 0  # And a machine's number of its reading at the beginning.
        self._stopped_by: RunFailure | KeyboardInterrupt | None = None
        self._asked = False
        self._motion.stop(start.duration - RAMP)

    def _begin(self, start: Start) -> None:
        """What depends on where the robot stands."""
        self._start, self.scenario = start, as_logged(self._driven).replace(duration=start.duration)
        self._controller = held_controller(self._driven, start.pose, start.motion, self._measured)
        # What is compiled or loaded in the first call must not come in the first tick.
        self._controller.step(start.angles, 0.0, self._command)
        self._controller.reset()
        self.latest = Tick(0.0, start.angles, start.pose, np.zeros(6))
        self._rows = Journal(self.scenario, *self._journal)

    @property
    def time(self) -> float:
        """[s] that the log has reached."""
        return self._now

    @property
    def odd_tick(self) -> str | None:
        """How the tick of a machine that sets the pace differs from the controller's period, in words."""
        return self._clock.report(self._expected)

    @property
    def ending(self) -> str:
        """What became of the robot, once it is over."""
        if self.time < self._motion.rests:
            return "it was let go at once"
        if self._held is not None:
            return f"it was held where it stood for {RAMP + HOLD:g} s, and let go"
        return f"it was slowed down on its path, held for {HOLD:g} s, and let go"

    def run(self, progress: Callable[[float], None] | None = None) -> SimulationLog:
        """To the end, or to rest before it: after Ctrl-C, an old reading, an error that grows; a lost machine ends it.

        The log says how it ended, as that of a run does. Where it ended before its first tick there is none, and why is
        raised.
        """
        began = time.monotonic()
        ended_by = self.go(progress)
        if ended_by is not None and not self._rows:
            raise ended_by
        trip, wall = self._controller.first_trip, time.monotonic() - began
        fields = self._rows.log_fields(ended_by, safety=trip, wall_time=wall)
        if (odd := self.odd_tick) is not None:
            tick = {"name": "machine_tick", "time": self.time, "number": self._clock.tick, "text": odd}
            fields["warnings"] = (*fields["warnings"], tick)
        return SimulationLog(**fields)

    def go(self, progress: Callable[[float], None] | None = None) -> RunFailure | KeyboardInterrupt | None:
        """As `run`, without a log: why it ended before its end."""
        with real_time():
            self._go(progress)
        return self._stopped_by

    def _go(self, progress: Callable[[float], None] | None) -> None:
        try:
            self._look_again()
            while not self._done():
                try:
                    if self._asked:
                        self._stop(KeyboardInterrupt())
                    self._tick()
                    if progress is not None:
                        progress(self.time)
                except KeyboardInterrupt as end:
                    if self._stopped_by is not None:
                        # One that comes while it stops does not wait.
                        raise
                    self._stop(end)
        except (RunFailure, KeyboardInterrupt) as end:
            self._stopped_by = self._stopped_by or end
        except (Exception, SystemExit) as error:  # Whatever it is, the log is kept.
            self._stopped_by = self._stopped_by or failure_of(error, self.scenario)
        finally:
            for last in (self._machine.disconnect, self._rows.close):
                # Who does not wait for the machine keeps the rows.
                try:
                    last()
                except KeyboardInterrupt as end:
                    self._stopped_by = self._stopped_by or end

    def _look_again(self) -> None:
        """Plans the way anew where the robot no longer stands where it stood."""
        for _ in range(_FRESH):
            reading = self._machine.read()
            if moved := self._machine.reads and np.abs(reading.angles - self._start.angles).max() > AT_STOP:
                seconds = self._start.duration - self._motion.duration(0.0)
                self._begin(planned(self._driven, self._machine, self._motion, reading.angles, seconds))
            elif reading.age < self._period:
                # What came while something was compiled is old.
                return
        if moved:
            raise RunFailure("the robot moves before anything was sent to it; hold it still", reason="not_at_rest")

    def stop(self) -> None:
        """Slows down on its path, and ends; from any thread."""
        self._asked = True

    def _done(self) -> bool:
        # Where nothing comes from a machine, its clock stands.
        return self.time >= self._motion.rests + HOLD or time.monotonic() > self._gives_up

    def _stop(self, why: RunFailure | KeyboardInterrupt) -> None:
        """Slows down from what has been commanded already on; the first reason is the one that is told."""
        if isinstance(why, RunFailure) and (why.reason == HELD[0] or (self._held is None and why.reason in HELD)):
            self._held = self._read.angles
            with suppress(StewartDrakeError):
                self._motion.hold(forward_kinematics(self._robot, self._held, self.latest.reference))
        if self._stopped_by is None:
            if isinstance(why, RunFailure):
                why.time = self.time
            self._stopped_by = why
            self._motion.stop(self.time + self._ahead)
            self._gives_up = time.monotonic() + 2.0 * RAMP + HOLD

    def _tick(self) -> None:
        reading, tick, late = self._next()
        self._read = reading
        if tick <= self._last:
            # A paced machine that has nothing new: only time passes.
            self._look(reading)
            return
        if self._rows and (gone := (tick - self._last) * self._clock.tick) > WAITS:
            # The motion waits, or its next pose would be far away.
            self._behind += tick - self._last - 1
            tick = self._last + 1
            if gone > self._stale:
                text = f"nothing came from the machine, or nothing ran here, for {gone:.3g} s"
                self._stop(RunFailure(text, reason="late"))
        now = self._now + (tick - self._last) * self._clock.tick if self._rows else 0.0
        # A command is on its way for two ticks, and before the first one none was.
        age = max(reading.age, min(reading.command_age, now) - 2.0 * self._period)
        arrived = time.monotonic()
        self._look(reading)
        self._miss(tick)
        self._controller.step(reading.angles, now, self._command, age)
        self._bound(reading, now)
        self._machine.command(self._command)
        late += time.monotonic() - arrived
        logged = {
            name: self._controller.signal(of) if isinstance(of, str) else of
            for name, of in self._controller.logged.items()
        }
        told = np.full(6, np.nan) if reading.pose is None else reading.pose
        own = {"told_pose": told, "reading_age": age, "lateness": late}
        if not self._machine.reads:
            # Its reading is what it was last told.
            own["reading"] = np.full(6, np.nan)
        wanted = self._motion.row(now)
        self._rows.append({"time": now, **logged, **own, "sent": self._command, "reference": wanted})
        self._last, self._now, self.latest = tick, now, Tick(now, reading.angles, wanted[:6], self._command.copy())

    def _bound(self, reading: Reading, now: float) -> None:
        """Keeps commands that are angles near to those that are read, and nearer to the last that has arrived."""
        if not self._holds:
            return
        wanted = self._command if self._held is None else self._held
        times = now + np.array([0.0, self._ahead, self._ahead - self._on_the_way])
        here, there, before = inverse_kinematics(self._robot, self._motion.evaluate(np.maximum(times, 0.0))[0])
        reach = (self._following if self._machine.reads else np.inf) + np.abs(there - here)
        near = np.clip(wanted, reading.angles - reach, reading.angles + reach)
        sent = self.latest.sent if self._rows else reading.angles
        arrived = sent if reading.arrived is None else reading.arrived
        step = np.inf if self._far >= FAR else np.abs(there - before) + APPROACH_SPEED * self._on_the_way
        self._command[:] = np.clip(near, arrived - step, arrived + step)

    def _miss(self, tick: int) -> None:
        """Ticks that were lost before this one are ticks without a reading, or its rate would come out too large."""
        if self._rows and self.scenario.controller.feedback:
            first, most = self._last + 1, getattr(self.scenario.estimator, "hold_ticks", 0)
            for missed in range(max(first, tick - most), tick):
                at = self._now + (missed - self._last) * self._clock.tick
                self._controller.step(np.full(6, np.nan), at, self._command)

    def _next(self) -> tuple[Reading, int, float]:
        """The next reading, its tick, and how late it is [s]."""
        machine, first = self._machine, not self._rows
        if machine.paced:
            reading = machine.read()
            self._clock.take(reading)
            self._origin = reading.number if first else self._origin
            return reading, int(reading.number - self._origin) - self._behind, reading.age
        if first:
            self._pace = Pace(self._period)
        else:
            self._pace.advance(leave_out=True)
        late = self._pace.wait()
        return machine.read(), self._pace.tick - self._behind, late

    def _look(self, reading: Reading) -> None:
        """What makes it slow down and stop."""
        self._holding = self._holding + 1 if reading.holding else 0
        if self._holding * self._period > self._stale:
            text = "the machine says that it holds and follows nothing: are its motors off, or commands out of range?"
            self._stop(RunFailure(text, reason="holding"))
        elif reading.age > self._stale:
            text = f"a reading that is {reading.age:.3g} s old, at most {self._stale:.3g} s"
            self._stop(RunFailure(text, reason="stale_reading"))
        elif self._machine.reads and self._controller.status == LEVELS[0]:
            # Else the safety layer stops it, and says why.
            wanted = self._held
            if wanted is None:
                wanted = inverse_kinematics(self._robot, self._motion.evaluate(self.time)[0])
            apart = np.abs(reading.angles - wanted)
            self._far = self._far + 1 if apart.max() > self._following else 0
            if self._held is None and (still := self._controller.standstill) is not None:
                self._stop(RunFailure(standstill_text(*still), still[1], still[0]))
            elif self._far >= FAR:
                leg = int(apart.argmax())
                text = f"leg {leg} is {apart[leg]:.3g} rad from where it should be, at most {self._following:.3g} rad"
                self._stop(RunFailure(text, leg, "not_following"))
