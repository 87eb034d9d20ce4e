"""Which installed package a module comes from, found without importing anything."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import sys
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from urllib.parse import unquote, urlsplit

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import PACKAGE

_OWN = "stewart_drake"


def need_pandas(instead: str) -> None:
    """Asks for pandas, which this package uses but does not install.

    Args:
        instead: What gives the same without it.

    Raises:
        ConfigurationError: It is not installed.
    """
    if importlib.util.find_spec("pandas") is None:
        allowed = f"an installation with pandas: pip install pandas; {instead}"
        raise ConfigurationError("to_pandas", "no pandas", allowed)


def distribution_of(module: str) -> str | None:
    """Name of the installed distribution that a module is part of; an editable installation is one too.

    Args:
        module: Dotted name.

    Returns:
        None for a module of Python itself, for a file that merely lies where Python looks, and for what is not there.
    """
    top = module.partition(".")[0]
    if top in sys.stdlib_module_names or top == "__main__":
        return None
    files = _files(module)
    if not files:
        return None
    if top == _OWN:
        return "stewart-drake" if _inside(files, PACKAGE) else None
    for name in importlib.metadata.packages_distributions().get(top, ()):
        if _inside(files, Path(str(importlib.metadata.distribution(name).locate_file("")))):
            return name
    for distribution in importlib.metadata.distributions():
        project = _editable(distribution)
        if project is not None and _inside(files, project):
            return distribution.name
    return None


def _files(module: str) -> list[Path]:
    """Files that an import of `module` would run, of its parents too; none where there is no such module."""
    files = []
    spec: ModuleSpec | None = None
    parts = module.split(".")
    for count in range(1, len(parts) + 1):
        name = ".".join(parts[:count])
        try:
            # Of a name without dots this imports nothing; with dots it would import the parents.
            spec = importlib.util.find_spec(name) if spec is None else _find_inside(spec, name)
        except (ImportError, ValueError, AttributeError):
            spec = None
        if spec is None:
            return []
        # A namespace package is no file.
        if spec.has_location and spec.origin is not None:
            files.append(Path(spec.origin).absolute())
    return files if spec is not None and spec.has_location else []


def _find_inside(parent: ModuleSpec, name: str) -> ModuleSpec | None:
    return PathFinder.find_spec(name, list(parent.submodule_search_locations or ()))


def _inside(files: list[Path], folder: Path) -> bool:
    return all(file.is_relative_to(folder.absolute()) for file in files)


def _editable(distribution: importlib.metadata.Distribution) -> Path | None:
    """Folder of the project where this is an editable installation."""
    try:
        about = json.loads(distribution.read_text("direct_url.json") or "{}")
        if not about["dir_info"]["editable"]:
            return None
        return Path(unquote(urlsplit(about["url"]).path))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
