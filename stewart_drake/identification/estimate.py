"""The parameters that make the measured torques most likely, how well they are known, and which are not.

Long-run covariance: Newey, West (1987); base parameters: Gautier (1991); bodies: Wensing, Kim, Slotine (2018).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.errors import ConfigurationError, StewartDrakeError, drake_guard
from stewart_drake.identification.parameters import (
    CRANK_MASS,
    GAIN,
    MASS,
    MOMENT,
    PARAMETERS,
    ROD_INERTIA,
    ROD_MASS,
    SIZE,
    VISCOUS,
    Kind,
    free_directions,
    inertia_matrix,
    of_robot,
    scales,
)
from stewart_drake.identification.samples import Samples
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

ASKED: tuple[Kind, ...] = ("platform_mass", "coulomb", "viscous")
LARGEST = 0.3
"""[-] standard deviation of a direction, in `parameters.scales`, beyond which it counts as unidentifiable."""
MEMORY = 0.5  # [s] over which what is left may be correlated
LEAST = 1e-5
"""[-] of the platform's mass, and of what else the guess has, that eigenvalues of bodies and numbers keep."""
_PASSES = 6
_KEEP_FIRST = np.array([5.0 if own.kind == "rod_mass" else 1.0 for own in PARAMETERS])
"""Where several could keep the guess's value it is the rods' mass, which a scale tells."""
_NORMAL_95 = 1.959964
_BLIND = 1e-9  # [-] of the largest singular value below which a direction is that of rounding
_UNLIKE, _NOISY, _FACTOR = 0.5, 0.1, 30.0
"""[-] of the torques' changes that may be left, unless less of the torques; how they may differ from the guess's."""


class InconsistentError(StewartDrakeError): ...


class Unidentifiable(NamedTuple):
    """A parameter that keeps its value, its deviation [-] in `scales`, and the change of all that no torque notices."""

    at: int
    deviation: float
    direction: np.ndarray


@dataclass(frozen=True, eq=False)
class Estimate:
    """Values (`SIZE`,), free along ways (`SIZE`, k), with covariance and information (k, k) there."""

    values: np.ndarray
    ways: np.ndarray
    covariance: np.ndarray
    information: np.ndarray
    unidentifiable: tuple[Unidentifiable, ...]

    def identifiable_part(self, change: np.ndarray) -> np.ndarray:
        """What the motion tells of a change (`SIZE`,) of the parameters: that which leaves alone what is not told."""
        for each in self.unidentifiable:
            change = change - change[each.at] * each.direction
        return change

    @property
    def half_width(self) -> np.ndarray:
        """(`SIZE`,) of the 95 % intervals; 0 for what kept its value."""
        variance = np.einsum("ij,jk,ik->i", self.ways, self.covariance, self.ways)
        return _NORMAL_95 * np.sqrt(np.maximum(variance, 0.0))


def estimate(
    guess: RobotParameters, samples: Samples, held: Collection[Kind] = (), asked: Collection[Kind] = ASKED
) -> Estimate:
    """Fits the parameters of a robot to samples, but for kinds that are held; what is asked must be identifiable."""
    size, values = scales(guess), of_robot(guess)
    unidentifiable: list[Unidentifiable] = []
    noise = np.eye(LEGS) * np.mean(samples.torque**2)
    for turn in range(_PASSES):
        ways = size[:, None] * free_directions(held, {each.at for each in unidentifiable})
        slope, left = _whitened(samples, values, ways, noise)
        values = values + ways @ np.linalg.lstsq(slope, left, rcond=_BLIND)[0]
        # A first pass from a crude guess may leave the logarithms of gains far off.
        values[GAIN] = np.clip(values[GAIN], -3.0, 3.0)
        noise = _noise(samples, values)
        if turn == 1:
            _refuse_other(guess, samples, values)
            slope, _ = _whitened(samples, values, size[:, None] * free_directions(held), noise)
            unidentifiable = _unidentifiable(slope, samples, held, size)
            for each in unidentifiable:
                if (own := PARAMETERS[each.at]).kind in set(asked) - set(held):
                    got = f"a motion that leaves an uncertainty of {each.deviation:.3g} times its size"
                    allowed = "a motion that determines it; `excite` designs one"
                    raise ConfigurationError(f"{samples.source}: {own}", got, allowed)
            values = of_robot(guess) if unidentifiable else values
    slope, left = _whitened(samples, values, ways, noise)
    information = slope.T @ slope
    inverse = np.linalg.inv(information)
    rows = int(samples.used.sum())
    covariance = inverse @ _long_run(samples, slope * left[:, None]) @ inverse * rows / (rows - len(inverse))
    return Estimate(values, ways, covariance, information, tuple(unidentifiable))


def _whitened(
    samples: Samples, values: np.ndarray, ways: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (6 n, k) of whitened torques, and what is left of these (6 n,); zero where a row has no say."""
    both = samples.used[:, :, None] & samples.used[:, None, :]
    # W' W is the inverse of the covariance of those rows that have a say.
    white = np.where(both, np.linalg.inv(np.linalg.cholesky(np.where(both, noise, np.eye(LEGS)))), 0.0)
    slope = (white @ (samples.derivative(values) @ ways)).reshape(-1, ways.shape[1])
    return slope, np.einsum("nij,nj->ni", white, samples.torque - samples.predicted(values)).ravel()


def _noise(samples: Samples, values: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) [N^2 m^2] of what is left, by the rows that both of two motors have."""
    used = samples.used.astype(float)
    left = (samples.torque - samples.predicted(values)) * used
    covariance = left.T @ left / np.maximum(used.T @ used, 1.0)
    # Pairs seldom in motion together could make it indefinite; half of what is common is on the safe side.
    covariance = 0.5 * (covariance + np.diag(np.diag(covariance)))
    return covariance + 1e-12 * float(np.mean(samples.torque**2)) * np.eye(LEGS)


def _long_run(samples: Samples, scores: np.ndarray) -> np.ndarray:
    """Covariance (k, k) of the scores' sum, those (6 n, k) of six rows at a time correlated over `MEMORY`.

    W. K. Newey and K. D. West, Econometrica 55 (1987).
    """
    of_instant = scores.reshape(len(samples.time), LEGS, -1).sum(axis=1)
    lags = max(1, round(MEMORY / samples.step))
    total = of_instant.T @ of_instant
    for own in (of_instant[piece] for piece in samples.pieces):
        for lag in range(1, min(lags + 1, len(own))):
            part = (1.0 - lag / (lags + 1.0)) * own[lag:].T @ own[:-lag]
            total = total + part + part.T
    return total


def _unidentifiable(
    slope: np.ndarray, samples: Samples, held: Collection[Kind], size: np.ndarray
) -> list[Unidentifiable]:
    """Which parameters to keep, one after the other, until all directions that are left are told: base parameters.

    M. Gautier, "Numerical calculation of the base inertial parameters of robots" (J. Robotic Systems 8, 1991).
    """
    found: list[Unidentifiable] = []
    # Rows closer than half a period of the filter say the same again.
    rows = np.linalg.qr(slope @ free_directions(held).T, mode="r") / np.sqrt(samples.repeats)
    while True:
        free = free_directions(held, {each.at for each in found})
        _, sigma, directions = np.linalg.svd(rows @ free)
        if len(directions) == 0 or sigma[-1] * LARGEST >= 1.0:
            return found
        direction = free @ directions[-1]
        at = int((np.abs(direction) * _KEEP_FIRST).argmax())
        deviation = np.inf if sigma[-1] <= _BLIND * sigma[0] else 1.0 / sigma[-1]
        found.append(Unidentifiable(at, float(deviation), direction / direction[at] * size / size[at]))


def _refuse_other(guess: RobotParameters, samples: Samples, values: np.ndarray) -> None:
    """Refuses torques that are not those of the motion, or of another size than the guess's."""

    def size(torque: np.ndarray) -> float:
        return float(np.sqrt(np.mean(torque[samples.used] ** 2))) if samples.used.any() else 0.0

    torque = samples.torque
    measured, expected = size(torque), size(samples.predicted(of_robot(guess)))
    left, changes = size(torque - samples.predicted(values)), size(torque - torque.mean(axis=0))
    if left > max(_UNLIKE * changes, _NOISY * measured):
        got = f"torques with {min(100.0, 100.0 * left / changes):.0f} % of their changes unexplained by any parameters"
    elif expected > 0.0 and not 1.0 / _FACTOR < measured / expected < _FACTOR:
        got = f"torques of {measured:.3g} N m where the guess needs {expected:.3g} N m (RMS)"
    else:
        return
    raise ConfigurationError(samples.source, got, "a log of the guessed robot, angles in rad, torques in N m")


def pseudo_inertia(guess: RobotParameters, values: Any) -> Any:
    """(4, 4) [kg] of the platform with lengths in those of the robot."""
    length = guess.characteristic_length
    inertia, moment = inertia_matrix(values) / length**2, values[MOMENT] / length
    top = np.concatenate([0.5 * np.trace(inertia) * np.eye(3) - inertia, moment[:, None]], axis=1)
    return np.concatenate([top, np.append(moment, values[MASS])[None]])


def _lower_bounds(guess: RobotParameters) -> np.ndarray:
    """Least value (`SIZE`,) of each parameter, -inf of one that has none; a rod is no thinner than its own moment."""
    bounds, own = np.full(SIZE, -np.inf), of_robot(guess)
    bounds[[ROD_MASS, CRANK_MASS]] = LEAST * own[[ROD_MASS, CRANK_MASS]]
    bounds[ROD_INERTIA] = 0.5 * guess.rod_inertia[2] * (1.0 + LEAST)
    bounds[CRANK_MASS + 1 : VISCOUS.stop] = 0.0
    return bounds


def is_consistent(guess: RobotParameters, values: np.ndarray) -> bool:
    """Whether bodies can have parameters (`SIZE`,), with half of `LEAST` to spare."""
    smallest = np.linalg.eigvalsh(pseudo_inertia(guess, values))[0]
    inside = (values >= _lower_bounds(guess) - 1e-9 * scales(guess)).all()
    return bool(smallest >= 0.5 * LEAST * guess.platform_mass and inside)


def consistent(guess: RobotParameters, found: Estimate) -> np.ndarray:
    """Parameters (`SIZE`,) that bodies can have, nearest to an estimate in its own information: a semidefinite program.

    P. M. Wensing, S. Kim, J.-J. E. Slotine, "Linear matrix inequalities for physically consistent inertial parameter
    identification" (IEEE RA-L 3, 2018). Rods, cranks and rotors have no negative mass, and no friction drives.
    """
    bounds = _lower_bounds(guess)
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
