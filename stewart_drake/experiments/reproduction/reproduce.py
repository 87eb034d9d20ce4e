"""The whole report: sections in order, finished ones kept, so that an interrupted reproduction goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from stewart_drake.experiments.report import Section, write_report
from stewart_drake.experiments.reproduction.study import Study
from stewart_drake.files import write_atomically
from stewart_drake.scenario import Scenario
from stewart_drake.versions import collect_versions

SECTIONS = (
    "plant",
    "kinematics",
    "force_map",
    "state_space",
    "nine_experiments",
    "dataset",
    "training",
    "in_the_loop",
    "sensitivity",
    "workspace",
    "departures",
)
"""Modules of this package in the report's order; each has `make(study) -> Section`."""

TITLE = "Intelligent optimal feed-back torque control of a rotary Stewart platform: what holds and what does not"


def reproduce(
    folder: Path,
    quick: bool = False,
    base: Scenario | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> list[Section]:
    """Makes the report in `folder`: report.html, report.md, report.json, figures/.

    Args:
        folder: Where to; finished parts of an earlier call with the same code and settings are used again.
        quick: Smaller sizes.
        base: Scenario to vary; None takes the defaults.
        progress: Called with the section at hand and the share of the whole that is done, 0 to 1.

    Returns:
        The sections.

    Raises:
        ConfigurationError: The folder cannot be written to, or `base` cannot run, such as a geometry for which the
            paper's reference is out of reach; found before any work.
    """
    base = Scenario() if base is None else base
    _refuse_early(base)
    study = Study(folder, quick, base)
    parts = folder / "parts"
    parts.mkdir(parents=True, exist_ok=True)
    versions = collect_versions()
    stamp = _stamp(base, quick, versions)
    sections = []
    for index, key in enumerate(SECTIONS):

        def advance(share: float, index: int = index, key: str = key) -> None:
            if progress is not None:
                progress(key, (index + share) / len(SECTIONS))

        advance(0.0)
        path = parts / f"{key}-{stamp}.json"
        section = _kept(path)
        if section is None:
            section = import_module(f"{__package__}.{key}").make(replace(study, progress=advance))
            write_atomically(path, section.to_json().encode())
        sections.append(section)
        advance(1.0)
    write_report(folder, TITLE, _preface(quick, versions), sections)
    numbers = {section.key: section.numbers for section in sections}
    document = {"quick": quick, "versions": versions, "scenario": base.to_dict(), "numbers": numbers}
    write_atomically(folder / "report.json", (json.dumps(document, indent=1) + "\n").encode())
    return sections


def _refuse_early(base: Scenario) -> None:
    from stewart_drake.simulation import check_scenario

    check_scenario(base)
    base.load_tuner_network()


def _kept(path: Path) -> Section | None:
    try:
        return Section.from_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _stamp(base: Scenario, quick: bool, versions: dict[str, str | None]) -> str:
    same = {name: versions[name] for name in ("stewart-drake", "drake", "numpy", "scipy", "source")}
    content: list[Any] = [base.to_dict(), quick, same]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


def _preface(quick: bool, versions: dict[str, str | None]) -> str:
    size = "This is the quick version, with smaller sizes. " if quick else ""
    named = ", ".join(f"{name} {versions[name]}" for name in ("stewart-drake", "drake", "numpy", "scipy", "python"))
    return (
        "Every figure and table below was computed by `stewart-drake reproduce` in one go, on the multibody plant. "
        "Each section begins with what the paper claims and ends with what we saw. "
        f"{size}Versions: {named}; revision {versions['git_revision'] or 'unknown'}."
    )
