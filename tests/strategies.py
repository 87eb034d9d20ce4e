"""Hypothesis strategies shared by the tests."""

import math

import numpy as np
from hypothesis import strategies as st

from stewart_drake.mechanics.kinematics import reach_margin
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
TANGENTIAL = RobotParameters(crank_plane_angle=-math.pi / 2.0)
ALTERNATING = RobotParameters(legs=[{"branch": 1 if leg % 2 == 0 else -1} for leg in range(6)])


def _unequal() -> RobotParameters:
    rng, legs = np.random.default_rng(3), []
    for leg in range(6):
        (yaw, tilt), shaft, joint = rng.uniform(-0.5, 0.5, 2), *rng.uniform(-0.012, 0.012, (2, 3))
        yaw += leg // 2 * (2.0 * np.pi / 3.0)
        h = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        legs.append(
            {
                "shaft_position": ROBOT.shaft_positions[leg] + shaft,
                "platform_joint": ROBOT.platform_joints[leg] + joint,
                "crank_zero_direction": h,
                "crank_quarter_direction": [-math.sin(tilt) * h[1], math.sin(tilt) * h[0], math.cos(tilt)],
                "crank_length": 0.1 + 0.005 * leg,
                "rod_length": 0.39 + 0.006 * leg,
                "branch": 1 if leg == 4 else -1,
            }
        )
    return RobotParameters(
        legs=legs,
        platform_inertia=(0.003, 0.004, 0.0055),
        platform_products=(0.0004, -0.0003, 0.0005),
        platform_center_of_mass=(0.02, -0.03, 0.05),
        rotor_inertia=2e-4,
        rod_mass=0.3,
        rod_inertia=(0.006, 0.006, 0.00001),
        crank_mass=0.2,
    )


UNEQUAL = _unequal()
ROBOTS = {"paper": ROBOT, "tangential": TANGENTIAL, "alternating": ALTERNATING, "unequal": UNEQUAL}
_HALF_WIDTH = np.array([np.pi / 6, np.pi / 6, np.pi / 6, 0.06, 0.06, 0.02])


def vectors(size: int, bound: float = 1.0) -> st.SearchStrategy[np.ndarray]:
    return st.lists(st.floats(-bound, bound), min_size=size, max_size=size).map(np.array)


def poses(size: float = 1.0, robot: RobotParameters = ROBOT) -> st.SearchStrategy[np.ndarray]:
    region = vectors(6).map(lambda unit: robot.home_pose + size * _HALF_WIDTH * unit)
    return region.filter(lambda pose: reach_margin(robot, pose).min() > 0.02)


def robots_and_poses(size: float = 0.6) -> st.SearchStrategy[tuple[RobotParameters, np.ndarray]]:
    return st.sampled_from(list(ROBOTS.values())).flatmap(lambda robot: st.tuples(st.just(robot), poses(size, robot)))
