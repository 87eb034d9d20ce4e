"""Code that a file names runs only once the user has said so, and is known again by its digest."""

import dataclasses
import importlib.util
import json
import pickle
import py_compile
import sys
from pathlib import Path

import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code_path import CodePath
from stewart_drake.files.code_trust import _keep, code_rule, store, trusting_code
from stewart_drake.files.yaml_files import shipped_folder
from stewart_drake.logs.log import load_log
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario, load_scenario
from stewart_drake.studies.runs import simulate
from stewart_drake.studies.study import run_study
from stewart_drake.studies.sweep import Sweep, load_sweep
from stewart_drake.studies.workers import Workers

SHORT = "duration: 0.05\ntuner: {kind: fixed}\nreference: {kind: hold}\n"
PARTS = """
from pathlib import Path

from pydrake.systems.framework import LeafSystem

from stewart_drake import Metric

Path(__file__).with_name("it was run").touch()


class Rise:
    def evaluate(self, t):
        return [0, 0, 0, 0, 0, 0.3 + 0.01 * t], [0, 0, 0, 0, 0, 0.01], [0] * 6


class Push:
    def evaluate(self, t):
        return [0, 0, 0, 0, 0, t]


class Look:
    def look(self, inputs):
        return None


class Weight(LeafSystem):
    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("measurement", 12)
        self.DeclareVectorInputPort("reference", 18)
        self.DeclareVectorOutputPort("torque", 6, lambda context, output: output.SetFromVector([0.33] * 6))


count = Metric("count", "", "of steps", lambda tally: tally.steps, "steps", kind="whole")
"""
PLACES = {
    "reference": ("reference: {{kind: '{}'{}}}", "Rise"),
    "disturbance": ("disturbances: [{{kind: '{}'{}}}]", "Push"),
    "controller": ("controller: {{kind: '{}'{}}}", "Weight"),
    "python controller": ("controller: {{kind: python, system: '{}'{}}}", "Weight"),
    "monitor": ("safety: {{monitors: [{{kind: '{}'{}}}]}}", "Look"),
    "metric": ("metrics: ['{}']", "count"),
    "motion": ("reference: {{kind: adjusted, motion: {{kind: '{}'{}}}}}", "Rise"),
    "part": ("reference: {{kind: sum, parts: [hold, {{kind: '{}'{}}}]}}", "Rise"),
}


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """`parts.py` in the current folder; `parts.ran()` says whether anything of it was run since the last time."""
    monkeypatch.chdir(tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    path = elsewhere / "parts.py"
    path.write_text(PARTS)
    return path


def ran(parts):
    marks = list(parts.parent.glob("it was run"))
    for mark in marks:
        mark.unlink()
    return bool(marks)


def one_line(status, out, err, *words):
    assert (status, err.count("\n")) == (2, 1), (status, out, err)
    for word in (*words, "--trust-code"):
        assert word in err, err
    return True


def scenario_with(place, code, arguments=""):
    text = PLACES[place][0].format(code, arguments)
    return "\n".join([*(line for line in SHORT.splitlines() if line.split(":")[0] != text.split(":")[0]), text, ""])


@pytest.mark.parametrize("place", [each for each in PLACES if each != "metric"])
@pytest.mark.parametrize("command", ["run", "margins", "workspace", "write-sdf"])
def test_a_module_in_a_file_is_not_called(call, tmp_path, place, command):
    text = scenario_with(place, "psutil:Popen", f", arguments: {{args: [touch, '{tmp_path}/X']}}")
    (tmp_path / "s.yaml").write_text(text)
    arguments = {
        "run": ["s.yaml"],
        "margins": ["s.yaml"],
        "workspace": ["--scenario", "s.yaml"],
        "write-sdf": ["x.sdf", "--scenario", "s.yaml"],
    }
    key = text.splitlines()[-1].split(":")[0]
    assert one_line(*call(command, *arguments[command]), f"{key}.", "'psutil:Popen'")
    assert not (tmp_path / "X").exists()
    with pytest.raises(ConfigurationError, match="trust_code=True"):
        load_scenario("s.yaml")


@pytest.mark.parametrize("place", PLACES)
def test_a_file_with_code_runs_once_it_is_trusted_and_while_it_is_the_same(call, parts, place):
    Path("s.yaml").write_text(scenario_with(place, f"{parts}:{PLACES[place][1]}"))
    assert one_line(*call("run", "s.yaml", "--quiet"), str(parts))
    status, out, _ = call("check", "s.yaml")
    assert (status, ran(parts)) == (0, False)
    assert "asks for --trust-code" in out
    assert run(load_scenario("s.yaml", trust_code=True)).status in ("completed", "lost")
    assert ran(parts)
    assert "asks for" not in call("check", "s.yaml")[1]
    parts.write_text(PARTS + "\n")
    assert one_line(*call("run", "s.yaml", "--quiet"), "has changed")
    assert not ran(parts)


@pytest.mark.slow
def test_what_a_run_leaves_runs_again_while_its_code_is_the_same(call, parts):
    lines = [
        PLACES[place][0].format(f"{parts}:{PLACES[place][1]}", "") for place in [*PLACES][:6] if place != "controller"
    ]
    Path("s.yaml").write_text("\n".join(["duration: 0.05", *lines, ""]))
    assert call("run", "s.yaml", "--quiet", "--out", "out", "--trust-code")[0] in (0, 3)
    assert Path("out/code/parts.py").read_text() == PARTS
    parts.unlink()
    Path("out").rename("moved")
    assert call("run", "moved/scenario.yaml", "--quiet", "--out", "again")[0] in (0, 3)
    Path("moved/code/parts.py").write_text(PARTS + "\n")
    status, _, err = call("run", "moved/scenario.yaml", "--quiet", "--out", "third")
    assert (status, err.count("\n"), err.count("has changed")) == (2, 5, 5)


NAMES = ["loose", "package.inside", "space.inside", "package.deeper.inside"]


@pytest.mark.parametrize("module", NAMES)
def test_nothing_is_imported_to_read_check_or_digest_it(call, tmp_path, monkeypatch, module):
    for name in ("loose", "package/__init__", "package/inside", "package/deeper/__init__", "package/deeper/inside"):
        (tmp_path / f"{name}.py").parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / f"{name}.py").write_text("raise AssertionError('it was run')\n")
    (tmp_path / "space").mkdir()
    (tmp_path / "space/inside.py").write_text("raise AssertionError('it was run')\n")
    monkeypatch.syspath_prepend(tmp_path)
    Path("s.yaml").write_text(scenario_with("disturbance", f"{module}:Mine"))
    assert one_line(*call("run", "s.yaml"), module.rpartition(".")[2] + ".py")
    assert call("check", "s.yaml")[0] == 0
    with trusting_code():
        code = load_scenario("s.yaml").disturbances[0].code
    assert len(code.files) == {"space.inside": 1}.get(module, module.count(".") + 1)
    assert not [name for name in sys.modules if name.partition(".")[0] in ("loose", "package", "space")]
    # What its import would run counts, too.
    code.files[0].write_text("raise AssertionError('another')\n")
    assert one_line(*call("run", "s.yaml"), "has changed")


def test_bytecode_of_other_code_does_not_run(tmp_path, monkeypatch):
    (tmp_path / "other.py").write_text(PARTS)
    code = importlib.util.cache_from_source(tmp_path / "pushing.py")
    py_compile.compile(tmp_path / "other.py", code, invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
    (tmp_path / "pushing.py").write_text("class Push:\n    size = 2\n")
    monkeypatch.syspath_prepend(tmp_path)
    with trusting_code():
        found = CodePath.named("pushing:Push").load("disturbances")
    assert found.size == 2
    assert not (tmp_path / "it was run").exists()


@pytest.mark.parametrize(
    "code", ["__main__:Mine", "os:system", "no_such_module:Mine", "numpy.none:Mine", "none.py:Mine"]
)
def test_what_cannot_be_found_is_refused_however_it_is_trusted(call, code):
    Path("s.yaml").write_text(scenario_with("disturbance", code))
    status, _, err = call("run", "s.yaml", "--trust-code")
    assert (status, err.count("\n")) == (2, 1)
    assert "disturbances.0.kind" in err


SWEEPS = [
    "disturbances: {{kind: choice, values: [['{}:Push']]}}",
    "disturbances: {{kind: grid, values: [[], [{{kind: '{}:Push'}}]]}}",
    "'disturbances[0]': {{kind: choice, values: ['{}:Push']}}",
    "reference: {{kind: choice, values: ['{}:Rise']}}",
    "reference.kind: {{kind: choice, values: ['{}:Rise']}}",
    "controller.kind: {{kind: choice, values: ['{}:Weight']}}",
    "safety: {{kind: choice, values: [{{monitors: ['{}:Look']}}]}}",
    "metrics: {{kind: choice, values: [['{}:count']]}}",
]


def sweep_of(distribution, parts, **more):
    base = SHORT.replace("{kind: hold}", "{kind: sine}") + "disturbances: [{kind: constant, wrench: [0,0,0,0,0,0]}]\n"
    Path("s.yaml").write_text(base)
    lines = ["scenario: s.yaml", "runs: 2", *(f"{key}: {value}" for key, value in more.items())]
    Path("sweep.yaml").write_text("\n".join([*lines, f"distributions: {{{distribution.format(parts)}}}", ""]))


@pytest.mark.parametrize("distribution", SWEEPS)
def test_code_in_a_distribution_is_asked_for_before_anything_is_made(call, parts, distribution):
    sweep_of(distribution, parts)
    assert one_line(*call("sweep", "sweep.yaml", "--out", "out"), "distributions.", str(parts))
    assert not ran(parts)
    assert not Path("out").exists()
    with pytest.raises(ConfigurationError, match="trust_code=True"):
        load_sweep("sweep.yaml")


def statuses(folder):
    return [json.loads(line)["status"] for line in Path(folder, "rows.jsonl").read_text().splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize("distribution", [SWEEPS[0], SWEEPS[7]])
def test_code_in_a_distribution_runs_in_processes_once_it_is_trusted(call, parts, monkeypatch, distribution):
    sweep_of(distribution, parts)
    # The decision goes with the work: workers have no home here.
    monkeypatch.setenv("XDG_STATE_HOME", "/dev/null")
    status, _, err = call("sweep", "sweep.yaml", "--out", "out", "--trust-code", "--quiet", "--workers", "2")
    assert (status, err) == (0, "")
    assert ran(parts)
    assert set(statuses("out")) <= {"completed", "lost"}


@pytest.mark.slow
def test_code_in_a_condition_and_a_controller_of_a_comparison_is_asked_for(call, parts):
    Path("own.py").write_text(PARTS)
    Path("s.yaml").write_text(SHORT + "safety: {monitors: ['own.py:Look']}\n")
    assert call("run", "s.yaml", "--quiet", "--out", "one", "--trust-code")[0] == 0
    evil = parts.with_name("evil.py")
    evil.write_text(PARTS + "\n")
    for part in (f"conditions: {{c: {{'safety.monitors[0]': '{evil}:Look'}}}}", "conditions: {n: {}}"):
        controller = "{}" if "evil" in part else f"{{controller: {{kind: '{evil}:Weight'}}}}"
        Path("c.yaml").write_text(
            f"scenario: s.yaml\ncontrollers: {{one: {controller}}}\nreferences: {{hold: {{reference: hold}}}}\n{part}\n"
            "tune: {controllers: {one: {bounds.position: [0.01, 0.1]}}}\ncost: {position: 0.03}\n"
        )
        for command in ("compare", "tune"):
            assert one_line(*call(command, "c.yaml", "--out", "out"), str(evil))
            assert not ran(evil)
            assert not Path("out").exists()
    assert call("compare", "c.yaml", "--out", "out", "--quiet", "--workers", "1", "--trust-code")[0] == 0
    assert ran(evil)


@pytest.mark.parametrize(
    "change", ["disturbances[0]={}:Push", "disturbances=['{}:Push']", "reference.kind={}:Rise", "controller={}:Weight"]
)
def test_code_in_an_override_is_asked_for(call, parts, change):
    Path("s.yaml").write_text(SHORT + "disturbances: [{kind: constant, wrench: [0, 0, 0, 0, 0, 0]}]\n")
    for command in (["run", "s.yaml"], ["margins", "s.yaml"], *([["faults"]] if "[0]" not in change else [])):
        assert one_line(*call(*command, "--set", change.format("elsewhere/parts.py")), str(parts))
    assert not ran(parts)
    run(load_scenario("s.yaml", [change.format("elsewhere/parts.py")], trust_code=True))
    assert ran(parts)


def test_in_python_texts_are_asked_for_and_classes_are_not(parts):
    text = {"disturbances": [f"{parts}:Push"]}
    choice = {"kind": "choice", "values": [text["disturbances"]]}
    sweep = {"scenario": "hold", "runs": 1, "distributions": {"disturbances": choice}}
    for make in (
        lambda: Scenario.from_dict(text),
        lambda: Scenario(**text),
        lambda: Scenario().replace(text),
        lambda: Sweep.from_dict(sweep),
    ):
        with pytest.raises(ConfigurationError, match=r"disturbances.*trust_code=True"):
            make()
    assert Scenario.from_dict(text, trust_code=True).disturbances
    # Now it is known, here and in another process.
    assert Scenario(**text) == Scenario().replace(text) == pickle.loads(pickle.dumps(Scenario(**text)))
    parts.write_text(PARTS + "\n")
    with pytest.raises(ConfigurationError, match="has changed"):
        Scenario(**text)


def test_another_class_of_a_trusted_file_is_asked_for(parts):
    with trusting_code():
        Scenario.from_dict({"disturbances": [f"{parts}:Push"]})
    with pytest.raises(ConfigurationError, match="--trust-code"):
        Scenario.from_dict({"disturbances": [f"{parts}:Rise"]})
    (line,) = store().read_text().splitlines()
    digest, name = line.split(" ")
    assert (len(digest), name) == (64, "Push")


def test_who_cannot_write_at_home_is_trusted_in_this_process(parts, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", "/dev/null")
    with trusting_code():
        Scenario.from_dict({"disturbances": [f"{parts}:Push"]})
    assert Scenario.from_dict({"disturbances": [f"{parts}:Push"]}).disturbances[0].code.trusted


def test_a_store_in_the_current_folder_is_not_asked(parts, tmp_path, monkeypatch):
    with trusting_code():
        key = Scenario.from_dict({"disturbances": [f"{parts}:Push"]}).disturbances[0].code.key
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_STATE_HOME", "state")
    monkeypatch.setattr("stewart_drake.files.code_trust._TRUSTED", set())
    (tmp_path / "state/stewart-drake").mkdir(parents=True)
    (tmp_path / "state/stewart-drake/trusted_code").write_text(f"{key}\n")
    with pytest.raises(ConfigurationError, match="--trust-code"):
        Scenario.from_dict({"disturbances": [f"{parts}:Push"]})


def test_shipped_code_is_trusted_where_it_lies_and_only_what_it_defines(parts, monkeypatch):
    shipped = f"{shipped_folder('comparisons') / 'task_space_pd.py'}:TaskSpacePd"
    assert Scenario.from_dict({"controller": shipped}).controller.load().__name__ == "TaskSpacePd"
    parts.write_text((shipped_folder("comparisons") / "task_space_pd.py").read_text())
    with pytest.raises(ConfigurationError, match="--trust-code"):
        Scenario.from_dict({"controller": f"{parts}:TaskSpacePd"})
    link = parts.with_name("linked.py")
    link.symlink_to(parts)
    monkeypatch.setattr("stewart_drake.files.code_trust.PACKAGE", link.parent / "none")
    with pytest.raises(ConfigurationError, match="--trust-code"):
        Scenario.from_dict({"controller": f"{link}:TaskSpacePd"})


def test_what_shipped_code_imports_is_not_shipped():
    code = "stewart_drake.studies.workers:BrokenExecutor"
    scenario = Scenario.from_dict({"disturbances": [code]})
    with pytest.raises(ConfigurationError, match=r"^disturbances\.0\.kind: .*itself defines"):
        scenario.disturbances[0].evaluate(0.0)


def test_a_log_of_somebody_elses_is_read_and_not_run(parts, tmp_path):
    Path("s.yaml").write_text(scenario_with("disturbance", f"{parts}:Push"))
    run(load_scenario("s.yaml", trust_code=True)).save(tmp_path / "log.parquet")
    parts.write_text(PARTS + "\n")
    ran(parts)
    scenario = load_log(tmp_path / "log.parquet").scenario
    for each in (scenario, scenario.replace({"duration": 0.1})):
        with pytest.raises(ConfigurationError, match=r"^disturbances\.0\.kind: .*--trust-code"):
            run(each, check=False)
    assert not ran(parts)
    parts.unlink()
    assert load_log(tmp_path / "log.parquet").scenario.disturbances[0].code.digest is None


@pytest.mark.slow
def test_a_study_has_the_rows_of_one_version_of_a_users_file(call, parts):
    sweep_of(
        "robot.platform_mass: {{kind: uniform, low: 0.9, high: 1.1}}", parts, set=f"{{disturbances: ['{parts}:Push']}}"
    )

    def edited(scenario):
        log = simulate(scenario)
        parts.write_text(PARTS + "\n")
        # Trusted or not, this study began with another.
        Scenario.from_dict({"disturbances": [f"{parts}:Push"]}, trust_code=True)
        return log

    plan = load_sweep("sweep.yaml", trust_code=True)
    task = plan.task
    object.__setattr__(plan, "task", lambda index: dataclasses.replace(task(index), function=edited))
    with pytest.raises(ConfigurationError, match=r"disturbances.*has changed") as caught:
        run_study(plan, Path("out"), Workers(0))
    assert caught.value.reason == "untrusted_code"
    assert len(statuses("out")) == 1
    status, _, err = call("sweep", "sweep.yaml", "--out", "out")
    assert (status, "parts.py" in err, "--restart" in err) == (2, True, True)
    parts.write_text(PARTS)
    assert call("sweep", "sweep.yaml", "--out", "out", "--quiet", "--workers", "1")[0] == 0
    assert statuses("out") == ["completed"] * 2


def test_a_worker_runs_what_the_study_began_with_and_nothing_else(parts):
    with trusting_code():
        code = Scenario.from_dict({"disturbances": [f"{parts}:Push"]}).disturbances[0].code
    with code_rule(frozenset()), pytest.raises(ConfigurationError, match="has changed"):
        Scenario.from_dict({"disturbances": [f"{parts}:Push"]})
    with code_rule(frozenset()), pytest.raises(ConfigurationError, match="has changed"):
        Scenario.from_dict({"controller": f"{shipped_folder('comparisons') / 'task_space_pd.py'}:TaskSpacePd"})
    with code_rule(frozenset({code.key})):
        assert Scenario.from_dict({"disturbances": [f"{parts}:Push"]}).disturbances[0].made


def test_a_line_of_the_users_file_is_what_is_kept_and_deleting_it_takes_it_back(parts):
    with trusting_code():
        code = Scenario.from_dict({"disturbances": [f"{parts}:Push"]}).disturbances[0].code
    assert store().read_text() == f"{code.key}\n"
    _keep("another key")
    assert len(store().read_text().splitlines()) == 2
