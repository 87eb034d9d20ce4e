"""Files: what is read is regular, bounded and safe; what is written is there whole or not at all."""

import ast
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from conftest import make_network
from made_logs import made_log

import stewart_drake
from stewart_drake.base.atomic_files import digest, locked_folder, write_atomically
from stewart_drake.base.code import anchored
from stewart_drake.base.errors import ConfigurationError, DiskError
from stewart_drake.base.tables import ENDINGS, column_name, numbers_to_csv, quantity_of, read_numbers
from stewart_drake.base.yaml_files import parse_yaml, shipped_folder
from stewart_drake.control.network import load_network
from stewart_drake.logs.log import load_log
from stewart_drake.references import RecordedReference
from stewart_drake.scenario.scenario import load_scenario

MOTION = "time_s,roll,pitch,yaw,x,y,z\n" + "".join(f"{0.1 * k:g},0,{0.01 * k:g},0,0,0,0.3\n" for k in range(30))
KINDS = {
    "own.yaml": (lambda: (shipped_folder("scenarios") / "heart.yaml").read_bytes(), load_scenario),
    "own.json": (lambda: make_network().to_bytes(), load_network),
    "own.parquet": (lambda: made_log(rows=5).to_parquet(), load_log),
    "own.csv": (MOTION.encode, lambda path: RecordedReference(motion_file=str(path)).evaluate(0.0)),
}
"""Name of a file -> a good one, and what loads it."""


def refused(load, path):
    """Whether a file is refused, by some lines; what else is raised fails the test."""
    try:
        load(path)
    except ConfigurationError as error:
        lines = str(error).split("\n")
        assert all(line.isprintable() and len(line) < 2000 for line in lines)
        return True
    return False


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize(
    "damage", [lambda good: good[: len(good) // 2] + b"\xff[", lambda _: b"[" * 5000, lambda _: b"\x00"]
)
def test_a_damaged_file_is_refused_in_plain_words(tmp_path, name, damage):
    make, load = KINDS[name]
    path, good = tmp_path / name, make()
    path.write_bytes(good)
    assert not refused(load, path)
    path.write_bytes(damage(good))
    assert refused(load, path)


@pytest.mark.parametrize("name", KINDS)
def test_what_is_no_regular_file_or_too_large_is_refused(tmp_path, name):
    path, load = tmp_path / name, KINDS[name][1]
    for make in (
        os.mkfifo,
        lambda p: p.symlink_to("/dev/zero"),
        Path.mkdir,
        lambda p: p.symlink_to(p),
        lambda p: (p.touch(), os.truncate(p, 2**40)),
    ):
        make(path)
        assert refused(load, path)
        assert digest(path) is None
        path.rmdir() if path.is_dir() else path.unlink()
    assert digest("a\0b") is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &a 1\nb: *a", r"line 2, column 4: an alias, \*a"),
        ("a: &a {b: 1}\nc: {<<: *a}", "an alias"),
        ("a: !!python/object:os.system x", "constructor for the tag"),
        ("a: 1\na: 2", "duplicate key"),
        ("a: [1", "line 1"),
        ("a:\n\tb: 1", r"line 2, column 1: .*indent with spaces"),
        ("[" * 5000, "RecursionError"),
    ],
)
def test_yaml_has_no_aliases_and_no_tags(text, words):
    with pytest.raises(ConfigurationError, match=words):
        parse_yaml(text, "file")


def test_a_column_is_read_in_any_of_its_units_and_its_name_says_which(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("note, pose_roll_deg ,torque_0_mNm,X_mm,Time\na,180,1500,2,3\n\nb,,0,nan,1e1\n")
    quantities = (("time", "s"), ("pose_roll", "rad"), ("pose_x", "m"), ("torque_0", "N m"))
    values = read_numbers(path, "table", quantities, 1000, 9)
    np.testing.assert_allclose(values, [[3.0, np.pi, 0.002, 1.5], [10.0, np.nan, np.nan, 0.0]])
    path.write_text(numbers_to_csv(quantities, values))
    assert path.read_text().splitlines()[0] == "time_s,pose_roll_rad,pose_x_m,torque_0_Nm"
    np.testing.assert_array_equal(read_numbers(path, "table", quantities, 1000, 9), values)
    path.write_text("time,x_mm,X_m,pose_roll,torque_0\n1,2,3,4,5\n")
    with pytest.raises(ConfigurationError, match=r"column of pose_x: .*got 'x_mm, X_m'"):
        read_numbers(path, "table", quantities, 1000, 9)
    path.write_text(numbers_to_csv(quantities, values))
    for rows, size, words in ((1, 1000, "at most 1 rows"), (9, 10, "at most 10 bytes")):
        with pytest.raises(ConfigurationError, match=words):
            read_numbers(path, "table", quantities, size, rows)
    for unit in ENDINGS:
        assert quantity_of(column_name("of_something", unit)) == ("of_something", 1.0)
    assert quantity_of("POSE_X_MM") == ("POSE_X", 1e-3)


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_whatever_stops_the_writing_the_old_file_stays_and_nothing_else(tmp_path, monkeypatch, failure):
    path = tmp_path / "kept.json"
    write_atomically(path, b"old\r\n")

    def fail(*_):
        raise failure

    for bad in (tmp_path / "no" / "folder", tmp_path):
        with pytest.raises(ConfigurationError) as caught:
            write_atomically(bad, b"x")
        assert caught.value.key == str(bad)
    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises((DiskError, KeyboardInterrupt)) as caught:
        write_atomically(path, b"new")
    assert "No space left" in str(caught.value) or isinstance(failure, KeyboardInterrupt)
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"old\r\n", [path])


def test_threads_that_write_to_one_place_leave_the_content_of_one(tmp_path):
    path, problems = tmp_path / "kept", []

    def write(content):
        try:
            for _ in range(50):
                write_atomically(path, content)
        except ConfigurationError as error:
            problems.append(error)

    threads = [threading.Thread(target=write, args=(bytes([number]) * 5000,)) for number in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert problems == []
    assert path.read_bytes() in [bytes([number]) * 5000 for number in range(4)]
    assert list(tmp_path.iterdir()) == [path]


def test_a_table_of_a_million_columns_is_refused_by_its_header(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_text(",".join(map(str, range(10**6))) + "\n")
    for load in (load_log, lambda path: RecordedReference(motion_file=str(path)).evaluate(0.0)):
        with pytest.raises(ConfigurationError, match="at most 5000 columns, got '1000000 columns'"):
            load(path)


def test_a_folder_is_one_process_s_at_a_time_and_cleared_of_what_a_killed_one_left(tmp_path):
    for name in (".mine", ".file.77.part"):
        (tmp_path / name).write_bytes(b"half")
    for _ in range(2):
        with locked_folder(tmp_path):
            with pytest.raises(ConfigurationError, match="no other process"), locked_folder(tmp_path):
                pass
            assert {path.name for path in tmp_path.iterdir()} == {".mine", ".lock"}
    assert [path.name for path in tmp_path.iterdir()] == [".mine"]


def test_relative_paths_are_taken_from_the_folder_however_deep_and_others_stay():
    data = {
        "tuner": {"weights_file": "net.json"},
        "reference": {"parts": [{"motion": {"motion_file": "a/b.csv"}}, {"motion_file": "/c.csv"}]},
        "distributions": {"robot": {"kind": "grid", "values": ["mine.yaml", "paper"]}},
        "disturbances": ["mine.py:Mine", "package.module:Mine"],
        "set": {"reference.motion_file": "d.csv", "name": "net.json", "safety.monitors[0]": "a/../m.py:M"},
    }
    assert anchored(data, Path("/base")) == {
        "tuner": {"weights_file": "/base/net.json"},
        "reference": {"parts": [{"motion": {"motion_file": "/base/a/b.csv"}}, {"motion_file": "/c.csv"}]},
        "distributions": {"robot": {"kind": "grid", "values": ["/base/mine.yaml", "paper"]}},
        "disturbances": ["/base/mine.py:Mine", "package.module:Mine"],
        "set": {
            "reference.motion_file": "/base/d.csv",
            "name": "net.json",
            "safety.monitors[0]": "/base/a/../m.py:M",
        },
    }


def test_overrides_are_taken_from_the_current_folder_and_the_file_from_its_own(tmp_path, monkeypatch):
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine.py").write_text("one = 1\n")
    path = tmp_path / "there" / "scenario.yaml"
    path.write_text("controller: mine.py:Mine\n")
    monkeypatch.chdir(tmp_path / "here")
    for overrides, folder in (((), "there"), (["controller.kind=mine.py:Mine"], "here")):
        loaded = load_scenario(path, overrides, trust_code=True)
        assert Path(loaded.controller.code.place) == tmp_path / folder / "mine.py"


def test_every_text_file_of_the_package_is_read_and_written_in_utf_8_whatever_the_locale():
    others = [
        f"{path.name}:{node.lineno}"
        for path in Path(stewart_drake.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        if node.func.attr in ("read_text", "write_text") and "encoding" not in [each.arg for each in node.keywords]
    ]
    assert others == []
