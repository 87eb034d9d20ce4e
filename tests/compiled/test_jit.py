import importlib
import os
import pkgutil
import shutil
from pathlib import Path

import pytest
from conftest import python
from stewart_drake.compiled import jit

from stewart_drake import compiled

DISPATCHERS = {
    f"{module.name}.{name}": value
    for module in pkgutil.iter_modules(compiled.__path__)
    for name, value in vars(importlib.import_module(f"stewart_drake.compiled.{module.name}")).items()
    if hasattr(value, "py_func") and value.py_func.__module__ == f"stewart_drake.compiled.{module.name}"
}


@pytest.mark.parametrize("function", DISPATCHERS.values(), ids=DISPATCHERS.keys())
def test_every_compiled_function_is_kept_under_the_digest_of_all_sources(function):
    assert f"stewart_drake-{jit.digest()[:16]}" in Path(function.stats.cache_path).parts


@pytest.mark.parametrize("changed", ["compiled/riccati.py", "compiled/control.py", "compiled/constants.py"])
def test_the_digest_is_of_every_source_that_is_compiled_in(changed, tmp_path):
    source = Path(compiled.__file__).parent
    shutil.copytree(source, tmp_path / "compiled", ignore=shutil.ignore_patterns("__pycache__"))
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


@pytest.mark.slow
def test_constants_from_elsewhere_are_in_modules_that_the_digest_covers():
    """What a compiled module imports from the package is compiled in: another module would go stale unseen."""
    used = python("-c", _IMPORTS).split()
    # `pack` of a robot runs in Python.
    assert set(used) == {"stewart_drake.robot"}


_IMPORTS = """
import ast, pathlib, stewart_drake
folder = pathlib.Path(stewart_drake.__file__).parent / "compiled"
for file in set(folder.glob("*.py")) - {folder / "jit.py"}:
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("stewart_drake."):
            if not node.module.startswith("stewart_drake.compiled"):
                print(node.module)
"""


def make_package(folder, factor):
    """A package with two compiled functions, one of which calls the other; returns its folder."""
    package = folder / "stewart_drake"
    shutil.rmtree(package, ignore_errors=True)
    (package / "compiled").mkdir(parents=True)
    source = Path(compiled.__file__).parent
    shutil.copy(source / "jit.py", package / "compiled")
    shutil.copy(source.parent / "errors.py", package)
    shutil.copytree(source.parent / "files", package / "files", ignore=shutil.ignore_patterns("__pycache__"))
    (package / "__init__.py").touch()
    (package / "compiled" / "__init__.py").touch()
    head = "from stewart_drake.compiled.jit import njit\n"
    (package / "compiled" / "above.py").write_text(
        f"{head}from stewart_drake.compiled.below import f\n@njit(cache=True)\ndef g(x):\n    return f(x)\n"
    )
    below = f"{head}@njit(cache=True)\ndef f(x):\n    return {factor} * x\n"
    (package / "compiled" / "below.py").write_text(below)
    return folder


def answer(folder, cache, monkeypatch):
    """What the package says to 1, and whether the outer function was kept before and is now, and was compiled."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", os.fspath(cache))
    way = f"import sys; sys.path.insert(0, {os.fspath(folder)!r})"
    program = f"""{way}
from stewart_drake.compiled.above import g
from stewart_drake.compiled.jit import is_kept
before = is_kept(g)
print(g(1.0), before, is_kept(g), sum(g.stats.cache_misses.values()))
"""
    value, before, after, misses = python("-c", program).split()
    return float(value), before == "True", after == "True", int(misses)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A package, and a cache that one process has filled."""
    folder = make_package(tmp_path_factory.mktemp("package"), 2.0)
    with pytest.MonkeyPatch.context() as patch:
        assert answer(folder, folder / "cache", patch) == (2.0, False, True, 1)
        assert answer(folder, folder / "cache", patch) == (2.0, True, True, 0)
    return folder


@pytest.mark.slow
def test_a_change_below_reaches_what_was_compiled_above(package, tmp_path, monkeypatch):
    """The same files, the callee's changed; numba's own cache would answer as the first time."""
    shutil.copytree(package / "cache", tmp_path / "cache")
    changed = make_package(tmp_path / "changed", 3.0)
    assert answer(changed, tmp_path / "cache", monkeypatch) == (3.0, False, True, 1)
