"""Versions of the software that produced a result."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
import subprocess

from stewart_drake.base.atomic_files import PACKAGE


def collect_versions() -> dict[str, str | None]:
    """Versions of Python, this package, drake, numpy and scipy; git revision and digest of the source."""
    versions: dict[str, str | None] = {"python": platform.python_version(), "platform": platform.platform()}
    versions |= {name: package_version(name) for name in ("stewart-drake", "drake", "numpy", "scipy")}
    return {**versions, "git_revision": git_revision(), "source": source_digest()}


def package_version(name: str) -> str | None:
    """Version of an installed package, or None."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def source_digest() -> str:
    """Digest of this package's Python files."""
    content = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        content.update(str(path.relative_to(PACKAGE)).encode() + b"\0" + path.read_bytes())
    return content.hexdigest()[:16]


def git_revision() -> str | None:
    """Revision of this package's git checkout, with `-dirty` after changes; None without git."""
    root = PACKAGE.parent
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
