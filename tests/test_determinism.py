import subprocess
import sys

import pytest
from conftest import ROOT, environment

RUN = """
import hashlib, json, sys
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.scenario.scenario import load_scenario
from stewart_drake.runs.simulation import run
content = hashlib.sha256()
for name in ("paper_fig7", "exact_heart"):
    log = run(load_scenario(name).replace({"duration": 0.3}))
    for signal, values in log.signals.items():
        content.update(signal.encode() + values.tobytes())
    metrics = run_metrics(log)
    del metrics["real_time_factor"], metrics["git_revision"]
    content.update(json.dumps(metrics, sort_keys=True).encode())
print(content.hexdigest())
"""


def numbers(folder, **changes):
    command = [sys.executable, "-c", RUN]
    done = subprocess.run(command, cwd=folder, env=environment(**changes), capture_output=True, text=True, check=True)
    return done.stdout


@pytest.mark.long
def test_numbers_are_the_same_to_the_bit_over_threads_hash_seeds_and_folders(tmp_path):
    threads = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    one = numbers(ROOT, PYTHONHASHSEED="0", **dict.fromkeys(threads, "1"))
    assert one == numbers(tmp_path, PYTHONHASHSEED="4294967295", **dict.fromkeys(threads, "4"))
