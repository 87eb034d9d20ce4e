"""Code that a file names runs only once the user has said so, and is known again by its digest."""

import dataclasses
import json
import pickle
import sys
from pathlib import Path

import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.code import code_rule, store, trusting_code
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


class Weight:
    def __call__(self, measurement, setpoint, time):
        return [0.33] * 6


count = Metric("count", "", "of steps", lambda tally: tally.steps, "steps", kind="whole")
"""
PLACES = {
    "reference": ("reference: {{kind: '{}'{}}}", "Rise"),
    "disturbance": ("disturbances: [{{kind: '{}'{}}}]", "Push"),
    "controller": ("controller: {{kind: '{}'{}}}", "Weight"),
    "python controller": ("controller: {{kind: python, system: '{}'{}}}", "Weight"),
    "monitor": ("safety: {{monitors: [{{kind: '{}'{}}}]}}", "Look"),
    "metric": ("metrics: ['{}']", "count"),
    "part": ("reference: {{kind: sum, parts: [hold, {{kind: '{}'{}}}]}}", "Rise"),
}


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """`parts.py` beside the current folder."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "elsewhere" / "parts.py"
    path.parent.mkdir()
    path.write_text(PARTS)
    return path


def ran(parts):
    """Whether anything of it was run since the last time."""
    mark = parts.with_name("it was run")
    found = mark.exists()
    mark.unlink(missing_ok=True)
    return found


def refused(words="--trust-code"):
    return pytest.raises(ConfigurationError, match=words)


def scenario_with(place, code, arguments=""):
    text = PLACES[place][0].format(code, arguments)
    return "\n".join([*(line for line in SHORT.splitlines() if line.split(":")[0] != text.split(":")[0]), text, ""])


def trusted(code):
    with trusting_code():
        return Scenario.from_dict({"disturbances": [code]}).disturbances[0].code


@pytest.mark.parametrize("place", [each for each in PLACES if each != "metric"])
def test_a_module_in_a_file_is_not_called(call, tmp_path, place):
    text = scenario_with(place, "psutil:Popen", f", arguments: {{args: [touch, '{tmp_path}/X']}}")
    Path("s.yaml").write_text(text)
    status, _, err = call("run", "s.yaml")
    assert (status, err.count("\n"), "'psutil:Popen'" in err, "--trust-code" in err) == (2, 1, True, True)
    assert text.splitlines()[-1].split(":")[0] in err
    assert not (tmp_path / "X").exists()


@pytest.mark.parametrize("place", PLACES)
def test_a_file_with_code_runs_once_it_is_trusted_and_while_it_is_the_same(call, parts, place):
    Path("s.yaml").write_text(scenario_with(place, f"{parts}:{PLACES[place][1]}"))
    with refused():
        load_scenario("s.yaml")
    status, out, _ = call("check", "s.yaml")
    assert (status, ran(parts)) == (0, False)
    assert "asks for --trust-code" in out
    assert run(load_scenario("s.yaml", trust_code=True)).status in ("completed", "lost")
    assert ran(parts)
    assert load_scenario("s.yaml") == load_scenario("s.yaml", trust_code=True)
    parts.write_text(PARTS + "\n")
    with refused("has changed"):
        load_scenario("s.yaml")
    assert not ran(parts)


@pytest.mark.parametrize("module", ["loose", "package.inside", "space.inside"])
def test_nothing_is_imported_to_read_check_or_digest_it(call, tmp_path, monkeypatch, module):
    for name in ("loose", "package/__init__", "package/inside", "space/inside"):
        (tmp_path / f"{name}.py").parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.py").write_text("raise AssertionError('it was run')\n")
    monkeypatch.syspath_prepend(tmp_path)
    Path("s.yaml").write_text(scenario_with("disturbance", f"{module}:Mine"))
    with refused(module.rpartition(".")[2] + ".py"):
        load_scenario("s.yaml")
    assert call("check", "s.yaml")[0] == 0
    code = trusted(f"{module}:Mine")
    assert not [name for name in sys.modules if name.partition(".")[0] in ("loose", "package", "space")]
    code.file.write_text("raise AssertionError('another')\n")
    with refused("has changed"):
        load_scenario("s.yaml")


@pytest.mark.parametrize(
    "code", ["__main__:Mine", "os:system", "no_such_module:Mine", "numpy.none:Mine", "none.py:Mine"]
)
def test_what_cannot_be_found_is_refused_however_it_is_trusted(code):
    with refused(r"^disturbances\.0\.kind: ") as caught:
        Scenario.from_dict({"disturbances": [code]}, trust_code=True)
    assert "\n" not in str(caught.value)


def test_a_misspelt_class_is_told_what_was_meant_under_the_key_where_it_stands(parts):
    for section in ("controller", "reference"):
        name, meant = {"controller": ("Weigth", "Weight"), "reference": ("Rize", "Rise")}[section]
        scenario = Scenario.from_dict({section: f"{parts}:{name}"}, trust_code=True)
        with refused(rf"^{section}\.kind: .*{name}'; did you mean {meant}\?$"):
            getattr(scenario, section).load()


@pytest.mark.parametrize(
    "distribution",
    [
        "disturbances: {{kind: grid, values: [[], [{{kind: '{}:Push'}}]]}}",
        "'disturbances[0]': {{kind: choice, values: ['{}:Push']}}",
        "reference.kind: {{kind: choice, values: ['{}:Rise']}}",
        "metrics: {{kind: choice, values: [['{}:count']]}}",
    ],
)
def test_code_in_a_distribution_is_asked_for_before_anything_is_made(parts, distribution):
    Path("s.yaml").write_text(SHORT + "disturbances: [{kind: constant, wrench: [0,0,0,0,0,0]}]\n")
    Path("sweep.yaml").write_text(
        f"scenario: s.yaml\nruns: 2\ndistributions: {{{distribution.format('elsewhere/parts.py')}}}\n"
    )
    with refused(r"^distributions\..*parts\.py.*trust_code=True"):
        load_sweep("sweep.yaml")
    assert not ran(parts)


@pytest.mark.parametrize("change", ["disturbances[0]={}:Push", "reference.kind={}:Rise", "controller.kind={}:Weight"])
def test_code_in_an_override_is_asked_for_and_takes_the_place_of_any_kind(parts, change):
    Path("s.yaml").write_text(
        SHORT
        + "disturbances: [{kind: constant, wrench: [0, 0, 0, 0, 0, 0]}]\ncontroller: {solver: split, model: exact}\n"
    )
    changes = [change.format("elsewhere/parts.py")]
    with refused():
        load_scenario("s.yaml", changes)
    assert not ran(parts)
    run(load_scenario("s.yaml", changes, trust_code=True), check=False)
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
        with refused(r"disturbances.*trust_code=True"):
            make()
    assert Scenario.from_dict(text, trust_code=True).disturbances
    # Now it is known, here and in another process.
    assert Scenario(**text) == Scenario().replace(text) == pickle.loads(pickle.dumps(Scenario(**text)))


def test_what_is_kept_is_digest_and_name_and_deleting_it_takes_it_back(parts, monkeypatch):
    code = trusted(f"{parts}:Push")
    assert store().read_text() == f"{code.key}\n" == f"{code.digest} Push\n"
    with refused():
        Scenario.from_dict({"disturbances": [f"{parts}:Rise"]})
    monkeypatch.setattr("stewart_drake.files.code._TRUSTED", set())
    store().unlink()
    with refused():
        Scenario.from_dict({"disturbances": [f"{parts}:Push"]})


def test_who_cannot_write_at_home_is_trusted_in_this_process(parts, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", "/dev/null")
    trusted(f"{parts}:Push")
    assert Scenario.from_dict({"disturbances": [f"{parts}:Push"]}).disturbances[0].code.trusted


def test_a_store_in_the_current_folder_is_not_asked(parts, tmp_path, monkeypatch):
    key = trusted(f"{parts}:Push").key
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_STATE_HOME", "state")
    monkeypatch.setattr("stewart_drake.files.code._TRUSTED", set())
    (tmp_path / "state/stewart-drake").mkdir(parents=True)
    (tmp_path / "state/stewart-drake/trusted_code").write_text(f"{key}\n")
    with refused():
        Scenario.from_dict({"disturbances": [f"{parts}:Push"]})


def test_shipped_code_is_trusted_where_it_lies_and_only_what_it_defines(parts):
    shipped = f"{shipped_folder('comparisons') / 'task_space_pd.py'}:TaskSpacePd"
    assert Scenario.from_dict({"controller": shipped}).controller.load().__name__ == "TaskSpacePd"
    parts.write_text((shipped_folder("comparisons") / "task_space_pd.py").read_text())
    with refused():
        Scenario.from_dict({"controller": f"{parts}:TaskSpacePd"})
    scenario = Scenario.from_dict({"disturbances": ["stewart_drake.studies.workers:BrokenExecutor"]})
    with refused(r"^disturbances\.0\.kind: .*itself defines"):
        scenario.disturbances[0].evaluate(0.0)


def test_a_log_of_somebody_elses_is_read_and_not_run(parts, tmp_path):
    Path("s.yaml").write_text(scenario_with("disturbance", f"{parts}:Push"))
    run(load_scenario("s.yaml", trust_code=True)).save(tmp_path / "log.parquet")
    parts.write_text(PARTS + "\n")
    ran(parts)
    scenario = load_log(tmp_path / "log.parquet").scenario
    for each in (scenario, scenario.replace({"duration": 0.1})):
        with refused(r"^disturbances\.0\.kind: .*--trust-code"):
            run(each, check=False)
    assert not ran(parts)
    parts.unlink()
    assert load_log(tmp_path / "log.parquet").scenario.disturbances[0].code.digest is None


@pytest.mark.slow
def test_a_study_has_the_rows_of_one_version_of_a_users_file(call, parts):
    Path("s.yaml").write_text(scenario_with("disturbance", f"{parts}:Push"))
    Path("sweep.yaml").write_text(
        "scenario: s.yaml\nruns: 2\ndistributions: {robot.platform_mass: {kind: uniform, low: 0.9, high: 1.1}}\n"
    )

    def edited(scenario):
        log = simulate(scenario)
        parts.write_text(PARTS + "\n")
        # Trusted or not, this study began with another.
        trusted(f"{parts}:Push")
        return log

    def statuses():
        return [json.loads(line)["status"] for line in Path("out/rows.jsonl").read_text().splitlines()]

    plan = load_sweep("sweep.yaml", trust_code=True)
    task = plan.task
    object.__setattr__(plan, "task", lambda index: dataclasses.replace(task(index), function=edited))
    with pytest.raises(ConfigurationError, match=r"disturbances.*has changed") as caught:
        run_study(plan, Path("out"), Workers(0))
    assert caught.value.reason == "untrusted_code"
    assert len(statuses()) == 1
    status, _, err = call("sweep", "sweep.yaml", "--out", "out")
    assert (status, "parts.py" in err, "--restart" in err) == (2, True, True)
    parts.write_text(PARTS)
    assert call("sweep", "sweep.yaml", "--out", "out", "--quiet", "--workers", "1")[0] == 0
    assert statuses() == ["completed"] * 2


def test_a_worker_runs_what_the_study_began_with_and_nothing_else(parts):
    code = trusted(f"{parts}:Push")
    with code_rule(frozenset()), refused("has changed"):
        Scenario.from_dict({"disturbances": [f"{parts}:Push"]})
    with code_rule(frozenset({code.key})):
        assert Scenario.from_dict({"disturbances": [f"{parts}:Push"]}).disturbances[0].made
