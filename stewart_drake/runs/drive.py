"""Runs a controller on a machine: approach to the motion, the motion, and a stop; logged as a simulated run is."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

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
from stewart_drake.safety.stream import StreamReference, Targets, UdpTargets
from stewart_drake.scenario.controller import Controller
from stewart_drake.scenario.scenario import Scenario

APPROACH_SPEED = 0.5  # [rad/s] Speed of the fastest crank during the approach.
MAX_READING_AGE = 0.1  # [s] The robot is stopped at older readings.
MAX_READING_AGE_SERVOS = 0.5  # [s] The same, for motors that hold their angles.
MAX_TICK_GAP = 0.1  # [s] After longer gaps between ticks the motion continues from where it was.
STOP_TOLERANCE = 0.02  # [rad] A crank at its stop may read as much beyond it.
PERIOD_RATIO = (0.95, 1.05)  # Allowed range of a paced machine's tick over the controller's period.
PERIOD_RATIO_SERVOS = (0.6, 3.0)  # The same, for motors that hold their angles.
PERIOD_TOLERANCE = 1e-3  # Share of the period; a tick that differs by more becomes the controller's period.
MAX_FIRST_READINGS = 10  # Readings until the first that is fresh.
MIN_DURATION = 0.1  # [s] of a motion.
HOLD_TIME = 0.3  # [s] at rest at the end, until the machine is disconnected.
COMMAND_DELAY = 0.03
"""[s] Longest delay of a command; three ticks if that is longer. A commanded angle differs from the last one that has
arrived by at most the path and the change of its lead beyond the path in this time, plus `APPROACH_SPEED` times it."""
MAX_FAR_READINGS = 2  # Readings in a row far from the path, until the robot is stopped. A single one may be wrong.
HOLD_REASONS = "not_following", "not_moving", "holding"
"""Reasons to hold the robot at the angles that it reads: it is not on its path, so it cannot slow down along it."""


def as_logged(scenario: Scenario) -> Scenario:
    """The scenario of a drive's log, except its duration: its robot is that of the controller's model."""
    return scenario if scenario.model.robot is None else scenario.replace(robot=scenario.controller_model.robot)


class Start(NamedTuple):
    """Present state of a machine, and the planned motion."""

    angles: np.ndarray  # (6,) [rad] crank angles, as read.
    pose: np.ndarray  # (6,) [rad, m] of the platform at these angles.
    motion: PacedMotion
    duration: float  # [s] of approach, motion and stop.


def connected(
    scenario: Scenario, machine: Machine, seconds: float | None = None, targets: Targets | None = None
) -> Start:
    """Connects a machine, and plans the approach from its present pose, `seconds` of the motion, and the stop.

    A reference of kind stream follows `targets`, or what comes at its `udp`.

    Raises:
        ConfigurationError: `seconds` is out of range; the machine takes other commands than the model's motors, has
            another rate, or measures no angles to learn from or to check; the model's robot cannot have its angles;
            the approach leaves the limits.
        MachineError: It cannot be reached.
    """
    model, reference, period = scenario.controller_model, scenario.reference, scenario.reading_period
    seconds, longest = scenario.duration if seconds is None else seconds, MAX_ROWS * period
    if not MIN_DURATION <= seconds <= longest:
        allowed = f"from {MIN_DURATION} to {longest:g} s of the motion, {MAX_ROWS} ticks"
        raise ConfigurationError("--for", seconds, allowed)
    check_takes(scenario, machine.takes, "the machine")
    machine.connect()
    if (adaptation := scenario.adaptation) and not machine.reads and not getattr(adaptation, "frozen", False):
        raise ConfigurationError("adaptation", adaptation.kind, "null: this machine does not tell its angles")
    if scenario.safety is not None and not machine.reads:
        raise ConfigurationError("safety", "a layer", "null: this machine does not tell its angles, which it compares")
    low, high = PERIOD_RATIO_SERVOS if model.motors.holds else PERIOD_RATIO
    if machine.paced and machine.period is not None and not low * period < machine.period < high * period:
        allowed = f"about {machine.period:.4g} s, that of the machine, which sets the pace"
        raise ConfigurationError("controller.period", period, allowed)
    motion = PacedMotion(reference, reference.evaluate(0.0)[0], RAMP)
    first = machine.read()
    start = plan_start(scenario, machine, motion, first.angles, seconds)
    report = check_reference(model.robot, scenario.limits, motion, start.duration, scenario.gravity_in_base)
    report.raise_if_infeasible()
    if isinstance(reference, StreamReference) and (live := reference.live(targets)) is not None:
        motion.follow(live)
    return start


def plan_start(scenario: Scenario, machine: Machine, motion: PacedMotion, angles: np.ndarray, seconds: float) -> Start:
    """Plans the approach of a machine that reads crank angles (6,) [rad] to `seconds` of a motion."""
    robot, goal = scenario.controller_model.robot, motion.goal
    try:
        pose = _pose_at(robot, angles, scenario.controller_model.home)
    except ConfigurationError:
        if machine.reads:
            raise
        # Motors without encoders and without a command yet: they move to the motion's first pose by themselves.
        pose = goal
    distance = float(np.abs(inverse_kinematics(robot, goal) - inverse_kinematics(robot, pose)).max())
    # The peak speed of a minimum-jerk move is 1.875 times its mean.
    motion.begin(pose, max(RAMP, 1.875 * distance / APPROACH_SPEED))
    try:
        check_reference(robot, scenario.limits, motion, motion.approach, scenario.gravity_in_base).raise_if_infeasible()
    except InfeasibleReferenceError as error:
        allowed = f"a pose from which the motion can be reached ({error}){getattr(machine, 'first', '')}"
        raise ConfigurationError("start", np.round(pose, 4).tolist(), allowed) from None
    return Start(angles, pose, motion, motion.duration(seconds))


def measured_home(robot: RobotParameters, angles: np.ndarray, home: Sequence[float]) -> np.ndarray:
    """`model.home` (6,) [rad] of a robot in its home pose that reads crank angles (6,) [rad] with offsets `home`."""
    return np.round(inverse_kinematics(robot, robot.home_pose) - angles + np.array(home), 4) + 0.0


def _pose_at(robot: RobotParameters, angles: np.ndarray, home: Sequence[float]) -> np.ndarray:
    """Pose (6,) at measured crank angles (6,) [rad]; ConfigurationError if the robot cannot have them."""
    measured = f"in its home pose its model.home is {measured_home(robot, angles, home).tolist()}"
    for leg, (angle, (low, high)) in enumerate(zip(angles, robot.crank_angle_ranges, strict=True)):
        if not low - STOP_TOLERANCE <= angle <= high + STOP_TOLERANCE:
            allowed = f"within {low:.4g} to {high:.4g} rad, its stops: is its zero that of the model? {measured}"
            raise ConfigurationError(f"angle of leg {leg}", f"{angle:.4g} rad", allowed)
    try:
        pose = forward_kinematics(robot, angles)
    except StewartDrakeError as error:
        allowed = f"angles that the believed robot can stand at ({error}): are leg order, signs and zeros its own? "
        allowed += measured
        raise ConfigurationError("angles", np.round(angles, 4).tolist(), allowed) from None
    # The pose is the same after a whole turn, which the motor would turn back.
    turns = np.round((angles - inverse_kinematics(robot, pose)) / (2.0 * np.pi))
    if turns.any():
        leg, new_home = int(np.abs(turns).argmax()), np.round(np.array(home) - 2.0 * np.pi * turns, 4) + 0.0
        angle = angles[leg] - 2.0 * np.pi * turns[leg]
        allowed = f"{angle:.4g} rad, without whole turns, or model.home={new_home.tolist()}"
        raise ConfigurationError(f"angle of leg {leg}", f"{angles[leg]:.4g} rad, {turns[leg]:g} turns on", allowed)
    return pose


def drive_controller(
    scenario: Scenario, pose: np.ndarray, motion: PacedMotion | None = None, tick: float | None = None
) -> Controller:
    """The controller of a drive that starts at a pose (6,) and reads crank angles.

    A measured `tick` [s] becomes its period, unless an estimator runs between its ticks. Without a `motion` it holds
    the pose and has made one step, so that its code is compiled before a machine waits for it.
    """
    changes: dict[str, object] = {"reference": {"kind": "hold", "pose": pose.tolist()}, "initial_offset": [0.0] * 6}
    period = scenario.controller.period
    if tick is not None and scenario.reading_period == period and abs(tick - period) > PERIOD_TOLERANCE * period:
        changes["controller.period"] = tick
    options = scenario.control().replace({**changes, "model.reading": "angles"})
    if motion is not None:
        preview = scenario.preview
        return Controller(options, {"reference": motion.row, "reference_ahead": lambda now: motion.row(now + preview)})
    controller = Controller(options)
    controller.step(inverse_kinematics(scenario.controller_model.robot, pose), 0.0, np.empty(6))
    return controller


class Tick(NamedTuple):
    """Angles, reference and commands of a tick."""

    time: float  # [s].
    angles: np.ndarray  # (6,) [rad] as read.
    reference: np.ndarray  # (6,) [rad, m] reference pose.
    sent: np.ndarray  # (6,) commands.


class Drive:
    """The loop of a controller on a connected machine.

    A paced machine's readings set the ticks; otherwise ticks have absolute deadlines on the monotonic clock. Rows are
    also written to the file `journal`, if given, from which a killed drive can be read. The log keeps the latest
    `max_rows` rows.

    Attributes:
        latest: The latest tick; may be read from any thread.
    """

    def __init__(
        self,
        scenario: Scenario,
        machine: Machine,
        start: Start,
        journal: Path | None = None,
        max_rows: int | None = None,
    ) -> None:
        self._machine, self._motion, self._driven = machine, start.motion, scenario
        self._robot, self._servos = scenario.controller_model.robot, scenario.controller_model.motors.holds
        self._max_error = scenario.bounds.crank_angle or np.inf  # [rad] of a crank angle.
        self._preview, self._command = scenario.preview, np.empty(6)
        self._max_age = MAX_READING_AGE_SERVOS if self._servos else MAX_READING_AGE
        self._journal, self._last_tick = (journal, max_rows), -1
        self._expected, self._measured = scenario.reading_period, machine.period if machine.paced else None
        self._begin(start)
        self._period = self._controller.period
        self._clock, self._now = TickClock(self._period), 0.0
        self._command_delay = max(COMMAND_DELAY, 3.0 * self._period)
        # (6,) [rad] leads in this time, the oldest first.
        self._leads = deque[np.ndarray](maxlen=1 + round(self._command_delay / self._period))
        self._held: np.ndarray | None = None  # (6,) [rad] Angles at which the robot is held.
        self._deadline = np.inf  # [s] End of the drive on the monotonic clock, set by a stop.
        self._holding_ticks = 0  # Ticks in a row in which the machine followed no command.
        self._far_readings = 0  # Readings in a row that were far from the path.
        self._ticks_behind = 0  # Ticks by which the motion's clock is behind that of the machine.
        self._pace = Pace(self._period)
        self._first_number = 0  # Number of the first reading.
        self._stopped_by: RunFailure | KeyboardInterrupt | None = None
        self._stop_requested, self._wall_time = False, 0.0
        self._motion.stop(start.duration - RAMP)

    def _begin(self, start: Start) -> None:
        """Sets all that depends on the robot's present pose."""
        self._start, self.scenario = start, as_logged(self._driven).replace(duration=start.duration)
        self._controller = drive_controller(self._driven, start.pose, start.motion, self._measured)
        # The first call compiles or loads code, too slow for a tick.
        self._controller.step(start.angles, 0.0, self._command)
        self._controller.reset()
        self.latest = Tick(0.0, start.angles, start.pose, np.zeros(6))
        self._rows = Journal(self.scenario, *self._journal)

    @property
    def time(self) -> float:
        """[s] time of the latest row."""
        return self._now

    @property
    def odd_tick(self) -> str | None:
        """Text on how a paced machine's tick differs from the controller's period, or None."""
        return self._clock.report(self._expected)

    @property
    def ending(self) -> str:
        """Text on how the robot was stopped, after the end."""
        if self.time < self._motion.rests:
            return "it was let go at once"
        if self._held is not None:
            return f"it was held where it stood for {RAMP + HOLD_TIME:g} s, and let go"
        return f"it was slowed down on its path, held for {HOLD_TIME:g} s, and let go"

    def run(self, progress: Callable[[float], None] | None = None) -> SimulationLog:
        """Runs to the end of the motion, or stops before it: after Ctrl-C, at an old reading or a large error.

        The log has the outcome. If the drive ends before its first tick, the reason is raised instead. A lost machine
        ends the drive at once.
        """
        return self.log(self.go(progress))

    def log(self, ended_by: RunFailure | KeyboardInterrupt | None) -> SimulationLog:
        """The log after `go`, which returned `ended_by`."""
        if ended_by is not None and not self._rows:
            raise ended_by
        fields = self._rows.log_fields(ended_by, safety=self._controller.first_trip, wall_time=self._wall_time)
        source, odd = self._motion.source, self.odd_tick
        heard = source.warning if isinstance(source, UdpTargets) else None
        for name, found in (("machine_tick", odd and (self._clock.tick, odd)), ("targets", heard)):
            if found:
                warning = {"name": name, "time": self.time, "number": float(found[0]), "text": found[1]}
                fields["warnings"] = (*fields["warnings"], warning)
        return SimulationLog(**fields)

    def go(self, progress: Callable[[float], None] | None = None) -> RunFailure | KeyboardInterrupt | None:
        """Drives the machine as `run` does, but returns no log; returns the reason of an early end."""
        start_time = time.monotonic()
        with real_time():
            self._go(progress)
        self._wall_time = time.monotonic() - start_time
        return self._stopped_by

    def _go(self, progress: Callable[[float], None] | None) -> None:
        try:
            self._update_start()
            while not self._done():
                try:
                    if self._stop_requested:
                        self._stop(KeyboardInterrupt())
                    self._tick()
                    if progress is not None:
                        progress(self.time)
                except KeyboardInterrupt as end:
                    if self._stopped_by is not None:
                        # A second Ctrl-C, during the stop, ends the drive at once.
                        raise
                    self._stop(end)
        except (RunFailure, KeyboardInterrupt) as end:
            self._stopped_by = self._stopped_by or end
        except (Exception, SystemExit) as error:  # The log is kept after any error.
            self._stopped_by = self._stopped_by or failure_of(error, self.scenario)
        finally:
            for close in (self._machine.disconnect, self._rows.close, self._motion.close):
                # Ctrl-C while a slow machine disconnects does not lose the rows.
                try:
                    close()
                except KeyboardInterrupt as end:
                    self._stopped_by = self._stopped_by or end

    def _update_start(self) -> None:
        """Waits for a fresh reading, and plans the approach again if the robot has moved since `connected`."""
        for _ in range(MAX_FIRST_READINGS):
            reading = self._machine.read()
            if moved := self._machine.reads and np.abs(reading.angles - self._start.angles).max() > STOP_TOLERANCE:
                seconds = self._start.duration - self._motion.duration(0.0)
                self._begin(plan_start(self._driven, self._machine, self._motion, reading.angles, seconds))
            elif reading.age < self._period:
                return
        if moved:
            raise RunFailure("the robot moves before anything was sent to it; hold it still", reason="not_at_rest")

    def stop(self) -> None:
        """Slows down along the path, and ends; may be called from any thread."""
        self._stop_requested = True

    def _done(self) -> bool:
        # Without readings the clock of a paced machine does not advance, so there is a deadline too.
        return self.time >= self._motion.rests + HOLD_TIME or time.monotonic() > self._deadline

    def _stop(self, why: RunFailure | KeyboardInterrupt) -> None:
        """Slows down, after the part of the path that is already commanded; the first reason counts."""
        if isinstance(why, RunFailure) and (
            why.reason == "not_following" or (self._held is None and why.reason in HOLD_REASONS)
        ):
            self._held = self._reading.angles
            with suppress(StewartDrakeError):
                self._motion.hold(forward_kinematics(self._robot, self._held, self.latest.reference))
        if self._stopped_by is None:
            if isinstance(why, RunFailure):
                why.time = self.time
            self._stopped_by = why
            self._motion.stop(self.time + self._preview)
            self._deadline = time.monotonic() + 2.0 * RAMP + HOLD_TIME

    def _tick(self) -> None:
        reading, tick, late = self._next()
        self._reading = reading
        if tick <= self._last_tick:
            # A paced machine without a new reading.
            self._check(reading)
            return
        if self._rows and (gap := (tick - self._last_tick) * self._clock.tick) > MAX_TICK_GAP:
            # The motion waits; its pose at the machine's time could be far away.
            self._ticks_behind += tick - self._last_tick - 1
            tick = self._last_tick + 1
            if gap > self._max_age:
                text = f"nothing came from the machine, or nothing ran here, for {gap:.3g} s"
                self._stop(RunFailure(text, reason="late"))
        now = self._now + (tick - self._last_tick) * self._clock.tick if self._rows else 0.0
        # A command takes two ticks to be acknowledged; before the first one there is none.
        age = max(reading.age, min(reading.command_age, now) - 2.0 * self._period)
        arrival = time.monotonic()
        self._check(reading)
        self._step_missed(tick)
        self._controller.step(reading.angles, now, self._command, age, reading.imu)
        self._limit_command(reading, now)
        self._machine.command(self._command)
        late += time.monotonic() - arrival
        self._last_tick, self._now = tick, now
        self._log_tick(reading, age, late)

    def _log_tick(self, reading: Reading, age: float, late: float) -> None:
        signals: dict[str, float | np.ndarray] = {
            name: self._controller.signal(of) if isinstance(of, str) else of
            for name, of in self._controller.logged.items()
        }
        pose = np.full(6, np.nan) if reading.pose is None else reading.pose
        signals |= {"reported_pose": pose, "reading_age": age, "lateness": late}
        if not self._machine.reads:
            # The angles are the last command.
            signals["reading"] = np.full(6, np.nan)
        reference = self._motion.row(self._now)
        self._rows.append({"time": self._now, **signals, "sent": self._command, "reference": reference})
        self.latest = Tick(self._now, reading.angles, reference[:6], self._command.copy())

    def _limit_command(self, reading: Reading, now: float) -> None:
        """Keeps commanded angles near the reading, and nearer to the last command that has arrived."""
        if not self._servos:
            return
        times = now + np.array([0.0, self._preview, self._preview - self._command_delay])
        here, ahead, before = inverse_kinematics(self._robot, self._motion.evaluate(np.maximum(times, 0.0))[0])
        command, lead = self._command.copy() if self._held is None else self._held, np.zeros(6)
        if self._held is None and not self._driven.controller.feedback:
            # It depends on no reading, so a wrong one cannot make it wrong.
            lead = command - ahead
        self._leads.append(lead)
        distance = (self._max_error if self._machine.reads else np.inf) + np.abs(ahead - here) + np.abs(lead)
        command = np.clip(command, reading.angles - distance, reading.angles + distance)
        sent = self.latest.sent if self._rows else reading.angles
        arrived = sent if reading.arrived is None else reading.arrived
        step = np.abs(ahead - before) + np.abs(lead - self._leads[0]) + APPROACH_SPEED * self._command_delay
        if self._far_readings >= MAX_FAR_READINGS:
            step = np.full(6, np.inf)
        self._command[:] = np.clip(command, arrived - step, arrived + step)

    def _step_missed(self, tick: int) -> None:
        """Steps through the lost ticks without a reading; otherwise the estimated rate would be too large."""
        if self._rows and (self.scenario.controller.feedback or self.scenario.safety is not None):
            first, limit = self._last_tick + 1, getattr(self.scenario.estimator, "hold_ticks", 0)
            for missed in range(max(first, tick - limit), tick):
                at = self._now + (missed - self._last_tick) * self._clock.tick
                self._controller.step(np.full(6, np.nan), at, self._command)

    def _next(self) -> tuple[Reading, int, float]:
        """The next reading, its tick, and its lateness [s]."""
        machine, first = self._machine, not self._rows
        if machine.paced:
            reading = machine.read()
            self._clock.take(reading)
            self._first_number = reading.number if first else self._first_number
            return reading, int(reading.number - self._first_number) - self._ticks_behind, reading.age
        if first:
            self._pace = Pace(self._period)
        else:
            self._pace.advance(skip=True)
        late = self._pace.wait()
        return machine.read(), self._pace.tick - self._ticks_behind, late

    def _check(self, reading: Reading) -> None:
        """Stops the robot if the machine follows nothing, the reading is old, or a crank is off its path."""
        self._holding_ticks = self._holding_ticks + 1 if reading.holding else 0
        if self._holding_ticks * self._period > self._max_age:
            text = "the machine says that it holds and follows nothing: are its motors off, or commands out of range?"
            self._stop(RunFailure(text, reason="holding"))
        elif reading.age > self._max_age:
            text = f"a reading that is {reading.age:.3g} s old, at most {self._max_age:.3g} s"
            self._stop(RunFailure(text, reason="stale_reading"))
        elif self._machine.reads and self._controller.status == LEVELS[0]:
            # At other levels the safety layer is stopping the robot.
            path = self._held
            if path is None:
                path = inverse_kinematics(self._robot, self._motion.evaluate(self.time)[0])
            error = np.abs(reading.angles - path)
            self._far_readings = self._far_readings + 1 if error.max() > self._max_error else 0
            if self._held is None and (still := self._controller.standstill) is not None:
                self._stop(RunFailure(standstill_text(*still), still[1], still[0]))
            elif self._far_readings >= MAX_FAR_READINGS:
                leg = int(error.argmax())
                text = f"leg {leg} is {error[leg]:.3g} rad from where it should be, at most {self._max_error:.3g} rad"
                self._stop(RunFailure(text, leg, "not_following"))
