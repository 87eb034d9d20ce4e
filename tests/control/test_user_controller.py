import numpy as np
import pytest
from strategies import ROBOT
from ticks import REST, ticked

from stewart_drake.control.base import Setpoint
from stewart_drake.control.lqi import LqiOptions
from stewart_drake.control.network import load_network
from stewart_drake.control.user_controller import PythonOptions, function_part, user_code
from stewart_drake.errors import ConfigurationError, NotFiniteError
from stewart_drake.files.code import ControllerError
from stewart_drake.part import guarded as bridged
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario

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


def test_weights_error_and_integral_are_connected_where_they_are_there(written):
    more = GOOD.replace(
        '        self.DeclareVectorInputPort("reference", 18)\n',
        '        self.DeclareVectorInputPort("reference", 18)\n'
        '        self.weights = self.DeclareVectorInputPort("weights", 2)\n'
        '        self.DeclareVectorOutputPort("error", 6, lambda c, o: o.SetFromVector(np.full(6, 0.25)))\n'
        '        self.DeclareVectorOutputPort("integral", 6, lambda c, o: o.SetFromVector(np.full(6, 0.75)))\n',
    ).replace("0.33 * self.scale", "0.1 * self.weights.Eval(context)[0]")
    log = run(scenario(written(more), tuner={"kind": "fixed", "omega_q": 3.0}))
    np.testing.assert_allclose(log["torque"], 0.3)
    np.testing.assert_allclose(log["weights"], [[3.0, 1.0]] * len(log.time))
    assert (log["error"] == 0.25).all()
    assert (log["integral"] == 0.75).all()
    assert log["density"].shape[1] == 12


def test_an_import_path_works_as_a_file_does_and_context_is_handed_over():
    path = "stewart_drake.systems.library:DensityFeatures"
    made = PythonOptions(kind=path, arguments={"window": 4}).construct({"period": 0.25, "robot": ROBOT})
    assert made.period == pytest.approx(0.25)


BAD = [
    ("import nothing_of_this_name\n", "ModuleNotFoundError"),
    ("class Other: pass\n", "mine.py defines"),
    ("Mine = 3\n", "a LeafSystem of pydrake, or what is called"),
    ("class Mine: pass\n", "a LeafSystem of pydrake"),
    (GOOD.replace("self.scale = scale", "raise ZeroDivisionError('no')"), "ZeroDivisionError: no"),
    (GOOD.replace("scale=1.0", "needed"), "missing a required argument|missing 1 required"),
    (GOOD.replace('"measurement", 12', '"measured", 12'), "input port measurement (12,)"),
    (GOOD.replace('"torque", 6', '"torque", 3'), "output port torque (6,)"),
    (
        GOOD.replace('DeclareVectorInputPort("reference", 18)', 'DeclareAbstractInputPort("reference", Value(""))'),
        "its own is abstract",
    ),
    (
        GOOD.replace('"reference", 18)\n', '"reference", 18)\n        self.DeclareVectorInputPort("weights", 3)\n'),
        "input port weights (2,)",
    ),
    (
        GOOD.replace("    def calc", '        self.DeclareVectorOutputPort("error", 6, self.calc)\n\n    def calc'),
        "output port integral (6,)",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), BAD, ids=[words for _, words in BAD])
def test_one_clear_error_before_the_run(written, text, words):
    with pytest.raises(ConfigurationError) as caught:
        run(scenario(written(text)))
    assert caught.value.key == "controller.kind"
    assert any(option in str(caught.value) for option in words.split("|")), str(caught.value)


SET = "        output.Set"
RAISED = [
    *("KeyError('x')", "SystemExit(3)", "StopIteration()"),
    *("type('Own', (BaseException,), {})('own')", "type('Mute', (Exception,), {'__str__': None})()"),
    "__import__('stewart_drake').ConfigurationError('key', 3, 'four')",
]


@pytest.mark.parametrize("error", RAISED)
def test_whatever_it_raises_keeps_the_log_and_is_shown_with_its_line(written, error):
    text = GOOD.replace(
        "        output.Set", f"        if context.get_time() > 0.05:\n            raise {error}\n{SET}"
    )
    log = run(scenario(written(text)))
    assert (log.status, log.reason) == ("failed", "controller_raised")
    assert len(log.time) > 40
    line = text.splitlines().index(f"            raise {error}") + 1
    first, *trace = log.message.splitlines()
    assert first.endswith(f" (mine.py, line {line}, in calc)")
    assert trace[0] == "Traceback (most recent call last):"
    assert trace[1].endswith(f'mine.py", line {line}, in calc')
    assert all(line.isprintable() for line in log.message.splitlines())


def test_mistakes_of_this_package_are_not_blamed_on_it(written):
    options = scenario(written(GOOD)).controller
    with pytest.raises(ConfigurationError), user_code(options):
        load_network("none")
    with pytest.raises(KeyError), user_code(LqiOptions()):
        raise KeyError("x")
    with pytest.raises(ControllerError), user_code(options):
        raise KeyError("code in this test stands for a user's")


@pytest.mark.parametrize("value", ["np.nan", "np.inf", "-np.inf"])
def test_a_torque_that_is_no_number_ends_the_run_without_a_safety_layer_too(written, value):
    log = run(scenario(written(GOOD.replace("0.33 * self.scale", f"{value} if context.get_time() > 0.05 else 0.33"))))
    assert (log.status, log.reason) == ("failed", "not_finite")
    assert 0.04 < log.end_time < 0.06


FILTERED = (
    GOOD.replace(
        "        self.scale = scale\n", "        self.scale = scale\n        self.DeclareContinuousState(6)\n"
    ).replace(
        "np.full(6, 0.33 * self.scale)",
        "context.get_continuous_state_vector().CopyToVector()",
    )
    + """
    def DoCalcTimeDerivatives(self, context, derivatives):
        x = context.get_continuous_state_vector().CopyToVector()
        derivatives.get_mutable_vector().SetFromVector(50.0 * (0.33 - x) {})
"""
)


@pytest.mark.parametrize(("rate", "time_step"), [(50.0, 0.001), (3000.0, 0.001), (20_000.0, 2e-5)])
def test_continuous_state_is_integrated_to_third_order_in_tenths_of_the_plants_step(written, rate, time_step):
    text = FILTERED.format(f"* {rate / 50.0}")
    log = run(scenario(written(text), duration=max(0.002, 20.0 * time_step), plant={"time_step": time_step}))
    error = np.abs(log["torque"] - 0.33 * (1.0 - np.exp(-rate * log.time))[:, None]).max()
    share = 0.1 * rate * time_step
    if share < 0.5:
        # Local error share^4 / 24 of what is left to go, over a time constant.
        assert error < 0.33 * share**3 / 24.0 + 1e-10
        assert share < 0.1 or error > 0.03 * 0.33 * share**3 / 24.0
    # Stiff ones are stable.
    assert np.abs(log["torque"]).max() < 0.4


def test_a_run_that_it_ends_before_its_time_is_not_completed(written):
    stop = "lambda c: EventStatus.ReachedTermination(self, 'enough')"
    text = GOOD.replace("import LeafSystem", "import EventStatus, LeafSystem").replace(
        "        self.scale = scale\n",
        f"        self.scale = scale\n        self.DeclarePeriodicPublishEvent(0.001, 0.05, {stop})\n",
    )
    log = run(scenario(written(text)))
    assert (log.status, log.reason) == ("failed", "controller_stopped")
    assert "enough" in log.message
    assert 0.04 < log.end_time < 0.06


# --- a plain function ------------------------------------------------------------------------------------------------

POSE, RATE = ROBOT.home_pose + 0.01, np.full(6, 0.2)
SETPOINT = Setpoint(ROBOT.home_pose, np.full(6, 0.1), np.full(6, 3.0))
NOW = np.array([0.25])


def spring(measurement, setpoint, time):
    measurement.pose[:] -= setpoint.pose
    return -measurement.pose - measurement.pose_rate + setpoint.pose_rate + setpoint.pose_acceleration + time


def test_a_function_gets_what_it_asks_for_and_what_it_changes_is_its_own():
    state = ticked(function_part(spring), POSE, RATE, SETPOINT, NOW)
    np.testing.assert_allclose(state.torque, -0.01 - 0.2 + 0.1 + 3.0 + 0.25)
    np.testing.assert_allclose(state.error, 0.01)
    np.testing.assert_array_equal(state.integral, REST)


@pytest.mark.parametrize(
    ("answer", "kind", "words"),
    [
        (None, ControllerError, "returned None"),
        ("much", ControllerError, "'much'; expected six torques"),
        (np.zeros(5), ControllerError, r"shape \(5,\); expected six torques"),
        (np.zeros((6, 1)), ControllerError, r"shape \(6, 1\)"),
        ([0.0, np.nan, 0.0, 0.0, 0.0, 0.0], NotFiniteError, "torque of .*lambda.* is not finite"),
    ],
    ids=str,
)
def test_what_is_no_torque_ends_the_run_with_a_line(answer, kind, words):
    with pytest.raises(kind, match=words):
        ticked(function_part(lambda *_: answer), POSE, RATE, SETPOINT, NOW)


def test_what_it_raises_is_shown_with_its_line_and_can_be_bridged():
    part = function_part(lambda measurement, *_: measurement.nothing)
    with pytest.raises(
        ControllerError, match=r"user's code raised AttributeError.*test_user_controller.py, line"
    ) as caught:
        ticked(part, POSE, RATE, SETPOINT, NOW)
    assert caught.value.reason == "controller_raised"
    state = ticked(bridged(part), POSE, RATE, SETPOINT, NOW, torque=np.ones(6))
    np.testing.assert_array_equal(state.torque, np.ones(6))
    assert state.health[0] > 0.0
