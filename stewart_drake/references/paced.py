"""A motion for a machine: a smooth way to its first pose, then the motion, at a pace that begins and ends with rest.

The path is never left: what stops early slows down along it. The pace rises as `smoothstep`, and falls as one minus it.
"""

from __future__ import annotations

import numpy as np

from stewart_drake.references.motions import Reference, smoothstep

RAMP = 1.0
"""[s] that a pace takes to rise from 0 to 1, or to fall."""


class PacedMotion:
    """A way from a pose to the start of a motion, then the motion; rates and accelerations are exact.

    Args:
        motion: What follows the way.
        start: (6,) [rad, m] where the robot stands.
        approach: [s] of the way there, at rest at both ends.
    """

    def __init__(self, motion: Reference, start: np.ndarray, approach: float) -> None:
        self._motion, self._start, self.approach = motion, start, approach
        self.goal = motion.evaluate(0.0)[0]
        self._stops = np.inf
        self._held: np.ndarray | None = None

    def begin(self, start: np.ndarray, approach: float) -> None:
        """From another pose (6,), by a way of another length [s]; a stop on the motion stays where it is on that."""
        self._stops += approach - self.approach
        self._start, self.approach = start, approach

    def hold(self, pose: np.ndarray) -> None:
        """At rest at a pose (6,) from now on, whatever was planned."""
        self._held = pose

    def duration(self, motion: float) -> float:
        """[s] until rest, for some seconds of the motion, counted at its own pace."""
        return self.approach + motion + RAMP

    def stop(self, time: float) -> None:
        """Slows down from a time [s] on; it rests `RAMP` later. An earlier stop stays."""
        self._stops = min(self._stops, time)

    @property
    def rests(self) -> float:
        """[s] from when on it rests; infinity without a stop."""
        return self._stops + RAMP

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration (..., 6) at times [s] from 0."""
        shape = np.shape(time)
        if self._held is not None:
            return np.broadcast_to(self._held, (*shape, 6)).copy(), np.zeros((*shape, 6)), np.zeros((*shape, 6))
        way, pace, change = self._way(np.atleast_1d(np.asarray(time, dtype=float)))
        on_motion = way >= self.approach
        gone, speed, gain = risen(way - self.approach)
        # The motion's own time, its pace and the change of that.
        own = np.maximum(gone, 0.0), speed * pace, gain * pace**2 + speed * change
        there, back = self._motion.evaluate(own[0]), self._to_start(way)
        moved = timed(there, own[1], own[2]), timed(back, pace, change)
        made = (np.where(on_motion[:, None], a, b) for a, b in zip(*moved, strict=True))
        pose, rate, acceleration = (each.reshape(*shape, 6) for each in made)
        return pose, rate, acceleration

    def own_time(self, time: float) -> float:
        """[s] of the motion at a time; 0 on the way to it."""
        (way,), _, _ = self._way(np.array([time]))
        return max(float(risen(way - self.approach)[0]), 0.0)

    def row(self, time: float) -> np.ndarray:
        """(18,) pose, rate and acceleration."""
        return np.concatenate(self.evaluate(time))

    def _way(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """[s] gone along the way, its rate and the change of that: as the time, until it is to stop."""
        gone, pace, change = risen(time - self._stops)
        return time - gone, 1.0 - pace, -change

    def _to_start(self, way: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The straight way to the first pose."""
        between, length = self.goal - self._start, max(self.approach, 1e-9)
        share, speed, gain = smoothstep(way[:, None] / length)
        return self._start + share * between, speed / length * between, gain / length**2 * between


def risen(time: np.ndarray, ramp: float = RAMP) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The integral [s] of a pace that rises within `ramp` from 0 at time 0 to 1, the pace, and its change [1/s]."""
    x = np.clip(time / ramp, 0.0, 1.0)
    pace, change, _ = smoothstep(x)
    gone = ramp * x**4 * (2.5 - 3.0 * x + x**2) + np.maximum(time - ramp, 0.0)
    return gone, pace, change / ramp


def timed(
    motion: tuple[np.ndarray, np.ndarray, np.ndarray], pace: np.ndarray, change: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose, rate and acceleration (..., 6) of a motion whose own time goes at a pace (...)."""
    pose, rate, acceleration = motion
    pace, change = pace[..., None], change[..., None]
    return pose, pace * rate, pace**2 * acceleration + change * rate
