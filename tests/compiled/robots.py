"""Robots and poses for the compiled functions: other branch, other geometry, heavy legs, legs of their own."""

import numpy as np
from hypothesis import strategies as st
from strategies import ALTERNATING, TANGENTIAL, UNEQUAL, vectors

from stewart_drake.robot import RobotParameters

PAPER = RobotParameters()
ROBOTS = (
    PAPER,
    RobotParameters(branch=1),
    RobotParameters(
        shaft_circle_radius=0.25,
        platform_joint_radius=0.09,
        crank_length=0.08,
        rod_length=0.38,
        shaft_half_angle=0.3,
        rod_mass=0.8,
        rod_inertia=(0.016, 0.016, 0.00001),
        crank_mass=0.4,
        platform_inertia=(0.003, 0.004, 0.006),
        effort_limit=1.5,
        characteristic_length=0.3,
    ),
    TANGENTIAL,
    ALTERNATING,
    UNEQUAL,
)
robots = st.sampled_from(ROBOTS)
_HALF_WIDTH = np.array([0.3, 0.3, 0.3, 0.03, 0.03, 0.02])


def offsets(size=1.0):
    """Offsets from the home pose, all axes at once."""
    return vectors(6).map(lambda unit: size * _HALF_WIDTH * unit)
