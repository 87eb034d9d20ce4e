import json
import subprocess
import sys

import pytest
from attacked_files import KINDS
from conftest import ROOT, environment, once


@pytest.fixture(scope="session")
def attacked(tmp_path_factory):
    """What became of the files of each kind, and what was said; one process imports what all of them need."""

    def make(folder):
        command = [sys.executable, str(ROOT / "tests" / "attacked_files.py"), str(folder)]
        env = environment(OMP_NUM_THREADS="1", PYTHONWARNINGS="ignore")
        with (folder / "out").open("w") as out, (folder / "err").open("w") as err:
            subprocess.run(command, stdout=out, stderr=err, check=False, timeout=900, env=env)

    folder = once(tmp_path_factory, "attacked", make)
    found = map(json.loads, (folder / "out").read_text().splitlines())
    return {line["kind"]: line for line in found}, f"{folder}\n{(folder / 'err').read_text()}"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_whatever_a_file_is_it_is_loaded_or_refused_by_one_line_in_bounded_time_and_memory(attacked, kind):
    found, said = attacked
    assert found[kind]["status"] == 0, said
    # An attack that nothing survives, or everything, attacks nothing.
    assert found[kind]["refused"] > 0 or kind == "digest"
