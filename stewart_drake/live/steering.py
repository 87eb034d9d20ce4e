"""What a hand on a slider becomes: a smooth reference, kept within what the robot can do."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from stewart_drake.analysis.feasibility import checked_times
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.references.motions import Reference
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.limits import PLACES, ReferenceLimits, limit_margins
from stewart_drake.scenario.scenario import Scenario

BANDWIDTH = 8.0
"""[rad/s] of the filter behind the sliders: a move is over after about a second."""
FARTHEST = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
"""[rad, m] from where the motion begins, within which a pose may be asked for."""
APART = np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002])
"""[rad, m] between two poses that are checked, at most."""
CRANK_SPEED = 2.0
"""[rad/s] of the fastest crank at which a hand moves the robot."""
GOVERNED = 0.02
"""[s] between two looks at how far the hand may go."""
_COURSE = np.linspace(0.0, 10.0, 64)  # Times of a move that are looked at, times the bandwidth.
_BLOCK, _HALVINGS = 8, 10


class SmoothValue:
    """A value (n,) that follows a target through a filter with three equal poles; it never overshoots.

    Its rate is continuous and its acceleration too, so that a controller with feedforward can follow it. At first it
    rests; `bandwidth` [rad/s] is that of the filter.
    """

    def __init__(self, value: np.ndarray, bandwidth: float = BANDWIDTH) -> None:
        w = self._bandwidth = bandwidth
        chain = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-(w**3), -3.0 * w**2, -3.0 * w]])
        # exp(t chain) is exp(-w t) times three terms: the cube of chain + w I is zero.
        rest = chain + w * np.eye(3)
        self._terms = np.stack([np.eye(3), rest, 0.5 * rest @ rest])
        self._course = np.array([self.transition(each / w) for each in _COURSE])
        self.target = np.array(value, dtype=float)
        self.state = np.zeros((3, len(self.target)))
        self.state[0] = self.target

    def after(self, time: float) -> np.ndarray:
        """Value, rate and acceleration (3, n) after a time [s], if the target stays."""
        rest = np.zeros_like(self.state)
        rest[0] = self.target
        return rest + self.transition(time) @ (self.state - rest)

    def transition(self, time: float) -> np.ndarray:
        """(3, 3): what a time [s] makes of the distance from the target and its rates."""
        ahead = np.tensordot([1.0, time, time**2], self._terms, 1)
        return np.asarray(np.exp(-self._bandwidth * time) * ahead)

    def course(self, target: np.ndarray) -> np.ndarray:
        """Values, rates and accelerations (k, 3, n) of the whole move to a target (n,)."""
        rest = np.zeros_like(self.state)
        rest[0] = target
        return rest + self._course @ (self.state - rest)


class HandReference:
    """The pose set by hand, with the motion of the scenario about it: a motion that goes on from its latest time.

    reference(t) = hand(t) + share(t) (motion(t) - motion(0)), hand and share each a `SmoothValue`.
    """

    def __init__(self, motion: Reference, bandwidth: float = BANDWIDTH) -> None:
        self._motion, self._now = motion, 0.0
        self.goal = self.home = motion.evaluate(0.0)[0]
        self._around: tuple[float, np.ndarray] | None = None
        self.hand, self.share = (SmoothValue(value, bandwidth) for value in (self.home, np.ones(1)))

    def aim(self, scenario: Scenario, pose: np.ndarray) -> Reached:
        """Sends the hand to a pose (6,) [rad, m], or as far towards it as the robot can go."""
        if (np.abs(pose - self.home) > FARTHEST + 1e-9).any():
            allowed = f"a pose within {FARTHEST[0]:g} rad and {FARTHEST[3]:g} m of {self.home.round(4).tolist()}"
            raise ConfigurationError("pose", pose.tolist(), allowed)
        around = self.excursions(scenario.duration)
        reached = nearest_allowed(scenario.robot, scenario.limits, self.goal, pose, scenario.gravity, around)
        self.goal = reached.pose
        return reached

    def govern(self, scenario: Scenario, time: float) -> None:
        """Takes the hand's target as far towards `goal` as limits and `CRANK_SPEED` allow on the way; time [s] as `at`.

        What the filter makes of a target is known: the whole move is looked at, to its end. A reference governor.
        """
        hand, begun = self.hand, self.hand.target
        if (begun == self.goal).all():
            return
        speed = min(scenario.limits.crank_speed or np.inf, CRANK_SPEED)
        limits = scenario.limits.replace(crank_speed=speed)
        own = self.at(time)[:6] - hand.state[0]
        for share in 0.5 ** np.arange(7):
            target = self.goal if share == 1.0 else begun + share * (self.goal - begun)
            if _first_broken(scenario.robot, limits, hand.course(target), scenario.gravity, own[None]) is None:
                # Whole, for a thread that drives.
                hand.target = target.copy()
                return

    def advance(self, time: float) -> None:
        """To a later time [s]."""
        for each in (self.hand, self.share):
            each.state = each.after(time - self._now)
        self._now = time

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration (..., 6) at times [s] near the latest one, if the targets stay."""
        rows = np.array([self.at(each) for each in np.ravel(time)])
        pose, rate, acceleration = np.moveaxis(rows.reshape(*np.shape(time), 3, 6), -2, 0)
        return pose, rate, acceleration

    def at(self, time: float) -> np.ndarray:
        """The same in one, (18,), at one time [s]."""
        ahead = time - self._now
        hand, share = (each.after(ahead) if ahead else each.state for each in (self.hand, self.share))
        s, rate, acceleration = share[:, 0]
        pose, velocity, force = self._motion.evaluate(time)
        own = pose - self.home
        return np.concatenate(
            [
                hand[0] + s * own,
                hand[1] + rate * own + s * velocity,
                hand[2] + acceleration * own + 2.0 * rate * velocity + s * force,
            ]
        )

    def excursions(self, duration: float, on: bool = False) -> np.ndarray:
        """Samples (n, 6) of what the motion adds to the pose set by hand; zeros (1, 6) once it is off, and not `on`."""
        if self.share.target[0] == 0.0 and not on:
            return np.zeros((1, 6))
        if self._around is None or self._around[0] != duration:
            poses = (self._motion.evaluate(checked_times(duration))[0] - self.home) / APART
            # Of those that are near to one another the farthest.
            poses = poses[np.argsort(-np.linalg.norm(poses, axis=1), kind="stable")]
            self._around = duration, poses[np.unique(np.floor(poses), axis=0, return_index=True)[1]] * APART
        return self._around[1]


class Reached(NamedTuple):
    """How far towards a pose the robot can go."""

    pose: np.ndarray  # (6,) [rad, m] asked for, or the last allowed one on the straight way to it.
    limit: str  # What is at its limit there; empty where the pose asked for is allowed.


def nearest_allowed(
    robot: RobotParameters,
    limits: ReferenceLimits,
    here: np.ndarray,
    wanted: np.ndarray,
    gravity: float,
    around: np.ndarray,
) -> Reached:
    """The last pose on the straight way from `here` to the one that is wanted, (6,) each, that keeps to the limits.

    Limits are those at rest; `around` (n, 6) [rad, m] is what a motion adds to the pose, zeros (1, 6) for none.
    """
    here, wanted = np.asarray(here, dtype=float), np.asarray(wanted, dtype=float)
    way = wanted - here
    shares = np.linspace(0.0, 1.0, 1 + max(1, math.ceil((np.abs(way) / APART).max())))

    def broken_at(share: np.ndarray) -> tuple[int, str] | None:
        at_rest = np.zeros((len(share), 3, 6))
        at_rest[:, 0] = here + share[:, None] * way
        return _first_broken(robot, limits, at_rest, gravity, around)

    for at in range(0, len(shares) - 1, _BLOCK):
        if (broken := broken_at(shares[at : at + _BLOCK + 1])) is not None:
            break
    else:
        return Reached(wanted, "")
    place, limit = broken
    low, high = shares[at + place - 1 : at + place + 1].tolist()
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if (broken := broken_at(np.array([low, middle]))) is None:
            low = middle
        else:
            high, limit = middle, broken[1]
    return Reached(here + low * way, limit)


def _first_broken(
    robot: RobotParameters, limits: ReferenceLimits, motion: np.ndarray, gravity: float, around: np.ndarray
) -> tuple[int, str] | None:
    """Index of the first row after row 0 that breaks a limit, and which; None where all keep to them.

    Rows (n, 3, 6) of pose, rate, acceleration; `around` (k, 6) is added. Row 0 tells on which side of a singularity.
    """
    rows = np.repeat(motion, len(around), axis=0)
    rows[:, 0] += np.tile(around, (len(motion), 1))
    margins = limit_margins(robot, limits, rows[:, 0], rows[:, 1], rows[:, 2], gravity)
    first: tuple[int, str] | None = None
    for name, values in margins.items():
        broken = ~(values >= 0.0)
        broken[: len(around)] = False
        if broken.any():
            row = int(broken.any(axis=1).argmax())
            place = row // len(around)
            if first is None or place < first[0]:
                _, where = PLACES[name][int(broken[row].argmax())]
                first = place, f"{name.replace('_', ' ')} of {where}"
    return first
