import functools
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from conftest import make_network
from quick_report import FASTER

from stewart_drake.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.logs import versions
from stewart_drake.paper import reproduce as module
from stewart_drake.paper.report import Section
from stewart_drake.paper.reproduce import check_base, reproduce
from stewart_drake.scenario import Scenario

ROOT = Path(__file__).parent.parent.parent
PNG = b"\x89PNG\r\n\x1a\n"
KEYS = ("first", "second", "third")
# The clearance of links takes most of the check's time and changes nothing of its logic.
BASE = Scenario.from_dict({"limits": {"clearance": None}})


# A base that has passed is not looked at again in every test.
once_checked = functools.cache(check_base)


@pytest.fixture
def made(monkeypatch):
    """Three small sections in place of the report's own; the list names those that were computed, with their size."""
    calls = []

    def module_of(key):
        def make(study):
            calls.append((key, study.quick))
            study.progress(0.5)
            body = f"![A line](<figures/{key}.png>)"
            numbers = {"rows": (1, 2.5, None), "size": study.pick(10, 3), "z": {"pi": float(np.pi)}}
            (study.folder / "figures").mkdir(exist_ok=True)
            (study.folder / "figures" / f"{key}.png").write_bytes(PNG + study.pick(b"whole", b"quick"))
            (study.folder / f"{key}.txt").write_text(str(study.quick))
            words = f"The {key}", f"Claim of {key}.", f"Verdict of {key}."
            return Section(key, *words, body, numbers, [f"figures/{key}.png", f"{key}.txt"])

        made = ModuleType(key)
        made.make = make
        return made

    package = module.__package__
    for key in KEYS:
        monkeypatch.setitem(sys.modules, f"{package}.{key}_section", module_of(key))
    monkeypatch.setattr(module, "SECTIONS", KEYS)
    monkeypatch.setattr(module, "check_base", once_checked)
    # What is tested here must not depend on whether someone commits meanwhile.
    monkeypatch.setattr(versions, "git_revision", lambda: "abc")
    monkeypatch.setattr(versions, "source_digest", lambda: "as it is")
    return calls


def content(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def stop_at(key, share):
    def progress(at, whole):
        if at == key and whole * len(KEYS) - KEYS.index(key) >= share - 1e-9:
            raise KeyboardInterrupt

    return progress


# --- what is left behind -------------------------------------------------------------------------------------------


def test_a_report_holds_every_section_and_its_numbers(tmp_path, made):
    sections = reproduce(tmp_path / "out", base=BASE)
    assert [section.key for section in sections] == list(KEYS)
    document = json.loads((tmp_path / "out" / "report.json").read_text(), parse_constant=pytest.fail)
    assert document["numbers"] == {section.key: section.numbers for section in sections}
    assert document["numbers"]["first"] == {"rows": [1, 2.5, None], "size": 10, "z": {"pi": np.pi}}
    assert document["quick"] is False
    assert Scenario.from_dict(document["scenario"]) == BASE
    assert {"drake", "numpy", "torch", "source"} <= set(document["versions"])
    for name in ("report.md", "report.html"):
        text = (tmp_path / "out" / name).read_text()
        for key in KEYS:
            assert f"Claim of {key}." in text
            assert text.count(f"Verdict of {key}.") == 2
        assert "quick version" not in text
        assert "marks a departure from the print" in text
    assert made == [(key, False) for key in KEYS]


def test_each_section_is_handed_on_as_soon_as_it_is_there(tmp_path, made):
    seen = []
    sections = reproduce(tmp_path, base=BASE, finished=lambda section: seen.append((section, len(made))))
    assert seen == list(zip(sections, (1, 2, 3), strict=True))


def test_the_default_base_is_the_default_scenario(tmp_path, made):
    reproduce(tmp_path, quick=True)
    document = json.loads((tmp_path / "report.json").read_text())
    assert Scenario.from_dict(document["scenario"]) == Scenario()
    assert document["quick"] is True
    assert document["numbers"]["second"]["size"] == 3
    assert "quick version" in (tmp_path / "report.md").read_text()
    assert made == [(key, True) for key in KEYS]


# --- going on ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("at", "share", "before", "after"),
    [
        ("first", 0.0, [], ["first", "second", "third"]),
        ("first", 1.0, ["first"], ["second", "third"]),
        ("second", 0.0, ["first"], ["second", "third"]),
        ("second", 0.5, ["first", "second"], ["second", "third"]),
        ("third", 1.0, ["first", "second", "third"], []),
    ],
)
def test_an_interrupted_reproduction_goes_on_where_it_was(tmp_path, made, at, share, before, after):
    with pytest.raises(KeyboardInterrupt):
        reproduce(tmp_path, base=BASE, progress=stop_at(at, share))
    assert [key for key, _ in made] == before
    assert not (tmp_path / "report.html").exists()
    made.clear()
    resumed = reproduce(tmp_path, base=BASE)
    assert [key for key, _ in made] == after
    made.clear()
    whole = reproduce(tmp_path / "another", base=BASE)
    assert resumed == whole
    for name in ("report.md", "report.html", "report.json"):
        assert (tmp_path / name).read_bytes() == (tmp_path / "another" / name).read_bytes()


def test_a_finished_report_is_made_again_without_any_work(tmp_path, made):
    first = reproduce(tmp_path, base=BASE)
    before, again = content(tmp_path), []
    made.clear()
    reproduce(tmp_path, base=BASE, finished=again.append)
    assert made == []
    assert again == first
    assert content(tmp_path) == before


def another_number(part):
    document = json.loads(part.read_text())
    document["section"]["numbers"]["another"] = 3
    part.write_text(json.dumps(document))


def a_pipe(part):
    part.unlink()
    os.mkfifo(part)


def a_device(part):
    part.unlink()
    part.symlink_to("/dev/zero")


TEXTS = ["", "{", "[]", "{}", '{"section": {}, "digests": {}}', '{"section": 3}', "another report's"]
SPOILT = [
    *(("parts/first-*.json", spoil) for spoil in (another_number, a_pipe, a_device, Path.unlink, *TEXTS)),
    *((name, spoil) for name in ("first.txt", "figures/first.png") for spoil in (Path.unlink, "another report's")),
]


@pytest.mark.parametrize(("name", "spoil"), SPOILT, ids=lambda value: getattr(value, "__name__", value))
def test_a_part_that_is_not_what_was_written_or_whose_files_are_not_is_made_again(tmp_path, made, name, spoil):
    reproduce(tmp_path, base=BASE)
    before, (path,) = content(tmp_path), tmp_path.glob(name)
    path.write_text(spoil) if isinstance(spoil, str) else spoil(path)
    made.clear()
    reproduce(tmp_path, base=BASE)
    assert made == [("first", False)]
    assert content(tmp_path) == before


def test_quick_and_whole_in_one_folder_do_not_mix(tmp_path, made):
    reproduce(tmp_path, base=BASE)
    whole = content(tmp_path)
    reproduce(tmp_path, quick=True, base=BASE)
    assert content(tmp_path)["first.png"] != whole["first.png"]
    assert [quick for _, quick in made] == [False] * 3 + [True] * 3
    reproduce(tmp_path, base=BASE)
    assert {name: (tmp_path / name).read_bytes() for name in ("report.html", "report.json", "first.txt")} == {
        name: whole[name] for name in ("report.html", "report.json", "first.txt")
    }


def test_other_settings_other_weights_and_other_code_give_other_parts(tmp_path, made, monkeypatch):
    weights = tmp_path / "tuner.json"
    make_network(seed=0).save(weights)
    base = BASE.replace({"tuner.weights_file": str(weights)})

    def computed(**options):
        made.clear()
        reproduce(tmp_path / "out", **{"base": base, **options})
        return len(made)

    assert computed() == 3
    assert computed() == 0
    assert computed(base=base.replace({"robot.platform_mass": 1.01})) == 3
    assert computed(base=base.replace({"controller.period": 0.01})) == 3
    make_network(seed=1).save(weights)
    assert computed() == 3
    real = versions.package_version
    for name in ("torch", "drake", "scipy"):
        monkeypatch.setattr(
            "stewart_drake.logs.versions.package_version",
            lambda asked, name=name: "9" if asked == name else real(asked),
        )
        monkeypatch.setattr(module, "package_version", versions.package_version)
        assert computed() == 3, name
    monkeypatch.setattr(versions, "source_digest", lambda: "changed")
    assert computed() == 3


# --- bad input -----------------------------------------------------------------------------------------------------

HOLD = {"reference": {"kind": "hold"}}
BAD_BASE = {
    "rods too short": ({"robot.rod_length": 0.3}, InfeasibleReferenceError),
    "own reference out of reach": ({"reference.amplitude": [1.5, 0, 0, 0, 0, 0]}, InfeasibleReferenceError),
    "paper's reference out of the limits": (HOLD | {"limits.joint_swing": 0.5}, InfeasibleReferenceError),
    "only later out of the limits": ({"duration": 0.1, "limits.joint_swing": 0.5}, InfeasibleReferenceError),
    "too weak once there is gravity": (HOLD | {"gravity": 0.0, "robot.effort_limit": 0.2}, InfeasibleReferenceError),
    "weights": ({"tuner.weights_file": "tuner.json"}, ConfigurationError),
}


@pytest.mark.parametrize("case", BAD_BASE)
def test_a_base_that_cannot_do_it_is_refused_before_any_work(tmp_path, monkeypatch, made, case):
    monkeypatch.chdir(tmp_path)
    Path("tuner.json").write_text('{"format": "stewart-drake tuner", "version": 1')
    changes, kind = BAD_BASE[case]
    with pytest.raises(kind):
        reproduce(tmp_path / "new", base=BASE.replace(changes))
    assert made == []
    assert not (tmp_path / "new").exists()


def test_the_checks_let_good_bases_pass():
    check_base(BASE)
    check_base(BASE.replace({"tuner": {"kind": "fixed"}, "gravity": 0.0, "duration": 0.1}))


@pytest.mark.parametrize("where", ["a file", "below a file", "/proc/x"])
def test_a_folder_that_cannot_be_written_to_is_refused_before_any_work(tmp_path, made, where):
    (tmp_path / "file").write_text("mine")
    folder = {"a file": tmp_path / "file", "below a file": tmp_path / "file" / "x"}.get(where, Path(where))
    with pytest.raises(ConfigurationError, match="a folder that can be written to"):
        reproduce(folder, base=BASE)
    assert made == []
    assert content(tmp_path) == {"file": b"mine"}


def test_numbers_that_json_does_not_have_end_the_report_before_anything_is_overwritten(tmp_path, made, monkeypatch):
    reproduce(tmp_path, base=BASE)
    before = content(tmp_path)
    third = sys.modules[f"{module.__package__}.third_section"]
    real = third.make

    def broken(study):
        section = real(study)
        section.numbers["it"] = float("nan")
        return section

    monkeypatch.setattr(third, "make", broken)
    with pytest.raises(ValueError, match="JSON"):
        reproduce(tmp_path, quick=True, base=BASE)
    for name in ("report.html", "report.md", "report.json"):
        assert content(tmp_path)[name] == before[name]
    assert len(made) == 6


# --- the command ---------------------------------------------------------------------------------------------------


@pytest.fixture
def call(call):
    """The subcommand."""
    return functools.partial(call, "reproduce")


def test_the_command_makes_the_report_and_prints_each_verdict(call, made):
    status, out, err = call("--quick", "--set", "limits.clearance=null")
    assert status == 0
    for key in KEYS:
        assert f"The {key}" in out
        assert f"Verdict of {key}." in out
    assert "100 / 100 %" in err
    assert [line for line in err.splitlines() if line.startswith("done: ")] == [f"done: The {key}" for key in KEYS]
    assert "runs/reproduction/report.html" in out
    assert Path("runs/reproduction/report.html").is_file()
    assert made == [(key, True) for key in KEYS]
    assert call("--quick", "--set", "limits.clearance=null", "--quiet") == (0, "", "")
    assert len(made) == 3


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--set", "robot.rod_length=0.3"], ["reference", "leg"]),
        (["--set", "tuner.weights_file=none.json"], ["none.json"]),
        (["--scenario", "paper_fig8"], ["paper_fig8", "paper_fig7"]),
        (["--out", "file"], ["--out", "this is a file"]),
    ],
)
def test_the_command_refuses_bad_input_in_one_line_and_writes_nothing(call, made, tmp_path, args, words):
    (tmp_path / "file").write_text("mine")
    status, out, err = call(*args)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1, err
    assert [word for word in words if word not in err] == []
    assert content(tmp_path) == {"file": b"mine"}
    assert sorted(tmp_path.iterdir()) == [tmp_path / "file"]
    assert made == []


def test_the_command_ends_with_130_when_it_is_interrupted(call, made, monkeypatch):
    second = sys.modules[f"{module.__package__}.second_section"]
    real = second.make

    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(second, "make", interrupted)
    status, out, err = call("--set", "limits.clearance=null")
    assert (status, out) == (130, "")
    assert err.splitlines()[-1] == "stewart-drake: interrupted"
    monkeypatch.setattr(second, "make", real)
    assert call("--set", "limits.clearance=null", "--quiet")[0] == 0
    assert [key for key, _ in made] == ["first", "second", "third"]


# --- the whole -----------------------------------------------------------------------------------------------------


def test_a_shell_finds_the_finished_report_and_prints_each_verdict(report):
    code = "from stewart_drake.cli.app import main\nif __name__ == '__main__': main()"
    env = os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    sets = [word for key, value in FASTER.items() for word in ("--set", f"{key}={json.dumps(value)}")]
    command = [sys.executable, "-c", code, "reproduce", "--quick", "--out", str(report.folder), *sets]
    before = content(report.folder / "parts") | content(report.folder / "figures")
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert [section.title for section in report.sections.values() if section.title not in done.stdout] == []
    assert content(report.folder / "parts") | content(report.folder / "figures") == before
