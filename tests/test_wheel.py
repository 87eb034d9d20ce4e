"""The wheel works outside of the checkout: scenarios, SDF and trained weights travel inside it."""

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder, ROOT]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    (path,) = folder.glob("*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_carries_what_the_package_reads(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    wanted = (
        "robots/reachy_mini.yaml",
        "sdf/stewart.sdf",
        "scenarios/paper_fig7.yaml",
        "weights/tuner.json",
        "py.typed",
    )
    assert {f"stewart_drake/{name}" for name in wanted} <= names
    assert not [name for name in names if name.startswith(("tests/", "notebooks/"))]


@pytest.mark.long
def test_the_wheel_runs_the_main_job_outside_of_the_checkout(wheel, shell, tmp_path):
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    env = {**os.environ, "PYTHONPATH": str(site)}
    where = "import stewart_drake as d, stewart_drake.plant.sdf_model as s; print(d.__file__); print(s.sdf_path())"
    _, found, _ = shell(code=where, env=env)
    assert all(Path(path).is_relative_to(site) and Path(path).is_file() for path in found.split())
    status, _, err = shell("run", "paper_fig7", "--out", "out", "--set", "duration=0.05", env=env)
    assert status == 0, err
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert (metrics["status"], metrics["git_revision"]) == ("completed", None)
