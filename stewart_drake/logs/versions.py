"""Which versions produced a result."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
import subprocess

from stewart_drake.base.atomic_files import PACKAGE


def collect_versions() -> dict[str, str | None]:
    """Versions of Python, this package and what it computes with; the git revision of a checkout."""
    versions: dict[str, str | None] = {"python": platform.python_version(), "platform": platform.platform()}
    versions |= {name: package_version(name) for name in ("stewart-drake", "drake", "numpy", "scipy")}
    return {**versions, "git_revision": git_revision(), "source": source_digest()}


def package_version(name: str) -> str | None:
    """None where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def source_digest() -> str:
    """Digest of this package's Python files, for where there is no git."""
    content = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        content.update(str(path.relative_to(PACKAGE)).encode() + b"\0" + path.read_bytes())
    return content.hexdigest()[:16]


def git_revision() -> str | None:
    """Revision of this package's checkout, with `-dirty` for changed files; None outside of one."""
    root = PACKAGE.parent
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
