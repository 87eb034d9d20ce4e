"""A motion for a machine: a smooth approach to its first pose, then the motion, starting and ending at rest.

An early stop slows down along the path. The pace rises as `smoothstep`, and falls as one minus it.
"""

from __future__ import annotations

import numpy as np

from stewart_drake.references.motions import Reference, smoothstep

RAMP = 1.0
"""[s] in which a pace rises from 0 to 1, or falls."""


class PacedMotion:
    """An approach from a pose to the start of a motion, then the motion; rates and accelerations are exact.

    Args:
        motion: The motion.
        start: (6,) [rad, m] present pose of the robot.
        approach: [s] duration of the approach, at rest at both ends.
    """

    def __init__(self, motion: Reference, start: np.ndarray, approach: float) -> None:
        self._motion, self._start, self.approach = motion, start, approach
        self.goal = motion.evaluate(0.0)[0]
        self._stops = np.inf
        self._held: np.ndarray | None = None

    def begin(self, start: np.ndarray, approach: float) -> None:
        """Starts from another pose (6,), with an approach [s]; a stop stays at the same time of the motion."""
        self._stops += approach - self.approach
        self._start, self.approach = start, approach

    def follow(self, motion: Reference) -> None:
        """Replaces the motion by another one that begins at the same pose."""
        self._motion = motion

    @property
    def source(self) -> object:
        """What a motion follows that has a source outside, or None."""
        return getattr(self._motion, "source", None)

    def close(self) -> None:
        """Ends a motion that has a source outside."""
        getattr(self._motion, "close", lambda: None)()

    def hold(self, pose: np.ndarray) -> None:
        """Rests at a pose (6,) from now on."""
        self._held = pose

    def duration(self, motion: float) -> float:
        """[s] until rest, for a duration [s] of the motion at full pace."""
        return self.approach + motion + RAMP

    def stop(self, time: float) -> None:
        """Slows down from a time [s] on, to rest `RAMP` later; an earlier stop has priority."""
        self._stops = min(self._stops, time)

    @property
    def rests(self) -> float:
        """[s] time from which it rests; infinity without a stop."""
        return self._stops + RAMP

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration (..., 6) at times [s] from 0."""
        shape = np.shape(time)
        if self._held is not None:
            return np.broadcast_to(self._held, (*shape, 6)).copy(), np.zeros((*shape, 6)), np.zeros((*shape, 6))
        path_time, pace, change = self._path_time(np.atleast_1d(np.asarray(time, dtype=float)))
        on_motion = path_time >= self.approach
        motion_time, speed, gain = risen(path_time - self.approach)
        motion = self._motion.evaluate(np.maximum(motion_time, 0.0))
        motion = timed(motion, speed * pace, gain * pace**2 + speed * change)
        approach = timed(self._approach(path_time), pace, change)
        rows = (np.where(on_motion[:, None], a, b) for a, b in zip(motion, approach, strict=True))
        pose, rate, acceleration = (values.reshape(*shape, 6) for values in rows)
        return pose, rate, acceleration

    def motion_time(self, time: float) -> float:
        """[s] time of the motion; 0 during the approach."""
        (path_time,), _, _ = self._path_time(np.array([time]))
        return max(float(risen(path_time - self.approach)[0]), 0.0)

    def row(self, time: float) -> np.ndarray:
        """(18,) pose, rate and acceleration."""
        return np.concatenate(self.evaluate(time))

    def _path_time(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time along the path [s], its pace and the change of that: the time itself, until a stop."""
        lost, pace, change = risen(time - self._stops)
        return time - lost, 1.0 - pace, -change

    def _approach(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The straight path to the first pose."""
        distance, duration = self.goal - self._start, max(self.approach, 1e-9)
        share, speed, gain = smoothstep(time[:, None] / duration)
        return self._start + share * distance, speed / duration * distance, gain / duration**2 * distance


def risen(time: np.ndarray, ramp: float = RAMP) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The integral [s] of a pace that rises within `ramp` from 0 at time 0 to 1, the pace, and its change [1/s]."""
    x = np.clip(time / ramp, 0.0, 1.0)
    pace, change, _ = smoothstep(x)
    integral = ramp * x**4 * (2.5 - 3.0 * x + x**2) + np.maximum(time - ramp, 0.0)
    return integral, pace, change / ramp


def timed(
    motion: tuple[np.ndarray, np.ndarray, np.ndarray], pace: np.ndarray, change: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pose, rate and acceleration (..., 6) of a motion played at a pace (...) that changes [1/s]."""
    pose, rate, acceleration = motion
    pace, change = pace[..., None], change[..., None]
    return pose, pace * rate, pace**2 * acceleration + change * rate
