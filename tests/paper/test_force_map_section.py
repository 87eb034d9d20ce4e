import numpy as np
import pytest

from stewart_drake.control.state_space import mass_diagonal
from stewart_drake.mechanics.dynamics import inverse_dynamics, static_torque
from stewart_drake.mechanics.force_map import force_map
from stewart_drake.mechanics.kinematics import euler_rate_matrix, leg_geometry
from stewart_drake.paper.accelerations import (
    MODELS,
    Accelerations,
    exact,
    inertia_in_base,
    light_legs,
    measured,
    predicted,
    relative_error,
    rod_force_per_torque,
    torque_parts,
)
from stewart_drake.planning.pose_box import NEAR, sample_poses
from stewart_drake.references import paper_reference
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
POSES = np.vstack([ROBOT.home_pose, sample_poses(ROBOT, NEAR, 3, np.random.default_rng(4), 0.05).poses])


# --- what the plant does ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scale", "tolerance"), [(1.0, 2e-5), (1e-2, 1e-6)])
def test_drake_accelerates_as_the_exact_model_says(scale, tolerance):
    robot = light_legs(ROBOT, scale)
    drake, model = measured(robot, POSES, 9.81), exact(robot, POSES, 9.81)
    assert relative_error(robot, drake.map, model.map).max() < tolerance
    np.testing.assert_allclose(drake.rest, model.rest, atol=2e-3)


def test_the_first_steps_are_not_to_be_trusted():
    early = measured(ROBOT, POSES[:1], 9.81, steps=1)
    truth = exact(ROBOT, POSES[:1], 9.81)
    assert relative_error(ROBOT, early.map, truth.map)[0] > 1e-4


def test_at_the_static_torque_nothing_moves():
    truth = exact(ROBOT, POSES, 9.81)
    held = (truth.map @ static_torque(ROBOT, POSES, 9.81)[..., None])[..., 0]
    np.testing.assert_allclose(held, -truth.rest, atol=1e-11)


def test_euler_map_gives_second_derivatives_of_the_pose():
    rate = np.random.default_rng(0).normal(size=(4, 6, 6))
    euler = Accelerations(POSES, rate, np.zeros((4, 6))).euler_map
    back = euler_rate_matrix(POSES[:, :3]) @ euler[:, :3]
    np.testing.assert_allclose(back, rate[:, :3], atol=1e-12)
    np.testing.assert_array_equal(euler[:, 3:], rate[:, 3:])


# --- what the models say ---------------------------------------------------------------------------------------------


def test_the_last_model_is_the_massless_limit_of_the_exact_one():
    said = predicted(ROBOT, POSES, "massless legs")
    errors = [relative_error(ROBOT, exact(light_legs(ROBOT, s), POSES, 0.0).euler_map, said) for s in (1e-5, 1e-6)]
    np.testing.assert_allclose(errors[0] / errors[1], 10.0, rtol=1e-2)
    assert errors[1].max() < 1e-5


def test_the_other_models_mend_one_thing_each():
    mass = mass_diagonal(ROBOT)[:, None]
    np.testing.assert_allclose(predicted(ROBOT, POSES, "printed"), force_map(ROBOT, POSES, "printed") / mass)
    statics = predicted(ROBOT, POSES, "statics")
    np.testing.assert_allclose(statics, force_map(ROBOT, POSES, "statics") / mass)
    turned = predicted(ROBOT, POSES, "statics, I in B")
    moment = inertia_in_base(ROBOT, POSES[:, :3]) @ turned[:, :3]
    np.testing.assert_allclose(moment, force_map(ROBOT, POSES, "statics")[:, :3], atol=1e-12)
    np.testing.assert_allclose(turned[:, 3:], statics[:, 3:])


def test_all_models_without_leg_mass_agree_at_home_but_for_15():
    home = POSES[:1]
    truth = exact(light_legs(ROBOT, 1e-9), home, 0.0).euler_map
    for model in MODELS:
        error = relative_error(ROBOT, predicted(ROBOT, home, model), truth)[0]
        assert (error > 0.01) if model.startswith("printed") else (error < 1e-7)


def test_the_rods_force_is_read_off_the_acceleration():
    light = light_legs(ROBOT, 1e-7)
    transmission = leg_geometry(ROBOT, POSES).transmission
    force = rod_force_per_torque(light, exact(light, POSES, 9.81))
    np.testing.assert_allclose(force * transmission, 1.0, rtol=1e-5)


def test_the_parts_of_a_motions_torque_add_up():
    motion = paper_reference().evaluate(np.linspace(0.1, 3.0, 7))
    parts = torque_parts(ROBOT, *motion, 9.81)
    np.testing.assert_allclose(sum(parts.values()), inverse_dynamics(ROBOT, *motion, 9.81), atol=1e-12)
    at_rest = torque_parts(ROBOT, motion[0], np.zeros((7, 6)), np.zeros((7, 6)), 9.81)
    np.testing.assert_allclose(at_rest.pop("gravity on all bodies"), static_torque(ROBOT, motion[0], 9.81))
    assert all(np.abs(torque).max() < 1e-12 for torque in at_rest.values())


def test_relative_error_weighs_angles_by_the_characteristic_length():
    truth = np.eye(6)[None]
    assert relative_error(ROBOT, truth, truth)[0] == 0.0
    assert relative_error(ROBOT, 0.0 * truth, truth)[0] == pytest.approx(1.0)
    off = truth.copy()
    off[0, 0, 0] += 1.0
    assert relative_error(ROBOT, off, truth)[0] == pytest.approx(0.11 / np.sqrt(3.0 * 0.11**2 + 3.0))
