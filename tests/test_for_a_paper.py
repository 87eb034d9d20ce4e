"""The page docs/for_a_paper.md, followed to the letter in an empty folder, with fewer evaluations."""

import json
import re
import shlex
from pathlib import Path

import pytest

from stewart_drake.studies.tune import load_tuning

PAGE = (Path(__file__).parents[1] / "docs" / "for_a_paper.md").read_text()


@pytest.mark.long
def test_the_page_leads_from_a_robot_to_figures_and_tables(call, tmp_path):
    (grid,) = re.findall(r"```yaml\n# (\S+)\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / grid[0]).write_text(grid[1])
    for command in [line for block in re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]:
        words = shlex.split(command)[1:]
        status, _, error = call(*words, *(["--quick"] if words[0] == "tune" else []))
        assert status == 0, (command, error)
    for name in (
        "grid/sweep.csv",
        "grid/sweep.pdf",
        "controllers/comparison.md",
        "controllers/rmse.pdf",
        "tuned/tune.pdf",
    ):
        assert (tmp_path / name).stat().st_size > 100
    # The user's own scenario in all of them.
    for folder in ("grid", "controllers", "tuned"):
        study = json.loads((tmp_path / folder / "study.json").read_text())
        assert study["scenario"]["reference"]["angular_frequency"] == [2.0] * 6
    assert load_tuning(tmp_path / "tune.yaml").evaluations == 49
