"""Writing files so that a reader never sees half of one."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from stewart_drake.errors import ConfigurationError


def write_atomically(path: Path, content: bytes) -> None:
    """Writes `content` to `path` by way of a temporary file in the same folder.

    Raises:
        ConfigurationError: The folder is missing or not writable; nothing is left behind.
    """
    try:
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(descriptor, "wb") as stream:
                stream.write(content)
            # mkstemp makes files private; give them what the umask gives any other file.
            umask = os.umask(0)
            os.umask(umask)
            Path(name).chmod(0o666 & ~umask)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise ConfigurationError(str(path), error.strerror or str(error), "a file in a writable folder") from error
