"""Motions made of other motions: sums, and one motion made smaller, slower or faded in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator

from stewart_drake.errors import ConfigurationError
from stewart_drake.references.base import Reference, check_numbers, check_vectors, smoothstep
from stewart_drake.references.basic import HoldReference, SineBurstsReference, SineReference
from stewart_drake.references.paths import MinimumJerkReference, SplineReference
from stewart_drake.references.recorded import RecordedReference
from stewart_drake.references.surgical import BreathingReference, HeartbeatReference, TremorReference
from stewart_drake.section import SECTION, NotNegative, Positive, Vector6

Motion = (
    HoldReference
    | SineReference
    | SineBurstsReference
    | BreathingReference
    | HeartbeatReference
    | TremorReference
    | MinimumJerkReference
    | SplineReference
    | RecordedReference
)


def _inside(key: str) -> WrapValidator:
    """Names a bad value in a motion inside of another motion with the whole of its key."""

    def renamed(error: ConfigurationError, place: str) -> ConfigurationError:
        return ConfigurationError(error.key.replace("reference.", f"reference.{place}.", 1), error.value, error.allowed)

    def validate(data: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        data = _plain(data)
        try:
            return handler(data)
        except ConfigurationError as error:
            if not isinstance(data, (list, tuple)):
                raise renamed(error, key) from None
        for index, part in enumerate(data):
            try:
                handler([part])
            except ConfigurationError as error:
                raise renamed(error, f"{key}.{index}") from None
        raise AssertionError("one of the parts is bad")  # pragma: no cover

    return WrapValidator(validate)


def _plain(data: Any) -> Any:
    """A motion made in Python as a section of a file, so that it is checked like one."""
    if isinstance(data, (list, tuple)):
        return [_plain(part) for part in data]
    if isinstance(data, type) or not dataclasses.is_dataclass(data):
        return data
    return {field.name: _plain(getattr(data, field.name)) for field in dataclasses.fields(data)}


@dataclass(frozen=True, kw_only=True)
class SumReference:
    """Several motions at once, such as breathing, heartbeat and tremor: center + sum (part - the part's own centre).

    Angles are added as angles: exact for one axis, a good approximation while tilts are small.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    kind: Literal["sum"] = "sum"
    parts: Annotated[tuple[Annotated[Motion, Field(discriminator="kind")], ...], _inside("parts")]
    """Motions, at least one. Of each counts how far it is from its own centre: `center` of a wave; the first pose of a
    path, a recording or a hold."""
    center: Vector6 | None = None
    """[rad, m] null takes the first part's."""

    def __post_init__(self) -> None:
        if not len(self.parts):
            raise ConfigurationError("reference.parts", self.parts, "at least one motion")
        if self.center is not None:
            check_vectors(self, "center")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`."""
        motions = [part.evaluate(time) for part in self.parts]
        pose, rate, acceleration = (np.sum(values, axis=0) for values in zip(*motions, strict=True))
        return pose - sum(map(center_of, self.parts)) + center_of(self), rate, acceleration


@dataclass(frozen=True, kw_only=True)
class AdjustedReference:
    """A motion made smaller, slower or faded in: center + scale fade(s) (motion(s) - center) at s = t / slowdown.

    Slowed by k, rates are 1/k and accelerations 1/k^2 of what they were.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    kind: Literal["adjusted"] = "adjusted"
    motion: Annotated[Motion | SumReference, Field(discriminator="kind"), _inside("motion")]
    """The motion to adjust."""
    scale: NotNegative = 1.0
    """[-] size of the motion about the centre, at least 0."""
    slowdown: Positive = 1.0
    """[-] by how much longer the motion takes, 1e-6 to 1e6."""
    fade_in: NotNegative = 0.0
    """[s] of the motion's own time over which it grows from rest in the centre, a quintic; 0 for none."""
    center: Vector6 | None = None
    """[rad, m] null takes the motion's own: `center` of a wave; the first pose of a path, a recording or a hold."""

    def __post_init__(self) -> None:
        check_numbers(self, 1e-6, 1e6, "a number from 1e-06 to 1e+06", "slowdown")
        check_numbers(self, 0.0, 1e6, "a number from 0 to 1e+06", "scale", "fade_in")
        if self.center is not None:
            check_vectors(self, "center")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`."""
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


AnyReference = Annotated[Motion | SumReference | AdjustedReference, Field(discriminator="kind")]


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
