"""A smooth reference from a pose set by hand, kept within the limits by a reference governor."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from stewart_drake.analysis.feasibility import checked_times
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.mechanics.kinematics import rotation_angle, rotation_matrix
from stewart_drake.references.motions import Reference
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.scenario.limits import PLACES, ReferenceLimits, limit_margins
from stewart_drake.scenario.scenario import Scenario

BANDWIDTH = 8.0  # [rad/s] of the filter behind the sliders: a move takes about a second.
REACH = np.array([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])  # [rad, m] largest distance of a target from the initial pose.
SPACING = np.array([0.05, 0.05, 0.05, 0.002, 0.002, 0.002])  # [rad, m] largest distance between checked poses.
CRANK_SPEED = 2.0  # [rad/s] largest crank speed of motion by hand.
GOVERNOR_PERIOD = 0.02  # [s]
_COURSE = np.linspace(0.0, 10.0, 64)  # Checked times of a move, times the bandwidth.
WORKSPACE_SHARE = 0.97  # Of `safety.workspace`, that a hand may use: the layer looks ahead, and errors add.
_WAY = 257  # Poses of a way that are compared with it.
_BLOCK = 8  # Poses that are checked together.
_BISECTIONS = 10


class SmoothValue:
    """A value (n,) that follows a target through a filter with three equal poles; it never overshoots.

    Rate and acceleration are continuous, so that a controller with feedforward can follow. It begins at rest;
    `bandwidth` [rad/s] is that of the filter.
    """

    def __init__(self, value: np.ndarray, bandwidth: float = BANDWIDTH) -> None:
        w = self._bandwidth = bandwidth
        chain = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-(w**3), -3.0 * w**2, -3.0 * w]])
        # exp(t chain) is exp(-w t) times three terms: the cube of chain + w I is zero.
        rest = chain + w * np.eye(3)
        self._terms = np.stack([np.eye(3), rest, 0.5 * rest @ rest])
        self._course = np.array([self.transition(time / w) for time in _COURSE])
        self.target = np.array(value, dtype=float)
        self.state = np.zeros((3, len(self.target)))
        self.state[0] = self.target

    def after(self, time: float) -> np.ndarray:
        """Value, rate and acceleration (3, n) after a time [s], for a constant target."""
        rest = np.zeros_like(self.state)
        rest[0] = self.target
        return rest + self.transition(time) @ (self.state - rest)

    def transition(self, time: float) -> np.ndarray:
        """(3, 3) transition matrix of the distance from the target and its rates over a time [s]."""
        ahead = np.tensordot([1.0, time, time**2], self._terms, 1)
        return np.asarray(np.exp(-self._bandwidth * time) * ahead)

    def course(self, target: np.ndarray) -> np.ndarray:
        """Values, rates and accelerations (k, 3, n) of the whole move to a target (n,)."""
        rest = np.zeros_like(self.state)
        rest[0] = target
        return rest + self._course @ (self.state - rest)


class HandReference:
    """A pose set by hand plus the motion of the scenario about it.

    reference(t) = hand(t) + share(t) (motion(t - begun) - motion(0)); hand and share are `SmoothValue`s.
    """

    def __init__(self, motion: Reference, bandwidth: float = BANDWIDTH) -> None:
        self._motion, self._now, self.begun = motion, 0.0, 0.0
        self.goal = self.home = motion.evaluate(0.0)[0]
        self._around: tuple[float, np.ndarray] | None = None
        self.hand, self.share = (SmoothValue(value, bandwidth) for value in (self.home, np.ones(1)))

    def aim(self, scenario: Scenario, pose: np.ndarray) -> Reached:
        """Sets the goal to what `reach` returns."""
        reached = self.reach(scenario, pose)
        self.goal = reached.pose
        return reached

    def reach(self, scenario: Scenario, pose: np.ndarray) -> Reached:
        """A pose (6,) [rad, m], or the last feasible one on the straight path to it from the goal."""
        if (np.abs(pose - self.home) > REACH + 1e-9).any():
            allowed = f"a pose within {REACH[0]:g} rad and {REACH[3]:g} m of {self.home.round(4).tolist()}"
            raise ConfigurationError("pose", pose.tolist(), allowed)
        around = self.excursions(scenario.duration)
        setup = scenario.robot, scenario.limits, self.goal, pose, scenario.gravity_in_base, around
        return _within_workspace(scenario, self.goal, nearest_allowed(*setup), around)

    def govern(self, scenario: Scenario, time: float) -> None:
        """Moves the filter's target as far towards `goal` as limits and `CRANK_SPEED` allow; time [s] as `at`.

        A reference governor: the filter's whole response to a target is known and checked.
        """
        hand, before = self.hand, self.hand.target
        if (before == self.goal).all():
            return
        speed = min(scenario.limits.crank_speed or np.inf, CRANK_SPEED)
        limits = scenario.limits.replace(crank_speed=speed)
        motion = self.at(time)[:6] - hand.state[0]
        for share in 0.5 ** np.arange(7):
            target = self.goal if share == 1.0 else before + share * (self.goal - before)
            if (
                _first_broken(scenario.robot, limits, hand.course(target), scenario.gravity_in_base, motion[None])
                is None
            ):
                # One assignment: another thread reads it.
                hand.target = target.copy()
                return

    def advance(self, time: float) -> None:
        """Advances to a later time [s]."""
        for value in (self.hand, self.share):
            value.state = value.after(time - self._now)
        self._now = time

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration (..., 6) at times [s] near the latest one, for constant targets."""
        rows = np.array([self.at(t) for t in np.ravel(time)])
        pose, rate, acceleration = np.moveaxis(rows.reshape(*np.shape(time), 3, 6), -2, 0)
        return pose, rate, acceleration

    def at(self, time: float) -> np.ndarray:
        """Pose, rate and acceleration (18,) at one time [s]."""
        ahead = time - self._now
        hand, share = (value.after(ahead) if ahead else value.state for value in (self.hand, self.share))
        s, rate, acceleration = share[:, 0]
        pose, velocity, force = self._motion.evaluate(time - self.begun)
        offset = pose - self.home
        return np.concatenate(
            [
                hand[0] + s * offset,
                hand[1] + rate * offset + s * velocity,
                hand[2] + acceleration * offset + 2.0 * rate * velocity + s * force,
            ]
        )

    def excursions(self, duration: float, on: bool = False) -> np.ndarray:
        """Samples (n, 6) of the motion minus its first pose; zeros (1, 6) while it is off, unless `on`."""
        if self.share.target[0] == 0.0 and not on:
            return np.zeros((1, 6))
        if self._around is None or self._around[0] != duration:
            poses = (self._motion.evaluate(checked_times(duration))[0] - self.home) / SPACING
            # One per cell of the grid: the farthest.
            poses = poses[np.argsort(-np.linalg.norm(poses, axis=1), kind="stable")]
            self._around = duration, poses[np.unique(np.floor(poses), axis=0, return_index=True)[1]] * SPACING
        return self._around[1]


class Reached(NamedTuple):
    """The last feasible pose on the straight path to a target."""

    pose: np.ndarray  # (6,) [rad, m]
    limit: str  # The limit that was reached; empty if the target is feasible.


def nearest_allowed(
    robot: RobotParameters,
    limits: ReferenceLimits,
    here: np.ndarray,
    target: np.ndarray,
    gravity: Gravity,
    around: np.ndarray,
) -> Reached:
    """The last pose on the straight path from `here` (6,) to `target` (6,) within the limits at rest.

    `around` (n, 6) [rad, m] are offsets that must be feasible too; zeros (1, 6) for none.
    """
    here, target = np.asarray(here, dtype=float), np.asarray(target, dtype=float)
    path = target - here
    shares = np.linspace(0.0, 1.0, 1 + max(1, math.ceil((np.abs(path) / SPACING).max())))

    def broken_at(share: np.ndarray) -> tuple[int, str] | None:
        at_rest = np.zeros((len(share), 3, 6))
        at_rest[:, 0] = here + share[:, None] * path
        return _first_broken(robot, limits, at_rest, gravity, around)

    for at in range(0, len(shares) - 1, _BLOCK):
        if (broken := broken_at(shares[at : at + _BLOCK + 1])) is not None:
            break
    else:
        return Reached(target, "")
    place, limit = broken
    low, high = shares[at + place - 1 : at + place + 1].tolist()
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if (broken := broken_at(np.array([low, middle]))) is None:
            low = middle
        else:
            high, limit = middle, broken[1]
    return Reached(here + low * path, limit)


def _within_workspace(scenario: Scenario, here: np.ndarray, reached: Reached, around: np.ndarray) -> Reached:
    """What was reached from `here` (6,), or the last pose on the way within `safety.workspace`."""
    if scenario.safety is None or scenario.safety.workspace is None:
        return reached
    path, (angle, distance) = reached.pose - here, WORKSPACE_SHARE * np.array(scenario.safety.workspace)
    poses = here + np.linspace(0.0, 1.0, _WAY)[:, None] * path
    home = scenario.robot.home_pose
    rows = poses[:, None] + around
    turned = rotation_angle(rotation_matrix(rows[..., :3]) @ rotation_matrix(home[:3]).T)
    outside = ((turned > angle) | (np.linalg.norm(rows[..., 3:] - home[3:], axis=-1) > distance)).any(axis=1)
    if outside[0] or not outside.any():
        return reached
    return Reached(poses[int(outside.argmax()) - 1], "safety.workspace")


def _first_broken(
    robot: RobotParameters, limits: ReferenceLimits, motion: np.ndarray, gravity: Gravity, around: np.ndarray
) -> tuple[int, str] | None:
    """Index of the first row after row 0 that breaks a limit, and the limit; None if there is none.

    Rows (n, 3, 6) of pose, rate, acceleration, to which `around` (k, 6) is added. Row 0 sets the side of a singularity.
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
