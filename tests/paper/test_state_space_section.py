import numpy as np
import pytest
import scipy.linalg

from stewart_drake.control.state_space import acceleration_map
from stewart_drake.mechanics.kinematics import leg_geometry, rod_lines
from stewart_drake.paper.as_printed import matrices_21_22_24
from stewart_drake.paper.lqi_poles import (
    channel_decay,
    closed_loop,
    decay_limit,
    faster_weights,
    gain_of_ratio,
    gain_without_discretisation,
    product_shape,
    riccati_residual,
    slowest_decay,
)
from stewart_drake.paper.singularities import (
    first_singularity,
    measures,
    nonzero_columns,
    stabilisability_rank,
)
from stewart_drake.paper.state_space_lqi import compare_discretisations
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
AXES = np.eye(6)
AT_HOME = acceleration_map(ROBOT, ROBOT.home_pose)


# --- matrices --------------------------------------------------------------------------------------------------------


def test_index_rules_of_21_22_24_by_hand():
    a, b, c = matrices_21_22_24(AT_HOME)
    assert np.argwhere(a).tolist() == [[0, 1], [2, 3], [4, 5], [6, 7], [8, 9], [10, 11]]
    np.testing.assert_array_equal(b[1::2], AT_HOME)
    np.testing.assert_array_equal(b[::2], 0.0)
    assert np.argwhere(c).tolist() == [[0, 0], [1, 2], [2, 4], [3, 6], [4, 8], [5, 10]]


# --- singular poses --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("axis", "sign", "kind"), [(0, 1, "parallel"), (1, -1, "parallel"), (3, 1, "serial"),
                                                    (4, -1, "serial"), (5, 1, "serial")])  # fmt: skip
def test_the_first_singular_pose_is_what_it_is_called(axis, sign, kind):
    found = first_singularity(ROBOT, sign * AXES[axis], np.pi if axis < 3 else 0.6)
    assert found.kind == kind
    legs = leg_geometry(ROBOT, found.pose(ROBOT))
    lines = np.linalg.svd(rod_lines(legs), compute_uv=False)
    if kind == "serial":
        assert abs(legs.transmission[found.leg]) < 1e-6
        assert lines[-1] > 0.01 * lines[0]
    else:
        assert found.leg is None
        assert lines[-1] < 1e-14
        assert np.abs(legs.transmission).min() > 0.1
    for back in np.linspace(0.01, 1.0, 7) * found.distance:
        told = measures(ROBOT, found.pose(ROBOT, back))
        assert min(told["transmission"], told["conditioning"]) > 1e-3


def test_no_singularity_within_a_short_walk():
    assert first_singularity(ROBOT, AXES[0], 0.5) is None


def test_ranks_tell_serial_from_parallel():
    parallel = first_singularity(ROBOT, AXES[0], np.pi).pose(ROBOT)
    assert stabilisability_rank(ROBOT, parallel, "printed") == stabilisability_rank(ROBOT, parallel, "statics") == 17
    assert nonzero_columns(ROBOT, parallel, "printed") == 6
    serial = first_singularity(ROBOT, AXES[4], 0.6)
    assert stabilisability_rank(ROBOT, serial.pose(ROBOT), "printed") == 17
    assert stabilisability_rank(ROBOT, serial.pose(ROBOT), "statics") is None
    assert nonzero_columns(ROBOT, serial.pose(ROBOT), "printed") == 5
    for kind in ("printed", "statics"):
        assert stabilisability_rank(ROBOT, serial.pose(ROBOT, 1e-3), kind) == 18
        assert stabilisability_rank(ROBOT, ROBOT.home_pose, kind) == 18


# --- gains and poles -------------------------------------------------------------------------------------------------


def test_decay_is_read_off_the_slowest_eigenvalue():
    assert slowest_decay(np.exp([-3.0 * 0.1, -(2.0 + 5.0j) * 0.1]), 0.1) == pytest.approx(2.0)
    assert slowest_decay(np.array([1.1]), 0.1) < 0.0


@pytest.mark.parametrize("weights", [(1.0, 1.0, 1.0), (1.0, 0.01, 100.0), (2.0, 0.3, 5.0)])
def test_a_channels_decay_is_that_of_its_riccati_equation(weights):
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for g in (0.01, 1.0, 30.0, 1e4):
        b, r = np.array([[0.0], [1.0], [0.0]]), np.array([[1.0 / g]])
        p = scipy.linalg.solve_continuous_are(a, b, np.diag(weights), r)
        poles = np.linalg.eigvals(a - b @ np.linalg.solve(r, b.T @ p))
        assert channel_decay(np.array([g]), weights)[0] == pytest.approx(-poles.real.max(), rel=1e-6)


def test_the_limit_of_equal_weights_is_half_the_root_of_three():
    assert decay_limit() == pytest.approx(np.sqrt(3.0) / 2.0, rel=1e-14)
    assert channel_decay(np.array([1e10]))[0] == pytest.approx(decay_limit(), rel=1e-6)


@pytest.mark.parametrize("factor", [0.5, 4.0, 10.0])
def test_other_weights_run_the_same_loop_at_another_speed(factor):
    weights = faster_weights(factor)
    assert decay_limit(weights) == pytest.approx(factor * decay_limit())
    g = np.array([0.3, 7.0, 1e3])
    # In time running faster by `factor`, torque weighs as factor^4 times more.
    np.testing.assert_allclose(channel_decay(factor**4 * g, weights), factor * channel_decay(g), rtol=1e-9)


def test_the_loop_of_the_robot_decays_as_its_slowest_channel():
    for ratio in (0.01, 1.0):
        gain = gain_of_ratio(AT_HOME, 1e-4, ratio)
        channels = channel_decay(ratio * np.linalg.svd(AT_HOME, compute_uv=False) ** 2)
        assert slowest_decay(closed_loop(AT_HOME, gain, 1e-4), 1e-4) == pytest.approx(channels.min(), rel=1e-3)


def test_drakes_gain_solves_the_standard_equation():
    assert riccati_residual(AT_HOME, 0.005, 0.1, 10.0) < 1e-11


def test_undiscretised_matrices_give_no_gain_at_all():
    assert np.abs(gain_without_discretisation(AT_HOME, 1.0)).max() < 1e-14


def test_euler_differs_in_first_order_of_the_period():
    far, near = (compare_discretisations(AT_HOME, period, 1.0) for period in (1e-2, 1e-3))
    assert far["gain"] / near["gain"] == pytest.approx(10.0, rel=0.05)
    assert far["radius"] < 1.0
    assert near["exact"] == pytest.approx(np.sqrt(0.75), rel=1e-4)


def test_product_shape_knows_what_multiplies():
    assert product_shape((6, 18), (18, 18), (18, 6)) == (6, 6)
    assert product_shape((18, 6), (18, 18), (6, 18)) is None
