import os
from pathlib import Path

import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.named_files import anchor_files, digest, file_digests, take_code_along
from stewart_drake.scenario import Scenario, load_scenario


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


OUT = ["../mine.py:Mine", "/elsewhere/mine.py:Mine", "a/../../mine.py:Mine", "/base/../mine.py:Mine", "/based/m.py:M"]
WRAPPED = [
    lambda system: {"controller": {"kind": "python", "system": system}},
    lambda system: {"controller.system": system},
    lambda system: {"distributions": {"controller.system": {"kind": "grid", "values": ["in.py:Mine", system]}}},
    lambda system: {"distributions": {"controller": {"kind": "choice", "values": [{"system": system}]}}},
    lambda system: {"controllers": {"mine": {"controller": {"kind": "python", "system": system}}}},
]


PLACES = (
    *("controller.system", "controller.system", "distributions.controller.system.values.1"),
    *("distributions.controller.values.0.system", "controllers.mine.controller.system"),
)


@pytest.mark.parametrize(("wrap", "place"), list(zip(WRAPPED, PLACES, strict=True)), ids=range(5))
def test_code_lies_in_the_folder_or_below(wrap, place):
    for system in OUT:
        with pytest.raises(ConfigurationError, match="a file in /base or below") as caught:
            anchor_files(wrap(system), Path("/base"))
        assert (caught.value.key, caught.value.value) == (place, system)
    for inside in ("mine.py:Mine", "a/../b/mine.py:Mine", "/base/c/mine.py:Mine"):
        anchor_files(wrap(inside), Path("/base"))


def test_a_section_that_two_keys_share_counts_under_both():
    shared = {"kind": "choice", "values": ["/elsewhere/mine.py:Mine"]}
    for keys in (("name", "controller.system"), ("controller.system", "name")):
        with pytest.raises(ConfigurationError, match="or below"):
            anchor_files(dict.fromkeys(keys, shared), Path("/base"))


def test_overrides_are_checked_against_the_current_folder_and_the_file_against_its_own(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    path = tmp_path / "there" / "scenario.yaml"
    path.write_text("controller: {kind: python, system: mine.py:Mine}\n")
    monkeypatch.chdir(tmp_path / "here")
    assert load_scenario(path).controller.file == tmp_path / "there" / "mine.py"
    loaded = load_scenario(path, ["controller.system=own.py:Mine"])
    assert loaded.controller.file == tmp_path / "here" / "own.py"
    for system in ("../there/mine.py:Mine", f"{tmp_path}/there/mine.py:Mine"):
        for override in (f"controller.system={system}", f"controller={{kind: python, system: '{system}'}}"):
            with pytest.raises(ConfigurationError, match="here or below"):
                load_scenario(path, [override])
    path.write_text(f"controller: {{kind: python, system: '{tmp_path}/here/mine.py:Mine'}}\n")
    with pytest.raises(ConfigurationError, match="there or below"):
        load_scenario(path)
    # In Python anybody can run anything anyway.
    assert Scenario.from_dict({"controller": {"kind": "python", "system": "/elsewhere/mine.py:Mine"}}).controller.file


def test_code_taken_along_makes_a_scenario_that_runs_from_another_folder(tmp_path):
    (tmp_path / "mine.py").write_text("one = 1\n")
    given = Scenario.from_dict({"controller": {"kind": "python", "system": f"{tmp_path / 'mine.py'}:Mine"}})
    data, files = take_code_along(given.to_dict())
    assert data == given.to_dict() | {"controller": given.to_dict()["controller"] | {"system": "mine.py:Mine"}}
    assert files == {"mine.py": b"one = 1\n"}
    assert take_code_along(Scenario().to_dict()) == (Scenario().to_dict(), {})


def test_two_files_of_one_name_are_both_taken_along(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(f"{folder} = 1\n")
    kinds = [f"{tmp_path}/{folder}/mine.py:Push" for folder in ("a", "b", "a")]
    data, files = take_code_along({"disturbances": [{"kind": kind} for kind in kinds]}, "code")
    assert set(files) == {"code/mine.py", "code/mine_2.py"}
    for kind, taken in zip(kinds, data["disturbances"], strict=True):
        assert files[taken["kind"].removesuffix(":Push")] == Path(kind.removesuffix(":Push")).read_bytes()


def test_what_is_no_regular_file_has_no_digest(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert [digest(path) for path in (tmp_path / "pipe", tmp_path, "/dev/zero", "a\0b")] == [None] * 4


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
