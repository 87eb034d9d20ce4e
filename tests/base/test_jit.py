"""One cache for all compiled laws, fresh with their sources, and records that are views."""

import functools
import shutil
from pathlib import Path

import numba
import numpy as np
import pytest
from conftest import python

import stewart_drake
from stewart_drake.base import jit

SOURCE = Path(stewart_drake.__file__).parent
COMPILING = {file for file in SOURCE.rglob("*.py") if "stewart_drake.base.jit import" in file.read_text()}


def test_nothing_is_compiled_outside_of_the_sources_that_the_digest_is_of():
    others = set(SOURCE.rglob("*.py")) - COMPILING - {Path(jit.__file__)}
    assert [file.name for file in others if "njit" in file.read_text()] == []


@jit.njit
def weighed(values, weight, out):
    out[0] = weight * values.sum()


def test_a_law_is_specialised_and_what_others_compiled_is_called_as_it_is():
    out, arguments = np.zeros(1), (np.arange(3.0), 2.0)
    fast = jit.specialised(weighed, (*arguments, out))
    assert fast is not weighed or jit._CONFIG.DISABLE_JIT
    fast(*arguments, out)
    assert out[0] == 6.0
    own = numba.njit(lambda values, weight, scale=2.0: scale * weight * values.sum())
    wrapped = functools.wraps(own)(lambda *given: own(*given))
    for function in (own, wrapped, max):
        assert jit.specialised(function, arguments) is function
    assert jit.specialised(own, arguments)(*arguments) == 12.0


PROGRAM = """
import sys
sys.stderr = sys.stdout
sys.dont_write_bytecode = True
sys.path.insert(0, sys.argv[1])
from stewart_drake.above import g
print(g(1.0), sum(g.stats.cache_misses.values()), sum(g.stats.cache_hits.values()))
"""


def answer(folder, factor):
    package = folder / "stewart_drake"
    (package / "base").mkdir(parents=True, exist_ok=True)
    for place in (package, package / "base"):
        (place / "__init__.py").touch()
    shutil.copy(jit.__file__, package / "base")
    law = "from stewart_drake.base.jit import njit\n{}@njit\ndef {}(x):\n    return {} * x\n"
    (package / "below.py").write_text(law.format("", "f", factor))
    (package / "above.py").write_text(law.format("from stewart_drake.below import f\n", "g", "f(1.0)"))
    *lines, last = python("-c", PROGRAM, folder).splitlines()
    value, misses, hits = last.split()
    return float(value), int(misses), int(hits), len(lines)


@pytest.mark.slow
def test_a_second_process_compiles_nothing_and_a_change_below_reaches_what_was_compiled_above(tmp_path, monkeypatch):
    # numba's own cache would answer as the first time.
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert answer(tmp_path, 2.0) == (2.0, 1, 0, 0)
    assert answer(tmp_path, 2.0) == (2.0, 0, 1, 0)
    assert answer(tmp_path, 3.0) == (3.0, 1, 0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_a_damaged_cache_is_dropped_with_a_line_and_made_again(tmp_path, monkeypatch, ending):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    assert answer(tmp_path, 2.0) == (2.0, 1, 0, 0)
    for file in (tmp_path / "cache").rglob(f"*.{ending}"):
        file.write_bytes(file.read_bytes()[:40])
    assert answer(tmp_path, 2.0) == (2.0, 1, 0, 1)
    assert answer(tmp_path, 2.0) == (2.0, 0, 1, 0)


@pytest.mark.slow
def test_without_room_for_a_cache_there_is_none_and_a_line(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))"
    monkeypatch.setitem(globals(), "PROGRAM", PROGRAM.replace("import sys", f"import sys; {limit}", 1))
    for _ in range(2):
        assert answer(tmp_path, 2.0) == (2.0, 1, 0, 1)
