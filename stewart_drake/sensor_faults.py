"""Sensors that fail: a reading that freezes, jumps or is not a number; pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from stewart_drake.option_checks import check_choice, check_leg, check_positive, check_real
from stewart_drake.scalars import SECTION, Leg, NotNegative, Positive, Real

EncoderFaultKind = Literal["freeze", "nan", "jump"]
PoseFaultKind = Literal["freeze", "nan"]


@dataclass(frozen=True, kw_only=True)
class EncoderFault:
    """One encoder that fails.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    kind: EncoderFaultKind
    """freeze: repeats its last good reading. nan: not a number. jump: off by `size`, as after slipped counts."""
    leg: Leg
    """0 to 5."""
    time: NotNegative = 0.0
    """[s] when it begins."""
    duration: Positive | None = None
    """[s] after which the encoder is well again; null for never."""
    size: Real = 0.0
    """[rad] of a jump."""

    def __post_init__(self) -> None:
        check_choice("sensors.faults.kind", self.kind, "freeze", "nan", "jump")
        check_leg("sensors.faults.leg", self.leg)
        _check_times(self.time, self.duration)
        check_real("sensors.faults.size", self.size, -math.inf, "a finite number [rad]")

    @property
    def channels(self) -> slice:
        """Entries of the reading that it spoils."""
        return slice(self.leg, self.leg + 1)


@dataclass(frozen=True, kw_only=True)
class PoseFault:
    """A sensor of pose and rate that fails as a whole.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    kind: PoseFaultKind
    """freeze: repeats its last good reading. nan: not a number."""
    time: NotNegative = 0.0
    """[s] when it begins."""
    duration: Positive | None = None
    """[s] after which the sensor is well again; null for never."""

    def __post_init__(self) -> None:
        check_choice("sensors.faults.kind", self.kind, "freeze", "nan")
        _check_times(self.time, self.duration)

    @property
    def channels(self) -> slice:
        """Entries of the reading that it spoils: all."""
        return slice(None)


def faulty_reading(
    faults: Sequence[EncoderFault] | Sequence[PoseFault], reading: np.ndarray, time: float, good: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a sensor says where it may have failed.

    Args:
        faults: Those of the scenario; of two at once on one channel the later in the list wins.
        reading: (n,) true.
        time: [s].
        good: (n,) for each channel the last reading before it froze, from the tick before.

    Returns:
        The reading (n,) and `good` (n,) for the next tick.
    """
    says, frozen = np.array(reading, dtype=float), np.zeros(len(reading), dtype=bool)
    for fault in faults:
        if not fault.time <= time < fault.time + (math.inf if fault.duration is None else fault.duration):
            continue
        where = fault.channels
        if fault.kind == "freeze":
            says[where], frozen[where] = good[where], True
        elif fault.kind == "nan":
            says[where] = np.nan
        elif isinstance(fault, EncoderFault):
            says[where] += fault.size
    return says, np.where(frozen, good, reading)


def _check_times(time: Any, duration: Any) -> None:
    check_real("sensors.faults.time", time)
    if duration is not None:
        check_positive("sensors.faults.duration", duration, allowed="a positive number [s], or null")
