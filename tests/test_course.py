"""The answers of docs/course.md."""

import json
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[1] / "docs" / "course.md").read_text()
NOTEBOOK = Path(__file__).parents[1] / "notebooks" / "exercises.ipynb"
QUESTIONS = re.findall(r"^(## \d+\. .*?)\n\n```python\n", PAGE, re.DOTALL | re.MULTILINE)
ANSWERS = re.findall(r"^## (\d+)\. .*?```python\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE)


def test_there_are_thirteen_exercises():
    assert [number for number, _ in ANSWERS] == [str(number) for number in range(1, 14)]


def test_the_notebook_of_exercises_asks_what_the_page_asks():
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(NOTEBOOK.read_text())["cells"]]
    assert [source for kind, source in cells if kind == "markdown"][1:] == QUESTIONS
    assert all("..." in source for kind, source in cells if kind == "code")


@pytest.mark.slow
def test_the_margin_of_exercise_nine_is_that_of_its_own_loop(call):
    command, delay = re.search(r"`stewart-drake (margins [^`]*)` gives (\S+) ms", PAGE).groups()
    status, out, _ = call(*command.split(), "--json")
    assert status == 0
    (found, _) = json.loads(out).values()
    assert 1e3 * found["margins"]["delay_s"]["all_at_once"][0] == pytest.approx(float(delay), abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), ANSWERS)
def test_an_answer_is_what_its_code_prints(number, code, capsys):
    exec(compile(code, f"exercise {number}", "exec"), {})
    printed = capsys.readouterr().out.split("\n")[:-1]
    said = [line for answer in re.findall(r"# -> (.*)", code) for line in answer.split("; ")]
    assert len(printed) == len(said) > 0
    for found, stated in zip(printed, said, strict=True):
        for word, wanted in zip(found.split(), stated.split(), strict=True):
            try:
                last_digit = 10.0 ** -len(wanted.partition(".")[2])
                assert float(word) == pytest.approx(float(wanted), rel=0.1, abs=last_digit)
            except ValueError:
                assert word == wanted
