import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import PAPER, offsets, robots
from strategies import vectors

from stewart_drake.control.computed_torque import ComputedTorqueOptions, computed_torque_part
from stewart_drake.control.joint_pid import PidOptions, pid_part
from stewart_drake.control.parts import ControllerSite
from stewart_drake.errors import RunFailure

COMPUTED = [ComputedTorqueOptions(saturation=kind) for kind in ("none", "clamp")]
PIDS = [PidOptions(saturation=kind) for kind in ("none", "clamp", "back_calculation")] + [
    PidOptions(feedforward="none", torque_limit=0.2),
    PidOptions(ki=0.0, saturation="back_calculation"),
]
CASES = [(computed_torque_part, each) for each in COMPUTED] + [(pid_part, each) for each in PIDS]


@pytest.mark.parametrize(("part", "options"), CASES, ids=lambda case: getattr(case, "__name__", repr(case))[:50])
@settings(max_examples=25)
@given(
    robots,
    offsets(0.5),
    offsets(0.05),
    vectors(6),
    vectors(6),
    st.sampled_from([0.0, 9.81]),
    st.sampled_from([0.1, 4.0]),
)
def test_compiled_ticks_are_those_of_the_law(part, options, robot, offset, error, rate, acceleration, gravity, size):
    """Three ticks one after the other, some at the motors' limits; what the law refuses both refuse alike."""
    pose = robot.home_pose + offset
    measured = np.concatenate([pose + size * error, size * rate])
    wanted = np.concatenate([pose, 0.3 * rate, 5.0 * acceleration])
    plain, fast = (part(options, ControllerSite(robot, gravity, compiled=compiled)) for compiled in (False, True))
    one, other = plain.initial, fast.initial
    for _ in range(3):
        try:
            one = plain.tick(measured, wanted, one)
        except RunFailure as refused:
            with pytest.raises(type(refused), match=refused.reason if not str(refused) else ".*"):
                fast.tick(measured, wanted, other)
            return
        other = fast.tick(measured, wanted, other)
        np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-9)
        measured = measured + 0.01 * np.concatenate([error, rate])


@pytest.mark.parametrize(("part", "options"), [(computed_torque_part, COMPUTED[1]), (pid_part, PIDS[1])])
@pytest.mark.parametrize("place", [0, 7, 20])
def test_what_is_not_finite_is_refused_by_the_law(part, options, place):
    seen = np.concatenate([PAPER.home_pose, np.zeros(6), PAPER.home_pose, np.zeros(12)])
    seen[place] = np.nan
    fast = part(options, ControllerSite(PAPER, 9.81, compiled=True))
    with pytest.raises(RunFailure):
        fast.tick(seen[:12], seen[12:], fast.initial)
