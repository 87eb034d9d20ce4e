"""What results depend on, by content: so kept ones are known again, and others are not mixed in."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from stewart_drake.control.network import default_network_path, read_weights
from stewart_drake.files.named_files import file_digests
from stewart_drake.files.whole import checksum
from stewart_drake.logs.metric_table import columns
from stewart_drake.logs.versions import collect_versions
from stewart_drake.scenario import AnnTuner

CODE = ("stewart-drake", "drake", "numpy", "scipy", "source")
"""Versions on which every number depends."""


def identity(
    work: Mapping[str, Any],
    tuners: Iterable[object] = (),
    versions: Mapping[str, str | None] | None = None,
    more: Iterable[str] = (),
) -> dict[str, Any]:
    """What results depend on, in plain values: the work, the files that it names, the code.

    Args:
        work: What is computed, in plain values.
        tuners: Of the work; of networks the weights count, and not what their file is called.
        versions: From `collect_versions`; None collects them.
        more: Names of versions beside `CODE`.

    Raises:
        ConfigurationError: A weights file cannot be read.
    """
    versions = collect_versions() if versions is None else versions
    texts = {weights_text(tuner) for tuner in tuners if isinstance(tuner, AnnTuner)}
    return {
        **work,
        "files": file_digests(work),
        "weights": sorted(hashlib.sha256(text.encode()).hexdigest()[:24] for text in texts),
        "columns": checksum([asdict(column) for column in columns()])[:8],
        "versions": {name: versions[name] for name in (*CODE, *more)},
    }


def weights_text(tuner: AnnTuner) -> str:
    """Content of the weights file that `tuner` names.

    Raises:
        ConfigurationError: It cannot be read.
    """
    return read_weights(default_network_path() if tuner.weights_file is None else Path(tuner.weights_file))
