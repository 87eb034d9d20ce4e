"""A page that steers a machine through `Drive`; it shows the machine and, pale, its reference."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np

from stewart_drake.base.errors import ConfigurationError, RunFailure, StewartDrakeError, one_line
from stewart_drake.live.session import SLICE, Command, PageRow, PageSession, as_six, drawn
from stewart_drake.live.steering import HandReference, nearest_allowed
from stewart_drake.logs.log import MAX_ROWS, SimulationLog
from stewart_drake.machines.machine import Machine
from stewart_drake.mechanics.kinematics import forward_kinematics, inverse_kinematics
from stewart_drake.references.paced import RAMP, PacedMotion
from stewart_drake.runs.drive import Drive, Start, as_logged
from stewart_drake.scenario.scenario import Scenario

BANDWIDTH = 3.0  # [rad/s] of the filter behind the sliders: a move takes about three seconds.
LOGGED = 600.0  # [s] that the log keeps, the latest.
STILL = 1e-4  # Share of the motion in the reference, below which it may begin anew.
LAST_ROW = 0.5  # [s] for pages to read the last row.


class MachineSession(PageSession):
    """Drives a connected machine until it is stopped; publishes rows from another thread.

    The motion of the scenario, about a pose set by hand, ends after the scenario's duration, which is the checked part.
    Switched on again, it begins anew.
    """

    def __init__(self, scenario: Scenario, machine: Machine, start: Start) -> None:
        super().__init__()
        self.scenario = as_logged(scenario)
        self._hand = HandReference(scenario.reference, BANDWIDTH)
        self._motion = PacedMotion(self._hand, start.pose, start.motion.approach)
        endless = start._replace(motion=self._motion, duration=min(MAX_ROWS * scenario.reading_period, 1e6))
        self._drive = Drive(scenario, machine, endless, max_rows=round(LOGGED / scenario.reading_period))
        self._motors = scenario.controller_model.motors
        self._pose, self._ended = start.pose, ""
        self._do = {"aim": self._aim, "move": self._move, "stop": lambda _: self._drive.stop()}
        self.row()  # Compiles.

    @property
    def home(self) -> np.ndarray:
        """(6,) [rad, m] at the beginning."""
        return self._hand.home

    def run(self) -> RunFailure | KeyboardInterrupt | None:
        """Runs until Ctrl-C, a stop on the page, or the end of the `Drive`; returns the reason."""
        ended = threading.Event()
        display = threading.Thread(target=self._show, args=(ended,), daemon=True)
        display.start()
        try:
            reason = self._drive.go(self._advance)
        finally:
            ended.set()
            display.join()
        self._ended = one_line(reason) if isinstance(reason, RunFailure) else "stopped"
        self.publish(self.row())
        time.sleep(LAST_ROW)
        return reason

    def log(self, reason: RunFailure | KeyboardInterrupt | None) -> SimulationLog:
        """The log of the last `LOGGED` s, after the end."""
        log = self._drive.log(reason)
        return replace(log, scenario=log.scenario.replace(duration=max(log.end_time, self.scenario.reading_period)))

    def _advance(self, now: float) -> None:
        elapsed = self._motion.motion_time(now)
        self._hand.advance(elapsed)
        if elapsed - self._hand.begun > self.scenario.duration - RAMP:
            self._hand.share.target = np.zeros(1)

    def _show(self, ended: threading.Event) -> None:
        while not ended.wait(SLICE):
            try:
                self.obey()
                self._hand.govern(self.scenario, self._motion.motion_time(self._drive.time))
                self.publish(self.row())
            except Exception as error:  # The machine can still be stopped without the display.
                self.message = one_line(error)

    def _aim(self, command: Command) -> None:
        reached = self._hand.aim(self.scenario, as_six(command["pose"]))
        if reached.limit:
            self.message = f"as far as it goes: {reached.limit}"

    def _move(self, command: Command) -> None:
        on, reference, scenario = bool(command["on"]), self._hand, self.scenario
        if on:
            now, still = self._motion.motion_time(self._drive.time), reference.share.state[0, 0] < STILL
            if not still and now - reference.begun > scenario.duration - 2.0 * RAMP:
                raise ConfigurationError("motion", "on", "off until it has slowed down; ask again in some seconds")
            # The motion may be infeasible about the present pose.
            setup = scenario.robot, scenario.limits, self.home, reference.goal, scenario.gravity_in_base
            if limit := nearest_allowed(*setup, reference.excursions(scenario.duration, on=True)).limit:
                raise ConfigurationError("motion", "on", f"off here: {limit}")
            reference.begun = now if still else reference.begun
        reference.share.target = np.array([float(on)])

    def row(self) -> PageRow:
        """State for the page at the latest tick."""
        drive, robot, target = self._drive, self.scenario.robot, self._hand.goal
        row: PageRow = {
            "session": self.name,
            "obeyed": self._obeyed,
            "time": drive.time,
            "factor": 1.0,
            "paused": False,
            "motion": bool(self._hand.share.target[0]),
            "target": target.tolist(),
            "message": self.message or drive.odd_tick or "",
            "ended": self._ended,
            **dict.fromkeys(("setting", "kappa", "payload", "dead", "frozen", "controller", "links", "torque")),
        }
        tick = drive.latest
        try:
            self._pose = forward_kinematics(robot, tick.angles, self._pose)
            angles = inverse_kinematics(robot, tick.reference)
        except StewartDrakeError as error:
            return row | {"message": f"no picture: {one_line(error)}"}
        row |= drawn(robot, tick.reference, (self._pose, tick.angles), (tick.reference, angles))
        return row | {"torque": tick.sent if self._motors.by_torque else None}
