"""What the README says works."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("code", re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL))
def test_python_blocks_run(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_python_blocks_and_misspelt_names_under_a_strict_type_checker(tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    for number, code in enumerate(blocks):
        (tmp_path / f"block_{number}.py").write_text(code)
    (tmp_path / "misspelt.py").write_text("from stewart_drake import RobotParamters\n")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--cache-dir", ROOT / ".mypy_cache" / "readme", "."],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "RobotParamters" in done.stdout
    assert re.findall(r"^(\S+?):\d+: error", done.stdout, flags=re.MULTILINE) == ["misspelt.py"], done.stdout


def test_make_targets_exist():
    targets = set(re.findall(r"^([a-z_]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    named = set(re.findall(r"(?:`|^)make ([a-z_]+)", README, flags=re.MULTILINE))
    assert named
    assert named <= targets


def test_commands_exist():
    from stewart_drake.cli.app import cli

    named = set(re.findall(r"`stewart-drake ([a-z-]+)", README))
    assert {"run", "reproduce", "collect", "train"} <= named
    assert named <= set(cli.commands)


def test_shipped_scenarios_are_described():
    shipped = {path.stem for path in (ROOT / "diagrams" / "scenarios").glob("*.yaml")}
    assert all(f"`{name}`" in README for name in shipped)


def test_links_lead_somewhere():
    targets = re.findall(r"\]\((?!https?://|#)([^)]+)\)", README)
    assert targets
    assert [target for target in targets if not (ROOT / target.split("#")[0]).exists()] == []


@pytest.mark.slow
def test_continuous_integration_runs_the_readme_command():
    script = (ROOT / ".ci" / "run").read_text()
    assert "make test" in script
    assert subprocess.run(["bash", "-n", ROOT / ".ci" / "run"], check=False).returncode == 0


def test_the_benchmarks_show_their_ratios():
    # pytest keeps what a test that passes prints, unless told otherwise.
    recipe = re.search(r"^bench:.*\n\t(.*)$", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)[1]
    assert " -s " in recipe
