import re
from pathlib import Path

import pytest

from stewart_drake.paper.departures_section import DEPARTURES, TITLES, make
from stewart_drake.paper.report import Table, to_html, to_markdown
from stewart_drake.paper.reproduce import SECTIONS
from stewart_drake.paper.study import Study

ROOT = Path(__file__).parent.parent.parent
PACKAGE = ROOT / "stewart_drake"

KNOWN = {
    # what is wrong or left open in the print: where it stands, words that the entry must have
    "inertia of the crank": ("Table I", ["5.9e-5"]),
    "no joint positions": ("Joint positions", ["layout"]),
    "no limits of the joints": ("Limits", ["63.1 deg", "65 deg", "leg 2"]),
    "rods free to spin": ("Balls", ["Universal", "ball"]),
    "misprint in the rotation": ("(3)", ["(3,1)", "passive"]),
    "translation rotated as well": ("(5)", ["G"]),
    "one branch without A, B, C": ("(6)", ["Both branches", "NaN"]),
    "Euler accelerations": ("(9)", ["angular acceleration", "inertia in P"]),
    "arm not rotated": ("e_M", ["R^-1 p_i"]),
    "force of a rod": ("(15)", ["e_l . e_N", "statics"]),
    "gravity, legs, gyroscopic term": ("(7)-(18)", ["Gravity", "rods", "gyroscopic"]),
    "reference's acceleration": ("(20)", ["acceleration"]),
    "M^-1": ("(22)", ["M^-1 tau"]),
    "Hautus": ("(28), (29)", ["lambda"]),
    "sign of u": ("(30)", ["-K e", "(34)"]),
    "continuous in discrete": ("(31), (32)", ["Continuous", "hold"]),
    "form of the Riccati equation": ("(32)", ["C^T Q C", "B^T P A", "(27)"]),
    "only the ratio": ("(27)", ["ratio", "five"]),
    "density": ("(35), (36)", ["zero", "m = 49"]),
    "ANFIS": ("III.D", ["ANFIS"]),
    "amplitudes": ("III.D", ["0.3 m", "feasible"]),
    "split": ("III.D", ["whole runs"]),
    "gravity in the results": ("IV", ["gravity", "compensated"]),
    "sample time": ("IV", ["5 ms"]),
    "cited equations": ("IV", ["(37), (38)"]),
}


@pytest.mark.parametrize("what", KNOWN)
def test_every_known_departure_has_its_entry(what):
    place, words = KNOWN[what]
    texts = [" ".join((where, printed, ours)) for where, printed, ours, _ in DEPARTURES if place in where]
    assert any(all(word in text for word in words) for text in texts), texts


def test_entries_are_whole_and_stand_once():
    assert len({row[:2] for row in DEPARTURES}) == len(DEPARTURES) == len(KNOWN)
    for where, printed, ours, places in DEPARTURES:
        assert all(len(text) > 2 for text in (where, printed, ours))
        assert places


@pytest.mark.parametrize("place", sorted({place for *_, places in DEPARTURES for place in places}))
def test_every_place_that_is_named_exists(place):
    if "." in place:
        assert (PACKAGE / place).is_file() or (ROOT / place).is_file()
    else:
        assert place in SECTIONS
        # A reader looks for the title; the section's own module has it.
        path = PACKAGE / "paper" / f"{place}_section.py"
        assert re.search(rf'"{TITLES[place]}', path.read_text())


def test_every_equation_that_the_code_says_it_departs_from_is_listed():
    listed = {int(n) for where, *_ in DEPARTURES for n in numbers_in(where)}
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
    shares = []
    section = make(Study(tmp_path, progress=shares.append))
    (table,) = (item for item in section.items if isinstance(item, Table))
    assert [row[0] for row in table.rows] == [where for where, *_ in DEPARTURES]
    assert table.rows[0][3] == "`robot.py`; `tests/test_robot.py`"
    assert "section *The nine experiments*; section *The network*" in {row[3] for row in table.rows}
    assert section.numbers == {"departures": len(DEPARTURES)}
    assert section.verdict.startswith(f"Does not hold: {len(DEPARTURES)} departures")
    assert shares == [1.0]
    page = to_html(to_markdown("t", "", [section]), "t", tmp_path)
    assert page.count("<tr>") == len(DEPARTURES) + 1 + 2
    assert "<code>robot.py</code>" in page
