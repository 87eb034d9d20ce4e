"""Reachy Mini, a platform that one can buy, against its maker's own kinematics; and commands of any kind to it."""

import numpy as np
import pytest
from reachy_mini_rust_kinematics import ReachyMiniRustKinematics

from stewart_drake.control.lqi import LqiOptions, lqi_part
from stewart_drake.errors import RunFailure
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, static_torque
from stewart_drake.mechanics.kinematics import (
    forward_kinematics,
    inverse_kinematics,
    newton,
    pose_jacobian,
    reach_margin,
    roll_pitch_yaw,
    rotation_angle,
    rotation_matrix,
)
from stewart_drake.part import WELL
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.safety import HOLD, MONITORS, SafetyOptions, safety_part

ROBOT = load_robot("reachy_mini")
HOME = ROBOT.home_pose
REFUSED_AS = {
    "good": {None},
    "not_finite": {"not_finite"},
    "huge": {None, "unreachable_pose", "following_error"},
    "far": {"unreachable_pose"},
    "jump": {None, "unreachable_pose", "following_error", "crank_dead_centre", "parallel_singularity"},
}


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
def test_inverse_kinematics_is_the_makers_on_100_000_poses():
    poses, solver = reachable(100_000), makers()
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


def commands(number, seed=3):
    rng = np.random.default_rng(seed)
    poses = HOME + rng.uniform(-1.0, 1.0, (number, 6)) * [0.05, 0.05, 0.05, 0.003, 0.003, 0.003]
    kinds = rng.choice(["good", "not_finite", "huge", "far", "jump"], number, p=[0.5, 0.1, 0.1, 0.15, 0.15])
    place = rng.integers(0, 6, number)
    spoilt = kinds == "not_finite"
    poses[spoilt, place[spoilt]] = rng.choice([np.nan, np.inf, -np.inf], spoilt.sum())
    spoilt = kinds == "huge"
    poses[spoilt, place[spoilt]] = rng.choice([-1.0, 1.0], spoilt.sum()) * 10.0 ** rng.uniform(1, 300, spoilt.sum())
    spoilt = kinds == "far"
    poses[spoilt, 3:] = HOME[3:] + rng.choice([-1.0, 1.0], (spoilt.sum(), 3)) * rng.uniform(0.1, 1.0, (spoilt.sum(), 3))
    spoilt = kinds == "jump"
    poses[spoilt] = HOME + rng.uniform(-1.0, 1.0, (spoilt.sum(), 6)) * [0.6, 0.6, 0.9, 0.03, 0.03, 0.03]
    return poses, kinds


@pytest.mark.slow
def test_after_any_command_the_next_good_one_works_and_each_bad_one_is_refused_by_name():
    poses, kinds = commands(20_000)
    options = LqiOptions(
        period=0.001, model="exact", solver="split", feedforward="full", feedforward_at="reference",
        weight_length=ROBOT.characteristic_length, saturation="clamp",
    )  # fmt: skip
    weights = np.array([4e5, 30.0, 4e7, 1.0])
    # The pose that is measured here never changes, however the reference jumps.
    watch = SafetyOptions(frozen_pose=None)
    still, held = np.zeros(6), static_torque(ROBOT, HOME, STANDARD_GRAVITY)
    controller = lqi_part(options, ROBOT, STANDARD_GRAVITY, 4)
    layer = safety_part(ROBOT, watch, STANDARD_GRAVITY, options.period, held)
    measured, memory, guarded = np.concatenate([HOME, still]), controller.initial.copy(), layer.initial.copy()
    for pose, kind in zip(poses, kinds, strict=True):
        said, before = None, memory.copy()
        try:
            controller.tick(measured, np.concatenate([pose, still, still]), weights, memory)
            command, failure = memory["torque"][0], np.array(WELL)
        except RunFailure as error:
            memory = before
            said, command, failure = error.reason, held, np.array([1.0, -1.0])
        reference = np.concatenate([pose if np.isfinite(pose).all() else HOME, still, still])
        given = {"command": command, "measurement": measured, "reference": reference, "controller_health": failure}
        layer.tick(*(given[port] if port in given else layer.source(port) for port in layer.inputs), guarded)
        level, monitor, _ = guarded["safety"][0]
        said = said or (None if level == 0.0 else MONITORS[int(monitor)])
        assert np.abs(command).max() <= ROBOT.effort_limit
        assert np.abs(guarded["torque"]).max() <= ROBOT.effort_limit
        if said is None:
            # Whole turns lead to the same pose; what is so near is no bad command.
            assert np.abs(pose[3:] - HOME[3:]).max() < watch.following_error[1]
            assert rotation_angle(rotation_matrix(pose[:3])) <= watch.following_error[0]
        assert said in REFUSED_AS[kind]
        if level > HOLD:
            # A stop is for good; who starts again starts here.
            memory[:], guarded[:] = controller.initial, layer.initial
