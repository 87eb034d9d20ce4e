"""One cache for all compiled laws, fresh with their sources, and records that are views."""

import importlib
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import python

import stewart_drake
from stewart_drake import jit

SOURCE = Path(stewart_drake.__file__).parent
COMPILING = sorted(
    file
    for file in SOURCE.rglob("*.py")
    if "stewart_drake.jit import" in file.read_text() and file != SOURCE / "jit.py"
)


def laws():
    for file in COMPILING:
        module = importlib.import_module(".".join(file.relative_to(SOURCE.parent).with_suffix("").parts))
        for name, value in vars(module).items():
            if hasattr(value, "py_func") and value.py_func.__module__ == module.__name__:
                yield f"{module.__name__}.{name}", value


@pytest.mark.slow
def test_every_law_is_kept_under_the_digest_of_all_sources():
    places = {name: Path(law.stats.cache_path).parts for name, law in laws()}
    assert len(places) > 100
    assert [name for name, parts in places.items() if f"compiled-{jit.source_digest()[:16]}" not in parts] == []


def test_nothing_is_compiled_outside_of_the_sources_that_the_digest_is_of():
    others = set(SOURCE.rglob("*.py")) - {*COMPILING, SOURCE / "jit.py"}
    assert [file.name for file in others if "njit" in file.read_text()] == []


def test_without_a_place_for_a_cache_a_law_compiles_all_the_same(monkeypatch):
    monkeypatch.setattr(jit, "_FOLDER", None)
    assert jit.njit(lambda x: 2.0 * x)(3.0) == 6.0


PACKAGE = {
    "below.py": "from stewart_drake.jit import njit\n@njit\ndef f(x):\n    return {factor} * x\n",
    "above.py": (
        "from stewart_drake.jit import njit\nfrom stewart_drake.below import f\n@njit\ndef g(x):\n    return f(x)\n"
    ),
}
PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
from stewart_drake.above import g
print(g(1.0), sum(g.stats.cache_misses.values()), sum(g.stats.cache_hits.values()))
"""


def answer(folder, factor, monkeypatch, cache):
    package = folder / "stewart_drake"
    package.mkdir(parents=True, exist_ok=True)
    (package / "__init__.py").touch()
    shutil.copy(SOURCE / "jit.py", package)
    for name, text in PACKAGE.items():
        (package / name).write_text(text.format(factor=factor))
    monkeypatch.setenv("NUMBA_CACHE_DIR", os.fspath(cache))
    value, misses, hits = python("-c", PROGRAM, folder).split()
    return float(value), int(misses), int(hits)


@pytest.mark.slow
def test_a_second_process_compiles_nothing_and_a_change_below_reaches_what_was_compiled_above(tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    assert answer(tmp_path / "one", 2.0, monkeypatch, cache) == (2.0, 1, 0)
    assert answer(tmp_path / "one", 2.0, monkeypatch, cache) == (2.0, 0, 1)
    assert answer(tmp_path / "one", 3.0, monkeypatch, cache) == (3.0, 1, 0)


RECORDS = """
import numpy as np
from stewart_drake.jit import fields, new_record, njit, record

KIND = fields(number=(), pair=2, table=(2, 3))

@njit
def law(states):
    state = record(states)
    state.number += 1.0
    state.pair[1] = state.number
    state.table[1, 2] = 7.0
    return state.pair[0]

state = new_record(KIND, pair=[5.0, 0.0])
vector = np.zeros(1 + KIND.itemsize // 8)
held = vector[:-1].view(KIND)
held[:] = state
assert law(held) == 5.0 and law(held) == 5.0
print(vector.tolist())
"""


@pytest.mark.slow
@pytest.mark.parametrize("disabled", ["0", "1"])
def test_a_record_is_a_view_compiled_or_not(disabled, monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", disabled)
    expected = [2.0, 5.0, 2.0, *[0.0] * 5, 7.0, 0.0]
    assert [float(x) for x in python("-c", RECORDS).strip(" []\n").split(",")] == expected


def test_a_record_begins_with_zeros_and_takes_what_fits():
    kind = jit.fields(number=(), pair=2)
    made = jit.new_record(kind, pair=[1.0, 2.0])
    assert (made.shape, made["number"][0], made["pair"][0].tolist()) == ((1,), 0.0, [1.0, 2.0])
    of_options = jit.new_record(kind, SimpleNamespace(number=None, pair=[1.0, 2.0], other=3.0), pair=4.0)
    assert (of_options["number"][0], of_options["pair"][0].tolist()) == (np.inf, [4.0, 4.0])
    with pytest.raises(ValueError, match="no field"):
        jit.new_record(kind, other=1.0)
    with pytest.raises(ValueError, match="broadcast"):
        jit.new_record(kind, pair=np.zeros(3))
