"""Inverse and forward kinematics put to the test: (1) to (6) as meant, as Drake has them, and as printed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stewart_drake.errors import ForwardKinematicsError
from stewart_drake.mechanics.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    leg_geometry,
    line_conditioning,
    rod_lines,
    rotation_matrix,
)
from stewart_drake.paper import as_printed
from stewart_drake.paper.drake_kinematics import GIVEN, DrakeKinematics
from stewart_drake.robot import RobotParameters

BRANCHES = (-1, 1)
SAME_ANGLE = 1e-6
"""[rad] below this two crank angles are the same; next to a dead centre an acos keeps half the digits only."""
SAME_POSE = 1e-6
"""[rad, m] below this two poses are the same."""


@dataclass(frozen=True)
class NewtonOutcome:
    """What Newton's method made of the crank angles of many poses.

    Attributes:
        found: (n, 6) [rad, m] poses, NaN where it did not converge.
        error: (n,) [m] distance to the true pose: shift of the centre plus turn times 1 m; NaN likewise.
        conditioning: (n,) [-] `kinematics.conditioning` at the true pose.
        across: (n,) bool, whether a parallel singularity lies between the true pose and home: the determinant of the
            rods' lines has another sign.
    """

    found: np.ndarray
    error: np.ndarray
    conditioning: np.ndarray
    across: np.ndarray

    @property
    def same(self) -> np.ndarray:
        """(n,) bool, whether the true pose was found."""
        return np.nan_to_num(self.error, nan=np.inf) < SAME_POSE

    @property
    def failed(self) -> np.ndarray:
        """(n,) bool, whether it did not converge."""
        return np.isnan(self.error)

    @property
    def other(self) -> np.ndarray:
        """(n,) bool, whether it found another pose of the same crank angles: another assembly."""
        return ~self.same & ~self.failed


@dataclass(frozen=True)
class MisprintEffect:
    """What a misprint in the inverse kinematics does to a robot that follows it; NaN where it asks for the impossible.

    Attributes:
        joint_shift: (n,) [m] largest error in the place of a platform joint.
        in_reach: (n,) bool, whether the misprinted equations have a solution at all.
        crank_error: (n,) [rad] largest error of a crank angle.
        position_error: (n,) [m] where the platform really goes: shift of its centre.
        turn_error: (n,) [rad] angle by which its attitude is off.
    """

    joint_shift: np.ndarray
    in_reach: np.ndarray
    crank_error: np.ndarray
    position_error: np.ndarray
    turn_error: np.ndarray


def turn_between(rpy: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angle of the rotation from one attitude to another; (...) [rad] from (..., 3) [rad] each."""
    a, b = rotation_matrix(rpy), rotation_matrix(other)
    # |R_a - R_b| = 2 sqrt 2 sin(angle / 2) holds its digits at small angles, where the trace loses them.
    half = np.linalg.norm(a - b, axis=(-2, -1)) / np.sqrt(8.0)
    return np.asarray(2.0 * np.arcsin(np.clip(half, 0.0, 1.0)))


def newton_each(robot: RobotParameters, theta: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """`forward_kinematics` pose by pose; (n, 6) [rad, m], NaN where it does not converge."""
    poses = np.full(theta.shape, np.nan)
    for row, (angles, start) in enumerate(zip(theta, np.broadcast_to(guess, theta.shape), strict=True)):
        if np.isnan(angles).any():
            continue
        try:
            poses[row] = forward_kinematics(robot, angles, start)
        except ForwardKinematicsError:
            continue
    return poses


def newton_outcome(robot: RobotParameters, poses: np.ndarray, guess: np.ndarray) -> NewtonOutcome:
    """Inverse kinematics there, Newton's method back.

    Args:
        robot: Geometry; its branch is the one used.
        poses: (n, 6) [rad, m] in reach.
        guess: (n, 6) or (6,) [rad, m] where Newton's method starts.
    """
    legs = leg_geometry(robot, poses)
    home = np.linalg.det(rod_lines(leg_geometry(robot, robot.home_pose)))
    found = newton_each(robot, legs.crank_angles, guess)
    error = turn_between(found[:, :3], poses[:, :3]) + np.linalg.norm(found[:, 3:] - poses[:, 3:], axis=-1)
    across = np.linalg.det(rod_lines(legs)) * home < 0.0
    return NewtonOutcome(found, error, line_conditioning(robot, legs), across)


def misprint_effect(robot: RobotParameters, poses: np.ndarray, joints: np.ndarray) -> MisprintEffect:
    """Where the robot goes whose crank angles come from misplaced platform joints.

    Args:
        robot: Geometry; its branch is the one used.
        poses: (n, 6) [rad, m] wanted, in reach.
        joints: (n, 6, 3) [m] platform joints in B as the misprint has them.
    """
    shift = np.linalg.norm(joints - as_printed.platform_joints(robot, poses), axis=-1).max(axis=-1)
    equation = as_printed.crank_equation(robot, joints)
    theta = as_printed.crank_angles(equation, robot.branches)
    theta[~equation.in_reach] = np.nan
    reached = newton_each(robot, theta, poses)
    return MisprintEffect(
        joint_shift=shift,
        in_reach=equation.in_reach,
        crank_error=_apart(theta, inverse_kinematics(robot, poses)).max(axis=-1),
        position_error=np.linalg.norm(reached[:, 3:] - poses[:, 3:], axis=-1),
        turn_error=turn_between(reached[:, :3], poses[:, :3]),
    )


def branch_of_6(robot: RobotParameters, poses: np.ndarray, sense: int = 1) -> dict[str, float]:
    """Which of the two solutions (6) gives, as shares of the legs at many poses.

    Args:
        robot: Geometry.
        poses: (n, 6) [rad, m] in reach.
        sense: -1 counts crank angles the other way round, which turns B into -B.

    Returns:
        `-1` and `1`: share that equals that branch; `neither`: share that solves nothing; `a_positive`: share with
        A > 0.
    """
    equation = as_printed.crank_equation(robot, as_printed.platform_joints(robot, poses))
    printed = sense * as_printed.crank_angles_6(equation._replace(b=sense * equation.b))
    match = [_apart(printed, as_printed.crank_angles(equation, branch)) < SAME_ANGLE for branch in BRANCHES]
    shares = {str(branch): float(hit.mean()) for branch, hit in zip(BRANCHES, match, strict=True)}
    return {**shares, "neither": float((~match[0] & ~match[1]).mean()), "a_positive": float((equation.a > 0.0).mean())}


def solver_differences(robot: RobotParameters, poses: np.ndarray) -> dict[str, dict[str, Any]]:
    """Closed form and Newton's method against Drake's `InverseKinematics` with ball constraints.

    Args:
        robot: Geometry; its branch is the one used.
        poses: (n, 6) [rad, m] in reach.

    Returns:
        For `pose` (given; crank angles asked) and `cranks` (given; pose asked): `asked`, `found`, and `largest`
        difference [rad or m], None where the solver found nothing.
    """
    drake = DrakeKinematics(robot)
    result: dict[str, dict[str, Any]] = {}
    for given in GIVEN:
        differences = []
        for pose in poses:
            answer = drake.solve(given, pose, robot.home_pose + 0.8 * (pose - robot.home_pose))
            if answer is not None:
                theta = inverse_kinematics(robot, pose)
                ours = theta if given == "pose" else forward_kinematics(robot, theta, pose)
                gap = _apart(answer, ours) if given == "pose" else np.abs(answer - ours)
                differences.append(float(gap.max()))
        result[given] = {"asked": len(poses), "found": len(differences), "largest": max(differences, default=None)}
    return result


def _apart(angle: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distance of two angles around the circle [rad]."""
    return np.abs(np.angle(np.exp(1j * (angle - other))))
