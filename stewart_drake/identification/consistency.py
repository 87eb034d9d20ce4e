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
from stewart_drake.identification.parameters import COULOMB, PLATFORM, VISCOUS, inertia_matrix, of_robot, scales
from stewart_drake.robot import RobotParameters

LEAST = 1e-5
"""[-] of the platform's mass, and of what else the guess has, that the smallest eigenvalue and each number keep."""


class InconsistentError(StewartDrakeError):
    """No parameters of bodies were found near an estimate."""


def pseudo_inertia(guess: RobotParameters, values: Any) -> Any:
    """(4, 4) [kg] of the platform with lengths in those of the robot; of numbers or expressions (`SIZE`,)."""
    length = guess.characteristic_length
    inertia = inertia_matrix(values[PLATFORM]) / length**2
    moment = values[1:4] / length
    top = np.concatenate([0.5 * np.trace(inertia) * np.eye(3) - inertia, moment[:, None]], axis=1)
    return np.concatenate([top, np.append(moment, values[0])[None]])


def lower_bounds(guess: RobotParameters) -> dict[int, float]:
    """Least value of each parameter that has one, by its place."""
    own = of_robot(guess)
    bounds: dict[int, float] = {at: LEAST * own[at] for at in (10, 12)}
    # A rod is no thinner than the moment about itself allows.
    bounds[11] = 0.5 * guess.rod_inertia[2] * (1.0 + LEAST)
    bounds[13] = 0.0
    return bounds | {at: 0.0 for part in (COULOMB, VISCOUS) for at in range(part.start, part.stop)}


def is_consistent(guess: RobotParameters, values: np.ndarray) -> bool:
    """Whether bodies can have parameters (`SIZE`,), with half of `LEAST` to spare."""
    smallest = np.linalg.eigvalsh(pseudo_inertia(guess, values))[0]
    size = scales(guess)
    inside = all(values[at] >= bound - 1e-9 * size[at] for at, bound in lower_bounds(guess).items())
    return bool(smallest >= 0.5 * LEAST * guess.platform_mass) and inside


def consistent(guess: RobotParameters, found: Estimate) -> np.ndarray:
    """Parameters (`SIZE`,) that bodies can have, nearest to an estimate; itself if it is such.

    Raises:
        InconsistentError: None were found.
    """
    if is_consistent(guess, found.values):
        return found.values
    from pydrake.solvers import ClarabelSolver, MathematicalProgram

    with drake_guard("the semidefinite program"):
        program = MathematicalProgram()
        # In these directions the information is a multiple of 1, and the longest is a parameter's own size.
        ways = found.ways @ np.linalg.inv(np.linalg.cholesky(found.information).T)
        ways = ways / np.abs(ways / scales(guess)[:, None]).max()
        along = program.NewContinuousVariables(ways.shape[1], "along")
        program.AddQuadraticCost(2.0 * np.eye(len(along)), np.zeros(len(along)), along)
        # 0 for what keeps the guess's value, which is that of a body.
        free = np.abs(ways).max(axis=1) > 0.0
        constant, *slopes = (pseudo_inertia(guess, each) / guess.platform_mass for each in (found.values, *ways.T))
        program.AddLinearMatrixInequalityConstraint([constant - LEAST * np.eye(4), *slopes], along)
        for at, bound in lower_bounds(guess).items():
            if free[at]:
                scale = np.abs(ways[at]).max()
                program.AddLinearConstraint(ways[at] / scale, (bound - found.values[at]) / scale, np.inf, along)
        result = ClarabelSolver().Solve(program)
        nearest = found.values + ways @ result.GetSolution(along)
    for at, bound in lower_bounds(guess).items():
        # The solver keeps bounds to its own tolerance.
        nearest[at] = max(nearest[at], bound) if free[at] else nearest[at]
    if not result.is_success() or not is_consistent(guess, nearest):
        raise InconsistentError(f"no bodies near the estimate: {result.get_solution_result()}")
    return nearest
