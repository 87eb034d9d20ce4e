"""Reference motions q(t) with exact first and second derivatives; poses are [roll, pitch, yaw, X, Y, Z] of P in B."""

from stewart_drake.references.basic import (
    HoldReference,
    Reference,
    SineBurstsReference,
    SineReference,
    in_blocks,
    paper_reference,
)
from stewart_drake.references.combined import AdjustedReference, AnyReference, SumReference, center_of
from stewart_drake.references.paths import MinimumJerkReference, SplineReference
from stewart_drake.references.recorded import RecordedReference
from stewart_drake.references.surgical import BreathingReference, HeartbeatReference, TremorReference

__all__ = [
    "AdjustedReference",
    "AnyReference",
    "BreathingReference",
    "HeartbeatReference",
    "HoldReference",
    "MinimumJerkReference",
    "RecordedReference",
    "Reference",
    "SineBurstsReference",
    "SineReference",
    "SplineReference",
    "SumReference",
    "TremorReference",
    "center_of",
    "in_blocks",
    "paper_reference",
]
