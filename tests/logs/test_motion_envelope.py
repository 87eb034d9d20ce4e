import numpy as np
from strategies import ROBOT

from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.motion_envelope import crank_rates, envelope_of_all, motion_envelope
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.references import paper_reference
from stewart_drake.scenario import Scenario

TIME = np.linspace(0.0, 3.0, 200)
POSE, RATE, _ = paper_reference().evaluate(TIME)


def log_of(rows, pose=POSE):
    torque = np.sin(np.outer(TIME, np.arange(1.0, 7.0)))
    signals = {
        "pose": pose,
        "pose_rate": RATE,
        "crank_angle": inverse_kinematics(ROBOT, POSE),
        "torque_applied": torque,
    }
    return SimulationLog(Scenario(), {name: values[rows] for name, values in {"time": TIME, **signals}.items()})


def test_crank_rates_are_the_derivative_of_the_crank_angles():
    step = 1e-5
    ahead, behind = (inverse_kinematics(ROBOT, paper_reference().evaluate(TIME + s)[0]) for s in (step, -step))
    np.testing.assert_allclose(crank_rates(ROBOT, POSE, RATE), (ahead - behind) / (2.0 * step), atol=1e-7)


def test_the_envelope_of_all_holds_the_ends_of_every_signal_of_each():
    parts, whole = [log_of(slice(0, 90)), log_of(slice(90, None))], log_of(slice(None))
    rate = crank_rates(ROBOT, POSE, RATE)
    envelope = envelope_of_all(parts)
    for box, values in (
        (envelope.pose, POSE), (envelope.crank_rate, rate), (envelope.power, rate * whole["torque_applied"])
    ):  # fmt: skip
        np.testing.assert_array_equal(box, [values.min(axis=0), values.max(axis=0)])


def test_a_pose_out_of_reach_hides_nothing_of_the_rest():
    pose = POSE.copy()
    pose[-1, 5] += 0.5
    envelope = motion_envelope(log_of(slice(None), pose))
    assert np.isfinite(envelope.crank_rate).all()
    assert envelope.pose[1, 5] == pose[-1, 5]
