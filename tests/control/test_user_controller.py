import pickle
import sys
from functools import partial

import numpy as np
import pytest
from pydrake.systems.framework import PortDataType
from strategies import ROBOT

from stewart_drake.control.lqi_options import LqiOptions
from stewart_drake.control.network import load_network
from stewart_drake.control.user_controller import PythonOptions, user_code
from stewart_drake.errors import ConfigurationError, RunFailure
from stewart_drake.files.code_trust import trusting_code
from stewart_drake.files.user_errors import ControllerError
from stewart_drake.files.yaml_files import shipped_folder
from stewart_drake.mechanics.kinematics import twist_jacobian
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.systems.diagram import ClosedLoop

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
        return {"kind": "python", "system": f"{path}:Mine"}

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
    controller = {"kind": "python", "system": "stewart_drake.systems.library:JointPid"}
    with pytest.raises(ConfigurationError, match="options"):
        ClosedLoop(scenario(controller))
    path = "stewart_drake.systems.density_features:DensityFeatures"
    made = PythonOptions(system=path, arguments={"window": 4}).construct({"period": 0.25, "robot": ROBOT})
    assert made.period == pytest.approx(0.25)
    made = PythonOptions(system=path, arguments={"window": 4, "period": 0.5}).construct({"period": 0.25})
    assert made.period == pytest.approx(0.5)
    assert PythonOptions(system="stewart_drake.systems.library:JointPid").load().__name__ == "JointPid"


def test_a_file_is_found_beside_the_scenario_and_what_was_read_is_what_runs(tmp_path):
    (tmp_path / "mine.py").write_text(GOOD)
    text = "duration: 0.05\nreference: {kind: hold}\ncontroller: {kind: python, system: 'mine.py:Mine'}\n"
    (tmp_path / "scenario.yaml").write_text(text)
    loaded = load_scenario(tmp_path / "scenario.yaml", trust_code=True)
    assert loaded.controller.code.files[-1] == tmp_path / "mine.py"
    assert run(loaded).status == "completed"
    (tmp_path / "mine.py").write_text(GOOD.replace("0.33", "0.11"))
    with pytest.raises(ConfigurationError, match=r"^controller\.system: .*it has changed since"):
        run(loaded)
    again = load_scenario(tmp_path / "scenario.yaml", trust_code=True)
    np.testing.assert_allclose(run(again)["torque"], 0.11)


BAD = [
    ("import nothing_of_this_name\n", "ModuleNotFoundError"),
    ("class Other: pass\n", "has no attribute 'Mine'"),
    ("def broken(:\n", "SyntaxError"),
    ("import sys\nsys.exit(3)\n", "SystemExit"),
    ("Mine = 3\n", "a LeafSystem of pydrake, or what is called"),
    ("class Mine: pass\n", "a LeafSystem of pydrake"),
    (GOOD.replace("self.scale = scale", "raise ZeroDivisionError('no')"), "ZeroDivisionError: no"),
    (GOOD.replace("scale=1.0", "needed"), "missing a required argument|missing 1 required"),
    (GOOD.replace('"measurement", 12', '"measured", 12'), "input port measurement (12,); it has no such port"),
    (GOOD.replace('"reference", 18', '"reference", 6'), "input port reference (18,); its own is (6,)"),
    (GOOD.replace('"torque", 6', '"torque", 3'), "output port torque (6,); its own is (3,)"),
    (GOOD.replace('"torque", 6', '"force", 6'), "output port torque (6,); it has no such port"),
    (
        GOOD.replace('DeclareVectorInputPort("reference", 18)', 'DeclareAbstractInputPort("reference", Value(""))'),
        "its own is abstract",
    ),
    (
        GOOD.replace('"reference", 18)\n', '"reference", 18)\n        self.DeclareVectorInputPort("weights", 3)\n'),
        "input port weights (2,); its own is (3,)",
    ),
    (
        GOOD.replace("    def calc", '        self.DeclareVectorOutputPort("error", 6, self.calc)\n\n    def calc'),
        "output port integral (6,); it has no such port",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("text", "words"), BAD, ids=[words for _, words in BAD])
def test_one_clear_error_before_the_run(written, text, words):
    with pytest.raises(ConfigurationError) as caught:
        run(scenario(written(text)))
    assert caught.value.key == "controller.system"
    assert any(option in str(caught.value) for option in words.split("|")), str(caught.value)


@pytest.mark.parametrize("changes", [{"system": "no_colon"}, {"system": "a b:C"}, {"arguments": {"a": float("nan")}}])
def test_bad_options_name_the_key(changes):
    (key,) = changes
    with pytest.raises(ConfigurationError) as caught:
        PythonOptions(**{"system": "stewart_drake.systems.library:JointPid"} | changes)
    assert caught.value.key == f"controller.{key}"


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"^controller\.system: .*a file that can be read"), trusting_code():
        PythonOptions(system=f"{tmp_path / 'none.py'}:Mine")


SET = "        output.Set"
RAISED = [
    *("KeyError('x')", "SystemExit(3)", "StopIteration()", "GeneratorExit()", "UnicodeError(b'\\xff')"),
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


def guarded(options, function):
    with pytest.raises(BaseException) as caught, user_code(options):
        function()
    return caught.value


def test_its_traceback_begins_with_its_own_first_frame_and_is_no_longer_than_a_page(written):
    options = scenario(
        written(GOOD + "\ndef ping(n):\n    pong(n)\n\ndef pong(n):\n    n[0]\n    ping(n)\n")
    ).controller
    functions = vars(sys.modules[options.load().__module__])
    lines = guarded(options, lambda: functions["ping"]({})).traceback.splitlines()
    error = guarded(options, lambda: functions["ping"]({}))
    assert pickle.loads(pickle.dumps(error)).traceback == error.traceback
    assert lines[0] == "Traceback (most recent call last):"
    assert lines[1].endswith(", in ping")
    assert lines[2].strip() == "pong(n)"
    assert lines[-1] == "KeyError: 0"
    assert 20 < guarded(options, lambda: functions["ping"]([0])).traceback.count("\n") < 50


def test_drakes_verdicts_and_mistakes_of_this_package_are_not_blamed_on_it(written):
    options = scenario(written(GOOD)).controller

    def fail(error):
        raise error

    # Code in this test stands for a user's; without a frame of any the verdict is Drake's.
    drakes = guarded(options, partial(PortDataType, "none"))
    assert isinstance(drakes, ControllerError)
    assert drakes.traceback == ""
    assert type(guarded(options, partial(load_network, "none"))) is ConfigurationError
    assert type(guarded(options, partial(twist_jacobian, None, None))) is not ControllerError
    for error in (KeyboardInterrupt(), RunFailure("its own")):
        assert guarded(options, partial(fail, error)) is error
    assert type(guarded(LqiOptions(), partial(fail, KeyError("x")))) is KeyError


@pytest.mark.parametrize("system", ["math:pi", "numpy:ndarray", "click:Parameter"])
def test_what_is_no_controller_is_not_made_although_it_is_trusted(system):
    with trusting_code():
        options = PythonOptions(system=system)
    with pytest.raises(ConfigurationError, match="a LeafSystem of pydrake, or what is called"):
        options.construct({})


@pytest.mark.parametrize("what", ["module", "constructor"])
def test_a_mistake_before_the_run_is_shown_with_its_line(written, what):
    bad = GOOD.replace("self.scale = scale", "self.scale = {}['a']") if what == "constructor" else GOOD + "\n{}['a']\n"
    line = next(number for number, text in enumerate(bad.splitlines(), 1) if "{}['a']" in text)
    where = "__init__" if what == "constructor" else "<module>"
    with pytest.raises(ConfigurationError) as caught:
        run(scenario(written(bad)))
    assert f"(KeyError: 'a' (mine.py, line {line}, in {where}))" in str(caught.value)


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


@pytest.mark.parametrize("rate", [50.0, 3000.0, 20_000.0])
@pytest.mark.parametrize("time_step", [0.001, 2e-5])
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


def test_a_derivative_that_is_no_number_ends_the_run_and_does_not_hang_it(written):
    log = run(scenario(written(FILTERED.format("* (np.nan if context.get_time() > 0.05 else 1.0)"))))
    assert (log.status, log.reason) == ("failed", "not_finite")
    assert 0.04 < log.end_time < 0.06


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


def test_the_shipped_example_follows_the_reference():
    system = f"{shipped_folder('comparisons') / 'task_space_pd.py'}:TaskSpacePd"
    log = run(scenario({"kind": "python", "system": system}, duration=0.4, reference={"kind": "sine"}))
    assert log.status == "completed"
    assert np.abs(log["pose"] - log["reference"]).max() < 1e-3
