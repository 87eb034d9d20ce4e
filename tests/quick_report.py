"""Fixtures of the reproduction: its quick report, made once for the whole session."""

import dataclasses
import json
from typing import NamedTuple

import pytest
from conftest import once

from stewart_drake.paper.report import Section
from stewart_drake.paper.reproduce import SECTIONS, reproduce
from stewart_drake.paper.study import Study
from stewart_drake.scenario import load_scenario
from stewart_drake.studies.runs import RunStore

FASTER = {"controller.solver": "split"}
"""The same gains and ticks, and a run takes less than half the time; other tests hold them equal."""


class Report(NamedTuple):
    """The quick report: its folder, its sections by key, and each call of its progress."""

    folder: object
    sections: dict
    progress: list


@pytest.fixture(scope="session")
def report(tmp_path_factory):
    """The quick report, made once for the whole session, whichever workers ask for it."""

    def make(folder):
        shares = []
        base = load_scenario("paper_fig7").replace(FASTER)
        reproduce(folder / "out", True, base, lambda key, share: shares.append((key, share)))
        (folder / "progress.json").write_text(json.dumps(shares))

    folder = once(tmp_path_factory, "quick-report", make)
    parts = {path.name.rpartition("-")[0]: path for path in (folder / "out" / "parts").glob("*.json")}
    found = {key: Section.from_json(json.dumps(json.loads(parts[key].read_text())["section"])) for key in SECTIONS}
    return Report(folder / "out", found, json.loads((folder / "progress.json").read_text()))


@pytest.fixture
def no_pictures(monkeypatch):
    """Figures are drawn but not written, which takes most of a section's time."""
    monkeypatch.setattr(Study, "save_figure", lambda _, _figure, name: f"{name}.png")


@pytest.fixture
def runs_by(monkeypatch):
    """In place of simulations: `runs_by(rule)` makes the log of a scenario by a rule; gives the groups asked for."""

    def replace_runs(rule):
        groups = []

        def run_all(_store, scenarios, progress=None, **_options):
            groups.append(list(scenarios))
            if progress is not None:
                progress(1.0)
            return [dataclasses.replace(rule(scenario), scenario=scenario) for scenario in scenarios]

        monkeypatch.setattr(RunStore, "run_all", run_all)
        return groups

    return replace_runs
