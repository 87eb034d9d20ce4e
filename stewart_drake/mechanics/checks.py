"""What raises by name where `kinematics_core` returns margins."""

from __future__ import annotations

import numpy as np

from stewart_drake.errors import ConfigurationError, UnreachablePoseError
from stewart_drake.mechanics import kinematics_core as core
from stewart_drake.mechanics.arrays import AnyRobot, Array, Robot, arrays_of, last, namespace, to_numpy


def legs_within_reach(robot: AnyRobot, pose: Array) -> tuple[Robot, core.Legs]:
    """A robot's arrays and `kinematics_core.legs_at`, checked.

    Raises:
        UnreachablePoseError, ConfigurationError: As in `inverse_kinematics`.
    """
    own, pose = checked(robot, pose)
    legs = core.legs_at(own, pose)
    within_reach(legs.cranks, pose)
    return own, legs


def checked(robot: AnyRobot, pose: Array, branch: int | None = None) -> tuple[Robot, Array]:
    """The robot's arrays, with another branch if there is one, and the pose.

    Raises:
        ConfigurationError: A branch other than -1 and +1, or a pose that is not finite or not (..., 6).
    """
    xp = namespace(pose)
    if pose.ndim < 1 or pose.shape[-1] != 6 or not bool(xp.all(xp.isfinite(pose))):
        raise ConfigurationError("pose", pose, "finite numbers of shape (..., 6)")
    if branch not in (None, -1, 1):
        raise ConfigurationError("branch", branch, "-1 or 1, or None")
    own = arrays_of(robot, pose)
    return (own if branch is None else own._replace(branches=xp.ones_like(own.branches) * branch)), pose


def within_reach(cranks: core.Cranks, pose: Array) -> core.Cranks:
    """The same, if every rod can span.

    Raises:
        UnreachablePoseError: As in `inverse_kinematics`.
    """
    if not bool((cranks.reach >= 0.0).all()):
        reach = np.nan_to_num(to_numpy(last(namespace(cranks.reach), cranks.reach, 1)), nan=-np.inf)
        worst = np.unravel_index(int(reach.argmin()), reach.shape)
        at = np.broadcast_to(to_numpy(pose), reach.shape)[worst[:-1]]
        raise UnreachablePoseError(np.array(at), int(worst[-1]), float(reach[worst]))
    return cranks
