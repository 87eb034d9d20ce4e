import json
import subprocess
import sys

import pytest
from attacked_files import KINDS
from conftest import ROOT


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_whatever_a_file_is_it_is_loaded_or_refused_by_one_line_in_bounded_time_and_memory(tmp_path, kind):
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "attacked_files.py"), kind, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env={"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"},
    )
    assert done.returncode == 0, f"status {done.returncode}; the file is in {tmp_path}\n{done.stderr[-3000:]}"
    counts = json.loads(done.stdout.splitlines()[-1])
    # An attack that nothing survives, or everything, attacks nothing.
    assert counts["refused"] > 0 or kind == "digest"
