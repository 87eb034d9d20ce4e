"""An observer of the platform's motion: pose, rate and what no model explains, from readings of the cranks' angles.

Between two ticks the exact model says what the known torques do. What else happens is one more acceleration of each
crank, which nobody knows and which wanders. A reading then corrects all three, by the steady Kalman filter of

    theta' = rate,  rate' = model + surplus + white noise,  surplus' = white noise,  reading = theta + white noise,

the same for each crank. In the cranks' coordinates noise is alike in all directions and the gains are three numbers,
however the robot stands. Source of the filter's closed form: the spectral factorisation of its Riccati equation, see
`kalman_gains`; of a disturbance as a further state: C. Johnson, "Accommodation of external disturbances in linear
regulator and servomechanism problems" (IEEE Trans. Autom. Control 16, 1971).

A motor that sticks makes such a state hunt: it grows until the crank breaks away and jumps too far. So for motors with
friction it stays as it is while the reference rests and all cranks stand where it wants them, as far as readings tell.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.compiled.constants import OBSERVER_MEMORY, OBSERVER_NUMBERS, WHITE_SHARE, filled
from stewart_drake.errors import RunFailure, SingularPoseError, UnreachablePoseError, pose_text
from stewart_drake.mechanics.dynamics import forward_dynamics, pose_acceleration_map, task_inertia
from stewart_drake.mechanics.kinematics import (
    leg_geometry,
    pose_jacobian,
    pose_rate_to_twist,
    rod_lines,
    twist_jacobian,
    twist_to_pose_rate,
)
from stewart_drake.robot import RobotParameters
from stewart_drake.section import Natural, Positive, Section
from stewart_drake.spectral import filter_cubic, filter_read, spectral_factor

_M = OBSERVER_MEMORY

SMALLEST_NOISE = 1e-5
"""[rad] that readings have at least for the observer: finer than that no model is."""
ARRIVED = 6.0
"""Standard deviations of a reading within which a crank stands where it is wanted, whatever its friction."""
SLIP = 4.0
"""[-] the same in units of break_away / (inertia bandwidth^2): about half of what a crank that hunts jumps by."""
NOISE_AT_MOST = 8.0
"""Standard deviations of a reading that an innovation of noise and counts alone has at most."""
SHARE = WHITE_SHARE
"""[-] white noise of an acceleration, in units of the disturbance over the bandwidth. It damps the filter's poles: with
none the loop that feeds the surplus back has a disk margin of some 0.37 in place of 0.49 (`stewart-drake margins`)."""
RESTS = 1e-4
"""[rad/s] a crank that is to turn more slowly is to rest."""


class EstimatorOptions(Section, key="estimator"):
    """Base of the options of estimators."""

    kind: str

    @property
    def exact(self) -> bool:
        """Whether it passes on what a sensor of pose and rate says."""
        return False

    @property
    def expected(self) -> float:
        """[rad/s^2 per sqrt(s)] that an observer expects unless a tuner says otherwise; 0 for no observer."""
        return 0.0

    def ahead(self, delay: int) -> int:
        """[ticks] from a command to its torque, as believed, of those that it takes."""
        return delay


class DifferenceOptions(EstimatorOptions):
    """The pose as it is read, its rate from the difference of two readings; a sensor that measures both is believed."""

    kind: Literal["difference"] = "difference"

    @property
    def exact(self) -> bool:
        """See `EstimatorOptions`."""
        return True


class ObserverOptions(EstimatorOptions):
    """A Kalman filter with the exact model in it, see the text of `hardware.observer`."""

    kind: Literal["observer"] = "observer"
    disturbance: Annotated[Positive, Field(le=1e6)] = 16.0
    """[rad/s^2 per sqrt(s)] by which the unexplained part of each crank's acceleration is expected to change in a
    second: low is quiet, high is stiff. With the noise of the readings it sets the bandwidth."""
    delay: Annotated[Natural, Field(le=100)] | None = None
    """[ticks] from a command to its torque, as believed; null takes `command_delay`. The controller gets the state, and
    the reference, of the time at which its command acts."""
    max_innovation: Positive = 0.05
    """[rad] a reading further than this from what was expected is not believed."""
    hold_ticks: Annotated[Natural, Field(le=1000)] = 10
    """Ticks in a row in which a reading may be missing before the run ends; meanwhile the model stands in for it."""

    @property
    def expected(self) -> float:
        """See `EstimatorOptions`."""
        return self.disturbance

    def ahead(self, delay: int) -> int:
        """See `EstimatorOptions`."""
        return delay if self.delay is None else self.delay


class KalmanGains(NamedTuple):
    """What an innovation of 1 rad adds.

    Attributes:
        angle: [-] to the crank's angle.
        rate: [1/s] to its rate.
        surplus: [1/s^2] to the unexplained acceleration.
    """

    angle: float
    rate: float
    surplus: float


def bandwidth(noise: float, disturbance: float, period: float) -> float:
    """[rad/s] of the observer: geometric mean of its three poles in continuous time."""
    return float((float(disturbance) / (noise * math.sqrt(period))) ** (1.0 / 3.0))


def kalman_gains(noise: float, disturbance: float, period: float) -> KalmanGains:
    """Gains of the steady Kalman filter of one crank, in closed form.

    With g = disturbance^2 h^5 / noise^2 and a = white^2 h^3 / noise^2 for a white acceleration, the spectrum of the
    readings is proportional to u^3 + (a/4 + g/16) u^2 + (a + g/2) u + g, see `spectral`: surplus and acceleration reach
    the angle through h^2 (z + 1) / 2 d^3 and h^2 (z + 1) / 2 d^2, d = z - 1. Its factor has the filter's poles.

    Args:
        noise: [rad] standard deviation of a reading.
        disturbance: [rad/s^2 per sqrt(s)], see `ObserverOptions`.
        period: [s].
    """
    turn = bandwidth(noise, disturbance, period) * period
    wandering, white = turn**6, SHARE**2 * turn**4
    factor = spectral_factor(*map(np.float64, filter_cubic(wandering, white)))
    return KalmanGains(*map(float, filter_read(factor, period)))


class ObserverMemory(NamedTuple):
    """What a tick says, and what the next one needs of it.

    Attributes:
        pose: (6,) [rad, m] now.
        rate: (6,) [rad/s, m/s] now.
        pose_ahead: (6,) when the command of this tick will act.
        rate_ahead: (6,) likewise.
        compensation: (6,) [N m] against what is not explained, for the command.
        innovation: (6,) [rad] readings less what was expected of them; 0 where one is missing.
        surplus: (6,) [rad/s^2] acceleration of the cranks that the model does not explain.
        missed: (6,) ticks in a row without a reading.
        side: Sign of the rods' determinant; 0 before the first tick.
        commands: (delay + 1, 6) [N m] the last, oldest first.
    """

    pose: np.ndarray
    rate: np.ndarray
    pose_ahead: np.ndarray
    rate_ahead: np.ndarray
    compensation: np.ndarray
    innovation: np.ndarray
    surplus: np.ndarray
    missed: np.ndarray
    side: np.ndarray
    commands: np.ndarray

    def flat(self) -> np.ndarray:
        """All in one vector (61 + 6 (delay + 1),), in the order of the attributes."""
        return np.concatenate([np.ravel(each) for each in self])

    @classmethod
    def from_flat(cls, values: np.ndarray) -> ObserverMemory:
        """Inverse of `flat`."""
        parts = [values[start:end] for start, end in itertools.pairwise(_M)]
        return cls(*(*parts, values[_M.size :].reshape(-1, 6)))


class Observer(NamedTuple):
    """What stays the same from tick to tick.

    Attributes:
        robot: As believed.
        options: See `ObserverOptions`.
        gravity: [m/s^2].
        period: [s].
        noise: [rad] standard deviation of a reading, see `SensorOptions.reading_noise`.
        friction: [N m] largest break-away torque that the motors are believed to have.
        least: [-] smallest share of the options' disturbance that a tuner may ask for.
    """

    robot: RobotParameters
    options: ObserverOptions
    gravity: float
    period: float
    noise: float
    friction: float = 0.0
    least: float = 1.0

    @property
    def reading_noise(self) -> float:
        """[rad] of a reading, at least `SMALLEST_NOISE`."""
        return max(self.noise, SMALLEST_NOISE)

    def gains(self, disturbance: float) -> KalmanGains:
        """Of the filter, for a disturbance as in `ObserverOptions`."""
        return kalman_gains(self.reading_noise, disturbance, self.period)

    @property
    def slip(self) -> float:
        """[rad/s^2] of a crank by `SLIP` of the largest break-away torque."""
        home = self.robot.home_pose
        mobility = pose_jacobian(self.robot, home) @ pose_acceleration_map(self.robot, home)
        return SLIP * self.friction * float(np.diag(mobility).max())

    def arrived(self, disturbance: float) -> float:
        """[rad] within which a crank that rests stands where it is wanted; negative for motors without friction."""
        if self.friction == 0.0:
            return -1.0
        turn = bandwidth(self.reading_noise, disturbance, self.period)
        return max(ARRIVED * self.reading_noise, self.slip / turn**2)

    @property
    def surprise_scale(self) -> tuple[float, float]:
        """[rad] of an innovation that noise explains, and [rad per rad/s^2] what an unexplained acceleration leaves."""
        turn = bandwidth(self.reading_noise, self.options.disturbance * self.least, self.period)
        return NOISE_AT_MOST * self.reading_noise, 1.0 / turn**2 + self.period**2

    def initial(self, pose: np.ndarray, rate: np.ndarray, command: np.ndarray, delay: int) -> np.ndarray:
        """Memory before the first tick, flat.

        Args:
            pose: (6,) [rad, m] roughly where the platform stands; picks the assembly mode.
            rate: (6,) [rad/s, m/s] of a robot that is in motion at the start.
            command: (6,) [N m] at the motors until the first command arrives.
            delay: [ticks] of the commands.
        """
        none = np.zeros(6)
        commands = np.tile(command, (delay + 1, 1))
        return ObserverMemory(pose, rate, pose, rate, none, none, none, none, np.zeros(1), commands).flat()


def advance(
    observer: Observer, pose: np.ndarray, rate: np.ndarray, torque: np.ndarray, surplus: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pose and rate (6,) a period later, by the exact model under constant torques and `surplus` (6,) [rad/s^2].

    Raises:
        UnreachablePoseError: The pose is out of reach.
        numpy.linalg.LinAlgError: Exactly at a singularity.
    """
    robot, period = observer.robot, observer.period
    more = np.linalg.solve(twist_jacobian(robot, pose), surplus)
    acceleration = forward_dynamics(robot, pose, rate, torque, observer.gravity) + twist_to_pose_rate(pose, more)
    return pose + period * (rate + 0.5 * period * acceleration), rate + period * acceleration


def observe(
    observer: Observer,
    angles: np.ndarray,
    sent: np.ndarray,
    reference: np.ndarray,
    disturbance: float,
    memory: ObserverMemory,
) -> ObserverMemory:
    """One tick, but the first: predicts, corrects by what is believed of the readings, and looks ahead.

    Args:
        observer: See there.
        angles: (6,) [rad] readings; NaN for one that is missing.
        sent: (6,) [N m] the last command, of the tick before, less what of it the friction takes.
        reference: (18,) wanted now: pose [rad, m], its rate and its acceleration.
        disturbance: [rad/s^2 per sqrt(s)] for this tick, see `ObserverOptions`.
        memory: Of the tick before.

    Raises:
        RunFailure: A reading has been missing, or not believed, for too long.
        SingularPoseError: The robot has come to a singularity.
    """
    robot, options, gains = observer.robot, observer.options, observer.gains(disturbance)
    # What is not a number no motor gives; the safety layer repeats the last command for it.
    sent = sent if np.isfinite(sent).all() else memory.commands[-1]
    commands = np.concatenate([memory.commands[1:], sent[None]])
    with _named(memory):
        pose, rate = advance(observer, memory.pose, memory.rate, commands[0], memory.surplus)
        expected = leg_geometry(robot, pose).crank_angles
        innovation = np.remainder(angles - expected + np.pi, 2.0 * np.pi) - np.pi
        believed = np.abs(innovation) <= options.max_innovation
        missed = np.where(believed, 0.0, memory.missed + 1.0)
        if missed.max() > options.hold_ticks:
            leg = int(missed.argmax())
            text = f"encoder readings {pose_text(angles)}: {leg} is missing or not believed"
            raise RunFailure(text, reason="encoder", leg=leg)
        innovation = np.where(believed, innovation, 0.0)
        jacobian = twist_jacobian(robot, pose)
        turned = np.linalg.solve(jacobian, np.outer(innovation, gains[:2])).T
        pose, rate = pose + twist_to_pose_rate(pose, turned[0]), rate + twist_to_pose_rate(pose, turned[1])
        wanted = pose_rate_to_twist(pose, np.stack([pose - reference[:6], reference[6:12]]))
        apart = np.abs(jacobian @ wanted.T).max(axis=0)
        stands = apart[0] <= observer.arrived(disturbance) and apart[1] <= RESTS
        surplus = memory.surplus if stands else memory.surplus + gains.surplus * innovation
        now = memory._replace(pose=pose, rate=rate, surplus=surplus, missed=missed, commands=commands)
        return _looking_ahead(observer, now._replace(innovation=innovation))


@contextmanager
def _named(memory: ObserverMemory) -> Iterator[None]:
    """Names what is wrong with a robot that has come to a singularity, or will before its command acts."""
    try:
        yield
    except UnreachablePoseError as error:
        # A crank carried across its dead centre, slightly.
        raise SingularPoseError("serial", error.pose, error.margin, 0.0, error.leg) from None
    except np.linalg.LinAlgError:
        raise SingularPoseError("parallel", memory.pose, 0.0, 0.0) from None


def _looking_ahead(observer: Observer, memory: ObserverMemory) -> ObserverMemory:
    """The rest of a tick: what will be when its command acts."""
    robot, pose, rate = observer.robot, memory.pose, memory.rate
    side = np.sign(np.linalg.det(rod_lines(leg_geometry(robot, pose))))
    if memory.side[0] not in (0.0, side):
        raise SingularPoseError("parallel", pose, 0.0, 0.0)
    for command in memory.commands[1:]:
        pose, rate = advance(observer, pose, rate, command, memory.surplus)
    jacobian = twist_jacobian(robot, pose)
    wrench = task_inertia(robot, pose) @ np.linalg.solve(jacobian, memory.surplus)
    compensation = -np.linalg.solve(jacobian.T, wrench)
    return memory._replace(pose_ahead=pose, rate_ahead=rate, compensation=compensation, side=np.atleast_1d(side))


def start(observer: Observer, pose: np.ndarray, memory: ObserverMemory) -> ObserverMemory:
    """The first tick, from the pose (6,) [rad, m] that its readings tell; the rate is that of the memory.

    Raises:
        SingularPoseError: The robot comes to a singularity before its first command acts.
    """
    with _named(memory):
        return _looking_ahead(observer, memory._replace(pose=pose))


FlatObserver = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def flat_observer(
    observer: Observer, first_pose: Callable[[np.ndarray, np.ndarray], np.ndarray], compiled: bool
) -> FlatObserver:
    """A tick of angles (6,), last command (6,), reference (18,), disturbance (1,) and memory alone, compiled or not.

    Args:
        observer: See there.
        first_pose: Pose (6,) from the first readings (6,) and the pose in the memory.
        compiled: See `Scenario.compiled`.
    """

    def in_numpy(
        angles: np.ndarray, sent: np.ndarray, reference: np.ndarray, disturbance: np.ndarray, flat: np.ndarray
    ) -> np.ndarray:
        memory = ObserverMemory.from_flat(flat)
        if memory.side[0] == 0.0:
            return start(observer, first_pose(angles, memory.pose), memory).flat()
        return observe(observer, angles, sent, reference, float(disturbance[0]), memory).flat()

    if not compiled:
        return in_numpy
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled import mechanism
    from stewart_drake.compiled import observer as fast

    packed = mechanism.pack(observer.robot)
    numbers = filled(
        OBSERVER_NUMBERS,
        period=observer.period,
        gravity=observer.gravity,
        noise=observer.reading_noise,
        max_innovation=observer.options.max_innovation,
        hold_ticks=observer.options.hold_ticks,
        arrived=ARRIVED * observer.reading_noise if observer.friction > 0.0 else -1.0,
        slip=observer.slip,
        rests=RESTS,
    )

    def tick(
        angles: np.ndarray, sent: np.ndarray, reference: np.ndarray, disturbance: np.ndarray, flat: np.ndarray
    ) -> np.ndarray:
        result = np.empty_like(flat)
        if flat[_M.side] != 0.0:
            ended = fast.observe(packed, numbers, angles, sent, reference, disturbance, flat, result)
            if ended == mechanism.OK:
                return result
        # Rare: numpy says what was wrong.
        return in_numpy(angles, sent, reference, disturbance, flat)

    return tick
