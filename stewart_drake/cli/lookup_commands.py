"""Commands for what to write into a scenario, and whether all is well here: `list`, `explain`, `init`, `doctor`."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from itertools import takewhile
from pathlib import Path
from typing import Any

import click
from click.shell_completion import get_completion_class

from stewart_drake.base.config import did_you_mean
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.keys import Key
from stewart_drake.base.yaml_files import read_mapping, shipped_folder
from stewart_drake.cli import options as opt
from stewart_drake.cli.options import command
from stewart_drake.cli.terminal import print_table, shown_compiling, tell
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
        every = Scenario.keys(inside=True)
        kinds = [key for key in every if key.kind and key.chooses_kind and key.name.count(".") == 1]
        rows = [(key.name.removesuffix(".kind"), key.kind, key.text) for key in kinds]
        print_table("kinds", rows, ("key", "kind", "what it is"), numbers=())


def _about(path: Path) -> str:
    """What a file says of itself, in a sentence."""
    given = read_mapping("file", path, 100).get("about")
    lines = [
        line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("# yaml-language-server")
    ]
    comment = " ".join(line.removeprefix("#").strip() for line in takewhile(lambda line: line.startswith("#"), lines))
    return str(given or re.split(r"(?<=[.!?]) |: `", comment)[0])


@command("explain")
def explain(key: str) -> None:
    """KEY is a scenario key such as controller.period, its last part such as period, a section such as limits.

    A kind such as reference.recorded has a line for each of its keys.

    Keys of the files of `sweep`, `compare` and `tune` have that name in front: sweep.distributions, compare.bands.

    Of a word for how a run ended, such as lost, or how the safety layer took a fault, such as ramped, its meaning.
    """
    every = [*Scenario.keys(inside=True), *_study_keys()]
    matching = [each for each in every if each.name == key] or [each for each in every if each.name.endswith(f".{key}")]
    inside_file = [each for each in every if each.name.rpartition(".")[0] == key and key in _STUDIES]
    if inside_file:
        lines = [(each.name.rpartition(".")[2], each.text, each.default, each.allowed) for each in inside_file]
        print_table(
            f"a file of `stewart-drake {key}`", lines, ("key", "what it does", "default", "allowed"), numbers=()
        )
        return
    section, _, kind = key.rpartition(".")
    if not matching and (of_kind := [each for each in every if each.kind == kind]):
        places = [each.name.rpartition(".")[0] for each in of_kind]
        place = section or min(places, key=len)
        there = [each for each, at in zip(of_kind, places, strict=True) if at == place and not each.chooses_kind]
        matching = [each._replace(kind="") for each in there]
    if not matching:
        from stewart_drake.logs.outcomes import OUTCOMES
        from stewart_drake.studies.faults import REACTIONS

        words = {**OUTCOMES, **REACTIONS}
        if key in words:
            print_table(
                key, [("how a run ended" if key in OUTCOMES else "reaction to a fault", words[key])], numbers=()
            )
            return
        names = dict.fromkeys(name for each in every for name in (each.name, each.name.rpartition(".")[2]))
        allowed = f"a key of a scenario, sweep or comparison, or an outcome{did_you_mean(key, [*names, *words])}"
        raise ConfigurationError("KEY", key, allowed)
    inside = [each for each in every if each.name.rpartition(".")[0] == matching[0].name and not each.chooses_kind]
    if matching[0].chooses_kind:
        print_table(key, [(each.kind, each.text) for each in matching], ("kind", "what it is"), numbers=())
        return
    kinds_of: dict[tuple[str, ...], list[str]] = {}
    for each in [*matching, *inside]:
        name, text = (each.name.rpartition(".")[2], each.sentence) if each in inside else (each.name, each.text)
        kinds_of.setdefault((name, text, each.unit, each.default, each.allowed), []).append(each.kind)
    rows = [(name, ", ".join(filter(None, kinds)), *rest) for (name, *rest), kinds in kinds_of.items()]
    header = ("key", "of kind", "what it does", "unit", "default", "allowed")
    used = [place for place in range(len(header)) if any(row[place] for row in rows)]
    if len(rows) == 1:
        print_table(key, [(header[place], rows[0][place]) for place in used], numbers=())
    else:
        print_table(key, [[row[place] for place in used] for row in rows], [header[place] for place in used], ())


_STUDIES = ("sweep", "compare", "tune")


def _study_keys() -> Iterator[Key]:
    """The keys of the files of studies, with the command's name before them; `tune` is a section of a comparison."""
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
    """FILE is the scenario to write [default: scenario.yaml]; or a sweep, or a comparison, also one to tune."""
    if file.exists():
        raise ConfigurationError("FILE", str(file), "a new file")
    if study is not None:
        text = (Path(__file__).with_name("templates") / f"{study}.yaml").read_text(encoding="utf-8")
        if scenario is not None:
            text = re.sub(r"(?<=\nscenario: )exact_breathing *", lambda _: f"{json.dumps(scenario)}    ", text)
        write_text(file, text.replace("FILE", str(file)))
        tell(f"file in {file}; next: stewart-drake {study} {file}")
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
        "# `stewart-drake explain KEY` explains a key. The robot has encoders, delay and friction, as a real one.",
        *_commented({"name": file.stem, **{key: given[key] for key in given if key != "name"}}, texts),
        "",
        "# These keys have their defaults:",
        *(f"# {name}{_comment(texts[name])}" for name in others),
    ]
    write_text(file, "\n".join(lines) + "\n")
    load_scenario(file)
    tell(f"scenario in {file}; next: stewart-drake run {file}")


def _commented(data: Mapping[str, Any], texts: Mapping[str, Key], before: str = "") -> Iterator[str]:
    """Lines of YAML, each with what its key does."""
    indent = "  " * before.count(".")
    for name, value in data.items():
        comment = _comment(texts[before + name], value) if before + name in texts else ""
        if isinstance(value, dict):
            yield f"{indent}{name}:{comment}"
            yield from _commented(value, texts, f"{before}{name}.")
        else:
            plain = isinstance(value, str) and value.isidentifier()
            yield f"{indent}{name}: {value if plain else json.dumps(value)}{comment}"


def _comment(key: Key, value: Any = None) -> str:
    """What a key does; of a text that goes through the values, what this one does."""
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
    unsaid = {"source", "git_revision"} if versions["git_revision"] is None else {"source"}
    rows = [(name, version or "not installed") for name, version in versions.items() if name not in unsaid]
    rows.append(("graphviz", shutil.which("dot") or "not installed: runs write diagram.dot, but no diagram.svg"))
    cache = jit._FOLDER
    kept = "not cached: set NUMBA_CACHE_DIR to a writable folder"
    if cache is not None:
        size = sum(path.stat().st_size for path in cache.rglob("*") if path.is_file())
        kept = f"{cache}, {size / 1e6:.0f} MB"
    rows.append(("compiled code", kept))
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
