"""Torques of a motion as a linear function of the bodies' parameters: the exact model, asked once for each of them."""

from __future__ import annotations

import numpy as np

from stewart_drake.identification.parameters import unit_robots
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.robot import RobotParameters


def body_torques(
    guess: RobotParameters, pose: np.ndarray, rate: np.ndarray, acceleration: np.ndarray, gravity: float
) -> tuple[np.ndarray, np.ndarray]:
    """Torques per unit of each parameter of the bodies, and those that no parameter changes.

    Args:
        guess: Geometry.
        pose: (n, 6) [rad, m].
        rate: (n, 6) [rad/s, m/s].
        acceleration: (n, 6) [rad/s^2, m/s^2].
        gravity: [m/s^2].

    Returns:
        (n, 6, 14) [N m] per unit of `parameters.PARAMETERS`, and (n, 6) [N m].

    Raises:
        UnreachablePoseError: As in `inverse_kinematics`.
    """
    columns = [inverse_dynamics(robot, pose, rate, acceleration, gravity) for robot in unit_robots(guess)]
    return np.stack(columns[:-1], axis=-1), columns[-1]
