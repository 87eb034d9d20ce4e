import numpy as np
import pytest

from stewart_drake.paper.trajectories import paper_trajectory, unseen_trajectories
from stewart_drake.planning.feasibility import check_reference
from stewart_drake.references import paper_reference
from stewart_drake.scenario import Scenario
from stewart_drake.training.collect import FREQUENCIES

BASE = Scenario()
UNSEEN = unseen_trajectories()


def test_there_are_at_least_ten_and_each_has_its_own_name():
    names = [t.name for t in (paper_trajectory(), *UNSEEN)]
    assert len(UNSEEN) >= 10
    assert len(set(names)) == len(names)
    assert paper_trajectory().reference == paper_reference()


@pytest.mark.parametrize("trajectory", [paper_trajectory(), *UNSEEN], ids=lambda t: t.name)
def test_each_keeps_to_every_limit_of_the_robot(trajectory):
    report = check_reference(BASE.robot, BASE.limits, trajectory.reference, trajectory.duration, BASE.gravity)
    report.raise_if_infeasible()
    assert np.isfinite([margin.margin for margin in report.smallest.values()]).all()


@pytest.mark.parametrize("trajectory", UNSEEN, ids=lambda t: t.name)
def test_the_second_half_holds_whole_swings_of_every_axis_that_moves(trajectory):
    reference = trajectory.reference
    frequency = np.array(reference.angular_frequency)[np.array(reference.amplitude) != 0.0] / (2.0 * np.pi)
    swings = 0.5 * trajectory.duration * 2.0 * frequency
    np.testing.assert_allclose(swings, np.round(swings), atol=1e-9)
    # So the mean of the squared speed over the second half is that over any later half.
    half = 0.5 * trajectory.duration
    t = np.linspace(0.0, half, 4001)[:-1]
    means = [(reference.evaluate(t + start)[1] ** 2).mean(axis=0) for start in (half, 3.0 * half)]
    np.testing.assert_allclose(*means, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("trajectory", UNSEEN, ids=lambda t: t.name)
def test_none_has_a_frequency_of_the_training_data_or_of_the_paper(trajectory):
    moved = np.array(trajectory.reference.amplitude) != 0.0
    frequency = np.array(trajectory.reference.angular_frequency)[moved] / (2.0 * np.pi)
    assert np.abs(frequency[:, None] - np.array([*FREQUENCIES, 1.0 / np.pi])).min() > 0.01


def named(name):
    (found,) = [t for t in UNSEEN if t.name == name]
    pose, rate, _ = found.reference.evaluate(np.linspace(0.0, found.duration, 8001))
    return found, pose - BASE.robot.home_pose, rate


def test_breathing_is_ten_millimetres_and_three_degrees_at_three_tenths_of_a_hertz():
    found, offset, _ = named("breathing")
    np.testing.assert_allclose(np.abs(offset).max(axis=0)[[0, 5]], [np.radians(3.0), 0.01], rtol=1e-6)
    assert found.text == "roll 3 deg at 0.3 Hz, Z 10 mm at 0.3 Hz"
    np.testing.assert_allclose(found.reference.evaluate(1.0 / 0.3)[0], found.reference.evaluate(0.0)[0], atol=1e-12)


def test_the_circle_has_one_radius_and_the_cone_one_opening():
    for name, axes, radius in (("circle", [3, 4], 0.02), ("cone", [0, 1], np.radians(10.0))):
        _, offset, _ = named(name)
        np.testing.assert_allclose(np.linalg.norm(offset[:, axes], axis=-1), radius)
        assert not offset[:, [a for a in range(6) if a not in axes]].any()


def test_the_mix_moves_all_axes_within_its_speeds_and_is_the_same_every_time():
    found, offset, rate = named("mix")
    assert (np.abs(offset).max(axis=0) > 0.0).all()
    # Amplitudes are rounded to tenths of a degree or millimetre.
    rounding = 2.0 * np.pi * 2.5 * 0.05 * np.repeat([np.pi / 180.0, 1e-3], 3)
    assert (np.abs(rate).max(axis=0) <= np.repeat([np.radians(20.0), 0.03], 3) + rounding).all()
    assert unseen_trajectories()[-1] == found
