"""Hypothesis strategies shared by the tests."""

import numpy as np
from hypothesis import strategies as st

from stewart_drake.mechanics.kinematics import reach_margin
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
_HALF_WIDTH = np.array([np.pi / 6, np.pi / 6, np.pi / 6, 0.06, 0.06, 0.02])


def vectors(size: int, bound: float = 1.0) -> st.SearchStrategy[np.ndarray]:
    """Vectors in a cube of half width `bound`."""
    return st.lists(st.floats(-bound, bound), min_size=size, max_size=size).map(np.array)


def poses(size: float = 1.0) -> st.SearchStrategy[np.ndarray]:
    """Poses within +-30 deg about each axis, +-60 mm in X and Y, Z 0.28 to 0.32 m, all at once, scaled by `size`.

    Three in ten thousand corners of that region, angles and offsets together, are out of reach; those are left out.
    """
    region = vectors(6).map(lambda unit: ROBOT.home_pose + size * _HALF_WIDTH * unit)
    return region.filter(lambda pose: reach_margin(ROBOT, pose).min() > 0.02)
