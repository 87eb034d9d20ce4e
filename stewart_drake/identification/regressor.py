"""Torques of a motion as a linear function of the bodies' parameters: the exact model, asked once for each of them."""

from __future__ import annotations

import numpy as np

from stewart_drake.identification.parameters import unit_robots
from stewart_drake.mechanics.checks import legs_within_reach
from stewart_drake.mechanics.dynamics_core import inverse_dynamics
from stewart_drake.robot import RobotParameters

_BLOCK = 1024


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
    robots = unit_robots(guess)
    columns = np.empty((len(pose), 6, len(robots)))
    for start in range(0, len(pose), _BLOCK):
        rows = slice(start, start + _BLOCK)
        # The legs' lines do not depend on the masses.
        _, legs = legs_within_reach(guess, pose[rows])
        for at, robot in enumerate(robots):
            motion = pose[rows], rate[rows], acceleration[rows]
            columns[rows, :, at] = inverse_dynamics(robot, legs, *motion, gravity, masked=False)
    return columns[..., :-1], columns[..., -1]
