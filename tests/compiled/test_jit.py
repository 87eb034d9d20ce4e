import importlib
import os
import pkgutil
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import python

from stewart_drake import compiled
from stewart_drake.compiled import jit

DISPATCHERS = {
    f"{module.name}.{name}": value
    for module in pkgutil.iter_modules(compiled.__path__)
    for name, value in vars(importlib.import_module(f"stewart_drake.compiled.{module.name}")).items()
    if hasattr(value, "py_func") and value.py_func.__module__ == f"stewart_drake.compiled.{module.name}"
}


@pytest.mark.parametrize("function", DISPATCHERS.values(), ids=DISPATCHERS.keys())
def test_every_compiled_function_is_kept_under_the_digest_of_all_sources(function):
    assert function._cache._cache_file._source_stamp[1] == jit.digest()


@pytest.mark.parametrize("changed", ["compiled/riccati.py", "compiled/control.py", "riccati.py", "estimator.py"])
def test_the_digest_is_of_every_source_that_is_compiled_in(changed, tmp_path):
    source = Path(compiled.__file__).parent
    shutil.copytree(source, tmp_path / "compiled", ignore=shutil.ignore_patterns("__pycache__"))
    for name in jit._BESIDE:
        shutil.copy(source.parent / name, tmp_path)
    assert jit.digest(tmp_path / "compiled") == jit.digest()
    with (tmp_path / changed).open("a") as stream:
        stream.write("\n# changed\n")
    assert jit.digest(tmp_path / "compiled") != jit.digest()


def test_without_a_place_for_a_cache_functions_compile_all_the_same(monkeypatch):
    def nowhere(**options):
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(jit.numba, "njit", nowhere)

    @jit.njit(cache=True, error_model="numpy")
    def twice(x):
        return 2.0 * x

    assert twice(3.0) == 6.0


def test_constants_from_elsewhere_are_in_modules_that_the_digest_covers():
    """What a compiled module imports from the package is compiled in: another module would go stale unseen."""
    used = python("-c", _IMPORTS).split()
    covered = {f"stewart_drake.{name.removesuffix('.py')}" for name in jit._BESIDE}
    # `pack` of a robot runs in Python.
    assert set(used) - {"stewart_drake.robot"} <= covered
    assert used


_IMPORTS = """
import ast, pathlib, stewart_drake
folder = pathlib.Path(stewart_drake.__file__).parent / "compiled"
for file in folder.glob("*.py"):
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("stewart_drake."):
            if not node.module.startswith("stewart_drake.compiled"):
                print(node.module)
"""


def test_a_change_below_reaches_what_was_compiled_above(tmp_path):
    """The same files twice, the callee's changed; numba's own cache would answer as the first time."""
    package = tmp_path / "stewart_drake"
    (package / "compiled").mkdir(parents=True)
    source = Path(compiled.__file__).parent
    shutil.copy(source / "jit.py", package / "compiled")
    (package / "__init__.py").touch()
    (package / "compiled" / "__init__.py").touch()
    for name in jit._BESIDE:
        (package / name).touch()
    head = "from stewart_drake.compiled.jit import njit\n"
    (package / "compiled" / "above.py").write_text(
        f"{head}from stewart_drake.compiled.below import f\n@njit(cache=True)\ndef g(x):\n    return f(x)\n"
    )
    answers = []
    for factor in (2.0, 3.0):
        below = f"{head}@njit(cache=True)\ndef f(x):\n    return {factor} * x\n"
        (package / "compiled" / "below.py").write_text(below)
        way = f"import sys; sys.path.insert(0, {os.fspath(tmp_path)!r})"
        answers.append(float(python("-c", f"{way}; from stewart_drake.compiled.above import g; print(g(1.0))")))
    np.testing.assert_array_equal(answers, [2.0, 3.0])
