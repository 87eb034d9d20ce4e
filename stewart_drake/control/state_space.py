"""The paper's error dynamics with integral action, (19)-(25), discretised, and the Hautus tests (28), (29).

State order is the paper's: [phi, phi', theta, theta', psi, psi', X, X', Y, Y', Z, Z', z_1 .. z_6], errors throughout.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.force_map import ForceMapKind, force_map
from stewart_drake.robot import RobotParameters

AXES = 6
STATES = 18
Discretization = Literal["exact", "euler"]

POSITION = np.arange(0, 12, 2)
"""Indices of the six position errors in the 18 states."""
RATE = np.arange(1, 12, 2)
"""Indices of the six rate errors."""
INTEGRAL = np.arange(12, 18)
"""Indices of the six integrals."""


def mass_diagonal(robot: RobotParameters) -> np.ndarray:
    """Diagonal (6,) [kg m^2, kg] of M in (9): Ixx, Iyy, Izz, m, m, m of the platform alone.

    Deviation, kept from the paper: legs, gravity and gyroscopic terms are left out, and moments in B act on inertia in
    P.
    """
    return np.array([*robot.platform_inertia, *(robot.platform_mass,) * 3])


def acceleration_map(robot: RobotParameters, pose: np.ndarray, kind: ForceMapKind = "statics") -> np.ndarray:
    """M^-1 tau (..., 6, 6) of (10): second derivative of poses (..., 6) per unit of torque, in the paper's model."""
    return force_map(robot, pose, kind) / mass_diagonal(robot)[:, None]


def state_matrix() -> np.ndarray:
    """A of (25), built from (21) and (24); (18, 18)."""
    matrix = np.zeros((STATES, STATES))
    matrix[POSITION, RATE] = 1.0
    matrix[INTEGRAL, POSITION] = 1.0
    return matrix


def input_matrix(acceleration_map: np.ndarray) -> np.ndarray:
    """B (..., 18, 6) of (25) from M^-1 tau (..., 6, 6). Deviation: (22) prints tau where (10) demands M^-1 tau."""
    matrix = np.zeros((*acceleration_map.shape[:-2], STATES, AXES))
    matrix[..., RATE, :] = acceleration_map
    return matrix


def output_matrix() -> np.ndarray:
    """C of (25): [C_bar, I], the six position errors plus their integrals; (6, 18)."""
    matrix = np.zeros((AXES, STATES))
    matrix[np.arange(AXES), POSITION] = 1.0
    matrix[np.arange(AXES), INTEGRAL] = 1.0
    return matrix


def discretize(
    a: np.ndarray, b: np.ndarray, period: float, method: Discretization = "exact"
) -> tuple[np.ndarray, np.ndarray]:
    """Zero-order hold of x' = A x + B u over one control period.

    `exact` uses that A of (25) is nilpotent, A^3 = 0, so that the matrix exponential is a polynomial of degree two.
    Deviation: the paper puts continuous A, B into the discrete equations (31), (32).

    Args: A (18, 18) [1/s], B (..., 18, 6), the period [s], and `exact` or `euler`.

    Returns:
        A_d (18, 18), B_d (..., 18, 6).
    """
    identity = np.eye(a.shape[0])
    if method == "euler":
        return identity + period * a, period * b
    if method != "exact":
        raise ConfigurationError("discretization", method, "exact or euler")
    a2 = a @ a
    integral = period * identity + (period**2 / 2.0) * a + (period**3 / 6.0) * a2
    return identity + period * a + (period**2 / 2.0) * a2, integral @ b


def hautus_stabilisability(a: np.ndarray, b: np.ndarray) -> int:
    """Smallest rank of [lambda I - A, B] over the modes that are not asymptotically stable, (28).

    Deviation: the test concerns Re(lambda) >= 0; the print says lambda <= 0 and counts columns of B.

    Stabilisable where it equals the number of states, which it is too if every mode is stable.
    """
    return _smallest_rank(a, lambda mode: np.hstack([mode * np.eye(a.shape[0]) - a, b]))


def hautus_detectability(a: np.ndarray, c: np.ndarray) -> int:
    """Smallest rank of [lambda I - A; C] likewise, (29); detectable where it equals the number of states."""
    return _smallest_rank(a, lambda mode: np.vstack([mode * np.eye(a.shape[0]) - a, c]))


def _smallest_rank(a: np.ndarray, pencil: Callable[[complex], np.ndarray]) -> int:
    # Triple eigenvalues at zero come back from the solver as a small circle whose radius grows as eps^(1/3). Zero is
    # tried beside them, not in their place: a slow unstable mode must not pass for an integrator.
    radius = 10.0 * np.finfo(float).eps ** (1.0 / 3.0) * max(1.0, float(np.abs(a).max()))
    modes = np.linalg.eigvals(a)
    candidates = {complex(mode) for mode in modes[modes.real >= 0.0]}
    if np.any(np.abs(modes) < radius):
        candidates.add(0.0j)
    return min((int(np.linalg.matrix_rank(pencil(mode))) for mode in candidates), default=a.shape[0])
