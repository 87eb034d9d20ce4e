import numpy as np
import pytest
from strategies import ROBOT

from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.motion_envelope import crank_rates, envelope_of_all, motion_envelope
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.references import paper_reference
from stewart_drake.scenario import Scenario


def log_of(pose, pose_rate, torque):
    angles = inverse_kinematics(ROBOT, pose)
    signals = {"pose": pose, "pose_rate": pose_rate, "crank_angle": angles, "torque_applied": torque}
    return SimulationLog(Scenario(), {"time": np.arange(len(pose)) * 0.01, **signals})


@pytest.fixture
def logs():
    time = np.linspace(0.0, 3.0, 200)
    pose, rate, _ = paper_reference().evaluate(time)
    torque = np.sin(np.outer(time, np.arange(1.0, 7.0)))
    return [log_of(pose[:90], rate[:90], torque[:90]), log_of(pose[90:], rate[90:], torque[90:])]


def test_crank_rates_are_the_derivative_of_the_crank_angles():
    time = np.linspace(0.0, 3.0, 40)
    pose, rate, _ = paper_reference().evaluate(time)
    step = 1e-5
    ahead, behind = (inverse_kinematics(ROBOT, paper_reference().evaluate(time + s)[0]) for s in (step, -step))
    np.testing.assert_allclose(crank_rates(ROBOT, pose, rate), (ahead - behind) / (2.0 * step), atol=1e-7)


def test_crank_rates_are_unknown_out_of_reach_which_hides_nothing_of_the_rest(logs):
    pose = logs[0]["pose"].copy()
    pose[-1, 5] += 0.5
    rates = crank_rates(ROBOT, pose, logs[0]["pose_rate"])
    assert np.isfinite(rates[:-1]).all()
    assert np.isnan(rates[-1]).all()
    envelope = motion_envelope(SimulationLog(Scenario(), dict(logs[0].signals) | {"pose": pose}))
    assert np.isfinite(envelope.crank_rate).all()
    assert envelope.pose[1, 5] == pose[-1, 5]


def test_the_envelope_holds_the_ends_of_every_signal(logs):
    log = logs[0]
    envelope = motion_envelope(log)
    rate = crank_rates(ROBOT, log["pose"], log["pose_rate"])
    power = rate * log["torque_applied"]
    for box, values in ((envelope.pose, log["pose"]), (envelope.crank_rate, rate), (envelope.power, power)):
        np.testing.assert_array_equal(box, [values.min(axis=0), values.max(axis=0)])


def test_the_envelope_of_all_is_that_of_the_runs_joined(logs):
    joined = {name: np.concatenate([log[name] for log in logs]) for name in logs[0].signals}
    whole, expected = envelope_of_all(logs), motion_envelope(SimulationLog(Scenario(), joined))
    for name in expected.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(whole, name), getattr(expected, name))
