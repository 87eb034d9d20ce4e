"""Where the training of a policy stands, and the file that keeps it from call to call."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import write_atomically


@dataclass
class Progress:
    """Where a training stands; what a checkpoint holds.

    Attributes:
        epoch: Done.
        weights: (n,) of the network, flat.
        moments: Of Adam, (2, n).
        steps: Of Adam.
        fixed: J of every situation at the centre, a robot after the other.
        latest: J in the last epoch.
        mean: (13,) of the features.
        scale: (13,).
        low: (13,).
        high: (13,).
        seconds: [s] of the processor.
        best: (n,) weights after the epoch of least J, which is measured while they move; at first those of the start.
        least: Mean of log J over that at the centre in that epoch, at kappa 0.
        history: Mean of log J/J at the centre, an epoch after the other; at kappa 0 and at all tastes.
    """

    epoch: int
    weights: np.ndarray
    moments: np.ndarray
    steps: int
    fixed: np.ndarray
    latest: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    low: np.ndarray
    high: np.ndarray
    best: np.ndarray
    least: float = 0.0
    seconds: float = 0.0
    history: list[tuple[float, float]] = field(default_factory=list)


def keep(at: Progress, identity: str, file: Path) -> None:
    """Writes a checkpoint of what has an identity.

    Raises:
        ConfigurationError: The folder is missing or not writable.
    """
    content = io.BytesIO()
    np.savez(content, identity=identity, **vars(at))
    write_atomically(file, content.getvalue())


def kept(checkpoint: Path | None, identity: str) -> Progress | None:
    """Where an earlier call got to; None where there was none.

    Raises:
        ConfigurationError: The file is none of `keep`, or of another identity.
    """
    if checkpoint is None or not checkpoint.exists():
        return None
    try:
        with np.load(checkpoint, allow_pickle=False) as file:
            found = dict(file)
            if str(found.pop("identity")) != identity:
                allowed = "one of a training with the same options; take it away to begin anew"
                raise ConfigurationError(f"checkpoint {checkpoint}", "of other options", allowed)
            history = [(float(plain), float(every)) for plain, every in found.pop("history")]
            numbers = {name: found.pop(name).item() for name in ("epoch", "steps", "least", "seconds")}
            return Progress(**numbers, **found, history=history)
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigurationError(f"checkpoint {checkpoint}", str(error), "a file as training left it") from None
