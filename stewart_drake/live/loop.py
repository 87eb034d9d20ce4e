"""A loop without end that a person changes while it runs: target, pushes, payload, faults, controller."""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import deepcopy

import numpy as np

from stewart_drake.base.errors import RunFailure, SafetyStop, one_line
from stewart_drake.base.sampling import on_grid
from stewart_drake.control.base_reading import levelled
from stewart_drake.control.user_controller import failure_of
from stewart_drake.hardware.disturbances import total_wrench
from stewart_drake.hardware.moving_base import base_signal
from stewart_drake.live.ball import BallHand
from stewart_drake.live.instrument import Push, Recorder, Spring, TestMotion, TurningSpring
from stewart_drake.live.steering import GOVERNOR_PERIOD, HandReference, Reached
from stewart_drake.mechanics.ball import BALL_FELL
from stewart_drake.plant.plant_options import ANGLES, BALL, POSE, RATE
from stewart_drake.safety import MONITORS, RAMP, Stillness
from stewart_drake.safety.limits import LIMITS
from stewart_drake.scenario.scenario import Scenario
from stewart_drake.scenario.stepped_loop import SteppedLoop

PULL_RESOLUTION = 0.02  # Share of the largest force; a smaller change of a pull is not recorded.


def cause_of(failure: RunFailure, scenario: Scenario, time: float) -> dict[str, object]:
    """What ended a loop at a time [s], and where; a trip of the safety layer came before, with the key of its limit."""
    safety, trip = scenario.safety, failure.trip if isinstance(failure, SafetyStop) else None
    if safety is None or trip is None:
        return {"reason": failure.reason, "time": failure.time or time, "leg": failure.leg}
    trip = trip["stopped"] or trip
    key = {MONITORS[number]: key for number, key, _ in LIMITS}.get(trip["monitor"], trip["monitor"])
    limit = {"key": key, "unit": safety.unit_of(key), "limit": np.ravel(getattr(safety, key, ()))}
    return {"reason": trip["monitor"], "time": trip["time"], "leg": trip["leg"], **limit}


class LiveLoop:
    """The loop of a scenario on its plant, changed while it runs.

    Every change but a new target or a push changes the scenario. The loop is then rebuilt; parts that remain keep their
    states, and so does the plant.

    Attributes:
        reference: Pose set by hand, with the motion of the scenario about it.
        ended: Reason why the loop cannot go on; empty while it can.
        cause: What ended it; None while it can go on.
        spring: Pulls or turns the platform; may be None.
        test: Motion that is added to the reference; may be None.
        ball: The hand on the ball; None if there is none.
        record: Recorder of motion, pushes and changes.
        stillness: Monitor of standstill, for scenarios without a safety layer.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._initial, self._loop = scenario, SteppedLoop(scenario)
        self.reset()

    def reset(self) -> None:
        """Back to the beginning."""
        scenario = self._initial
        self.ended, self._push, self._push_ends = "", np.zeros(6), -1
        self.cause: dict[str, object] | None = None
        self.spring: Spring | TurningSpring | None = None
        self.test: TestMotion | None = None
        self._pulled: Push | None = None
        self._ticked: int | None = None  # The step of the latest tick of the controller.
        self._step = on_grid(scenario.plant.time_step)
        self.ball = None if scenario.ball is None else BallHand(scenario.ball, self._step)
        self.record = Recorder(self._step, self.ball)
        self._governor_steps = max(1, round(GOVERNOR_PERIOD / self._step))
        self._tick = max(1, round(scenario.controller.period / self._step))
        self.stillness = Stillness(scenario.controller_model.robot, self._tick * self._step)
        self.reference = HandReference(scenario.reference)
        self._loop = self._loop_of(scenario)
        self._loop.begin()

    def change(self, changes: Mapping[str, object]) -> None:
        """Changes keys of the scenario, see `Scenario.replace`; a ConfigurationError leaves all as it was."""
        loop = self._loop_of(self.scenario.replace(changes))
        loop.take_over(self._loop)
        self._loop = loop
        self.record.changes.append((self.time, changes))

    def copy_with(self, changes: Mapping[str, object]) -> LiveLoop:
        """A copy with another plant, which continues from here with other keys of the scenario."""
        other = LiveLoop(self.scenario)
        other._loop.take_over(self._loop)
        other._initial, other.reference = self._initial, deepcopy(self.reference)
        other.change(changes)
        return other

    def aim(self, pose: np.ndarray) -> Reached:
        """Sets the goal to a pose (6,) [rad, m], or to the last feasible one on the straight path to it."""
        return self.reference.aim(self.scenario, pose)

    def move(self, on: bool) -> None:
        """Switches the motion of the scenario on or off."""
        self.reference.share.target[0] = float(on)

    def push(self, wrench: np.ndarray, duration: float) -> None:
        """Pushes the platform from now on, for a duration [s]: wrench (6,) [N m, N], moment about P and force, in B."""
        self._push[:], self._push_ends = wrench, self.steps + round(duration / self._step)
        self._record_push(wrench, duration)

    def advance(self, steps: int) -> None:
        """Advances by steps of the plant; does nothing once the loop has ended."""
        try:
            for _ in range(steps if not self.ended else 0):
                self._advance_one()
        except (Exception, SystemExit) as error:  # The page stays open, so that a person can reset.
            failure = failure_of(error, self.scenario)
            self._give_up_test()
            self.cause, self.ended = cause_of(failure, self.scenario, self.time), one_line(failure)

    def _advance_one(self) -> None:
        self._record_pull()
        if self.steps % self._governor_steps == 0:
            self.reference.govern(self.scenario, self.time)
        self._run_parts()
        if self.steps % self._tick == 0:
            self._ticked = self.steps
        if self.steps % self._tick == 0 and self.scenario.safety is None:
            runner = self._loop.runner
            self.stillness.look(runner.signal("reading" if "reading" in runner.places else "plant_pose"), self.wanted)
        if (safety := self.logged("safety")) is not None and safety[0] >= RAMP:
            self._give_up_test()
        self._loop.move()
        self.reference.advance(self.time)
        if self.test is not None:
            rest = self._in_base(self.reference.at(self.time))
            self.test.watch(self.time, self._loop.pose, float(rest[self.test.axis]))
        if self.steps % self.record.every == 0:
            measured = self._loop.measured
            ball = () if self.ball is None else (measured[BALL][:4],)
            self.record.add(self.time, self._asked, self._loop.pose, self._loop.torque, measured[ANGLES], *ball)

    def _run_parts(self) -> None:
        try:
            self._loop.run_parts()
        except RunFailure as failure:
            if self.ball is None or failure.reason != BALL_FELL:
                raise
            pose, rate, motion = (self._loop.measured[part].copy() for part in (POSE, RATE, BALL))
            self.ball.put_back(self.time, pose, rate, motion)
            # The plant goes on from the platform's motion, with the ball where it starts.
            self._loop.measured[:] = self._loop.plant.initial(pose, rate)
            self._loop.run_parts()

    def _give_up_test(self) -> None:
        if self.test is not None:
            self.test.give_up()

    @property
    def scenario(self) -> Scenario:
        """The scenario with all changes."""
        return self._loop.scenario

    @property
    def steps(self) -> int:
        """Steps of the plant since the beginning."""
        return self._loop.now

    @property
    def time(self) -> float:
        """[s] since the beginning."""
        return self._loop.time

    @property
    def pose(self) -> np.ndarray:
        """(6,) [rad, m] of the platform."""
        return self._loop.pose.copy()

    @property
    def crank_angles(self) -> np.ndarray:
        """(6,) [rad] theta."""
        return self._loop.measured[ANGLES].copy()

    @property
    def _asked(self) -> np.ndarray:
        """(6,) as `wanted`, without a tilt for a ball, which a run of the record adds anew."""
        return self._in_base(self._wanted(self.steps))[:6]

    @property
    def ball_motion(self) -> np.ndarray:
        """(5,) of the ball, see `plant_options.BALL`; (0,) if there is none."""
        return self._loop.measured[BALL].copy()

    @property
    def wanted(self) -> np.ndarray:
        """(6,) [rad, m] reference at the time of `pose`, turned or tilted where the controller does."""
        if self.scenario.ball_control is None or self._ticked is None:
            return self._asked
        # As the controller has tilted it at its latest tick.
        since, tilted = (self.steps - self._ticked) * self._step, self._loop.runner.signal("reference")
        return np.asarray(tilted[:6] + since * (tilted[6:12] + 0.5 * since * tilted[12:]))

    @property
    def torque(self) -> np.ndarray:
        """(6,) [N m] of the motors."""
        return self._loop.torque.copy()

    @property
    def pushed(self) -> bool:
        """Whether a push acts."""
        return self.steps < self._push_ends

    def logged(self, name: str) -> np.ndarray | None:
        """A signal by its name in a log, such as `setting`; None if the loop has none."""
        signal = self._loop.parts.logged.get(name)
        return self._loop.runner.signal(signal).copy() if isinstance(signal, str) else signal

    def _record_push(self, wrench: np.ndarray, duration: float) -> Push:
        self.record.pushes.append(Push(wrench.tolist(), self.time, self.time + duration))
        return self.record.pushes[-1]

    def _record_pull(self) -> None:
        """Records a pull as steps, a new one once the force has changed by `PULL_RESOLUTION`."""
        wrench = np.zeros(6) if self.spring is None else self.spring.wrench(self._loop.pose)
        if (before := self._pulled) is not None:
            if self.spring is not None:
                changed = float(np.linalg.norm(wrench - before.wrench))
                if changed <= PULL_RESOLUTION * self.spring.largest:
                    return
            before.until = self.time
        self._pulled = None if self.spring is None else self._record_push(wrench, math.inf)

    def _wanted(self, step: int, ahead: float = 0.0) -> np.ndarray:
        """(18,) pose, rate and acceleration at a step of the plant, or `ahead` [s] from it."""
        time = step * self._step + ahead
        wanted = self.reference.at(time)
        return wanted if self.test is None else wanted + self.test.added(time)

    def _in_base(self, row: np.ndarray) -> np.ndarray:
        """A row (18,) of a motion now, as the robot is asked to follow it; `Scenario.asked` of what a hand moves."""
        scenario, base = self.scenario, self.scenario.base.motion
        if scenario.base_compensation != "level" or base is None:
            return row
        reading = base_signal(base, scenario.gravity_in_base, np.array([self.time]))
        return levelled(row[None], reading)[0]

    def _loop_of(self, scenario: Scenario) -> SteppedLoop:
        """The loop of a scenario; the plant is kept if its keys are the same."""
        plant = self._loop.plant if _plant_keys(scenario) == _plant_keys(self.scenario) else None
        ahead = scenario.preview
        pushes = scenario.disturbances

        def wrench(step: int) -> np.ndarray:
            push = self._push if self.pushed else np.zeros(6)
            if self.spring is not None:
                push = push + self.spring.wrench(self._loop.pose)
            return push + total_wrench(pushes, step * self._step) if pushes else push

        sources = {"reference": self._wanted, "wrench": wrench}
        if ahead > 0.0:
            sources["reference_ahead"] = lambda step: self._wanted(step, ahead)
        if (hand := self.ball) is not None:
            sources["ball_push"] = lambda step: hand.force(self.scenario, step * self._step, self._loop.measured[BALL])
        return SteppedLoop(scenario, plant, sources)


def _plant_keys(scenario: Scenario) -> tuple[object, ...]:
    """Keys on which the plant depends."""
    return scenario.robot, scenario.plant, scenario.gravity_in_base, scenario.ball
