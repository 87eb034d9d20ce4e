import numpy as np
import pytest

from stewart_drake.mechanics.dynamics import task_inertia
from stewart_drake.mechanics.kinematics import leg_geometry, twist_jacobian
from stewart_drake.paper.force_map import (
    light_legs,
    measured,
    predicted,
    relative_error,
    rod_map_11,
    to_euler,
)
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
POSES = np.vstack([ROBOT.home_pose, sample_poses(ROBOT, NEAR, 3, np.random.default_rng(4), 0.05)])


def exact(robot, poses=POSES):
    """d(twist)/dt per N m at rest by the exact rigid-body model: the oracle of this file."""
    return np.linalg.solve(task_inertia(robot, poses), np.swapaxes(twist_jacobian(robot, poses), -1, -2))


@pytest.mark.parametrize(("scale", "tolerance"), [(1.0, 2e-5), (1e-2, 1e-6)])
def test_drake_accelerates_as_the_exact_model_says(scale, tolerance):
    robot = light_legs(ROBOT, scale)
    assert relative_error(robot, measured(robot, POSES, 9.81), exact(robot)).max() < tolerance


def test_the_last_model_is_the_massless_limit_of_the_exact_one():
    said = predicted(ROBOT, POSES, "massless legs")
    truth = [to_euler(POSES, exact(light_legs(ROBOT, scale))) for scale in (1e-5, 1e-6)]
    errors = [relative_error(ROBOT, each, said) for each in truth]
    np.testing.assert_allclose(errors[0] / errors[1], 10.0, rtol=1e-2)
    assert errors[1].max() < 1e-5


def test_the_rod_map_of_11_leaves_the_platform_joints_unrotated():
    legs = leg_geometry(ROBOT, POSES[1])
    printed = rod_map_11(ROBOT, legs)
    np.testing.assert_allclose(printed[:3].T, np.cross(ROBOT.platform_joints, legs.e_l))
    assert not np.allclose(printed[:3].T, np.cross(legs.arm, legs.e_l))
