from pathlib import Path

import pytest

from stewart_drake.experiments.runs import run_key
from stewart_drake.experiments.sweeps.spec import Sweep
from stewart_drake.named_files import anchor_files, file_digests
from stewart_drake.scenario import Scenario

RECORDING = "time,roll,pitch,yaw,x,y,z\n" + "".join(f"{0.1 * k},0,0,0,0,0,0.3\n" for k in range(9))


def test_relative_paths_are_taken_from_the_folder_however_deep_and_others_stay():
    data = {
        "tuner": {"weights_file": "net.json"},
        "reference": {"parts": [{"motion": {"motion_file": "a/b.csv"}}, {"motion_file": "/c.csv"}]},
        "controller": {"kind": "python", "system": "mine.py:Mine"},
        "distributions": {"tuner.weights_file": {"kind": "choice", "values": ["one.json", "/two.json"]}},
        "set": {"reference.motion_file": "d.csv", "name": "net.json", "controller.system": "one.py:Mine"},
        "grid": {"controller.system": {"kind": "grid", "values": ["two.py:Mine", "package.module:Mine"]}},
        "odd": {"kind": "python", "system": ["three.py:Mine"]},
    }
    anchor_files(data, Path("/base"))
    assert data == {
        "tuner": {"weights_file": "/base/net.json"},
        "reference": {"parts": [{"motion": {"motion_file": "/base/a/b.csv"}}, {"motion_file": "/c.csv"}]},
        "controller": {"kind": "python", "system": "/base/mine.py:Mine"},
        "distributions": {"tuner.weights_file": {"kind": "choice", "values": ["/base/one.json", "/two.json"]}},
        "set": {"reference.motion_file": "/base/d.csv", "name": "net.json", "controller.system": "/base/one.py:Mine"},
        "grid": {"controller.system": {"kind": "grid", "values": ["/base/two.py:Mine", "package.module:Mine"]}},
        "odd": {"kind": "python", "system": ["three.py:Mine"]},
    }
    assert set(file_digests(data)) == {
        *("/base/net.json", "/base/a/b.csv", "/c.csv", "/base/mine.py", "/base/one.json", "/two.json", "/base/d.csv"),
        *("/base/one.py", "/base/two.py"),
    }


def test_a_module_to_import_is_no_file_and_a_section_may_hold_itself():
    data = {"controller": {"kind": "python", "system": "package.module:Mine"}}
    data["again"] = data
    anchor_files(data, Path("/base"))
    assert data["controller"]["system"] == "package.module:Mine"
    assert file_digests(data) == {}


def test_digests_tell_contents_apart_and_a_missing_file_has_none(tmp_path):
    (tmp_path / "net.json").write_text("1")
    data = {"a": {"weights_file": str(tmp_path / "net.json")}, "b": [{"motion_file": str(tmp_path / "none.csv")}]}
    before = file_digests(data)
    assert before[str(tmp_path / "none.csv")] is None
    (tmp_path / "net.json").write_text("2")
    assert file_digests(data)[str(tmp_path / "net.json")] not in (None, before[str(tmp_path / "net.json")])


def test_another_recording_under_the_same_name_is_another_run(tmp_path):
    path = tmp_path / "motion.csv"
    path.write_text(RECORDING)
    scenario = Scenario.from_dict({"reference": {"kind": "recorded", "motion_file": str(path)}})
    before = run_key(scenario)
    path.write_text(RECORDING.replace("0.8,0,", "0.8,0.01,"))
    assert run_key(scenario) != before


@pytest.mark.parametrize("section", ["set", "distributions"])
def test_a_sweep_finds_a_recording_beside_its_file(tmp_path, section):
    (tmp_path / "motion.csv").write_text(RECORDING)
    recorded = {"kind": "recorded", "motion_file": "motion.csv"}
    data = {
        "scenario": "exact_fig7",
        "runs": 1,
        "distributions": {"gravity": {"kind": "uniform", "low": 9, "high": 10}},
    }
    if section == "set":
        data["set"] = {"reference": recorded}
    else:
        data["distributions"]["reference"] = {"kind": "choice", "values": [recorded]}
    sweep = Sweep.from_dict(data, tmp_path)
    assert str(tmp_path / "motion.csv") in file_digests(sweep.to_dict())
