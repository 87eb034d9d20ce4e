import numpy as np
import pytest
from hypothesis import assume, given, settings
from multibody_model import task_dynamics
from strategies import ALTERNATING, ROBOT, TANGENTIAL, UNEQUAL, vectors

from stewart_drake.mechanics.dynamics import task_bias, task_inertia
from stewart_drake.mechanics.kinematics import (
    pose_rate_to_twist,
    reach_margin,
    twist_jacobian,
    twist_to_pose_rate,
)
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions

HEAVY = ROBOT.replace(rod_mass=0.8, crank_mass=0.4, rod_inertia=(0.016, 0.016, 0.00001))
OTHER = ROBOT.replace(
    crank_length=0.12, rod_length=0.38, platform_joint_radius=0.1, shaft_half_angle=0.2, home_height=0.26, branch=1
)
THICK = ROBOT.replace(rod_inertia=(0.0016, 0.0016, 0.001))
"""Rods whose spin weighs as much as their swing, so that it cannot hide."""
SMALLEST_LOAD = 1e-6
"""[N m, N] a bias below this is rounding: at rest without gravity it is zero."""
REGION = np.array([0.5, 0.5, 0.5, 0.06, 0.06, 0.02])

_built = {}
robots = pytest.mark.parametrize(
    ("robot", "gravity"),
    [
        (ROBOT, 9.81),
        (HEAVY, 1.62),
        (OTHER, 9.81),
        (THICK, 0.0),
        (TANGENTIAL, 9.81),
        (ALTERNATING, 9.81),
        (UNEQUAL, 9.81),
    ],
)


def built(robot, gravity=9.81, **options):
    key = (robot, gravity, *sorted(options.items()))
    if key not in _built:
        _built[key] = build_plant(robot, PlantOptions(**options), gravity)
    return _built[key]


def at(stewart, state):
    """The plant's own Context at a state."""
    context = stewart.plant.CreateDefaultContext()
    stewart.plant.SetPositionsAndVelocities(context, state)
    return context


def within_reach(robot, unit):
    pose = robot.home_pose + REGION * unit
    assume(reach_margin(robot, pose).min() > 0.02)
    return pose


def agree(found, expected, smallest=0.0):
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-10 * max(smallest, np.abs(expected).max()))


def spins(stewart, pose, rate):
    """(6,) [rad/s] turning of the rods about their own axes, by Drake, in an assembled motion."""
    context = at(stewart, stewart.assemble(pose, rate))
    rods = [stewart.plant.GetBodyByName(f"rod_{leg}") for leg in range(6)]
    turning = [stewart.plant.EvalBodySpatialVelocityInWorld(context, rod).rotational() for rod in rods]
    axes = [stewart.plant.EvalBodyPoseInWorld(context, rod).rotation().matrix()[:, 2] for rod in rods]
    return np.sum(np.multiply(turning, axes), axis=-1)


@pytest.mark.slow
@robots
@settings(max_examples=25)
@given(unit=vectors(6), rate=vectors(6, 3.0))
def test_with_ball_joints_it_is_the_closed_form(robot, gravity, unit, rate):
    """Rods between two balls do not spin: the closed form's own assumption, so nothing is left to differ."""
    pose = within_reach(robot, unit)
    _, stewart = built(robot, gravity, rod_joint="ball")
    found = task_dynamics(stewart, at(stewart, stewart.assemble(pose, rate)))
    agree(found.inertia, task_inertia(robot, pose))
    agree(found.bias, task_bias(robot, pose, pose_rate_to_twist(pose, rate), gravity), SMALLEST_LOAD)
    agree(found.input_map, twist_jacobian(robot, pose).T)


@pytest.mark.slow
@robots
@settings(max_examples=25)
@given(unit=vectors(6), rate=vectors(6, 3.0))
def test_with_universal_joints_only_the_spin_of_the_rods_differs(robot, gravity, unit, rate):
    """All terms are linear in a rod's Izz, so two values of it give the terms without."""
    pose = within_reach(robot, unit)
    ix, iy, _ = robot.rod_inertia
    found = []
    for share in (0.5, 1.0):
        _, stewart = built(robot.replace(rod_inertia=(ix, iy, share * ix)), gravity)
        found.append(task_dynamics(stewart, at(stewart, stewart.assemble(pose, rate))))
    half, whole = found
    agree(2.0 * half.inertia - whole.inertia, task_inertia(robot, pose))
    bias = task_bias(robot, pose, pose_rate_to_twist(pose, rate), gravity)
    agree(2.0 * half.bias - whole.bias, bias, max(SMALLEST_LOAD, np.abs(half.bias).max()))
    agree(whole.input_map, twist_jacobian(robot, pose).T)
    spin = np.transpose([spins(stewart, pose, twist_to_pose_rate(pose, twist)) for twist in np.eye(6)])
    agree(whole.inertia - half.inertia, 0.5 * ix * spin.T @ spin)
