"""To name code in a file is always allowed and runs nothing; it is loaded only where who reads the file trusts it."""

import pickle
import sys
from pathlib import Path

import pytest

from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.yaml_files import shipped_folder
from stewart_drake.logs.log import load_log
from stewart_drake.runs.simulation import run
from stewart_drake.scenario.scenario import Scenario, load_scenario
from stewart_drake.studies.experiment import run_experiment
from stewart_drake.studies.sweep import make_sweep
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


count = Metric("count", "", "of steps", lambda tally: tally.steps, "steps", kind="integer")
"""
PLACES = {
    "reference": ("reference: {{kind: '{}'}}", "Rise"),
    "disturbance": ("disturbances: ['{}']", "Push"),
    "controller": ("controller: {{kind: '{}'}}", "Weight"),
    "monitor": ("safety: {{monitors: [{{kind: '{}'}}]}}", "Look"),
    "metric": ("metrics: ['{}']", "count"),
    "part": ("reference: {{kind: sum, parts: [hold, {{kind: '{}'}}]}}", "Rise"),
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


def refused(words="read .*parts.py, then add --trust-code"):
    return pytest.raises(ConfigurationError, match=words)


def write_scenario(place, code):
    text = PLACES[place][0].format(code)
    kept = (line for line in SHORT.splitlines() if line.split(":")[0] != text.split(":")[0])
    Path("s.yaml").write_text("\n".join([*kept, text, ""]))


@pytest.mark.parametrize("place", PLACES)
def test_a_file_that_names_code_is_read_and_checked_and_runs_only_with_the_flag(call, parts, place):
    write_scenario(place, f"elsewhere/parts.py:{PLACES[place][1]}")
    status, out, _ = call("check", "s.yaml")
    assert (status, f"runs code: {parts}" in out, "needs --trust-code" in out) == (0, True, True)
    status, _, err = call("run", "s.yaml")
    assert (status, err.count("\n"), str(parts) in err, "--trust-code" in err) == (2, 1, True, True)
    assert PLACES[place][0].split(":")[0] in err
    assert not ran(parts)
    assert not Path("runs").exists()
    assert run(load_scenario("s.yaml", trust_code=True)).status in ("completed", "lost")
    assert ran(parts)
    with refused():
        run(load_scenario("s.yaml"), check=False)


@pytest.mark.parametrize("module", ["loose", "package.inside", "space.inside"])
def test_a_module_is_not_imported_to_read_or_check_it(call, tmp_path, monkeypatch, module):
    for name in ("loose", "package/__init__", "package/inside", "space/inside"):
        (tmp_path / f"{name}.py").parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.py").write_text("raise AssertionError('it was run')\n")
    monkeypatch.syspath_prepend(tmp_path)
    write_scenario("disturbance", f"{module}:Mine")
    assert call("check", "s.yaml")[0] == 0
    with refused(f"read {module}, then add"):
        run(load_scenario("s.yaml"))
    assert not [name for name in sys.modules if name.partition(".")[0] in ("loose", "package", "space")]


@pytest.mark.parametrize("code", ["__main__:Mine", "time:sleep", "none_such:Mine", "numpy.none:Mine", "none.py:Mine"])
def test_what_cannot_be_found_is_refused_however_it_is_trusted(code):
    scenario = Scenario.from_dict({"disturbances": [code]}, trust_code=True)
    with refused(r"^disturbances\.0\.kind: ") as caught:
        run(scenario)
    assert "\n" not in str(caught.value)


def test_a_misspelt_class_is_told_what_was_meant_under_the_key_where_it_stands(parts):
    scenario = Scenario.from_dict({"reference": f"{parts}:Rize"}, trust_code=True)
    with refused(r"^reference\.kind: .*Rize'; did you mean Rise\?$"):
        scenario.reference.load()
    assert scenario.replace({"reference": f"{parts}:Rise"}, trust_code=True).reference.load().__name__ == "Rise"


def test_trust_stays_with_what_was_read_and_goes_no_further(parts):
    text = {"disturbances": [f"{parts}:Push"]}
    trusted = Scenario.from_dict(text, trust_code=True)
    for each in (trusted, trusted.replace({"duration": 0.1}), pickle.loads(pickle.dumps(trusted))):
        assert each.disturbances[0].code.trusted
    rise = trusted.replace({"reference": f"{parts}:Rise"}, trust_code=True)
    assert rise.reference.code.trusted
    assert rise.disturbances[0].code.trusted
    for each in (Scenario(**text), trusted.replace(text), trusted.replace({"reference": f"{parts}:Rise"})):
        with refused():
            run(each)


def test_shipped_code_needs_nothing_where_it_lies(parts):
    shipped = f"{shipped_folder('comparisons') / 'task_space_pd.py'}:TaskSpacePd"
    assert Scenario.from_dict({"controller": shipped}).controller.load().__name__ == "TaskSpacePd"
    parts.write_text((shipped_folder("comparisons") / "task_space_pd.py").read_text())
    with refused():
        Scenario.from_dict({"controller": f"{parts}:TaskSpacePd"}).controller.load()


def test_a_log_of_somebody_elses_is_read_and_not_run(parts, tmp_path):
    write_scenario("disturbance", f"{parts}:Push")
    run(load_scenario("s.yaml", trust_code=True)).save(tmp_path / "log.parquet")
    ran(parts)
    with refused(r"^disturbances\.0\.kind: .*--trust-code"):
        run(load_log(tmp_path / "log.parquet").scenario, check=False)
    assert not ran(parts)
    parts.unlink()
    assert load_log(tmp_path / "log.parquet").scenario.disturbances


@pytest.mark.parametrize("in_base", [True, False])
def test_a_study_asks_before_it_begins_and_its_workers_take_its_word(parts, tmp_path, in_base):
    here = {"disturbances": [f"{parts}:Push"]}
    values = {"kind": "choice", "values": [f"{parts}:Rise"]}
    study = {"scenario": "hold", "runs": 1, "set": {"duration": 0.05, **here}, "distributions": {"reference": values}}
    if in_base:
        study["distributions"] = {"robot.platform_mass": {"kind": "uniform", "low": 0.9, "high": 1.1}}
    with refused():
        run_experiment(make_sweep(study), tmp_path / "out", Workers(0))
    assert not ran(parts)
    plan = make_sweep(study, trust_code=True)
    assert run_experiment(plan, tmp_path / "out", Workers(0)).rows["sweep"][0]["status"] in ("completed", "lost")
