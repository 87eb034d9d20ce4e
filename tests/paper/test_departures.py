import re
from pathlib import Path

import pytest

from stewart_drake.paper.departures_section import departures, make
from stewart_drake.paper.rendering import render
from stewart_drake.paper.reproduce import SECTIONS
from stewart_drake.paper.study import Study

ROOT = Path(__file__).parent.parent.parent
PACKAGE = ROOT / "stewart_drake"
ROWS = departures()


def test_entries_are_whole_and_stand_once():
    assert len({tuple(row[:2]) for row in ROWS}) == len(ROWS) == 25
    for row in ROWS:
        assert len(row) == 4
        assert all(len(text) > 2 for text in row)


@pytest.mark.parametrize("place", sorted({place for *_, places in ROWS for place in places.split("; ")}))
def test_every_place_that_is_named_exists(place):
    if file := re.fullmatch(r"`([^`]+)`", place):
        assert (PACKAGE / file[1]).is_file() or (ROOT / file[1]).is_file()
    else:
        # A reader looks for the words that a section's title begins with.
        words = re.fullmatch(r"section \*([^*]+)\*", place)[1]
        assert sum(render(key, "title").startswith(words) for key in SECTIONS) == 1


def test_every_equation_that_the_code_says_it_departs_from_is_listed():
    listed = {int(n) for where, *_ in ROWS for n in numbers_in(where)}
    named = {}
    for path in PACKAGE.rglob("*.py"):
        for passage in re.findall(r"Deviation:(.*?)(?:\n\s*\n|\"\"\"|\. [A-Z])", path.read_text(), flags=re.DOTALL):
            # What is departed from comes first; a remedy may name other equations.
            named |= dict.fromkeys(numbers_in(passage)[:1], path.name)
    assert len(named) >= 5
    # (34) is the sign that is kept, against (30).
    assert {n: file for n, file in named.items() if n not in listed | {34}} == {}


def numbers_in(text):
    """Equation numbers in brackets; a range such as (7)-(18) means all of it. (3,1) is an entry of a matrix."""
    found = []
    for low, high in re.findall(r"\((\d+)\)(?:-\((\d+)\))?", text):
        found += range(int(low), int(high or low) + 1)
    return found


def test_the_section_lists_all_of_them(tmp_path):
    section = make(Study(tmp_path))
    assert section.numbers == {"departures": len(ROWS)}
    assert section.verdict.startswith(f"Does not hold: {len(ROWS)} departures")
    assert section.body.count("\n| ") == 1 + len(ROWS)
