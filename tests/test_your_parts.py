"""The page docs/your_parts.md, walked through in an empty folder."""

import json
import re
import shlex
import sys
from pathlib import Path

import pytest

from stewart_drake.base.registry import CONTROLLERS, ENCODER_FAULTS, TUNERS

PAGE = (Path(__file__).parents[1] / "docs" / "your_parts.md").read_text()
PARTS, GIVEN, ADDED = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
FILES = dict(
    zip(("mine.yaml", "sweep.yaml", "compare.yaml"), re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL), strict=True)
)
(COMMANDS,) = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in {"parts.py": PARTS, **FILES}.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.slow
def test_parts_in_a_file_are_checked_run_swept_and_compared(call, folder):
    for command in COMMANDS.splitlines():
        status, out, error = call(*shlex.split(command)[1:])
        assert status == 0, (command, error)
        assert "runs code" in out or "check" not in command
    metrics = json.loads((folder / "runs/mine/metrics.json").read_text())
    assert metrics["status"] == "completed"
    assert 0.0 < metrics["rmse_spread"] < 1e-3
    assert (folder / "runs/mine/code/parts.py").read_text() == PARTS
    for table in ("many/sweep.csv", "compared/comparison.csv"):
        assert "rmse_spread" in (folder / "runs" / table).read_text().splitlines()[0]
    # What has changed in between is not gone on with.
    (folder / "parts.py").write_text(PARTS.replace("np.ptp", "2 * np.ptp"))
    status, _, error = call("sweep", "sweep.yaml", "--out", "runs/many", "--trust-code")
    assert (status, "parts.py" in error, "--restart" in error) == (2, True, True)


def test_parts_in_python(folder, monkeypatch, capsys):
    monkeypatch.syspath_prepend(folder)
    for family in (CONTROLLERS, TUNERS, ENCODER_FAULTS):
        monkeypatch.setattr(family, "_lines", dict(family._lines))
    names = {"__name__": "page"}
    exec(compile(GIVEN + ADDED, "page", "exec"), names)
    del sys.modules["parts"]
    assert names["log"].status == "completed"
    assert [names[name].status for name in ("gentle", "heaving")] == ["completed"] * 2
    assert names["broken"].status in ("stopped", "failed")
    assert "SimulationLog" in capsys.readouterr().out
