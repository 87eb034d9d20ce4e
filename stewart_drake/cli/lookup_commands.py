"""Commands that explain files and check the installation: `list`, `explain`, `init`, `doctor`, and others."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from itertools import takewhile
from pathlib import Path

import click
from click.shell_completion import get_completion_class

from stewart_drake.base.config import did_you_mean
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import Key
from stewart_drake.base.yaml_files import read_mapping, shipped_folder
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_line, print_table, shown_compiling
from stewart_drake.runs.outputs import write_text
from stewart_drake.scenario.scenario import Scenario, load_scenario, scenario_schema

_FILES = ("scenarios", "controllers", "comparisons", "sweeps", "robots")


@command("list", what={"type": click.Choice([*_FILES, "kinds"])})
def list_(what: str | None) -> None:
    """WHAT: scenarios, controllers, comparisons, sweeps, robots, or kinds of a scenario's sections [default: all]."""
    for folder in _FILES:
        if what in (None, folder):
            files = sorted(shipped_folder(folder).glob("*.yaml"))
            print_table(folder, [(path.stem, _about(path)) for path in files], ("name", "what it is"), numbers=())
    if what in (None, "kinds"):
        kinds = [
            key for key in Scenario.keys(inside=True) if key.kind and key.chooses_kind and key.name.count(".") == 1
        ]
        rows = [(key.name.removesuffix(".kind"), key.kind, key.text) for key in kinds]
        print_table("kinds", rows, ("key", "kind", "what it is"), numbers=())


def _about(path: Path) -> str:
    """First sentence of a file's key `about`, or of its first comment."""
    given = read_mapping("file", path, 100).get("about")
    lines = [
        line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("# yaml-language-server")
    ]
    comment = " ".join(line.removeprefix("#").strip() for line in takewhile(lambda line: line.startswith("#"), lines))
    return str(given or re.split(r"(?<=[.!?]) |: `", comment)[0])


@command("explain")
def explain(key: str) -> None:
    """KEY is a scenario key such as controller.period, its last part such as period, a section such as limits.

    A kind such as reference.recorded has a line per key.

    Keys of the files of `sweep`, `compare` and `tune` begin with that name: sweep.distributions, compare.bands.

    KEY may also be an outcome of a run, such as lost, or a reaction of the safety layer, such as ramped.
    """
    every = [*Scenario.keys(inside=True), *_study_keys()]
    if key in _STUDIES and (of_file := [item for item in every if _parent(item) == key]):
        lines = [(_last_part(item), item.text, item.default, item.allowed) for item in of_file]
        header = ("key", "what it does", "default", "allowed")
        print_table(f"a file of `stewart-drake {key}`", lines, header, numbers=())
        return
    matching = [item for item in every if item.name == key] or [item for item in every if item.name.endswith(f".{key}")]
    section, _, kind = key.rpartition(".")
    if not matching and (of_kind := [item for item in every if item.kind == kind]):
        place = section or min(map(_parent, of_kind), key=len)
        of_place = (item for item in of_kind if _parent(item) == place and not item.chooses_kind)
        matching = [item._replace(kind="") for item in of_place]
    if not matching:
        _explain_outcome(key, every)
    elif matching[0].chooses_kind:
        print_table(key, [(item.kind, item.text) for item in matching], ("kind", "what it is"), numbers=())
    else:
        inside = [item for item in every if _parent(item) == matching[0].name and not item.chooses_kind]
        rows = [(item.name, item.text, item) for item in matching]
        _print_keys(key, rows + [(_last_part(item), item.sentence, item) for item in inside])


def _parent(key: Key) -> str:
    return key.name.rpartition(".")[0]


def _last_part(key: Key) -> str:
    return key.name.rpartition(".")[2]


def _print_keys(title: str, keys: Iterable[tuple[str, str, Key]]) -> None:
    """A table of keys with their names and texts, without empty columns; equal keys of several kinds are one line."""
    kinds_of: dict[tuple[str, ...], list[str]] = {}
    for name, text, key in keys:
        kinds_of.setdefault((name, text, key.unit, key.default, key.allowed), []).append(key.kind)
    rows = [(name, ", ".join(filter(None, kinds)), *rest) for (name, *rest), kinds in kinds_of.items()]
    header = ("key", "of kind", "what it does", "unit", "default", "allowed")
    used = [place for place in range(len(header)) if any(row[place] for row in rows)]
    if len(rows) == 1:
        print_table(title, [(header[place], rows[0][place]) for place in used], numbers=())
    else:
        print_table(title, [[row[place] for place in used] for row in rows], [header[place] for place in used], ())


def _explain_outcome(word: str, keys: Iterable[Key]) -> None:
    from stewart_drake.logs.outcomes import OUTCOMES
    from stewart_drake.studies.faults import REACTIONS

    outcomes = {**OUTCOMES, **REACTIONS}
    if word not in outcomes:
        names = dict.fromkeys(name for key in keys for name in (key.name, _last_part(key)))
        allowed = f"a key of a scenario, sweep or comparison, or an outcome{did_you_mean(word, [*names, *outcomes])}"
        raise ConfigurationError("KEY", word, allowed)
    print_table(word, [("outcome of a run" if word in OUTCOMES else "reaction to a fault", outcomes[word])], numbers=())


_STUDIES = ("sweep", "compare", "tune")


def _study_keys() -> Iterator[Key]:
    """Keys of the files of studies, which begin with the command's name; `tune` is a section of a comparison."""
    from stewart_drake.studies.comparison_file import CompareFile
    from stewart_drake.studies.sweep import SweepFile

    for name, file in (("sweep", SweepFile), ("compare", CompareFile)):
        for key in file.keys(inside=True):
            yield key._replace(name=f"{name}.{key.name}")


@command(
    "init",
    file={"type": opt.OUT_FILE, "default": "scenario.yaml"},
    study=opt.option("Write a file for this command instead.", click.Choice(_STUDIES), "--for"),
    scenario=opt.option("The scenario of that file [default: exact_breathing].", metavar="SCENARIO"),
)
def init(file: Path, study: str | None, scenario: str | None) -> None:
    """FILE is the scenario to write [default: scenario.yaml]; with --for a sweep, a comparison or one to tune."""
    if file.exists():
        raise ConfigurationError("FILE", str(file), "a new file")
    if study is not None:
        text = (Path(__file__).with_name("templates") / f"{study}.yaml").read_text(encoding="utf-8")
        if scenario is not None:
            text = re.sub(r"(?<=\nscenario: )exact_breathing *", lambda _: f"{json.dumps(scenario)}    ", text)
        write_text(file, text.replace("FILE", str(file)))
        print_line(f"file in {file}; next: stewart-drake {study} {file}")
        return
    if scenario is not None:
        raise ConfigurationError("--scenario", scenario, "no value without --for")
    texts: dict[str, Key] = {}
    given = read_mapping("scenario", shipped_folder("scenarios") / "exact_breathing.yaml", 100)
    given["reference"] = {"kind": "sine", "amplitude": [0.05, 0, 0, 0, 0, 0.01], "angular_frequency": 2}
    for key in Scenario.keys(inside=True):
        section = given.get(key.name.partition(".")[0])
        kind = section.get("kind") if isinstance(section, dict) else section
        if key.name not in texts or key.kind == kind:
            texts[key.name] = key
    others = [name for name in Scenario.__pydantic_fields__ if name not in given]
    lines = [
        f"# A scenario: `stewart-drake run {file}` runs it, `stewart-drake check {file}` checks its motion,",
        "# `stewart-drake explain KEY` explains a key. The robot has encoders, delay and friction, like a real one.",
        *_commented({"name": file.stem, **{key: given[key] for key in given if key != "name"}}, texts),
        "",
        "# These keys have their defaults:",
        *(f"# {name}{_comment(texts[name])}" for name in others),
    ]
    write_text(file, "\n".join(lines) + "\n")
    load_scenario(file)
    print_line(f"scenario in {file}; next: stewart-drake run {file}")


def _commented(data: Mapping[str, object], texts: Mapping[str, Key], before: str = "") -> Iterator[str]:
    """Lines of YAML with comments that explain the keys."""
    indent = "  " * before.count(".")
    for name, value in data.items():
        comment = _comment(texts[before + name], value) if before + name in texts else ""
        if isinstance(value, dict):
            yield f"{indent}{name}:{comment}"
            yield from _commented(value, texts, f"{before}{name}.")
        else:
            plain = isinstance(value, str) and value.isidentifier()
            yield f"{indent}{name}: {value if plain else json.dumps(value)}{comment}"


def _comment(key: Key, value: object = None) -> str:
    """Comment for a key with its unit and text, or the part of the text that explains `value`."""
    chosen = re.search(rf"(?:^|\. ){value}: ([^.]+)", key.text) if isinstance(value, str) else None
    sentence = chosen[1] if chosen else key.sentence
    words = f"[{key.unit}] {sentence}" if key.unit else sentence
    return f"  # {words.strip()}" if words else ""


@command("doctor")
def doctor() -> None:
    """Prints versions, graphviz, the cache of compiled code, the time of a control tick, and write permission."""
    from stewart_drake.base import jit
    from stewart_drake.logs.versions import collect_versions, package_version
    from stewart_drake.runs.simulation import run

    versions = collect_versions() | {
        name: package_version(name) for name in ("numba", "torch", "mujoco", "distributed")
    }
    # Outside of a checkout there is no revision.
    hidden = {"source", "git_revision"} if versions["git_revision"] is None else {"source"}
    rows = [(name, version or "not installed") for name, version in versions.items() if name not in hidden]
    rows.append(("graphviz", shutil.which("dot") or "not installed: runs write diagram.dot, but no diagram.svg"))
    cache = jit._FOLDER
    text = "not cached: set NUMBA_CACHE_DIR to a writable folder"
    if cache is not None:
        size = sum(path.stat().st_size for path in cache.rglob("*") if path.is_file())
        text = f"{cache}, {size / 1e6:.0f} MB"
    rows.append(("compiled code", text))
    with shown_compiling():
        logs = [run(load_scenario("exact_breathing", ["plant.kind=closed_form", "duration=1"])) for _ in range(2)]
    ticks = logs[1].end_time / logs[1].scenario.controller.period
    rows.append(("a tick of exact_breathing, fast engine", f"{1e6 * logs[1].wall_time / ticks:.0f} us of 1000 us"))
    rows.append(("cores", str(os.cpu_count())))
    rows.append(("this folder", "writable" if os.access(".", os.W_OK) else "not writable: use --out"))
    print_table("doctor", rows, numbers=())


@command("schema")
def schema() -> None:
    click.echo(json.dumps(scenario_schema(), indent=2))


@command("completion", shell={"type": click.Choice(["bash", "zsh", "fish"])})
def completion(shell: str) -> None:
    """For bash, add to ~/.bashrc: eval "$(stewart-drake completion bash)". Other shells: to their start file."""
    cls = get_completion_class(shell)
    assert cls is not None
    click.echo(cls(opt.cli, {}, "stewart-drake", "_STEWART_DRAKE_COMPLETE").source())
