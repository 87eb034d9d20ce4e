import numpy as np
import pytest
import scipy.linalg

from stewart_drake.control.riccati import acceleration_map
from stewart_drake.mechanics.kinematics import conditioning, leg_geometry, rod_lines
from stewart_drake.paper.state_space import (
    decay_limit,
    first_singularity,
    gain_of_ratio,
    nonzero_columns,
    slowest_decay,
    stabilisability_rank,
)
from stewart_drake.robot import RobotParameters

ROBOT = RobotParameters()
AXES = np.eye(6)
AT_HOME = acceleration_map(ROBOT, ROBOT.home_pose)


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


def test_ranks_tell_serial_from_parallel():
    parallel = first_singularity(ROBOT, AXES[0], np.pi).pose(ROBOT)
    assert stabilisability_rank(ROBOT, parallel, "printed") == stabilisability_rank(ROBOT, parallel, "statics") == 17
    assert nonzero_columns(ROBOT, parallel) == 6
    serial = first_singularity(ROBOT, AXES[4], 0.6).pose(ROBOT)
    assert stabilisability_rank(ROBOT, serial, "printed") == 17
    assert stabilisability_rank(ROBOT, serial, "statics") is None
    assert nonzero_columns(ROBOT, serial) == 5
    assert stabilisability_rank(ROBOT, ROBOT.home_pose, "printed") == 18


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
