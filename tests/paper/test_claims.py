"""The numbers of the paper's claims about mechanics and the state space, against oracles of their own."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from stewart_drake import RobotParameters, Scenario, leg_geometry
from stewart_drake.analysis.feasibility import NEAR, sample_poses
from stewart_drake.control.riccati import acceleration_map
from stewart_drake.mechanics.dynamics import task_inertia
from stewart_drake.mechanics.kinematics import conditioning, rod_lines, twist_jacobian
from stewart_drake.paper.force_map import light_legs, measured, predicted, relative_error, to_euler
from stewart_drake.paper.kinematics import DURATION, START, TORQUE, branch_of_6, exact_motion
from stewart_drake.paper.network import best_possible_scores
from stewart_drake.paper.nine_experiments import distinct, gains_along_reference, relative_distances
from stewart_drake.paper.reproduce import PAIRS, WIDE
from stewart_drake.paper.state_space import decay_limit, first_singularity, gain_of_ratio, slowest_decay

ROBOT = RobotParameters()
HOME = ROBOT.home_pose
AXES = np.eye(6)
AT_HOME = acceleration_map(ROBOT, HOME)
FREE = json.loads((Path(__file__).parent.parent / "data" / "reference_values.json").read_text())["free_motion"]
POSES = np.vstack([HOME, sample_poses(ROBOT, NEAR, 3, np.random.default_rng(4), 0.05)])


def near(count, region=NEAR):
    return sample_poses(ROBOT, region, count, np.random.default_rng(0))


def test_the_motion_is_the_one_that_another_program_computed():
    np.testing.assert_allclose(HOME + START, FREE["pose"], atol=1e-15)
    np.testing.assert_array_equal(TORQUE, FREE["torque"])
    assert FREE["time"] == DURATION
    pose = exact_motion(ROBOT, 9.81)
    np.testing.assert_allclose(pose[3:], FREE["position"], atol=1e-7)
    w, x, y, z = FREE["quaternion_wxyz"]
    turned = Rotation.from_quat([x, y, z, w]) * Rotation.from_euler("xyz", pose[:3]).inv()
    assert turned.magnitude() < 1e-7


@pytest.mark.parametrize(("sense", "branch"), [(1, "1"), (-1, "-1")])
def test_6_is_one_branch_or_the_other_by_the_sense_of_the_angle(sense, branch):
    shares = branch_of_6(ROBOT, near(50), sense)
    assert shares[branch] == 1.0
    assert shares["neither"] == shares["a_positive"] == 0.0
    wide = branch_of_6(ROBOT, near(300, WIDE), sense)
    assert wide["neither"] == wide["a_positive"] > 0.02


def exact(robot, poses=POSES):
    """d(twist)/dt per N m at rest by the exact rigid-body model: the oracle of this file."""
    return np.linalg.solve(task_inertia(robot, poses), np.swapaxes(twist_jacobian(robot, poses), -1, -2))


@pytest.mark.parametrize(("scale", "tolerance"), [(1.0, 2e-5), (1e-2, 1e-6)])
def test_drake_accelerates_as_the_exact_model(scale, tolerance):
    robot = light_legs(ROBOT, scale)
    assert relative_error(robot, measured(robot, POSES, 9.81), exact(robot)).max() < tolerance


def test_the_last_model_is_the_massless_limit_of_the_exact_one():
    said = predicted(ROBOT, POSES, "massless legs")
    truth = [to_euler(POSES, exact(light_legs(ROBOT, scale))) for scale in (1e-5, 1e-6)]
    errors = [relative_error(ROBOT, each, said) for each in truth]
    np.testing.assert_allclose(errors[0] / errors[1], 10.0, rtol=1e-2)
    assert errors[1].max() < 1e-5


@pytest.mark.parametrize(("axis", "sign", "kind"), [(0, 1, "parallel"), (1, -1, "parallel"), (3, 1, "serial"),
                                                    (4, -1, "serial"), (5, 1, "serial")])  # fmt: skip
def test_the_first_singular_pose_is_what_it_is_called(axis, sign, kind):
    found = first_singularity(ROBOT, sign * AXES[axis], np.pi if axis < 3 else 0.6)
    assert found.kind == kind
    legs = leg_geometry(ROBOT, found.pose(ROBOT))
    lines = np.linalg.svd(rod_lines(legs), compute_uv=False)
    if kind == "serial":
        assert np.abs(legs.transmission).min() < 1e-6
        assert lines[-1] > 0.01 * lines[0]
    else:
        assert lines[-1] < 1e-14
        assert np.abs(legs.transmission).min() > 0.1
    assert first_singularity(ROBOT, AXES[axis] * sign, 0.9 * found.distance) is None
    for back in np.linspace(0.01, 1.0, 7) * found.distance:
        before = found.pose(ROBOT, back)
        assert min(np.abs(leg_geometry(ROBOT, before).transmission).min(), conditioning(ROBOT, before)) > 1e-3


@pytest.mark.parametrize("ratio", [0.01, 1.0])
def test_the_loop_decays_as_the_slowest_of_six_channels_in_continuous_time(ratio):
    a, b = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([[0.0], [1.0], [0.0]])
    slowest = []
    for size in np.linalg.svd(AT_HOME, compute_uv=False):
        r = np.array([[1.0 / (ratio * size**2)]])
        p = scipy.linalg.solve_continuous_are(a, b, np.eye(3), r)
        slowest.append(-np.linalg.eigvals(a - b @ np.linalg.solve(r, b.T @ p)).real.max())
    decay = slowest_decay(AT_HOME, gain_of_ratio(AT_HOME, 1e-4, ratio), 1e-4)
    assert decay == pytest.approx(min(slowest), rel=1e-3)


def test_the_limit_of_equal_weights_is_half_the_root_of_three_and_weights_move_it():
    assert decay_limit() == pytest.approx(np.sqrt(3.0) / 2.0, rel=1e-14)
    for factor in (0.5, 4.0, 10.0):  # time runs faster by the factor
        assert decay_limit((1.0, factor**-2, factor**2)) == pytest.approx(factor * decay_limit())


BASE = Scenario()
ratio_of = np.array([q / r for q, r in PAIRS])


@pytest.mark.parametrize("changed", [{}, {"controller.solver": "split", "controller.force_map": "printed"}], ids=str)
def test_gains_of_one_ratio_are_equal_to_1e_10_and_of_two_ratios_are_not(changed):
    distances = relative_distances(gains_along_reference(BASE.replace(changed)))
    equal = np.isclose(ratio_of[:, None], ratio_of)
    assert distances[equal].max() < 1e-10 < 1e-2 < distances[~equal].min()
    assert distinct(distances, 1e-10) == 5


def test_over_the_nine_pairs_half_of_each_weight_s_variance_is_irreducible():
    # Labels -1, 0, 1; ratio 0 has a variance of 2/3 left in three pairs, ratios -1 and 1 of 1/4 in two, the ends none:
    # (3 * 2/3 + 4 * 1/4) / (9 * 2/3) = 1/2.
    assert best_possible_scores() == pytest.approx({"omega_Q": 0.5, "omega_R": 0.5, "ratio": 1.0}, abs=1e-12)
