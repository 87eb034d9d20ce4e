import numpy as np
import pytest
from hypothesis import given, settings
from strategies import ROBOT, poses, vectors

from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.scenario import Scenario
from stewart_drake.systems.diagram import ClosedLoop


def make(**sensors):
    loop = ClosedLoop(Scenario.from_dict({"sensors": {"kind": "encoders", **sensors}, "tuner": {"kind": "fixed"}}))
    return loop, loop.GetSubsystemByName("encoders")


LOOP, FINE = make(resolution_bits=0)


def read(pose, rate, loop=LOOP, system=FINE):
    context = loop.CreateDefaultContext()
    loop.plant.set_state(context, pose, rate)
    return system.angles.Eval(system.GetMyContextFromRoot(context))


@settings(max_examples=30)
@given(poses(0.8), vectors(6, 1.0))
def test_they_read_the_crank_angles_of_the_plant(pose, rate):
    np.testing.assert_allclose(read(pose, rate), inverse_kinematics(ROBOT, pose), atol=1e-12)


@pytest.mark.parametrize("bits", [8, 17])
def test_with_offset_and_in_counts(bits):
    offset = (0.01, -0.02, 0.03, 0.0, 0.05, -0.01)
    loop, encoders = make(resolution_bits=bits, offset=offset)
    pose, count = ROBOT.home_pose + [0.1, -0.05, 0.08, 0.01, 0.02, -0.005], 2.0 * np.pi / 2**bits
    angles = read(pose, np.zeros(6), loop, encoders)
    true = inverse_kinematics(ROBOT, pose) + offset
    np.testing.assert_array_equal(angles, np.round(true / count) * count)
    assert np.abs(angles - true).max() > 0.01 * count
