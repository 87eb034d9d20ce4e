import json
import subprocess
import sys

import pytest
from attacked_files import KINDS
from conftest import ROOT


@pytest.fixture(scope="module")
def attacked(tmp_path_factory):
    """What became of the files of each kind, and what was said; one process imports what all of them need."""
    folder = tmp_path_factory.mktemp("attacked")
    done = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "attacked_files.py"), str(folder)],
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
        env={"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"},
    )
    return {line["kind"]: line for line in map(json.loads, done.stdout.splitlines())}, f"{folder}\n{done.stderr}"


@pytest.mark.slow
@pytest.mark.xdist_group("attacked")
@pytest.mark.parametrize("kind", KINDS)
def test_whatever_a_file_is_it_is_loaded_or_refused_by_one_line_in_bounded_time_and_memory(attacked, kind):
    found, said = attacked
    assert found[kind]["status"] == 0, said
    # An attack that nothing survives, or everything, attacks nothing.
    assert found[kind]["refused"] > 0 or kind == "digest"
