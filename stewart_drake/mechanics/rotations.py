"""Rotation matrices and rotation vectors, compiled."""

from __future__ import annotations

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Mat3, Vec3
from stewart_drake.mechanics.kinematics_laws import cross, dot
from stewart_drake.mechanics.linear_algebra import set_to


@njit
def turn_by(vector: Vec3, matrix: Mat3) -> None:
    """Turns a rotation matrix by a rotation vector [rad] in its outer frame, in place (Rodrigues)."""
    angle = np.sqrt(dot(vector, vector))
    s = np.sin(angle) / angle if angle > 1e-8 else 1.0
    c = (1.0 - np.cos(angle)) / angle**2 if angle > 1e-8 else 0.5
    axis, first, second = np.empty(3), np.empty(3), np.empty(3)
    for column in range(3):
        for k in range(3):
            axis[k] = matrix[k, column]
        cross(vector, axis, first)
        cross(vector, first, second)
        for k in range(3):
            matrix[k, column] += s * first[k] + c * second[k]


@njit
def rotation_between(matrix: Mat3, other: Mat3, out: Vec3) -> None:
    """Rotation vector [rad] of `matrix` times the transpose of `other`, of angles below pi."""
    trace, first, second, product = 0.0, np.empty(3), np.empty(3), np.empty(3)
    set_to(out, 0.0)
    for m in range(3):
        for k in range(3):
            first[k], second[k] = matrix[k, m], other[k, m]
        trace += dot(first, second)
        # The vector of the skew part of sum_m a_m b_m^T is half the sum of b_m x a_m.
        cross(second, first, product)
        for k in range(3):
            out[k] += 0.5 * product[k]
    sine = np.sqrt(dot(out, out))
    angle = np.arctan2(sine, 0.5 * (trace - 1.0))
    scale = angle / sine if sine > 1e-9 else 1.0
    for k in range(3):
        out[k] *= scale


@njit
def turned_back(matrix: Mat3, vector: Vec3, out: Vec3) -> None:
    """Transpose of a matrix times a vector."""
    for i in range(3):
        out[i] = matrix[0, i] * vector[0] + matrix[1, i] * vector[1] + matrix[2, i] * vector[2]
