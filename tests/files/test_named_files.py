import os
from pathlib import Path

import pytest

from stewart_drake.files.named_files import anchored, code_named, file_digests
from stewart_drake.files.whole import digest
from stewart_drake.scenario import load_scenario


def test_relative_paths_are_taken_from_the_folder_however_deep_and_others_stay():
    data = {
        "tuner": {"weights_file": "net.json"},
        "reference": {"parts": [{"motion": {"motion_file": "a/b.csv"}}, {"motion_file": "/c.csv"}]},
        "distributions": {
            "tuner.weights_file": {"kind": "choice", "values": ["one.json", "/two.json"]},
            "robot": {"kind": "grid", "values": ["mine.yaml", "paper"]},
        },
        "set": {"reference.motion_file": "d.csv", "name": "net.json"},
    }
    assert anchored(data, Path("/base")) == {
        "tuner": {"weights_file": "/base/net.json"},
        "reference": {"parts": [{"motion": {"motion_file": "/base/a/b.csv"}}, {"motion_file": "/c.csv"}]},
        "distributions": {
            "tuner.weights_file": {"kind": "choice", "values": ["/base/one.json", "/two.json"]},
            "robot": {"kind": "grid", "values": ["/base/mine.yaml", "paper"]},
        },
        "set": {"reference.motion_file": "/base/d.csv", "name": "net.json"},
    }
    assert set(file_digests(anchored(data, Path("/base")))) == {
        *("/base/net.json", "/base/a/b.csv", "/c.csv", "/base/one.json", "/two.json", "/base/d.csv", "/base/mine.yaml"),
    }


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("mine.py:Mine", "/base/mine.py:Mine"),
        ("a/../mine.py:Mine", "/base/a/../mine.py:Mine"),
        ("/elsewhere/mine.py:Mine", "/elsewhere/mine.py:Mine"),
        ("package.module:Mine", "package.module:Mine"),
        ("mine.py", "mine.py"),
    ],
)
@pytest.mark.parametrize(
    "wrap",
    [
        lambda code: {"controller": {"kind": "python", "system": code}},
        lambda code: {"controller": code},
        lambda code: {"disturbances": [code], "name": "one"},
        lambda code: {"disturbances[0]": code},
        lambda code: {"conditions": {"c": {"safety.monitors[0]": code}}},
        lambda code: {"distributions": {"disturbances": {"kind": "choice", "values": [[code], []]}}},
        lambda code: {"distributions": {"reference.parts[1]": {"kind": "grid", "values": [{"kind": code}]}}},
    ],
)
def test_code_is_taken_from_the_folder_wherever_it_stands(wrap, given, expected):
    assert anchored(wrap(given), Path("/base")) == wrap(expected)


def test_code_is_named_with_its_digest_wherever_it_stands(tmp_path):
    (tmp_path / "mine.py").write_text("one = 1\n")
    (found,) = code_named({"distributions": {"a": [[f"{tmp_path}/mine.py:G"]]}, "name": "a:b", "c": 1})
    assert (found.files[-1], found.digest) == (tmp_path / "mine.py", digest(tmp_path / "mine.py"))
    assert not found.trusted


def test_overrides_are_taken_from_the_current_folder_and_the_file_from_its_own(tmp_path, monkeypatch):
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text("one = 1\n")
    path = tmp_path / "there" / "scenario.yaml"
    path.write_text("controller: {kind: python, system: mine.py:Mine}\n")
    monkeypatch.chdir(tmp_path / "here")
    assert load_scenario(path, trust_code=True).controller.code.files[-1] == tmp_path / "there" / "mine.py"
    for override in ("controller.system=mine.py:Mine", "controller={kind: python, system: mine.py:Mine}"):
        loaded = load_scenario(path, [override], trust_code=True)
        assert loaded.controller.code.files[-1] == tmp_path / "here" / "mine.py"


def test_what_is_no_regular_file_has_no_digest(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert [digest(path) for path in (tmp_path / "pipe", tmp_path, "/dev/zero", "a\0b")] == [None] * 4


def test_digests_tell_contents_apart_and_a_missing_file_has_none(tmp_path):
    (tmp_path / "net.json").write_text("1")
    data = {"a": {"weights_file": str(tmp_path / "net.json")}, "b": [{"motion_file": str(tmp_path / "none.csv")}]}
    before = file_digests(data)
    assert before[str(tmp_path / "none.csv")] is None
    (tmp_path / "net.json").write_text("2")
    assert file_digests(data)[str(tmp_path / "net.json")] not in (None, before[str(tmp_path / "net.json")])
