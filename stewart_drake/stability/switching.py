"""Loops whose setting changes while they run: x+ = A(s) x with a setting s that moves at a limited rate, or jumps.

Stable at every setting does not mean stable while it changes. A proof is a norm x' P(s) x that falls at every tick
wherever the setting goes, P(s) between given matrices by shares: `here' P(s), `later` where the setting may be a tick
later. One P for all is a common Lyapunov function, and then the setting may even jump. Source: J. Geromel, P. Colaneri,
"Stability and stabilization of discrete time switched systems" (Int. J. Control 79, 2006); P that depends on a
parameter: G. Becker, A. Packard, "Robust performance of linear parametrically varying systems" (Systems & Control
Letters 23, 1994).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.linalg import matrix_balance, solve_discrete_lyapunov

_FALLS = 1e-6
"""Of the norm in a tick, in the coordinates of `even`: less may be the solver's rounding."""


def even(matrix: np.ndarray) -> np.ndarray:
    """Coordinates W x (n, n) in which a stable matrix (n, n) is neither large nor slow in one direction alone.

    In them the norm of all that is to come, summed over ticks, is 1 in every direction.
    """
    _, (scale, _) = matrix_balance(matrix, permute=False, separate=True)
    lyapunov = solve_discrete_lyapunov((matrix * scale / scale[:, None]).T, np.eye(len(matrix)))
    return np.linalg.cholesky(lyapunov).T / scale


def common_lyapunov(matrices: np.ndarray) -> np.ndarray | None:
    """P (n, n) with A' P A < P for all matrices (s, n, n), or None where there is none, as far as the solver sees."""
    shares = np.ones((len(matrices), 1))
    found = lyapunov_field(matrices, shares, shares[:, None])
    return None if found is None else found[0]


def lyapunov_field(matrices: np.ndarray, here: np.ndarray, later: np.ndarray) -> np.ndarray | None:
    """Matrices (j, n, n) of which P(s) is a mean with A(s)' P(later) A(s) < P(here), or None where there are none.

    By a semidefinite program, in coordinates that make the first matrix even. What it finds is looked at again.

    Args:
        matrices: (s, n, n) A at settings, the first one stable.
        here: (s, j) shares that the j matrices have in P there.
        later: (s, v, j) shares wherever the setting may be a tick later; in between P must be a mean of these.
    """
    from pydrake.solvers import ClarabelSolver, MathematicalProgram

    w = even(matrices[0])
    program = MathematicalProgram()
    # Drake's symbols raise flags of floating point that mean nothing.
    with np.errstate(all="ignore"):
        unknown = _falling(program, w @ matrices @ np.linalg.inv(w), here, later)
    result = ClarabelSolver().Solve(program)
    p = np.stack([np.asarray(result.GetSolution(each), dtype=float) for each in unknown])
    if not np.isfinite(p).all():
        return None
    found: np.ndarray = w.T @ (0.5 * (p + p.swapaxes(-1, -2))) @ w
    fastest = growth(matrices, found, here, later).max()
    return found if fastest < 1.0 - _FALLS else None


def _falling(program: Any, matrices: np.ndarray, here: np.ndarray, later: np.ndarray) -> list[Any]:
    """The unknown matrices below 1 whose norm falls by as much as can be."""
    n = matrices.shape[-1]
    unknown = [program.NewSymmetricContinuousVariables(n, f"P{j}") for j in range(here.shape[-1])]
    least = program.NewContinuousVariables(1, "least")[0]

    def mean(of: np.ndarray) -> Any:
        return sum(share * each for share, each in zip(of, unknown, strict=True) if share > 0.0)

    for each in unknown:
        program.AddPositiveSemidefiniteConstraint(np.eye(n) - each)
    for a, at, ends in zip(matrices, here, later, strict=True):
        now = mean(at) - least * np.eye(n)
        for end in np.unique(ends, axis=0):
            program.AddPositiveSemidefiniteConstraint(now - a.T @ mean(end) @ a)
    program.AddLinearCost(-least)
    return unknown


def growth(matrices: np.ndarray, field: np.ndarray, here: np.ndarray, later: np.ndarray) -> np.ndarray:
    """By what factor (s,) the norm grows at most in a tick; infinite where it is none. See `lyapunov_field`."""
    try:
        before = np.linalg.inv(np.linalg.cholesky(np.tensordot(here, field, 1)))
        after = np.linalg.cholesky(np.tensordot(later, field, 1))
    except np.linalg.LinAlgError:
        return np.full(len(matrices), np.inf)
    moved = after.swapaxes(-1, -2) @ (matrices @ before.swapaxes(-1, -2))[:, None]
    largest: np.ndarray = np.linalg.norm(moved, 2, axis=(-2, -1)).max(axis=-1)
    return largest


def shares(places: np.ndarray, knots: tuple[int, ...]) -> np.ndarray:
    """Shares (..., j) of the knots of an even grid over the unit box at places (..., d): linear between neighbours."""
    found = np.ones((*places.shape[:-1], 1))
    for axis, count in enumerate(knots):
        at = np.linspace(0.0, 1.0, count) if count > 1 else np.zeros(1)
        near = np.maximum(0.0, 1.0 - np.abs(places[..., axis, None] - at) * (count - 1))
        found = (found[..., :, None] * near[..., None, :]).reshape(*places.shape[:-1], -1)
    return found


def moves(places: np.ndarray, step: float) -> np.ndarray:
    """Corners (..., 2^d, d) of where places (..., d) of the unit box may be a step later."""
    d = places.shape[-1]
    signs = 2.0 * np.stack(np.meshgrid(*[[0.0, 1.0]] * d, indexing="ij"), axis=-1).reshape(-1, d) - 1.0
    return np.clip(places[..., None, :] + step * signs, 0.0, 1.0)


def driven(matrices: np.ndarray, start: np.ndarray, tolerance: float = 1e-6) -> np.ndarray:
    """Basis (n, k), orthonormal, of the states that matrices (s, n, n) can ever reach from a state (n,).

    All of them leave that space as it is: with the rest of the space behind it each is block triangular, and what
    switches between them is stable where both blocks are.

    Args:
        matrices: The more general, the better.
        start: Not zero.
        tolerance: Length of what is left of a unit vector that counts as nothing.
    """
    basis = (start / np.linalg.norm(start))[:, None]
    while True:
        reached = (matrices @ basis).swapaxes(0, 1).reshape(len(start), -1)
        reached = reached / np.maximum(np.linalg.norm(reached, axis=0), np.finfo(float).tiny)
        left = reached - basis @ (basis.T @ reached)
        far = np.linalg.norm(left, axis=0).argmax()
        if np.linalg.norm(left[:, far]) <= tolerance or basis.shape[1] == len(start):
            return basis
        # The part along the basis once more: rounding.
        more = left[:, far] - basis @ (basis.T @ left[:, far])
        basis = np.concatenate([basis, (more / np.linalg.norm(more))[:, None]], axis=1)


def greedy(
    places: np.ndarray, matrices: np.ndarray, knots: tuple[int, ...], step: float, state: np.ndarray, ticks: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """States and settings as an adversary drives them, who moves the setting to where the state grows most.

    Args:
        places: (d,) of the unit box, where the setting starts.
        matrices: (j, n, n) at the knots, linear between them, in coordinates in which the norm is to grow.
        knots: See `shares`.
        step: Of each of d numbers in a tick.
        state: (n,) at the start.
        ticks: How many.

    Yields:
        State (n,) and place (d,) after each tick.
    """
    for _ in range(ticks):
        ends = np.concatenate([moves(places, step), places[None]])
        reached = np.tensordot(shares(ends, knots), matrices @ state, 1)
        best = int(np.linalg.norm(reached, axis=-1).argmax())
        places, state = ends[best], reached[best]
        yield state, places


def monodromy(matrices: np.ndarray) -> float:
    """Spectral radius a tick of a loop that goes through matrices (k, n, n) again and again, in this order."""
    whole = np.eye(matrices.shape[-1])
    for each in matrices:
        whole = each @ whole
    return float(np.abs(np.linalg.eigvals(whole)).max() ** (1.0 / len(matrices)))
