"""The nearest parameters that bodies can have: a semidefinite program.

The platform's pseudo-inertia matrix [[Sigma, moment], [moment', mass]] with Sigma = tr(I)/2 - I is positive
semidefinite, which is what a distribution of positive mass has and nothing else: P. M. Wensing, S. Kim, J.-J. E.
Slotine, "Linear matrix inequalities for physically consistent inertial parameter identification" (IEEE RA-L 3, 2018).
Rods, cranks and rotors have no negative mass or inertia, and no friction drives. Nearest is meant as the data mean it:
in the estimate's own information.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stewart_drake.errors import StewartDrakeError, drake_guard
from stewart_drake.identification.estimate import Estimate
from stewart_drake.identification.parameters import (
    CRANK_MASS,
    MASS,
    MOMENT,
    ROD_INERTIA,
    ROD_MASS,
    SIZE,
    VISCOUS,
    inertia_matrix,
    of_robot,
    scales,
)
from stewart_drake.robot import RobotParameters

LEAST = 1e-5
"""[-] of the platform's mass, and of what else the guess has, that the smallest eigenvalue and each number keep."""


class InconsistentError(StewartDrakeError):
    """No parameters of bodies were found near an estimate."""


def pseudo_inertia(guess: RobotParameters, values: Any) -> Any:
    """(4, 4) [kg] of the platform with lengths in those of the robot; of numbers or expressions (`SIZE`,)."""
    length = guess.characteristic_length
    inertia, moment = inertia_matrix(values) / length**2, values[MOMENT] / length
    top = np.concatenate([0.5 * np.trace(inertia) * np.eye(3) - inertia, moment[:, None]], axis=1)
    return np.concatenate([top, np.append(moment, values[MASS])[None]])


def lower_bounds(guess: RobotParameters) -> np.ndarray:
    """Least value (`SIZE`,) of each parameter, -inf of one that has none; a rod is no thinner than its own moment."""
    bounds, own = np.full(SIZE, -np.inf), of_robot(guess)
    bounds[[ROD_MASS, CRANK_MASS]] = LEAST * own[[ROD_MASS, CRANK_MASS]]
    bounds[ROD_INERTIA] = 0.5 * guess.rod_inertia[2] * (1.0 + LEAST)
    bounds[CRANK_MASS + 1 : VISCOUS.stop] = 0.0
    return bounds


def is_consistent(guess: RobotParameters, values: np.ndarray) -> bool:
    """Whether bodies can have parameters (`SIZE`,), with half of `LEAST` to spare."""
    smallest = np.linalg.eigvalsh(pseudo_inertia(guess, values))[0]
    inside = (values >= lower_bounds(guess) - 1e-9 * scales(guess)).all()
    return bool(smallest >= 0.5 * LEAST * guess.platform_mass and inside)


def consistent(guess: RobotParameters, found: Estimate) -> np.ndarray:
    """Parameters (`SIZE`,) that bodies can have, nearest to an estimate; itself but for rounding if it is such.

    Raises:
        InconsistentError: None were found.
    """
    bounds = lower_bounds(guess)
    if is_consistent(guess, found.values):
        return np.maximum(found.values, bounds)
    from pydrake.solvers import ClarabelSolver, MathematicalProgram

    with drake_guard("the semidefinite program"):
        program = MathematicalProgram()
        # In these directions the information is a multiple of 1, and the longest is a parameter's own size.
        ways = found.ways @ np.linalg.inv(np.linalg.cholesky(found.information).T)
        ways = ways / np.abs(ways / scales(guess)[:, None]).max()
        along = program.NewContinuousVariables(ways.shape[1], "along")
        program.AddQuadraticCost(2.0 * np.eye(len(along)), np.zeros(len(along)), along)
        constant, *slopes = (pseudo_inertia(guess, each) / guess.platform_mass for each in (found.values, *ways.T))
        program.AddLinearMatrixInequalityConstraint([constant - LEAST * np.eye(4), *slopes], along)
        size = np.abs(ways).max(axis=1)
        # Size 0 has what keeps the guess's value, which is that of a body.
        bounded = (size > 0.0) & np.isfinite(bounds)
        least = (bounds - found.values)[bounded] / size[bounded]
        for row, bound in zip((ways[bounded] / size[bounded, None]), least, strict=True):
            program.AddLinearConstraint(row, bound, np.inf, along)
        result = ClarabelSolver().Solve(program)
        nearest = found.values + ways @ result.GetSolution(along)
    # The solver keeps bounds to its own tolerance.
    nearest[bounded] = np.maximum(nearest, bounds)[bounded]
    if not result.is_success() or not is_consistent(guess, nearest):
        raise InconsistentError(f"no bodies near the estimate: {result.get_solution_result()}")
    return nearest
