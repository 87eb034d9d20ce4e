"""The whole report: sections in order, finished ones kept, so that an interrupted reproduction goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from importlib import import_module
from pathlib import Path

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import checksum, digest, read_checked, seal, unseal, write_atomically
from stewart_drake.logs.versions import collect_versions, package_version
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.paper.rendering import render
from stewart_drake.paper.report import Section, write_report
from stewart_drake.paper.study import Study
from stewart_drake.planning.pose_box import NEAR
from stewart_drake.references import paper_reference
from stewart_drake.runs.outputs import prepare_folder
from stewart_drake.scenario import Scenario
from stewart_drake.studies.runs import identity

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

MAX_PART_BYTES = 100_000_000
PAPER_DURATION = 10.0
"""[s] for which the robot must be able to follow (37), (38)."""


def reproduce(
    folder: Path,
    quick: bool = False,
    base: Scenario | None = None,
    progress: Callable[[str, float], None] | None = None,
    finished: Callable[[Section], None] | None = None,
) -> list[Section]:
    """Makes the report in `folder`: report.html, report.md, report.json, figures/.

    Args:
        folder: Where to; finished parts of an earlier call with the same code and settings are used again, as long as
            the files that belong to them are still there and unchanged.
        quick: Smaller sizes.
        base: Scenario to vary; None takes the defaults.
        progress: Called with the section at hand and the share of the whole that is done, 0 to 1.
        finished: Called with each section as soon as it is done, or found as a finished part.

    Returns:
        The sections.

    Raises:
        ConfigurationError: See `check_base`; or the folder cannot be written to or is in use. Found before any work.
    """
    base = Scenario() if base is None else base
    check_base(base)
    folder = prepare_folder(folder)
    study = Study(folder, quick, base)
    with study.locked("parts", "figures"):
        return _reproduce(study, progress, finished)


def _reproduce(
    study: Study, progress: Callable[[str, float], None] | None, finished: Callable[[Section], None] | None
) -> list[Section]:
    folder, quick, base, parts = study.folder, study.quick, study.base, study.folder / "parts"
    versions = collect_versions() | {"torch": package_version("torch")}
    stamp = _stamp(base, quick, versions)
    sections = []
    for index, key in enumerate(SECTIONS):

        def advance(share: float, index: int = index, key: str = key) -> None:
            if progress is not None:
                progress(key, (index + share) / len(SECTIONS))

        advance(0.0)
        path = parts / f"{key}-{stamp}.json"
        section = _kept(path, folder)
        if section is None:
            made = import_module(f"{__package__}.{key}_section").make(replace(study, progress=advance))
            section = _keep(made, path, folder)
        sections.append(section)
        if finished is not None:
            finished(section)
        advance(1.0)
    preface = render("report", "preface", quick=quick, versions=versions, near=NEAR)
    write_report(folder, render("report", "title"), preface, sections)
    numbers = {section.key: section.numbers for section in sections}
    document = {"quick": quick, "versions": versions, "scenario": base.to_dict(), "numbers": numbers}
    write_atomically(folder / "report.json", (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())
    return sections


def check_base(base: Scenario) -> None:
    """Refuses a scenario from which the report cannot be made, before any work.

    Raises:
        ConfigurationError: `base` itself cannot run; its robot cannot follow the paper's reference (37), (38) within
            its limits, with gravity or without; its weights file cannot be used.
    """
    from stewart_drake.runs.simulation import check_scenario

    check_scenario(base)
    base.load_tuner_network()
    paper = base.replace({"reference": asdict(paper_reference()), "duration": PAPER_DURATION})
    for gravity in (0.0, base.gravity or STANDARD_GRAVITY):
        check_scenario(paper.replace({"gravity": gravity}))


def _keep(section: Section, path: Path, folder: Path) -> Section:
    """Writes a finished part, the section and digests of its files; returns the section as it will be read back."""
    text = section.to_json()
    part = {"section": json.loads(text), "digests": _digests(section, folder)}
    write_atomically(path, json.dumps(seal(part), indent=1, allow_nan=False).encode())
    return Section.from_json(text)


def _kept(path: Path, folder: Path) -> Section | None:
    """The part at `path`; None where there is none, or where it or its files are no longer what was written."""
    try:
        part = unseal(json.loads(read_checked(path, f"part {path}", MAX_PART_BYTES).decode()))
        section = Section.from_json(json.dumps(part["section"]))
        digests = _digests(section, folder)
        return section if part["digests"] == digests and None not in digests.values() else None
    except (ConfigurationError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _digests(section: Section, folder: Path) -> dict[str, str | None]:
    return {name: digest(folder / name) for name in section.files}


def _stamp(base: Scenario, quick: bool, versions: dict[str, str | None]) -> str:
    work = {"scenario": base.to_dict(), "quick": quick}
    return checksum(identity(work, [base], versions, more=["torch"]))[:12]
