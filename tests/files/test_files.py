import os
import stat
from pathlib import Path

import pytest

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import locked_folder, write_atomically


def test_a_file_holds_exactly_what_was_written(tmp_path):
    content = bytes(range(256)) + b"\r\n\n"
    for path in (tmp_path / "new", tmp_path / "with space and .dots.json"):
        write_atomically(path, content)
        assert path.read_bytes() == content
    write_atomically(tmp_path / "new", b"")
    assert (tmp_path / "new").read_bytes() == b""
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new", "with space and .dots.json"]


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize("step", ["chmod", "replace"])
def test_whatever_stops_the_writing_the_old_file_stays_and_nothing_else(tmp_path, monkeypatch, failure, step):
    path = tmp_path / "kept"
    path.write_bytes(b"old")

    def fail(*_):
        raise failure

    monkeypatch.setattr(Path, step, fail)
    with pytest.raises(ConfigurationError if isinstance(failure, OSError) else KeyboardInterrupt) as caught:
        write_atomically(path, b"new")
    if isinstance(failure, OSError):
        assert caught.value.key == str(path)
        assert "No space left" in str(caught.value)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_reader_sees_the_old_file_until_the_new_one_is_whole(tmp_path, monkeypatch):
    path, seen = tmp_path / "file", []
    path.write_bytes(b"old")
    replace = Path.replace

    def watched(source, target):
        seen.append((path.read_bytes(), source.read_bytes(), source.parent))
        return replace(source, target)

    monkeypatch.setattr(Path, "replace", watched)
    write_atomically(path, b"new and longer")
    assert seen == [(b"old", b"new and longer", tmp_path)]
    assert path.read_bytes() == b"new and longer"


def test_what_a_killed_process_has_left_half_written_is_cleared_by_the_next(tmp_path, monkeypatch):
    (tmp_path / ".mine").write_bytes(b"not ours")
    monkeypatch.setattr(Path, "unlink", lambda *_, **__: None)  # as if the process had died
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "file", b"x")
    assert len(list(tmp_path.iterdir())) == 2
    monkeypatch.undo()
    with locked_folder(tmp_path):
        assert {path.name for path in tmp_path.iterdir()} == {".mine", ".lock"}
    assert [path.name for path in tmp_path.iterdir()] == [".mine"]


def test_a_folder_is_one_process_s_at_a_time(tmp_path):
    for _ in range(2):
        with (
            locked_folder(tmp_path),
            pytest.raises(ConfigurationError, match="no other process"),
            locked_folder(tmp_path),
        ):
            pass


def test_a_missing_folder_and_a_folder_in_the_way_are_named(tmp_path):
    for path in (tmp_path / "no" / "folder", tmp_path):
        with pytest.raises(ConfigurationError) as caught:
            write_atomically(path, b"x")
        assert caught.value.key == str(path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("umask", [0o022, 0o077])
def test_a_file_has_the_rights_that_any_other_new_file_has(tmp_path, umask):
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "ours", b"x")
        (tmp_path / "other").write_bytes(b"x")
        assert os.umask(umask) == umask  # left as it was
    finally:
        os.umask(before)
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ours", "other")]
    assert modes[0] == modes[1]
