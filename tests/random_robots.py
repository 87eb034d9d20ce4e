"""Robots with legs of any kind, by seed."""

import math
from functools import cache

import numpy as np

from stewart_drake import ConfigurationError, RobotParameters, leg_geometry
from stewart_drake.mechanics.kinematics import conditioning


@cache
def random_robot(seed):
    rng = np.random.default_rng(seed)
    while True:
        try:
            robot = RobotParameters(**_drawn(rng))
        except ConfigurationError:
            continue
        transmission = np.abs(leg_geometry(robot, robot.home_pose).transmission).min()
        if conditioning(robot, robot.home_pose) > 0.1 and transmission > 0.4:
            return robot


def _drawn(rng):
    size = rng.uniform(0.05, 0.5)
    legs = []
    for leg in range(6):
        third, side = math.radians(120.0 * (leg // 2)), -1.0 if leg % 2 == 0 else 1.0
        angle, top = third + side * rng.uniform(0.1, 0.5), third + side * rng.uniform(0.6, 1.0)
        yaw, tilt = rng.uniform(-math.pi, math.pi), rng.uniform(-0.5, 0.5)
        zero = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        across = np.array([-zero[1], zero[0], 0.0])
        legs.append(
            {
                "shaft_position": size
                * np.array([1.5 * math.cos(angle), 1.5 * math.sin(angle), rng.uniform(-0.1, 0.1)]),
                "platform_joint": size * np.array([math.cos(top), math.sin(top), rng.uniform(-0.1, 0.1)]),
                "crank_zero_direction": zero,
                "crank_quarter_direction": math.cos(tilt) * np.array([0.0, 0.0, 1.0]) + math.sin(tilt) * across,
                "crank_length": size * rng.uniform(0.5, 0.8),
                "rod_length": size * rng.uniform(2.2, 2.8),
                "branch": int(rng.choice([-1, 1])),
            }
        )
    mass = rng.uniform(0.1, 5.0)
    moments = mass * size**2 * rng.uniform(0.3, 0.5, 3)
    rod, crank = 0.05 * mass, 0.03 * mass
    return {
        "legs": legs,
        "home_height": 2.2 * size,
        "platform_mass": mass,
        "platform_inertia": moments,
        "platform_products": 0.1 * moments.min() * rng.uniform(-1.0, 1.0, 3),
        "platform_center_of_mass": 0.2 * size * rng.uniform(-1.0, 1.0, 3),
        "rod_mass": rod,
        "rod_inertia": rod * size**2 * np.array([0.5, 0.5, 1e-3]),
        "crank_mass": crank,
        "crank_inertia": crank * size**2 * np.array([1e-3, 0.03, 0.03]),
        "rotor_inertia": mass * size**2 * rng.uniform(0.0, 0.2),
        "effort_limit": 10.0 * mass * size,
        "characteristic_length": size,
        "link_radius": 0.02 * size,
    }
