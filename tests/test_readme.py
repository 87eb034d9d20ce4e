"""What the README and the pages in docs say works."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")
USING = (ROOT / "docs" / "using.md").read_text(encoding="utf-8")
PAGES = {
    path: path.read_text(encoding="utf-8")
    for path in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
}
CODE = re.findall(r"```python\n(.*?)```", README + USING, flags=re.DOTALL)
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("code", CODE)
def test_python_blocks_run(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.long
def test_python_blocks_and_misspelt_names_under_a_strict_type_checker(tmp_path):
    for number, code in enumerate(CODE):
        (tmp_path / f"block_{number}.py").write_text(code)
    (tmp_path / "misspelt.py").write_text("from stewart_drake import RobotParamters\n")
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", ROOT / ".mypy_cache" / "readme", "."]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False).stdout
    assert re.findall(r"^(\S+?):\d+: error", said, flags=re.MULTILINE) == ["misspelt.py"], said


ROWS = re.findall(r"^\| .+? \| (.*\d.*?) \| (`.+`) \|$", README, flags=re.MULTILINE)
NUMBER = re.compile(r"\d+(?:\.(\d+))?(?:e[+-]?\d+)?")


@pytest.mark.long
@pytest.mark.parametrize(("number", "commands"), ROWS, ids=lambda cell: cell[:30])
def test_the_command_of_a_row_prints_its_number(number, commands, tmp_path):
    printed = ""
    for command in re.findall(r"`(.+?)`", commands):
        words = command.split()
        if words[0] == "stewart-drake":
            words = [sys.executable, "-m", "stewart_drake", *words[1:]]
        elif words[0] == "python":
            words = [sys.executable, str(ROOT / words[1]), *words[2:]]
        run = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        printed += run.stdout + run.stderr
    found = [float(match[0]) for match in NUMBER.finditer(printed)]
    for match in NUMBER.finditer(number):
        digits = len(match[1] or "")
        assert any(round(value, digits) == float(match[0]) for value in found), (match[0], printed[-2000:])


def test_there_are_nine_rows():
    assert len(ROWS) == 9


def test_it_is_a_landing_page():
    assert README.count("\n") <= 90


def test_make_targets_exist_and_have_a_help_text():
    targets = dict(re.findall(r"^([a-z/%-]+):(.*)", MAKEFILE, flags=re.MULTILINE))
    assert len(targets) <= 25
    assert [name for name, rest in targets.items() if " ## " not in rest] == []
    pages = {f"results/{name}" for name in re.findall(r"^(?:define )?page_(\w+)", MAKEFILE, flags=re.MULTILINE)}
    assert all((ROOT / "docs" / f"{name}.md").is_file() for name in pages)
    named = {name for text in PAGES.values() for name in re.findall(r"(?:`|^)make (\w[\w/-]*)", text, re.MULTILINE)}
    assert {"demo", "test"} <= named
    assert named <= {*targets, *pages, "results/NAME"}


def test_commands_exist():
    from stewart_drake.cli.options import COMMANDS

    named = {
        name for text in PAGES.values() for name in re.findall(r"(?:`|^)stewart-drake ([a-z-]+)", text, re.MULTILINE)
    }
    assert named == {name for name in COMMANDS if " " not in name}


def test_the_page_for_assistants_names_commands_and_pages_that_there_are():
    from stewart_drake.cli.options import COMMANDS

    text = (ROOT / "docs" / "llms.txt").read_text(encoding="utf-8")
    named = set(re.findall(r"`stewart-drake ([a-z-]+)", text))
    assert named <= set(COMMANDS)
    assert {"run", "sweep", "drive", "explain"} <= named
    assert all((ROOT / "docs" / page).is_file() for page in re.findall(r"\]\(([^)]+)\)", text))


def test_shipped_scenarios_are_described():
    shipped = {path.stem for path in (ROOT / "diagrams" / "scenarios").glob("*.yaml")}
    assert all(f"`{name}`" in USING for name in shipped)


def test_links_lead_somewhere():
    dead = []
    for page, text in PAGES.items():
        for target in re.findall(r"\]\((?!https?://)([^)]+)\)", text):
            if target.startswith("/reference/"):
                continue  # made when the site is built, which finds dead links itself
            name, _, heading = target.partition("#")
            path = page.parent / name if name else page
            titles = re.findall(r"^#+ (.*)", path.read_text(), re.MULTILINE) if heading else []
            known = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
            if not path.exists() or (heading and heading not in known):
                dead.append(f"{page.relative_to(ROOT)}: {target}")
    assert dead == []
