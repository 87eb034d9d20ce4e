"""What there is to say of a policy, as rows of texts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from stewart_drake.control.features import FEATURES
from stewart_drake.control.policy import Policy
from stewart_drake.control.settings import NAMES

BOX_HEADER = ("setting", "least", "centre", "largest")


def box_rows(policy: Policy) -> list[tuple[str, ...]]:
    """A row for each number of a setting, under `BOX_HEADER`."""
    ends = policy.lowest, policy.centre, policy.lowest + policy.width
    return [(name, *(f"{each[k]:.3g}" for each in ends)) for k, name in enumerate(NAMES)]


def facts(policy: Policy) -> list[tuple[str, str]]:
    """Rows of two texts: what it is made of, then its provenance, dotted keys."""
    hidden = np.asarray(policy.layers.hidden)
    heard = [name for name, column in zip(FEATURES, hidden.T, strict=True) if column.any()]
    return [
        ("hears", ", ".join(heard) or "nothing"),
        ("hidden units", str(len(hidden))),
        *_told("", policy.provenance),
    ]


def _told(place: str, value: Any) -> Iterator[tuple[str, str]]:
    """Nested plain values as rows; lists of plain values are one."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from _told(f"{place}.{key}" if place else str(key), each)
    elif isinstance(value, list) and any(isinstance(each, (Mapping, list)) for each in value):
        for index, each in enumerate(value):
            yield from _told(f"{place}[{index}]", each)
    else:
        parts = value if isinstance(value, list) else [value]
        yield place, ", ".join(f"{each:.4g}" if isinstance(each, float) else str(each) for each in parts)
