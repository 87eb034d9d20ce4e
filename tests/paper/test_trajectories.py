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
    # None is in the training data or the paper.
    assert np.abs(frequency[:, None] - np.array([*FREQUENCIES, 1.0 / np.pi])).min() > 0.01
    swings = 0.5 * trajectory.duration * 2.0 * frequency
    np.testing.assert_allclose(swings, np.round(swings), atol=1e-9)


def test_the_texts_say_what_moves_and_the_mix_keeps_its_speeds_every_time():
    by_name = {t.name: t for t in UNSEEN}
    pose, _, _ = by_name["breathing"].reference.evaluate(np.linspace(0.0, 10.0, 8001))
    np.testing.assert_allclose(np.ptp(pose, axis=0)[[0, 5]], [np.radians(6.0), 0.02], rtol=1e-6)
    assert by_name["breathing"].text == "roll 3 deg at 0.3 Hz, Z 10 mm at 0.3 Hz"
    for name, axes, radius in (("circle", [3, 4], 0.02), ("cone", [0, 1], np.radians(10.0))):
        offset = by_name[name].reference.evaluate(np.linspace(0.0, 8.0, 801))[0] - BASE.robot.home_pose
        np.testing.assert_allclose(np.linalg.norm(offset[:, axes], axis=-1), radius)
        assert not np.delete(offset, axes, axis=1).any()
    rate = by_name["mix"].reference.evaluate(np.linspace(0.0, 8.0, 8001))[1]
    # Amplitudes are rounded to tenths of a degree or millimetre.
    rounding = 2.0 * np.pi * 2.5 * 0.05 * np.repeat([np.pi / 180.0, 1e-3], 3)
    assert (np.abs(rate).max(axis=0) <= np.repeat([np.radians(20.0), 0.03], 3) + rounding).all()
    assert (np.abs(rate).max(axis=0) > 0.0).all()
    assert unseen_trajectories() == UNSEEN
