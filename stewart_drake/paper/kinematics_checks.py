"""Inverse and forward kinematics put to the test: (1) to (6) as meant, as Drake has them, and as printed."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.math import RollPitchYaw

from stewart_drake.errors import ForwardKinematicsError, drake_guard
from stewart_drake.mechanics.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    leg_geometry,
    rod_lines,
    rotation_matrix,
)
from stewart_drake.paper import as_printed
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

BRANCHES = (-1, 1)
SAME_ANGLE = 1e-6
"""[rad] below this two crank angles are the same; next to a dead centre an acos keeps half the digits only."""
SAME_POSE = 1e-6
"""[rad, m] below this two poses are the same."""


def rod_spans(robot: RobotParameters, pose: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Distances of crank tips to platform joints by Drake's forward kinematics.

    Crank angles and pose are set independently in the plant; nothing of the package's kinematics is in between.

    Args:
        robot: Geometry; its branch is that of the plant.
        pose: (n, 6) [rad, m].
        theta: (n, 6) [rad] crank angles.

    Returns:
        (n, 6) [m]; the length of the rods where `theta` belongs to `pose`.
    """
    stewart = build_plant(robot)[1]
    plant, index = stewart.plant, stewart.indices
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    cranks = [plant.GetFrameByName(f"crank_{leg}") for leg in range(LEGS)]
    platform = plant.GetFrameByName("platform")
    home_angles = inverse_kinematics(robot, robot.home_pose)
    tips = np.outer(robot.crank_lengths, [1.0, 0.0, 0.0])
    spans, positions = np.empty(theta.shape), np.zeros(plant.num_positions())
    with drake_guard("setting positions"):
        for row, (at, angles) in enumerate(zip(pose, theta, strict=True)):
            positions[index.crank] = angles - home_angles
            positions[index.quaternion] = RollPitchYaw(at[:3]).ToQuaternion().wxyz()
            positions[index.position] = at[3:]
            plant.SetPositions(context, positions)
            joints = plant.CalcPointsPositions(context, platform, robot.platform_joints.T, world).T
            pairs = zip(cranks, tips, strict=True)
            ends = [plant.CalcPointsPositions(context, crank, tip, world)[:, 0] for crank, tip in pairs]
            spans[row] = np.linalg.norm(joints - ends, axis=-1)
    return spans


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


def newton_outcome(robot: RobotParameters, poses: np.ndarray, guess: np.ndarray) -> dict[str, Any]:
    """Inverse kinematics there, Newton's method back.

    Args:
        robot: Geometry; its branch is the one used.
        poses: (n, 6) [rad, m] in reach.
        guess: (n, 6) or (6,) [rad, m] where Newton's method starts.

    Returns:
        Numbers of poses: `same`, found again; `other`, another pose of the same crank angles was found, another
        assembly; `other_across`, those of them that a parallel singularity parts from home; `failed`, not converged.
        `error`: largest distance to a pose found again, shift of the centre plus turn times 1 m [m], None without any.
    """
    legs = leg_geometry(robot, poses)
    home = np.linalg.det(rod_lines(leg_geometry(robot, robot.home_pose)))
    found = newton_each(robot, legs.crank_angles, guess)
    error = turn_between(found[:, :3], poses[:, :3]) + np.linalg.norm(found[:, 3:] - poses[:, 3:], axis=-1)
    across = np.linalg.det(rod_lines(legs)) * home < 0.0
    same, other = error < SAME_POSE, error >= SAME_POSE
    return {
        "same": int(same.sum()),
        "other": int(other.sum()),
        "other_across": int((other & across).sum()),
        "failed": int(np.isnan(error).sum()),
        "error": float(error[same].max()) if same.any() else None,
    }


def misprint_effect(robot: RobotParameters, poses: np.ndarray, joints: np.ndarray) -> dict[str, np.ndarray]:
    """Where the robot goes whose crank angles come from misplaced platform joints.

    Args:
        robot: Geometry; its branch is the one used.
        poses: (n, 6) [rad, m] wanted, in reach.
        joints: (n, 6, 3) [m] platform joints in B as the misprint has them.

    Returns:
        (n,) each, NaN where the misprinted equations have no solution: `joint_shift` [m] and `crank_error` [rad],
        largest of the legs; `position_error` [m] and `turn_error` [rad], where the platform really goes.
    """
    shift = np.linalg.norm(joints - as_printed.platform_joints(robot, poses), axis=-1).max(axis=-1)
    equation = as_printed.crank_equation(robot, joints)
    theta = as_printed.crank_angles(equation, robot.branches)
    theta[~equation.in_reach] = np.nan
    reached = newton_each(robot, theta, poses)
    return {
        "joint_shift": shift,
        "crank_error": _apart(theta, inverse_kinematics(robot, poses)).max(axis=-1),
        "position_error": np.linalg.norm(reached[:, 3:] - poses[:, 3:], axis=-1),
        "turn_error": turn_between(reached[:, :3], poses[:, :3]),
    }


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


def _apart(angle: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distance of two angles around the circle [rad]."""
    return np.abs(np.angle(np.exp(1j * (angle - other))))
