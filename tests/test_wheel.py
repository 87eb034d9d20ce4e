"""The wheel works outside of the checkout: scenarios, SDF and trained weights travel inside it."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.long
def test_the_wheel_carries_what_the_package_reads_and_runs_outside_of_the_checkout(shell, tmp_path):
    build = ["-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w"]
    subprocess.run([sys.executable, *build, tmp_path, ROOT], check=True, capture_output=True, timeout=300)
    (wheel,), site = tmp_path.glob("*.whl"), tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    wanted = ("robots/reachy_mini.yaml", "sdf/stewart.sdf", "scenarios/paper_fig7.yaml", "weights/tuner.json")
    assert all((site / "stewart_drake" / name).is_file() for name in wanted)
    assert not any((site / name).exists() for name in ("tests", "notebooks"))
    env = {**os.environ, "PYTHONPATH": str(site)}
    where = "import stewart_drake as d; print(d.__file__)"
    _, found, _ = shell(code=where, env=env)
    assert all(Path(path).is_relative_to(site) and Path(path).is_file() for path in found.split())
    status, _, err = shell("run", "paper_fig7", "--out", "out", "--set", "duration=0.05", env=env)
    assert status == 0, err
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert (metrics["status"], metrics["git_revision"]) == ("completed", None)
