import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from multibody_model import task_dynamics
from strategies import ALTERNATING, ROBOT, TANGENTIAL, UNEQUAL, poses, vectors

from stewart_drake import DrakeOptions, build_plant
from stewart_drake.mechanics.dynamics import task_bias, task_inertia
from stewart_drake.mechanics.kinematics import pose_rate_to_twist, twist_jacobian

HEAVY = ROBOT.replace(rod_mass=0.8, crank_mass=0.4, rod_inertia=(0.016, 0.016, 0.00001))
THICK = ROBOT.replace(rod_inertia=(0.0016, 0.0016, 0.001))
"""Rods whose spin weighs as much as their swing, so that it cannot hide."""
SMALLEST_LOAD = 1e-6
"""[N m, N] a bias below this is rounding: at rest without gravity it is zero."""


cases = st.sampled_from(
    [(HEAVY, 1.62), (THICK, 0.0), (TANGENTIAL, 9.81), (ALTERNATING, 9.81), (UNEQUAL, 9.81)]
).flatmap(lambda case: st.tuples(*map(st.just, case), poses(0.6, case[0]), vectors(6, 3.0)))


@functools.cache
def built(robot, gravity, rod_joint):
    return build_plant(robot, DrakeOptions(rod_joint=rod_joint), gravity)[1]


def at(stewart, state):
    context = stewart.plant.CreateDefaultContext()
    stewart.plant.SetPositionsAndVelocities(context, state)
    return context


def agree(found, expected, smallest=0.0):
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10 * max(smallest, np.abs(expected).max()))


@pytest.mark.slow
@settings(max_examples=100)
@given(cases)
def test_with_ball_joints_it_is_the_closed_form(case):
    # Rods between two balls do not spin: the closed form's own assumption, so nothing is left to differ.
    robot, gravity, pose, rate = case
    stewart = built(robot, gravity, "ball")
    found = task_dynamics(stewart, at(stewart, stewart.assemble(pose, rate)))
    agree(found.inertia, task_inertia(robot, pose))
    agree(found.bias, task_bias(robot, pose, pose_rate_to_twist(pose, rate), gravity), SMALLEST_LOAD)
    agree(found.input_map, twist_jacobian(robot, pose).T)


@pytest.mark.slow
@settings(max_examples=100)
@given(cases)
def test_with_universal_joints_only_the_spin_of_the_rods_differs(case):
    # All terms are linear in a rod's Izz, so two values of it give the terms without.
    robot, gravity, pose, rate = case
    ix, iy, _ = robot.rod_inertia
    found = []
    for share in (0.5, 1.0):
        stewart = built(robot.replace(rod_inertia=(ix, iy, share * ix)), gravity, "universal")
        found.append(task_dynamics(stewart, at(stewart, stewart.assemble(pose, rate))))
    half, whole = found
    agree(2.0 * half.inertia - whole.inertia, task_inertia(robot, pose))
    bias = task_bias(robot, pose, pose_rate_to_twist(pose, rate), gravity)
    agree(2.0 * half.bias - whole.bias, bias, max(SMALLEST_LOAD, np.abs(half.bias).max()))
    agree(whole.input_map, twist_jacobian(robot, pose).T)
