"""The source distribution makes the wheel, which works outside of the checkout with all that it reads inside it."""

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
WANTED = (
    *("comparisons/fair.yaml", "paper/claims.csv", "robots/reachy_mini.yaml", "scenarios/paper_fig7.yaml"),
    *("sdf/stewart.sdf", "sweeps/monte_carlo.yaml", "weights/policy.json", "weights/tuner.json"),
    *(
        "cli/templates/sweep.yaml",
        "pages/instrument.js",
        "pages/live.html",
        "pages/replay.html",
        "pages/scene.js",
        "pages/plots.js",
        "pages/common.css",
    ),
    *("pages/uPlot.iife.min.js", "pages/uPlot.LICENSE", "pages/three.min.js", "pages/three.LICENSE"),
)


def test_the_version_is_the_same_everywhere():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    for file, line in (
        ("CITATION.cff", rf"^version: {version}$"),
        ("CHANGELOG.md", rf"\A# [^#]*^## {version}$"),
        ("sdf/package.xml", f"<version>{version}</version>"),
    ):
        assert re.search(line, (ROOT / file).read_text(), re.MULTILINE | re.DOTALL), file


@pytest.mark.long
def test_the_wheel_carries_what_the_package_reads_and_runs_outside_of_the_checkout(shell, tmp_path):
    pack = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", tmp_path]
    subprocess.run(pack, check=True, capture_output=True, timeout=300, cwd=ROOT)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", tmp_path]
    subprocess.run([*build, *tmp_path.glob("*.tar.gz")], check=True, capture_output=True, timeout=300)
    (wheel,), site = tmp_path.glob("*.whl"), tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    assert [name for name in WANTED if not (site / "stewart_drake" / name).is_file()] == []
    assert not any((site / name).exists() for name in ("tests", "notebooks"))
    env = {**os.environ, "PYTHONPATH": str(site)}
    where = "import stewart_drake as d; print(d.__file__)"
    _, found, _ = shell(code=where, env=env)
    assert all(Path(path).is_relative_to(site) and Path(path).is_file() for path in found.split())
    status, _, err = shell("run", "paper_fig7", "--out", "out", "--set", "duration=0.05", env=env)
    assert status == 0, err
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert (metrics["status"], metrics["git_revision"]) == ("completed", None)
