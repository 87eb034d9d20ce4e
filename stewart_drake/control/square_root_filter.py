"""Square-root information filter for the regression: a triangular factor of the information matrix, compiled.

The unknowns are a few of each motor alone and others that the six motors share; the unknowns of two motors never occur
in one equation. So the factor is stored as six blocks of rows, one for each motor, and one block of shared rows.

- Filter: G. J. Bierman, Factorization Methods for Discrete Sequential Estimation (1977).
- Forgetting goes back towards the initial information and keeps the estimate, so that what no motion excites is kept:
  R. Kulhavy, Restricted exponential forgetting in real-time identification (Automatica 23, 1987).
- The push is forgotten faster: J. E. Parkum, N. K. Poulsen, J. Holst, Recursive forgetting algorithms (Int. J. Control
  55, 1992).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from stewart_drake.base.jit import njit
from stewart_drake.base.records import Matrix, Vec2, Vec3, Vector
from stewart_drake.mechanics.linear_algebra import copy_to

MOTOR_DRIVE, MOTOR_DAMPING, MOTOR_COULOMB, N_MOTOR = range(4)
"""Indices and number of the unknowns of one motor: differences of the logarithm of its drive, of its damping and of its
Coulomb friction from the shared ones."""
HEAD, DRIVE, DAMPING, COULOMB, DELAY, PUSH, N_SHARED = (*range(6), 8)
"""Indices and number of the unknowns that all motors share: logarithm of the head's weight, logarithm of the drive,
damping, Coulomb friction, delay, and three of a push. If they are learnt, the head's first moment and then viscous and
dry friction of the ball joints follow."""
N_MOMENT, N_JOINT = 3, 2
"""Numbers of unknowns of the head's first moment, and of the friction of ball joints."""
SIDEWAYS = (3, 4, 2)
"""Axes of a sideways push in a wrench (moment, force): two horizontal forces and the moment about the vertical."""
PerMotor = Annotated[np.ndarray, (6, N_MOTOR)]


@njit
def add_row(motor_rows: Matrix, shared_rows: Matrix, row: Vector) -> None:
    """Adds a whitened measurement (3 + m + 1,), which is destroyed, to the factor of its motor by Givens rotations.

    Columns are the unknowns of the motor, the m shared ones and the right-hand side.
    """
    size = N_MOTOR + len(shared_rows)
    for k in range(size):
        if row[k] == 0.0:
            continue
        pivot = motor_rows[k, k] if k < N_MOTOR else shared_rows[k - N_MOTOR, k - N_MOTOR]
        length = np.hypot(pivot, row[k])
        c, s = pivot / length, row[k] / length
        for j in range(k, size + 1):
            above = motor_rows[k, j] if k < N_MOTOR else shared_rows[k - N_MOTOR, j - N_MOTOR]
            rotated = c * above + s * row[j]
            row[j] = c * row[j] - s * above
            if k < N_MOTOR:
                motor_rows[k, j] = rotated
            else:
                shared_rows[k - N_MOTOR, j - N_MOTOR] = rotated


@njit
def variance_along(motor_rows: Matrix, shared_rows: Matrix, row: Vector) -> float:
    """Variance of a linear combination (3 + m,) of the unknowns of a motor: |R^-T row|^2 of their factor R."""
    size, total = N_MOTOR + len(shared_rows), 0.0
    solution = np.empty(N_MOTOR + len(shared_rows))
    for k in range(size):
        value = row[k]
        for j in range(k):
            value -= solution[j] * (motor_rows[j, k] if j < N_MOTOR else shared_rows[j - N_MOTOR, k - N_MOTOR])
        solution[k] = value / (motor_rows[k, k] if k < N_MOTOR else shared_rows[k - N_MOTOR, k - N_MOTOR])
        total += solution[k] * solution[k]
    return total


@njit
def apply_correction(motor_rows: Matrix, shared_rows: Matrix, per_motor: PerMotor, shared: Vector) -> None:
    """Adds the least-squares correction to the estimate, and sets the right-hand sides of the factor to zero.

    `motor_rows` (6, 3, 3 + m + 1) are those of all motors, `per_motor` (6, 3) and `shared` (m,) the estimate.
    """
    size, change = len(shared_rows), np.empty(len(shared_rows))
    for k in range(size - 1, -1, -1):
        value = shared_rows[k, size]
        for j in range(k + 1, size):
            value -= shared_rows[k, j] * change[j]
        change[k] = value / shared_rows[k, k]
        shared_rows[k, size] = 0.0
    for k in range(size):
        shared[k] += change[k]
    motor_change = np.empty(N_MOTOR)
    for i in range(6):
        for k in range(N_MOTOR - 1, -1, -1):
            value = motor_rows[i, k, N_MOTOR + size]
            for j in range(size):
                value -= motor_rows[i, k, N_MOTOR + j] * change[j]
            for j in range(k + 1, N_MOTOR):
                value -= motor_rows[i, k, j] * motor_change[j]
            motor_change[k] = value / motor_rows[i, k, k]
            motor_rows[i, k, N_MOTOR + size] = 0.0
        for k in range(N_MOTOR):
            per_motor[i, k] += motor_change[k]


@njit
def constrain_last_two(
    motor_rows: Matrix, shared_rows: Matrix, per_motor: PerMotor, shared: Vector, most: Vec2
) -> None:
    """Makes an estimate the least-squares solution with its last two shared unknowns between 0 and `most`.

    Right-hand sides must be zero. The factor is unchanged: the constraint is not evidence.
    """
    size = len(shared_rows)
    first, second = shared[size - 2], shared[size - 1]
    if 0.0 <= first <= most[0] and 0.0 <= second <= most[1]:
        return
    # The last triangle of the factor has the information about these two. The constrained minimum is on an edge.
    a, b, c = shared_rows[size - 2, size - 2], shared_rows[size - 2, size - 1], shared_rows[size - 1, size - 1]
    best, least, at = np.zeros(2), np.inf, np.zeros(2)
    for n in range(2):
        for share in range(2):
            at[n] = share * most[n]
            step = at[n] - shared[size - 2 + n]
            other = shared[size - 1 - n] - (b * step / a if n == 1 else a * b * step / (b * b + c * c))
            at[1 - n] = min(max(other, 0.0), most[1 - n])
            squares = (a * (at[0] - first) + b * (at[1] - second)) ** 2 + (c * (at[1] - second)) ** 2
            if squares < least:
                least, best[0], best[1] = squares, at[0], at[1]
    motor_copy, shared_copy, row = motor_rows.copy(), shared_rows.copy(), np.empty(N_MOTOR + size + 1)
    for n in range(2):
        # A measurement that is practically exact.
        weight = 1e5 * abs(a) + 1e5 * abs(c)
        for k in range(len(row)):
            row[k] = weight if k == N_MOTOR + size - 2 + n else 0.0
        row[N_MOTOR + size] = weight * (best[n] - (first if n == 0 else second))
        add_row(motor_copy[0], shared_copy, row)
    apply_correction(motor_copy, shared_copy, per_motor, shared)
    copy_to(shared[size - 2 :], best)


@njit
def forget(
    motor_rows: Matrix, shared_rows: Matrix, keep: float, keep_push: float, motor_sigma: Vec3, shared_sigma: Vector
) -> None:
    """Keeps shares of the information, one for the push, another for the rest, and adds initial information.

    `motor_sigma` (3,) and `shared_sigma` (m,) are the initial standard deviations.
    """
    size = len(shared_rows)
    root, rest, push, row = np.sqrt(keep), np.sqrt(1.0 - keep), np.sqrt(keep_push / keep), np.empty(N_MOTOR + size + 1)
    for j in range(N_MOTOR + size + 1):
        # Other variances and all correlations stay.
        is_push = N_MOTOR + PUSH <= j < N_MOTOR + N_SHARED
        for i in range(6):
            for k in range(N_MOTOR):
                motor_rows[i, k, j] *= root
                if is_push:
                    motor_rows[i, k, j] *= push
        for k in range(size):
            if j >= N_MOTOR:
                shared_rows[k, j - N_MOTOR] *= root
                if is_push:
                    shared_rows[k, j - N_MOTOR] *= push
    for i in range(6):
        for k in range(N_MOTOR):
            for j in range(len(row)):
                row[j] = rest / motor_sigma[k] if j == k else 0.0
            add_row(motor_rows[i], shared_rows, row)
    for k in range(size):
        lost = np.sqrt(1.0 - keep_push) if PUSH <= k < N_SHARED else rest
        for j in range(len(row)):
            row[j] = lost / shared_sigma[k] if j == N_MOTOR + k else 0.0
        add_row(motor_rows[0], shared_rows, row)
