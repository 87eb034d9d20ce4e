"""Reachy Mini, a platform that one can buy, against its maker's own kinematics."""

import numpy as np
import pytest
from reachy_mini_rust_kinematics import ReachyMiniRustKinematics

from stewart_drake import forward_kinematics, inverse_kinematics, load_robot
from stewart_drake.mechanics.kinematics import newton, pose_jacobian, reach_margin, roll_pitch_yaw, rotation_matrix

ROBOT = load_robot("reachy_mini")
HOME = ROBOT.home_pose


def makers():
    solver = ReachyMiniRustKinematics(float(ROBOT.crank_lengths[0]), float(ROBOT.rod_lengths[0]))
    for leg in range(6):
        zero, quarter = ROBOT.crank_zero_directions[leg], ROBOT.crank_quarter_directions[leg]
        frame = np.eye(4)
        frame[:3] = np.column_stack([zero, quarter, np.cross(zero, quarter), ROBOT.shaft_positions[leg]])
        solver.add_branch(ROBOT.platform_joints[leg].tolist(), frame.tolist(), float(ROBOT.branches[leg]))
    return solver


def transforms(poses):
    matrices = np.tile(np.eye(4), (len(poses), 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = rotation_matrix(poses[:, :3]), poses[:, 3:]
    return matrices.tolist()


def reachable(number, seed=0):
    rng = np.random.default_rng(seed)
    poses = HOME + rng.uniform(-1.0, 1.0, (3 * number, 6)) * [0.6, 0.6, 0.9, 0.03, 0.03, 0.03]
    poses = poses[reach_margin(ROBOT, poses).min(axis=-1) > 0.0][:number]
    assert len(poses) == number
    return poses


@pytest.mark.slow
def test_inverse_kinematics_is_the_makers_on_20_000_poses():
    poses, solver = reachable(20_000), makers()
    theirs = np.array([solver.inverse_kinematics(matrix) for matrix in transforms(poses)])
    difference = theirs - inverse_kinematics(ROBOT, poses)
    assert np.abs(np.remainder(difference + np.pi, 2.0 * np.pi) - np.pi).max() < 1e-9


def test_forward_kinematics_is_the_makers_to_what_theirs_leaves():
    # Theirs takes one damped step a call, and stays where the rods' errors are below a micrometre.
    poses, solver = reachable(300, seed=1), makers()
    poses = poses[np.linalg.cond(pose_jacobian(ROBOT, poses) * [1, 1, 1, 0.04, 0.04, 0.04]) < 20.0]
    assert len(poses) > 100
    angles = inverse_kinematics(ROBOT, poses)
    near = poses + np.random.default_rng(2).uniform(-1e-3, 1e-3, poses.shape)
    ours = forward_kinematics(ROBOT, angles, near)
    np.testing.assert_allclose(ours, poses, rtol=0.0, atol=1e-10)
    assert newton(ROBOT, angles, ours, 0.0, 0)[1].max() < 1e-12
    apart = []
    for start, theta, pose in zip(transforms(near), angles, ours, strict=True):
        solver.reset_forward_kinematics(start)
        for _ in range(30):
            found = np.array(solver.forward_kinematics(theta.tolist()))
        theirs = np.concatenate([roll_pitch_yaw(found[:3, :3]), found[:3, 3]])
        (stepped,), _, _ = newton(ROBOT, theta[None], theirs[None], 0.0, 1)
        assert newton(ROBOT, theta[None], theirs[None], 0.0, 0)[1][0] < 1e-6
        # What is between us is what their rods have left, and nothing else.
        np.testing.assert_allclose(stepped, pose, rtol=0.0, atol=1e-9)
        apart.append(np.abs(theirs - pose).max())
    assert np.median(apart) < 1e-6
