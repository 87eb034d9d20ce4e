import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ROBOT, UNEQUAL, poses, robots_and_poses, vectors

from stewart_drake.errors import ConfigurationError, UnreachablePoseError
from stewart_drake.mechanics.dynamics import (
    STANDARD_GRAVITY,
    forward_dynamics,
    inverse_dynamics,
    static_torque,
    task_bias,
    task_inertia,
)
from stewart_drake.mechanics.kinematics import (
    inverse_kinematics,
    pose_jacobian,
    pose_rate_to_twist,
    rotation_matrix,
)

DATA = json.loads((Path(__file__).parents[1] / "data" / "reference_values.json").read_text())
HEAVY = ROBOT.replace(rod_mass=0.8, crank_mass=0.4, rod_inertia=(0.016, 0.016, 0.00001))
"""Legs that outweigh the platform, so that an error in them cannot hide."""
STEP = 1e-4


def differentiate(function, at, step=STEP):
    """Derivative at `at` of a function of one variable, fourth order."""
    samples = [function(at + k * step) for k in (-2, -1, 1, 2)]
    return (samples[0] - 8.0 * samples[1] + 8.0 * samples[2] - samples[3]) / (12.0 * step)


def points(robot, pose):
    """Crank tips and platform joints in B."""
    theta = inverse_kinematics(robot, pose)
    tips = robot.shaft_positions + robot.crank_lengths[:, None] * (
        np.cos(theta)[:, None] * robot.crank_zero_directions + np.sin(theta)[:, None] * robot.crank_quarter_directions
    )
    return tips, robot.platform_joints @ rotation_matrix(pose[:3]).T + pose[3:]


def potential_energy(robot, pose, gravity=STANDARD_GRAVITY):
    """From the heights of the centres of mass alone."""
    tips, joints = points(robot, pose)
    heights = 0.5 * robot.rod_mass * (tips + joints)[:, 2].sum()
    heights += 0.5 * robot.crank_mass * (tips + robot.shaft_positions)[:, 2].sum()
    return gravity * (heights + robot.platform_mass * platform_center(robot, pose)[2])


def platform_center(robot, pose):
    """Centre of mass of the platform in B."""
    return pose[3:] + rotation_matrix(pose[:3]) @ robot.platform_center_of_mass


def kinetic_energy(robot, pose, rate):
    """From velocities of the bodies' points by finite differences: no Jacobian, no leg vector of the package."""
    velocities = differentiate(lambda t: np.array(points(robot, pose + t * rate)), 0.0)
    (tips, joints), (tip_velocities, joint_velocities) = points(robot, pose), velocities
    centre = 0.5 * (tip_velocities + joint_velocities)
    # A rod without spin: its angular speed is the relative speed of its ends over its length.
    spin = np.linalg.norm(joint_velocities - tip_velocities, axis=-1) / np.linalg.norm(joints - tips, axis=-1)
    crank_speed = np.linalg.norm(tip_velocities, axis=-1) / robot.crank_lengths
    rotation_rate = differentiate(lambda t: rotation_matrix(pose[:3] + t * rate[:3]), 0.0)
    skew = rotation_matrix(pose[:3]).T @ rotation_rate
    omega = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    twice = robot.rod_mass * np.sum(centre**2) + robot.rod_inertia[0] * np.sum(spin**2)
    about_axis = robot.crank_inertia[1] + robot.crank_mass * (0.5 * robot.crank_lengths) ** 2 + robot.rotor_inertia
    twice += np.sum(about_axis * crank_speed**2)
    (xx, yy, zz), (xy, xz, yz) = robot.platform_inertia, robot.platform_products
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    speed = differentiate(lambda t: platform_center(robot, pose + t * rate), 0.0)
    twice += robot.platform_mass * np.sum(speed**2) + omega @ inertia @ omega
    return 0.5 * twice


@pytest.mark.parametrize("case", DATA["cases"])
def test_inertia_and_bias_of_an_independent_implementation(case):
    twist = np.concatenate([case["angular_velocity_W"], case["linear_velocity_W"]])
    np.testing.assert_allclose(task_inertia(ROBOT, case["pose"]), case["task_inertia"], rtol=1e-9, atol=1e-12)
    bias = task_bias(ROBOT, case["pose"], twist)
    np.testing.assert_allclose(bias, case["task_bias_with_gravity"], rtol=1e-9, atol=1e-11)


@given(at=robots_and_poses(), rate=vectors(6, 2.0))
def test_inertia_gives_the_kinetic_energy_of_all_bodies(at, rate):
    robot, pose = at
    twist = pose_rate_to_twist(pose, rate)
    energy = 0.5 * twist @ task_inertia(robot, pose) @ twist
    assert energy == pytest.approx(kinetic_energy(robot, pose, rate), rel=1e-7, abs=1e-10)


@pytest.mark.slow
@settings(max_examples=25)
# Nearer to a dead centre finite differences of energies lose too many digits.
@given(
    at=st.sampled_from([HEAVY, UNEQUAL]).flatmap(lambda robot: st.tuples(st.just(robot), poses(0.35, robot))),
    rate=vectors(6),
    acceleration=vectors(6, 5.0),
)
def test_torques_satisfy_lagranges_equations_of_the_energies(at, rate, acceleration):
    # d/dt(dL/dq') - dL/dq = J' T in Euler angles, with energies that share no code with the model.
    robot, pose = at

    def momentum(t, e):
        # Exact, because the kinetic energy is quadratic in the rates.
        there, rate_there = pose + t * rate + 0.5 * t * t * acceleration, rate + t * acceleration
        return 0.5 * (kinetic_energy(robot, there, rate_there + e) - kinetic_energy(robot, there, rate_there - e))

    generalised = [
        differentiate(lambda t, e=e: momentum(t, e), 0.0, 1e-3)
        - differentiate(lambda s, e=e: kinetic_energy(robot, pose + s * e, rate), 0.0, 1e-3)
        + differentiate(lambda s, e=e: potential_energy(robot, pose + s * e), 0.0)
        for e in np.eye(6)
    ]
    torque = inverse_dynamics(robot, pose, rate, acceleration)
    np.testing.assert_allclose(pose_jacobian(robot, pose).T @ torque, generalised, rtol=1e-5, atol=1e-5)


@given(at=robots_and_poses(), rate=vectors(6, 2.0), acceleration=vectors(6, 10.0))
def test_forward_dynamics_undoes_inverse_dynamics(at, rate, acceleration):
    robot, pose = at
    torque = inverse_dynamics(robot, pose, rate, acceleration, 5.0)
    found = forward_dynamics(robot, pose, rate, torque, 5.0)
    np.testing.assert_allclose(found, acceleration, rtol=1e-8, atol=1e-8)


def test_a_pose_out_of_reach_raises_and_a_torque_of_another_size_is_refused():
    zero = np.zeros(6)
    for function, more in {static_torque: (), inverse_dynamics: (zero, zero), task_bias: (zero,)}.items():
        with pytest.raises(UnreachablePoseError):
            function(ROBOT, np.array([0, 0, 0, 0, 0, 0.6]), *more)
    with pytest.raises(ConfigurationError, match="torque"):
        forward_dynamics(ROBOT, ROBOT.home_pose, zero, np.zeros(5))
