"""Which versions produced a result."""

from __future__ import annotations

import importlib.metadata
import platform
import subprocess
from pathlib import Path


def collect_versions() -> dict[str, str | None]:
    """Versions of Python, of this package and of what it computes with; the git revision where run from a checkout."""
    versions: dict[str, str | None] = {"python": platform.python_version(), "platform": platform.platform()}
    for name in ("stewart-drake", "drake", "numpy", "scipy"):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = None
    versions["git_revision"] = git_revision()
    return versions


def git_revision() -> str | None:
    """Revision of the checkout that this package runs from, with `-dirty` for changed files; None outside of one."""
    root = Path(__file__).parent.parent
    if not (root / ".git").exists():
        return None
    try:
        done = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
