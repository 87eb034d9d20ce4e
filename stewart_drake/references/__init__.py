"""Reference motions q(t) with exact first and second derivatives; poses are [roll, pitch, yaw, X, Y, Z] of P in B."""

from stewart_drake.references.motions import (
    AdjustedReference,
    AnyReference,
    HoldReference,
    MinimumJerkReference,
    Reference,
    SineBurstsReference,
    SineReference,
    SplineReference,
    SumReference,
    center_of,
    paper_reference,
)
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
    "paper_reference",
]
