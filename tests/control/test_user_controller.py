import numpy as np
import pytest
from strategies import ROBOT
from ticks import ticked

from stewart_drake import ConfigurationError, Scenario, Setpoint, run
from stewart_drake.base.code import ControllerError
from stewart_drake.base.errors import NotFiniteError
from stewart_drake.control.user_controller import function_part

HEAD = """
import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem


class Mine(LeafSystem):
    def __init__(self, scale=1.0):
        super().__init__()
        self.scale = scale
"""
GOOD = (
    HEAD
    + """
        self.DeclareVectorInputPort("measurement", 12)
        self.DeclareVectorInputPort("reference", 18)
        self.DeclareVectorOutputPort("torque", 6, self.calc)

    def calc(self, context, output):
        output.SetFromVector(np.full(6, 0.33 * self.scale))
"""
)


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "mine.py"
        path.write_text(text)
        return {"kind": f"{path}:Mine"}

    return write


def scenario(controller, **changes):
    data = {"duration": 0.1, "reference": {"kind": "hold"}, "controller": controller} | changes
    return Scenario.from_dict(data, trust_code=True)


def test_a_system_of_the_users_own_runs_in_the_loop(written):
    log = run(scenario({**written(GOOD), "arguments": {"scale": 0.5}}))
    assert log.status == "completed"
    np.testing.assert_allclose(log["torque"], 0.165)
    np.testing.assert_allclose(log["error"], log["pose"] - log["reference"], atol=1e-15)
    assert not log["integral"].any()
    assert "weights" not in log.signals


def test_weights_and_integral_are_connected_where_they_are_there(written):
    more = GOOD.replace(
        '        self.DeclareVectorInputPort("reference", 18)\n',
        '        self.DeclareVectorInputPort("reference", 18)\n'
        '        self.weights = self.DeclareVectorInputPort("weights", 2)\n'
        '        self.DeclareVectorOutputPort("integral", 6, lambda c, o: o.SetFromVector(np.full(6, 0.75)))\n',
    ).replace("0.33 * self.scale", "0.1 * self.weights.Eval(context)[0]")
    log = run(scenario(written(more), tuner={"kind": "fixed", "omega_q": 3.0}))
    np.testing.assert_allclose(log["torque"], 0.3)
    np.testing.assert_allclose(log["weights"], [[3.0, 1.0]] * len(log.time))
    assert (log["integral"] == 0.75).all()
    assert log["density"].shape[1] == 12


BAD = [
    ("import nothing_of_this_name\n", "ModuleNotFoundError"),
    ("class Other: pass\n", "mine.py defines"),
    ("class Mine: pass\n", "a LeafSystem of pydrake"),
    (GOOD.replace("self.scale = scale", "raise ZeroDivisionError('no')"), "ZeroDivisionError: no"),
    (GOOD.replace("scale=1.0", "needed"), "missing 1 required positional argument"),
    (GOOD.replace('"torque", 6', '"torque", 3'), "output port torque (6,)"),
]


@pytest.mark.parametrize(("text", "words"), BAD, ids=[words for _, words in BAD])
def test_one_clear_error_before_the_run(written, text, words):
    with pytest.raises(ConfigurationError) as caught:
        run(scenario(written(text)))
    assert caught.value.key == "controller.kind"
    assert words in str(caught.value)


@pytest.mark.parametrize("error", ["KeyError('x')", "SystemExit(3)"])
def test_whatever_it_raises_keeps_the_log_and_is_shown_with_its_line(written, error):
    raised = f"        if context.get_time() > 0.05:\n            raise {error}\n        output.Set"
    text = GOOD.replace("        output.Set", raised)
    log = run(scenario(written(text)))
    assert (log.status, log.reason) == ("failed", "controller_raised")
    assert len(log.time) > 40
    line = text.splitlines().index(f"            raise {error}") + 1
    first, *trace = log.message.splitlines()
    assert first.endswith(f" (mine.py, line {line}, in calc)")
    assert trace[0] == "Traceback (most recent call last):"
    assert trace[1].endswith(f'mine.py", line {line}, in calc')


POSE, RATE = ROBOT.home_pose + 0.01, np.full(6, 0.2)
SETPOINT = Setpoint(ROBOT.home_pose, np.full(6, 0.1), np.full(6, 3.0))
NOW = np.array([0.25])


def test_a_function_gets_what_it_asks_for_and_what_it_changes_is_its_own():
    def spring(measurement, setpoint, time):
        measurement.pose[:] -= setpoint.pose
        return -measurement.pose - measurement.pose_rate + setpoint.pose_rate + setpoint.pose_acceleration + time

    state = ticked(function_part(spring), POSE, RATE, SETPOINT, NOW)
    np.testing.assert_allclose(state.torque, -0.01 - 0.2 + 0.1 + 3.0 + 0.25)


@pytest.mark.parametrize(
    ("answer", "kind", "words"),
    [
        ("much", ControllerError, "'much'; expected six torques"),
        (np.zeros(5), ControllerError, r"shape \(5,\); expected six torques"),
        ([0.0, np.nan, 0.0, 0.0, 0.0, 0.0], NotFiniteError, "torque of .*lambda.* is not finite"),
    ],
    ids=str,
)
def test_what_is_no_torque_ends_the_run_with_a_line(answer, kind, words):
    with pytest.raises(kind, match=words):
        ticked(function_part(lambda *_: answer), POSE, RATE, SETPOINT, NOW)
