"""Where we leave the print, and where each departure can be seen or is tested: the table is in the template."""

from __future__ import annotations

import re

from stewart_drake.paper.rendering import render
from stewart_drake.paper.report import Section
from stewart_drake.paper.study import Study


def departures() -> list[list[str]]:
    """Equation or place; what is printed; what we do; where it shows, sections of the report and files."""
    rows = [line for line in render("departures", "body").split("\n") if line.startswith("| ")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows[1:]]


def make(study: Study) -> Section:
    """The section; see the module."""
    section = study.section("departures", {"departures": len(departures())})
    study.progress(1.0)
    return section
