"""What a hand on a slider becomes: a smooth reference, kept within what the robot can do."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stewart_drake.references.motions import Reference
from stewart_drake.robot import RobotParameters
from stewart_drake.scenario.limits import PLACES, ReferenceLimits, limit_margins

BANDWIDTH = 8.0
"""[rad/s] of the filter behind the sliders: a move is over after about a second."""
SAMPLES = 24
"""Poses between here and the pose asked for that are checked, and times of the motion."""


class SmoothValue:
    """A value (n,) that follows a target through a filter with three equal poles; it never overshoots.

    Its rate is continuous and its acceleration too, so that a controller with feedforward can follow it. At first it
    rests; `step` [s] is the time between two calls of `advance`, `bandwidth` [rad/s] that of the filter.
    """

    def __init__(self, value: np.ndarray, step: float, bandwidth: float = BANDWIDTH) -> None:
        w, self._step, self._bandwidth = bandwidth, step, bandwidth
        chain = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-(w**3), -3.0 * w**2, -3.0 * w]])
        # exp(t chain) is exp(-w t) times three terms: the cube of chain + w I is zero.
        rest = chain + w * np.eye(3)
        self._terms = np.stack([np.eye(3), rest, 0.5 * rest @ rest])
        self.target = np.array(value, dtype=float)
        self.state = np.zeros((3, len(self.target)))
        self.state[0] = self.target

    def advance(self) -> None:
        """One step."""
        self.state = self.after(1)

    def after(self, steps: float) -> np.ndarray:
        """Value, rate and acceleration (3, n) after some steps, whole or not, if the target stays."""
        rest = np.zeros_like(self.state)
        rest[0] = self.target
        return rest + self.transition(steps) @ (self.state - rest)

    def transition(self, steps: float) -> np.ndarray:
        """(3, 3): what some steps make of the distance from the target and its rates."""
        time = steps * self._step
        ahead = np.tensordot([1.0, time, time**2], self._terms, 1)
        return np.asarray(np.exp(-self._bandwidth * time) * ahead)


class HandReference:
    """The pose set by hand, with the motion of the scenario about it.

    reference(t) = hand(t) + share(t) (motion(t) - motion(0)), hand and share each a `SmoothValue`.
    """

    def __init__(self, motion: Reference, step: float, bandwidth: float = BANDWIDTH) -> None:
        self._motion, self._step = motion, step
        self.home = motion.evaluate(0.0)[0]
        self.hand, self.share = (SmoothValue(value, step, bandwidth) for value in (self.home, np.ones(1)))

    def advance(self) -> None:
        """One step."""
        self.hand.advance()
        self.share.advance()

    def at(self, time: float, ahead: float = 0.0) -> np.ndarray:
        """Pose, rate and acceleration (18,) at a time [s], `ahead` steps from now."""
        hand, share = (each.after(ahead) if ahead else each.state for each in (self.hand, self.share))
        s, rate, acceleration = share[:, 0]
        pose, velocity, force = self._motion.evaluate(time + ahead * self._step)
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
        return self._motion.evaluate(np.linspace(0.0, duration, SAMPLES))[0] - self.home


class HandMotion:
    """A `HandReference` as a motion, which goes on from its latest time; a hand on the page sets its targets."""

    def __init__(self, motion: Reference, bandwidth: float) -> None:
        self.reference, self._now = HandReference(motion, 1.0, bandwidth), 0.0

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration (..., 6) at times [s] near the latest one, if the targets stay."""
        rows = np.array([self.reference.at(self._now, each - self._now) for each in np.ravel(time)])
        pose, rate, acceleration = np.moveaxis(rows.reshape(*np.shape(time), 3, 6), -2, 0)
        return pose, rate, acceleration

    def advance(self, time: float) -> None:
        """Its latest time [s]."""
        for each in (self.reference.hand, self.reference.share):
            each.state = each.after(time - self._now)
        self._now = time


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
    low, high, limit = 0.0, 1.0, ""
    # Each round looks closer at the stretch in which the first pose breaks a limit.
    for _ in range(4):
        shares = np.linspace(low, high, SAMPLES + 1)[1:]
        broken = _first_broken(robot, limits, here + shares[:, None] * (wanted - here), gravity, around)
        if broken is None:
            return Reached(wanted, "")
        place, limit = broken
        low, high = float(shares[place - 1]) if place else low, float(shares[place])
    return Reached(here + low * (wanted - here), limit)


def _first_broken(
    robot: RobotParameters, limits: ReferenceLimits, way: np.ndarray, gravity: float, around: np.ndarray
) -> tuple[int, str] | None:
    """Index of the first pose of a way that breaks a limit, and which; None where all keep to them."""
    poses = (way[:, None] + around).reshape(-1, 6)
    still = np.zeros_like(poses)
    margins = limit_margins(robot, limits, poses, still, still, gravity)
    first: tuple[int, str] | None = None
    for name, values in margins.items():
        broken = ~(values >= 0.0)
        if broken.any():
            row = int(broken.any(axis=1).argmax())
            place = row // len(around)
            if first is None or place < first[0]:
                _, where = PLACES[name][int(broken[row].argmax())]
                first = place, f"{name.replace('_', ' ')} of {where}"
    return first
