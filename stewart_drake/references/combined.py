"""Motions made of other motions: sums, and one motion made smaller, slower or faded in."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Real, Section, Vector6
from stewart_drake.references.basic import Reference, smoothstep
from stewart_drake.registry import REFERENCES

Motion = Annotated[Reference, REFERENCES.but("sum", "adjusted")]
Scale = Annotated[Real, Field(ge=0.0, le=1e6)]


class SumReference(Section, key="reference"):
    """Several motions at once, such as breathing, heartbeat and tremor: center + sum (part - the part's own centre).

    Angles are added as angles: exact for one axis, a good approximation while tilts are small.
    """

    kind: Literal["sum"] = "sum"
    parts: Annotated[tuple[Motion, ...], Field(min_length=1)]
    """Motions, at least one. Of each counts how far it is from its own centre: `center` of a wave; the first pose of a
    path, a recording or a hold."""
    center: Vector6 | None = None
    """[rad, m] null takes the first part's."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        motions = [part.evaluate(time) for part in self.parts]
        pose, rate, acceleration = (np.sum(values, axis=0) for values in zip(*motions, strict=True))
        return pose - sum(map(center_of, self.parts)) + center_of(self), rate, acceleration


class AdjustedReference(Section, key="reference"):
    """A motion made smaller, slower or faded in: center + scale fade(s) (motion(s) - center) at s = t / slowdown.

    Slowed by k, rates are 1/k and accelerations 1/k^2 of what they were.
    """

    kind: Literal["adjusted"] = "adjusted"
    motion: Annotated[Reference, REFERENCES.but("adjusted")]
    """The motion to adjust."""
    scale: Scale = 1.0
    """[-] size of the motion about the centre, at least 0."""
    slowdown: Annotated[Real, Field(ge=1e-6, le=1e6)] = 1.0
    """[-] by how much longer the motion takes, 1e-6 to 1e6."""
    fade_in: Scale = 0.0
    """[s] of the motion's own time over which it grows from rest in the centre, a quintic; 0 for none."""
    center: Vector6 | None = None
    """[rad, m] null takes the motion's own: `center` of a wave; the first pose of a path, a recording or a hold."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        own = np.asarray(time, dtype=float) / self.slowdown
        pose, rate, acceleration = self.motion.evaluate(own)
        middle = center_of(self)
        away = pose - middle
        if self.fade_in > 0.0:
            fade, slope, curvature = (values[..., None] for values in smoothstep(own / self.fade_in))
            slope, curvature = slope / self.fade_in, curvature / self.fade_in**2
            acceleration = fade * acceleration + 2.0 * slope * rate + curvature * away
            rate = fade * rate + slope * away
            away = fade * away
        faster, faster_still = self.scale / self.slowdown, self.scale / self.slowdown**2
        return middle + self.scale * away, faster * rate, faster_still * acceleration


AnyReference = Annotated[Reference, REFERENCES]


def center_of(reference: Reference) -> np.ndarray:
    """The pose (6,) [rad, m] about which a motion is scaled and summed.

    Its `center` where it has one; otherwise that of the motion that it is made of, or its pose at t = 0.
    """
    center = getattr(reference, "center", None)
    if center is not None:
        return np.array(center, dtype=float)
    if isinstance(reference, SumReference):
        return center_of(reference.parts[0])
    if isinstance(reference, AdjustedReference):
        return center_of(reference.motion)
    return reference.evaluate(0.0)[0]
