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
    wanted = {"sdf/stewart.sdf", "sdf/package.xml", "scenarios/paper_fig7.yaml", "weights/tuner.json", "py.typed"}
    assert {f"stewart_drake/{name}" for name in wanted} <= names
    assert not [name for name in names if name.startswith(("tests/", "notebooks/"))]


@pytest.mark.slow
def test_the_wheel_runs_the_main_job_outside_of_the_checkout(wheel, tmp_path):
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    environment = {**os.environ, "PYTHONPATH": str(site)}
    where = (
        "import stewart_drake, stewart_drake.plant.sdf_model as s; print(stewart_drake.__file__); print(s.sdf_path())"
    )
    found = subprocess.run(
        [sys.executable, "-c", where], cwd=tmp_path, env=environment, check=True, capture_output=True, text=True
    ).stdout.split()
    assert all(Path(path).is_relative_to(site) and Path(path).is_file() for path in found)

    command = [sys.executable, "-m", "stewart_drake", "run", "paper_fig7", "--out", "out", "--set", "duration=0.05"]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, timeout=300)
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["status"] == "completed"
    assert metrics["git_revision"] is None
