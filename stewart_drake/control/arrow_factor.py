"""What the regression knows of its numbers: a triangular factor of the information, in the form of arrows, compiled.

What is common to the six motors and what is each one's own are estimated together; own numbers do not meet those of
other motors. Square-root information filter: G. J. Bierman, Factorization Methods for Discrete Sequential Estimation
(1977).
Forgetting goes towards the information that there was at first, and leaves the estimate: R. Kulhavy, Restricted
exponential forgetting in real-time identification (Automatica 23, 1987). So what nothing excites is kept. The push is
forgotten faster: J. E. Parkum, N. K. Poulsen, J. Holst, Recursive forgetting algorithms (Int. J. Control 55, 1992).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.base.jit import njit

OWN, COMMON, PUSH, PLACE, JOINT = 3, 8, 5, 3, 2
"""Numbers of each motor: log of its drive, damping, Coulomb; and of all: log of the head, these three, delay, and at
`PUSH` a push. After these come the head's first moment, where the centre of mass is learnt, and viscous and dry
friction of ball joints, where they are."""
SIDEWAYS = (3, 4, 2)
"""Axes of a push, in a wrench (moment, force): those that no weight has."""


@njit
def add_row(information: Any, shared: Any, row: Any) -> None:
    """Brings a row [own | common | right-hand side], which is destroyed, into a motor's factor, by rotations."""
    size = OWN + len(shared)
    for k in range(size):
        if row[k] == 0.0:
            continue
        pivot = information[k, k] if k < OWN else shared[k - OWN, k - OWN]
        length = np.hypot(pivot, row[k])
        c, s = pivot / length, row[k] / length
        for j in range(k, size + 1):
            above = information[k, j] if k < OWN else shared[k - OWN, j - OWN]
            turned = c * above + s * row[j]
            row[j] = c * row[j] - s * above
            if k < OWN:
                information[k, j] = turned
            else:
                shared[k - OWN, j - OWN] = turned


@njit
def spread_along(information: Any, shared: Any, row: Any) -> float:
    """Variance of a row [own | common] times a motor's numbers: |R^-T row|^2."""
    size, total = OWN + len(shared), 0.0
    solution = np.empty(OWN + len(shared))
    for k in range(size):
        value = row[k]
        for j in range(k):
            value -= solution[j] * (information[j, k] if j < OWN else shared[j - OWN, k - OWN])
        solution[k] = value / (information[k, k] if k < OWN else shared[k - OWN, k - OWN])
        total += solution[k] * solution[k]
    return total


@njit
def solve_arrow(information: Any, shared: Any, own: Any, common: Any) -> None:
    """Adds the least-squares solution to own (6, n) and common (m,) numbers; right-hand sides become zero."""
    size, change = len(shared), np.empty(len(shared))
    for k in range(size - 1, -1, -1):
        value = shared[k, size]
        for j in range(k + 1, size):
            value -= shared[k, j] * change[j]
        change[k] = value / shared[k, k]
        shared[k, size] = 0.0
    for k in range(size):
        common[k] += change[k]
    mine = np.empty(OWN)
    for i in range(6):
        for k in range(OWN - 1, -1, -1):
            value = information[i, k, OWN + size]
            for j in range(size):
                value -= information[i, k, OWN + j] * change[j]
            for j in range(k + 1, OWN):
                value -= information[i, k, j] * mine[j]
            mine[k] = value / information[i, k, k]
            information[i, k, OWN + size] = 0.0
        for k in range(OWN):
            own[i, k] += mine[k]


@njit
def hold_between(information: Any, shared: Any, own: Any, common: Any, most: Any) -> None:
    """Moves the last two common numbers of an estimate to between 0 and `most` (2,), and all others with them.

    It becomes the least-squares solution within these bounds. Right-hand sides are zero, and the factor stays: the
    evidence is what it was.
    """
    size = len(shared)
    free = common[size - 2 :].copy()
    if 0.0 <= free[0] <= most[0] and 0.0 <= free[1] <= most[1]:
        return
    # What is known of these two alone is the last triangle of the factor. The best of all within is on an edge.
    a, b, c = shared[size - 2, size - 2], shared[size - 2, size - 1], shared[size - 1, size - 1]
    best, least, at = np.zeros(2), np.inf, np.zeros(2)
    for n in range(2):
        for share in range(2):
            at[n] = share * most[n]
            way = at[n] - free[n]
            other = free[1 - n] - (b * way / a if n == 1 else a * b * way / (b * b + c * c))
            at[1 - n] = min(max(other, 0.0), most[1 - n])
            squares = (a * (at[0] - free[0]) + b * (at[1] - free[1])) ** 2 + (c * (at[1] - free[1])) ** 2
            if squares < least:
                least = squares
                best[:] = at
    held, held_shared, row = information.copy(), shared.copy(), np.empty(OWN + size + 1)
    for n in range(2):
        # A measurement that is as good as exact.
        row[:] = 0.0
        row[OWN + size - 2 + n] = 1e5 * abs(a) + 1e5 * abs(c)
        row[OWN + size] = row[OWN + size - 2 + n] * (best[n] - free[n])
        add_row(held[0], held_shared, row)
    solve_arrow(held, held_shared, own, common)
    common[size - 2 :] = best


@njit
def forget(information: Any, shared: Any, keep: float, keep_push: float, sizes_own: Any, sizes_common: Any) -> None:
    """Leaves shares of the information, of the push and of all else; adds as much of that at first as is missing."""
    root, rest, row = np.sqrt(keep), np.sqrt(1.0 - keep), np.empty(OWN + len(shared) + 1)
    information *= root
    shared *= root
    for k in range(PUSH, COMMON):
        # Other variances and all correlations stay.
        information[:, :, OWN + k] *= np.sqrt(keep_push / keep)
        shared[:, k] *= np.sqrt(keep_push / keep)
    for i in range(6):
        for k in range(OWN):
            row[:] = 0.0
            row[k] = rest / sizes_own[k]
            add_row(information[i], shared, row)
    for k in range(len(shared)):
        row[:] = 0.0
        row[OWN + k] = (np.sqrt(1.0 - keep_push) if PUSH <= k < COMMON else rest) / sizes_common[k]
        add_row(information[0], shared, row)
