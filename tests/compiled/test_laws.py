import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robots import offsets, robots
from strategies import vectors

from stewart_drake.control.computed_torque import ComputedTorqueOptions, computed_torque_part
from stewart_drake.control.joint_pid import PidOptions, pid_part
from stewart_drake.control.parts import ControllerSite
from stewart_drake.errors import NotFiniteError, RunFailure
from stewart_drake.mechanics.kinematics import reach_margin

LAWS = {
    "computed torque": (computed_torque_part, [ComputedTorqueOptions(saturation=kind) for kind in ("none", "clamp")]),
    "pid": (
        pid_part,
        [
            PidOptions(saturation=kind, feedforward=feedforward, ki=ki, torque_limit=limit)
            for kind, feedforward, ki, limit in (
                ("none", "gravity", 300.0, None),
                ("clamp", "none", 300.0, 0.7),
                ("back_calculation", "gravity", 300.0, 0.7),
                ("back_calculation", "gravity", 0.0, None),
            )
        ],
    ),
}
EACH = [(part, options) for part, every in LAWS.values() for options in every]


def both(part, options, robot, gravity=9.81):
    return [part(options, ControllerSite(robot, gravity, compiled=compiled)) for compiled in (False, True)]


@pytest.mark.parametrize(("part", "options"), EACH)
@settings(max_examples=30, deadline=None)
@given(robots, offsets(0.6), vectors(6, 0.5), vectors(18, 0.02), vectors(18, 0.01), st.sampled_from([0.0, 9.81]))
def test_compiled_it_says_the_same(part, options, robot, offset, rate, wanted, memory, gravity):
    pose = robot.home_pose + offset
    setpoint = np.concatenate([pose, rate, np.zeros(6)]) + wanted
    assume(min(reach_margin(robot, pose).min(), reach_margin(robot, setpoint[:6]).min()) > 0.01)
    slow, fast = both(part, options, robot, gravity)
    before = memory[: slow.initial.size]
    try:
        expected = slow.tick(np.concatenate([pose, rate]), setpoint, before)
    except RunFailure as error:
        with pytest.raises(type(error)):
            fast.tick(np.concatenate([pose, rate]), setpoint, before)
        return
    found = fast.tick(np.concatenate([pose, rate]), setpoint, before)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("part", "options"), EACH)
def test_compiled_it_refuses_the_same(part, options):
    from robots import PAPER

    fast = both(part, options, PAPER)[1]
    measured, wanted = np.zeros(12), np.zeros(18)
    measured[:6] = wanted[:6] = PAPER.home_pose
    for place in (0, 11):
        ill = measured.copy()
        ill[place] = np.nan
        with pytest.raises(NotFiniteError):
            fast.tick(ill, wanted, fast.initial)
    far = measured.copy()
    far[5] += 0.5
    with pytest.raises(RunFailure) as caught:
        fast.tick(far, wanted, fast.initial)
    assert caught.value.reason == "unreachable_pose"
