"""`NUMBA_DISABLE_JIT=1` runs every kernel as plain Python: the same numbers, and no index beyond an array."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

PROGRAM = """
import json
import sys
from stewart_drake import load_scenario, run
common = {"duration": 0.02, "plant.kind": "closed_form", "safety": {}}
for name, changes in json.load(sys.stdin):
    log = run(load_scenario(name).replace(common | changes))
    print(json.dumps([log.status, log["torque"].tolist()]))
"""
RUNS = (
    ("exact_heart", {"estimator": "observer", "tuner": "policy", "model.friction": {"coulomb": 0.02}}),
    ("exact_breathing", {"controller.bumpless": True, "controller.saturation": "back_calculation"}),
    ("paper_fig7", {}),
    ("exact_fig7", {"controller": {"kind": "pid"}, "sensors": {"kind": "encoders"}}),
    ("exact_fig7", {"controller": {"kind": "computed_torque"}, "plant.motor_friction": 0.02}),
)


@pytest.fixture(scope="module")
def torques():
    """Statuses and torques of the runs, compiled and in plain Python."""
    logs = {}
    for plain in ("0", "1"):
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM], input=json.dumps(RUNS), capture_output=True, text=True,
            env={**os.environ, "NUMBA_DISABLE_JIT": plain}, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        logs[plain] = [json.loads(line) for line in done.stdout.splitlines()]
    return list(zip(logs["0"], logs["1"], strict=True))


@pytest.mark.long
@pytest.mark.parametrize("place", range(len(RUNS)))
def test_in_plain_python_a_run_is_the_same(torques, place):
    (status, compiled), (plain_status, plain) = torques[place]
    assert (status, plain_status) == ("completed", "completed")
    assert len(compiled) in (5, 21)  # at 200 Hz and 1 kHz
    np.testing.assert_allclose(plain, compiled, rtol=1e-9, atol=1e-12)
