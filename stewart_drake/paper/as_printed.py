"""Equations of the paper as they stand in print, misprints and all; for comparison, never for control.

Poses are [roll, pitch, yaw, X, Y, Z] as everywhere; what is printed in degrees comes back in radians.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stewart_drake.mechanics.kinematics import LegGeometry, cross, rotation_matrix
from stewart_drake.robot import RobotParameters


def rotation_3(rpy: np.ndarray) -> np.ndarray:
    """R_xyz (..., 3, 3) of (3), with the printed entry (3,1): cos theta cos psi sin theta + sin phi sin psi."""
    rpy = np.asarray(rpy, dtype=float)
    matrix = np.swapaxes(rotation_matrix(rpy), -1, -2).copy()
    (sin_phi, sin_theta, sin_psi), (_, cos_theta, cos_psi) = (np.moveaxis(f(rpy), -1, 0) for f in (np.sin, np.cos))
    matrix[..., 2, 0] = cos_theta * cos_psi * sin_theta + sin_phi * sin_psi
    return matrix


def platform_joints(robot: RobotParameters, pose: np.ndarray) -> np.ndarray:
    """Platform joints (..., 6, 3) [m] in B as (2) means them: R^-1 p_i + G."""
    return _turned(robot.platform_joints, rotation_matrix(pose[..., :3])) + pose[..., None, 3:]


def platform_joints_3(robot: RobotParameters, pose: np.ndarray) -> np.ndarray:
    """The same by (2) with the inverse of (3) as printed."""
    return _turned(robot.platform_joints, np.linalg.inv(rotation_3(pose[..., :3]))) + pose[..., None, 3:]


def platform_joints_5(robot: RobotParameters, pose: np.ndarray) -> np.ndarray:
    """The same with the bracket of (5): R^-1 (p_i + G)."""
    return _turned(robot.platform_joints + pose[..., None, 3:], rotation_matrix(pose[..., :3]))


def _turned(points: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    return points @ np.swapaxes(rotation, -1, -2)


class CrankEquation(NamedTuple):
    """A cos(theta) + B sin(theta) = C of each leg, each (..., 6) [m^2]; the A, B, C that (6) does not give."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    @property
    def size(self) -> np.ndarray:
        """(..., 6) [m^2] sqrt(A^2 + B^2)."""
        return np.hypot(self.a, self.b)


def crank_equation(robot: RobotParameters, joints: np.ndarray) -> CrankEquation:
    """The equation that a rod of its length puts on its crank, for platform joints (..., 6, 3) [m] anywhere."""
    span = joints - robot.shaft_positions
    twice = 2.0 * robot.crank_lengths
    return CrankEquation(
        twice * np.sum(span * robot.crank_zero_directions, axis=-1),
        twice * np.sum(span * robot.crank_quarter_directions, axis=-1),
        np.sum(span * span, axis=-1) + robot.crank_lengths**2 - robot.rod_lengths**2,
    )


def crank_angles(equation: CrankEquation, branch: int | np.ndarray) -> np.ndarray:
    """Closed form theta = atan2(B, A) + branch * acos(C / sqrt(A^2 + B^2)); (..., 6) [rad], NaN out of reach."""
    with np.errstate(invalid="ignore"):
        return np.arctan2(equation.b, equation.a) + branch * np.arccos(equation.c / equation.size)


def crank_angles_6(equation: CrankEquation) -> np.ndarray:
    """(6) as printed; (..., 6) [rad], NaN where a rod cannot span. A enters by its square alone."""
    with np.errstate(invalid="ignore"):
        sine, cosine = np.arcsin(equation.c / equation.size), np.arccos(equation.b / equation.size)
    return -(sine - cosine + np.pi)


def rod_map_11(robot: RobotParameters, legs: LegGeometry) -> np.ndarray:
    """tau_1 (..., 6, 6) [m, -] of (14) with the unrotated p_i of (11): e_M = p_i x e_l."""
    joints = np.broadcast_to(robot.platform_joints, legs.e_l.shape)
    return np.swapaxes(np.concatenate([cross(joints, legs.e_l), legs.e_l], axis=-1), -1, -2)


def matrices_21_22_24(tau: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A_bar, B_bar and C_bar entry by entry as (21), (22), (24) say, indices from 1; `tau` stands in B_bar's rows."""
    a, b, c = np.zeros((12, 12)), np.zeros((12, 6)), np.zeros((6, 12))
    for k in range(1, 7):
        even, odd = 2 * k, 2 * k - 1
        a[odd - 1, odd] = 1.0  # (21): i = 2 k - 1, j = i + 1
        b[even - 1] = tau[even // 2 - 1]  # (22): i = 2 k
        c[k - 1, 2 * k - 2] = 1.0  # (24): i = k, j = 2 i - 1
    return a, b, c
