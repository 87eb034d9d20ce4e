"""The table, its comparison with the committed one, and the page of departures."""

import csv
import json
import re
from importlib.resources import files
from pathlib import Path

import pytest
from click.testing import CliRunner

from stewart_drake.cli import run_commands
from stewart_drake.paper import reproduce as module
from stewart_drake.paper.reproduce import MODULES, Claim, Result, differences

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "stewart_drake"
TABLE = list(csv.DictReader(files("stewart_drake.paper").joinpath("claims.csv").read_text().splitlines()))


def committed(size):
    return [Claim(each["claim"], "", float(each[size]), "", True) for each in TABLE]


@pytest.mark.parametrize("size", ["quick", "full"])
def test_a_number_that_differs_from_the_committed_table_is_named(size):
    claims = committed(size)
    assert differences(claims, size) == []
    for index, each in enumerate(TABLE):
        off = float(each[size]) + (1.5 * float(each["within"]) or 1.0)
        (line,) = differences([*claims[:index], claims[index]._replace(ours=off), *claims[index + 1 :]], size)
        assert line.startswith(f"{each['claim']}: expected {float(each[size]):g} within")
    assert differences(claims[1:], size) == [f"{TABLE[0]['claim']}: only in the committed table"]
    assert len(differences([claims[0]._replace(ours=float("nan")), *claims[1:]], size)) == 1


@pytest.mark.parametrize(("off", "status"), [(0.0, 0), (1e3, 1)])
def test_the_command_prints_the_table_and_fails_on_a_changed_one(monkeypatch, tmp_path, off, status):
    claims = committed("quick")
    claims[0] = claims[0]._replace(ours=claims[0].ours + off, paper="as it says", holds=False)
    results = {"plant": Result({"order": [1.0]}, claims, {})}
    monkeypatch.setattr(module, "reproduce", lambda *_: results)
    result = CliRunner(env={"COLUMNS": "200"}).invoke(run_commands.reproduce, ["--quick", "--out", str(tmp_path)])
    assert result.exit_code == status
    words = " ".join(result.stdout.split())
    assert all(text in words for text in ("claim", "paper", "ours", "verdict", "as it says", "fails", "holds"))
    assert ("expected" in result.stderr) == bool(status)


@pytest.mark.long
@pytest.mark.torch
def test_the_quick_reproduction_is_the_committed_one(tmp_path):
    results = module.reproduce(True, tmp_path)
    assert differences([claim for result in results.values() for claim in result.claims], "quick") == []
    assert list(json.loads((tmp_path / "numbers.json").read_text())) == list(results) == list(MODULES)
    drawn = {path.stem for path in (tmp_path / "figures").glob("*.png")}
    assert drawn == {name for result in results.values() for name in result.figures}


@pytest.mark.parametrize(
    ("value", "shown"), [(2.2e-16, "< 1e-10 m"), (0.0, "< 1e-10 m"), (0, "0 m"), (2e-10, "2e-10 m"), (9.0, "9 m")]
)
def test_rounding_error_is_shown_as_a_bound(value, shown):
    assert module.rows([Claim("length", "0", value, "m", True)]) == [("length", "0", shown, "holds")]


def test_the_page_has_the_committed_numbers():
    page = (ROOT / "docs" / "results" / "reproduction.md").read_text()
    for each in TABLE:
        bound, ours = re.search(rf"^\| {re.escape(each['claim'])} \|[^|]*\| (< )?(\S+)", page, re.MULTILINE).groups()
        expected = pytest.approx(float(each["full"]), rel=1e-3)
        assert float(each["full"]) < float(ours) if bound else float(ours) == expected
    assert page.count("\n| ") == len(TABLE) + 2


LINES = [line for line in (ROOT / "docs" / "departures.md").read_text().splitlines() if line.startswith("| ")][1:]
DEPARTURES = [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in LINES]


def numbers_in(text):
    """Equation numbers in brackets; a range such as (7)-(18) means all of it. (3,1) is an entry of a matrix."""
    found = []
    for low, high in re.findall(r"\((\d+)\)(?:-\((\d+)\))?", text):
        found += range(int(low), int(high or low) + 1)
    return found


def test_departures_are_listed_once_and_name_files_that_exist():
    assert len({tuple(each[:2]) for each in DEPARTURES}) == len(DEPARTURES) == 29
    for *texts, places in DEPARTURES:
        assert all(len(text) > 2 for text in texts)
        for place in places.split("; "):
            file = re.fullmatch(r"`([^`]+)`", place)[1]
            assert (PACKAGE / file).is_file() or (ROOT / file).is_file(), file


def test_every_equation_that_the_code_says_it_departs_from_is_listed():
    listed = {number for where, *_ in DEPARTURES for number in numbers_in(where)}
    named = {}
    for path in PACKAGE.rglob("*.py"):
        for passage in re.findall(r"Deviation:(.*?)(?:\n\s*\n|\"\"\"|\. [A-Z])", path.read_text(), flags=re.DOTALL):
            # What is departed from comes first; a remedy may name other equations.
            named |= dict.fromkeys(numbers_in(passage)[:1], path.name)
    assert len(named) >= 5
    # (34) is the sign that is kept, against (30).
    assert {number: file for number, file in named.items() if number not in listed | {34}} == {}
