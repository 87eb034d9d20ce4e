"""Tables made on the reduced engine say what Drake says of one of their runs."""

import json
import re

import pytest
from test_comparison import small
from test_sweep import TINY, sweep

from stewart_drake.campaigns.comparison import run_comparison
from stewart_drake.campaigns.executors import SerialExecutor
from stewart_drake.campaigns.judge import COMPARED
from stewart_drake.campaigns.sweep import run_sweep
from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.runs.simulation import run

REDUCED = {"plant.engine": "reduced"}
OFFSET = {"initial_offset[0]": {"kind": "uniform", "low": -0.05, "high": 0.05}}


@pytest.mark.slow
def test_a_sweep_says_how_far_its_first_run_is_from_drakes(tmp_path):
    plan = sweep(runs=2, set={**TINY, **REDUCED, "controller.solver": "split"}, distributions=OFFSET)
    made = run_sweep(plan, tmp_path, SerialExecutor())
    assert made.engine.startswith(
        "Engine: reduced, the exact closed form of the robot in place of Drake's plant. Run 0 on"
    )
    told = json.loads(made.table.schema.metadata[b"stewart_drake.sweep"])
    assert told["engine"] == made.engine
    drake = run_metrics(run(plan.scenario(0).replace({"plant.engine": "drake"})))
    for name in COMPARED[:2]:
        other, off = map(float, re.search(rf"{name} (\S+) \(here (\S+) %\)", made.engine).groups())
        assert other == pytest.approx(drake[name], rel=0.01)
        assert off == pytest.approx(100.0 * (made.rows[0][name] / drake[name] - 1.0), abs=0.06, rel=0.06)
        assert abs(off) < 5.0
    assert run_sweep(sweep(runs=1), tmp_path / "drake", SerialExecutor()).engine is None


@pytest.mark.slow
def test_the_page_of_a_comparison_says_so_too(tmp_path):
    runs = [{"controllers": ["stiff", "pid"], "references": ["sine"], "conditions": ["nominal"]}]
    plan = small(set={"duration": 0.1, "controller.solver": "split", **REDUCED}, runs=runs, bands=None, best_of={})
    result = run_comparison(plan, tmp_path, SerialExecutor())
    assert {row["status"] for row in result.rows} == {"completed"}
    assert (tmp_path / "comparison.md").read_text().splitlines()[-1] == result.engine


def never(_scenario):
    raise ConfigurationError("plant", "drake", "nothing here")


@pytest.mark.slow
def test_what_drake_refuses_is_told(tmp_path):
    plan = sweep(runs=1, set={**TINY, **REDUCED, "controller.solver": "split"}, distributions=OFFSET)
    run_sweep(plan, tmp_path, SerialExecutor())
    again = run_sweep(plan, tmp_path, SerialExecutor(), function=never)
    assert again.engine.endswith("Run 0 does not run on Drake: plant: expected nothing here")
