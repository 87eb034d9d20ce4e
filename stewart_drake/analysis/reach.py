"""Whether a robot can take a pose, and the nearest pose that it can take."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.jit import specialised
from stewart_drake.mechanics import reach_laws
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.robot import Gravity, RobotParameters
from stewart_drake.robot.gravity import check_gravity
from stewart_drake.scenario.limits import COLUMNS, PLACES, LimitMargin, ReferenceLimits, limit_bounds, space_of
from stewart_drake.scenario.scenario import Scenario


class Check(NamedTuple):
    """Whether a pose can be taken."""

    possible: bool
    margin: LimitMargin  # That of the nearest limit, or of the one that is broken most, relative to its size.
    reason: str  # In words.


class Nearest(NamedTuple):
    """The nearest pose that can be taken."""

    pose: np.ndarray  # (6,) [rad, m].
    distance: float  # [m] sqrt(shift^2 + (weight turn)^2); 0 where the target itself can be taken.
    shift: float  # [m] between the positions.
    turn: float  # [rad] between the orientations.


class Reach:
    """Whether a robot can take poses at rest, and the nearest poses that it can take.

    A pose can be taken if it is within all limits, on the side of the singularities on which home is, and if the search
    finds a way to it from home within the limits. Never a wrong yes: poses and ways are checked by the limits' margins.

    Args:
        robot: The robot.
        limits: The limits; None for those of a scenario with this robot.
        gravity: [m/s^2] along -z of B, or a vector (3,) in B, for the motors' holding torque.
        weight: [m/rad] by which turns count against shifts; None for the robot's characteristic length.

    Raises:
        ConfigurationError: A weight that is not positive; a robot whose home is not within the limits.
    """

    def __init__(
        self,
        robot: RobotParameters,
        limits: ReferenceLimits | None = None,
        gravity: Gravity = STANDARD_GRAVITY,
        weight: float | None = None,
    ) -> None:
        self.robot, self.limits = robot, Scenario(robot=robot).limits if limits is None else limits
        self.weight = robot.characteristic_length if weight is None else weight
        if not (isinstance(self.weight, (int, float)) and 0.0 < self.weight < math.inf):
            raise ConfigurationError("weight", weight, "a number above 0 [m/rad]")
        check_gravity(gravity)
        self._space = space_of(robot, self.limits, gravity, self.weight)
        self._probe, self._home, self._out = reach_laws.Probe.new(), robot.home_pose.copy(), np.empty(6)
        self._at_rest = specialised(reach_laws.at_rest, (self._space, self._home, self._probe))
        search = self._space, self._home, self._home, self._probe, self._out
        self._nearest = specialised(reach_laws.nearest, search)
        if not (least := self._least(self._home)).margin >= 0.0:
            allowed = f"limits that the robot keeps at home: {least.allowed}"
            raise ConfigurationError("limits", f"{least.value:.4g} {least.unit} at home", allowed)

    def check(self, pose: ArrayLike) -> Check:
        """Whether the robot can take a pose (6,) [rad, m], and the margin to the limit that decides.

        Raises:
            ConfigurationError: Not six finite numbers.
        """
        given = checked_pose("pose", pose)
        margin = self._least(given)
        if not margin.margin >= 0.0:
            return Check(False, margin, f"{margin.limit.replace('_', ' ')}: {margin.allowed}, not {margin.value:.4g}")
        if not self._search(self._space, self._home, given):
            return Check(False, margin, "no way to it from home within the limits was found")
        left = f"{margin.margin:.3g} {margin.unit}".removesuffix(" -")
        return Check(True, margin, f"{left} inside the next limit, {margin.limit.replace('_', ' ')}: {margin.allowed}")

    def nearest(self, pose: ArrayLike, from_pose: ArrayLike | None = None, time: float | None = None) -> Nearest:
        """The nearest pose to a pose (6,) [rad, m] that the robot can take.

        Args:
            pose: (6,) [rad, m] the target.
            from_pose: (6,) where the way starts; None for home.
            time: [s] in which `limits.crank_speed` must suffice for every crank, from there; None for any.

        Raises:
            ConfigurationError: Not six finite numbers; a start that is not within the limits; a time that is not
                positive.
        """
        target = checked_pose("pose", pose)
        start = self._home if from_pose is None else checked_pose("from_pose", from_pose)
        if from_pose is not None and not (least := self._least(start)).margin >= 0.0:
            raise ConfigurationError("from_pose", start.tolist(), f"a pose within the limits: {least.allowed}")
        space = self._space if time is None else self._in_time(start, time)
        if self._search(space, start, target):
            return Nearest(target, 0.0, 0.0, 0.0)
        gap, found = np.empty(6), self._out.copy()
        distance = float(reach_laws.difference(self.weight, found, target, gap))
        shift, turn = float(np.linalg.norm(gap[3:])), float(np.linalg.norm(gap[:3])) / self.weight
        return Nearest(found, distance, shift, turn)

    def _search(self, space: reach_laws.Space, start: np.ndarray, target: np.ndarray) -> bool:
        """Whether there is a way to a target; else `_out` is the nearest pose to which one was found."""
        if self._nearest(space, start, target, self._probe, self._out):
            return True
        # A way from a pose within the limits to the start is often found more easily.
        least, _ = self._at_rest(space, target, self._probe)
        return least >= 0.0 and bool(self._nearest(space, target, start, self._probe, np.empty(6)))

    def _in_time(self, start: np.ndarray, time: float) -> reach_laws.Space:
        """The limits, with every crank within what it can turn in a time [s]."""
        if not (isinstance(time, (int, float)) and 0.0 < time < math.inf):
            raise ConfigurationError("time", time, "a number of seconds above 0")
        space = self._space.copy()
        limits = space["limits"]
        way = min((self.limits.crank_speed or math.inf) * time, math.pi)
        here = inverse_kinematics(self.robot, start)
        off = np.remainder(here - limits["crank_middle"][0] + np.pi, 2.0 * np.pi) - np.pi
        half = limits["crank_half"][0]
        low, high = np.maximum(-half, off - way), np.minimum(half, off + way)
        limits["crank_middle"][0] += 0.5 * (low + high)
        limits["crank_half"][0] = 0.5 * (high - low)
        return space

    def _least(self, pose: np.ndarray) -> LimitMargin:
        """The least relative margin at a pose, in its unit."""
        _, place = self._at_rest(self._space, pose, self._probe)
        limit, columns = next((name, columns) for name, columns in COLUMNS.items() if place < columns.stop)
        leg, where = PLACES[limit][place - columns.start]
        bound = limit_bounds(self.robot, self.limits).get(limit, 0.0)
        share = 1.0
        if limit == "torque" and leg is not None:
            bound *= float(self.robot.effort_shares[leg])
            share = bound
        elif limit == "clearance":
            share = self.robot.characteristic_length
        return LimitMargin(limit, bound, float(self._probe["margins"][0, place]) * share, 0.0, leg, where)


def checked_pose(key: str, pose: ArrayLike) -> np.ndarray:
    """A pose (6,) of finite numbers."""
    try:
        array = np.array(pose, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (6,) or not np.isfinite(array).all():
        allowed = "six finite numbers: roll, pitch, yaw [rad], X, Y, Z [m]"
        raise ConfigurationError(key, pose if array.shape != (6,) else array.tolist(), allowed)
    for part, allowed in ((array[:3], "angles below 1000 rad"), (array[3:], "positions below 1000 m; in millimetres?")):
        if np.abs(part).max() > 1e3:
            raise ConfigurationError(key, array.tolist(), allowed)
    return array
