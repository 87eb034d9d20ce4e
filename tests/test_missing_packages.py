"""Where a package that only some need is not installed: what still works, and what is said of the rest."""

import sys
import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from stewart_drake.analysis.linear_loop import StateSpace
from stewart_drake.base.errors import ConfigurationError, MissingPackageError, installed_with
from stewart_drake.logs.log import SimulationLog
from stewart_drake.logs.mcap_file import check_mcap
from stewart_drake.studies.workers import Workers
from stewart_drake.training.paper_network import import_torch

ROOT = Path(__file__).parent.parent
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]


def ask_dask():
    with Workers(scheduler="tcp://127.0.0.1:1"):
        pass


NEEDS = {
    "gymnasium": ("stewart-drake[gym]", lambda: import_module("stewart_drake.training.environments")),
    "torch": ("stewart-drake[train]", import_torch),
    "control": ("stewart-drake[control]", lambda: StateSpace(*np.eye(4)[:, :, None], 0.1).to_control()),
    "distributed": ("stewart-drake[dask]", ask_dask),
    "mcap": ("stewart-drake[mcap]", check_mcap),
    "pandas": ("pandas", lambda: SimulationLog.to_pandas(None)),
}


@pytest.mark.parametrize("package", NEEDS)
def test_a_missing_package_is_named_in_one_line_with_what_installs_it(package, monkeypatch):
    requirement, need = NEEDS[package]
    monkeypatch.delitem(sys.modules, "stewart_drake.training.environments", raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigurationError) as caught:
        need()
    shown = f"'{requirement}'" if "[" in requirement else requirement
    assert str(caught.value).startswith(f"{package} is not installed: pip install {shown}")
    assert "\n" not in str(caught.value)
    if extra := requirement.partition("[")[2].rstrip("]"):
        assert any(each.startswith(package) for each in EXTRAS[extra])


def test_it_is_an_import_error_too_and_other_import_errors_stay_as_they_are():
    with pytest.raises(ImportError) as caught, installed_with("numpy"):
        from numpy import nothing_of_this_name  # noqa: F401
    assert not isinstance(caught.value, MissingPackageError)
    with (
        pytest.raises(ImportError, match="no_such is not installed: pip install it; or not"),
        installed_with("it", "or not"),
    ):
        import no_such.module  # noqa: F401


WITHOUT_TORCH = """
import sys


class NoTorch:
    def find_spec(name, path, target=None):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, NoTorch)
from importlib import import_module
from pkgutil import walk_packages
import stewart_drake
from stewart_drake.cli.app import main

for module in walk_packages(stewart_drake.__path__, "stewart_drake."):
    import_module(module.name)
for command in (["list"], ["tuner", "show"], ["run", "paper_fig7", "--set", "duration=0.05"]):
    sys.argv = ["stewart-drake", *command]
    try:
        main()
    except SystemExit as end:
        assert end.code == 0, command
"""


@pytest.mark.long
def test_without_torch_everything_works_but_training(shell):
    status, out, err = shell(code=WITHOUT_TORCH)
    assert status == 0, err
    assert "completed" in out


@pytest.mark.parametrize("command", ["train", "reproduce"])
def test_training_without_torch_ends_in_one_line_and_writes_nothing(command, call, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "torch", None)
    status, out, err = call(command, "--out", "folder/file")
    assert (status, out) == (2, "")
    (line,) = err.strip().splitlines()
    assert line.startswith("stewart-drake: torch is not installed: pip install 'stewart-drake[train]';")
    assert list(tmp_path.iterdir()) == []
