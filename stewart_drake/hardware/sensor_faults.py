"""Sensors that fail: readings that freeze, jump, drift, come late, of the wrong sign or from another leg; pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from stewart_drake.errors import ConfigurationError
from stewart_drake.section import Leg, NotNegative, Positive, Real, Section

EncoderFaultKind = Literal["freeze", "nan", "jump", "late", "drift", "reversed", "inverted", "swapped"]
PoseFaultKind = Literal["freeze", "nan", "late"]

LONGEST_DELAY = 1.0
"""[s] by which a reading may be late; so many readings are kept."""
Delay = Annotated[Positive, Field(le=LONGEST_DELAY)]


class EncoderFault(Section, key="sensors.faults"):
    """One encoder that fails, or all six at once."""

    kind: EncoderFaultKind
    """freeze: repeats its last good reading. nan: not a number. jump: off by `size`, as after slipped counts. late:
    says what it read `delay` ago. drift: off by `size` more each second. reversed: counts backwards from its last good
    reading. inverted: says the negative angle. swapped: `leg` and `other` say each other's angle."""
    leg: Leg | None
    """0 to 5; null for all."""
    time: NotNegative = 0.0
    """[s] when it begins."""
    duration: Positive | None = None
    """[s] after which the encoder is well again; null for never."""
    size: Real = 0.0
    """[rad] of a jump, [rad/s] of a drift."""
    delay: Delay | None = None
    """[s] of a late reading, up to 1; rounded up to whole ticks."""
    other: Leg | None = None
    """0 to 5, of swapped encoders."""

    def rules(self) -> None:
        """See `Section.rules`."""
        if self.kind == "swapped" and self.leg is None:
            raise ConfigurationError("leg", self.leg, "a leg from 0 to 5, for kind swapped")
        _check_delay(self.kind, self.delay)
        check_other_leg(self.kind, self.leg, self.other)

    @property
    def channels(self) -> slice:
        """Entries of the reading that it spoils."""
        return slice(None) if self.leg is None else slice(self.leg, self.leg + 1)


class PoseFault(Section, key="sensors.faults"):
    """A sensor of pose and rate that fails as a whole."""

    kind: PoseFaultKind
    """freeze: repeats its last good reading. nan: not a number. late: says what it read `delay` ago."""
    time: NotNegative = 0.0
    """[s] when it begins."""
    duration: Positive | None = None
    """[s] after which the sensor is well again; null for never."""
    delay: Delay | None = None
    """[s] of a late reading, up to 1; rounded up to whole ticks."""

    def rules(self) -> None:
        """See `Section.rules`."""
        _check_delay(self.kind, self.delay)

    @property
    def channels(self) -> slice:
        """Entries of the reading that it spoils: all."""
        return slice(None)


class SensorOptions(Section, key="sensors"):
    """Base of the options of sensors; wiring, safety and logs ask these, not which kind it is."""

    kind: str
    """Of sensor."""
    faults: tuple[Any, ...] = ()
    """Times at which it fails."""

    @property
    def exact(self) -> bool:
        """Whether what the controller sees is the truth."""
        return False

    @property
    def quantum(self) -> float:
        """[rad] of a count, of sensors that read the cranks' angles; 0 for none."""
        return 0.0


class IdealSensors(SensorOptions):
    """Pose and rate of the platform, exact."""

    kind: Literal["ideal"] = "ideal"
    faults: tuple[PoseFault, ...] = ()
    """Times at which the sensor fails."""

    @property
    def exact(self) -> bool:
        """See `SensorOptions`."""
        return not self.faults


def kept_readings(faults: Sequence[EncoderFault] | Sequence[PoseFault], period: float) -> int:
    """Rows of the memory of `faulty_reading`: the last good readings, and as many before as the latest fault needs."""
    return 1 + max((ticks_late(fault, period) for fault in faults), default=0)


def ticks_late(fault: EncoderFault | PoseFault, period: float) -> int:
    """Whole ticks by which a fault delays a reading; 0 for one that does not."""
    return 0 if fault.delay is None else math.ceil(fault.delay / period - 1e-6)


def faulty_reading(
    faults: Sequence[EncoderFault] | Sequence[PoseFault],
    reading: np.ndarray,
    time: float,
    period: float,
    memory: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """What a sensor says where it may have failed.

    Args:
        faults: Those of the scenario, in order: each acts on what those before it have made of the reading.
        reading: (n,) true.
        time: [s].
        period: [s] of the ticks.
        memory: (`kept_readings`, n) of the tick before: for each channel the last reading before it froze or began to
            count backwards, then the true readings of the ticks before, newest first. Before the first tick all rows
            are the first reading.

    Returns:
        The reading (n,) and the memory for the next tick.
    """
    good = memory[0]
    says, kept = np.array(reading, dtype=float), np.zeros(len(reading), dtype=bool)
    for fault in faults:
        if not fault.time <= time < fault.time + (math.inf if fault.duration is None else fault.duration):
            continue
        where = fault.channels
        if fault.kind == "freeze":
            says[where], kept[where] = good[where], True
        elif fault.kind == "nan":
            says[where] = np.nan
        elif fault.kind == "late":
            says[where] = memory[ticks_late(fault, period)][where]
        elif fault.kind == "reversed":
            says[where], kept[where] = 2.0 * good[where] - says[where], True
        elif isinstance(fault, EncoderFault):
            _spoil(fault, says, time)
    after = np.vstack([np.where(kept, good, reading), reading, memory[1:]])[: len(memory)]
    return says, after


def _spoil(fault: EncoderFault, says: np.ndarray, time: float) -> None:
    """The kinds that need no memory, in place."""
    if fault.kind == "swapped":
        pair = np.array([fault.leg, fault.other], dtype=int)
        says[pair] = says[pair[::-1]]
    elif fault.kind == "inverted":
        says[fault.channels] *= -1.0
    else:
        says[fault.channels] += fault.size * (1.0 if fault.kind == "jump" else time - fault.time)


def _check_delay(kind: str, delay: float | None) -> None:
    if (kind == "late") != (delay is not None):
        late = f"a positive number up to {LONGEST_DELAY:g} s, for kind late"
        raise ConfigurationError("delay", delay, late if kind == "late" else "null, but for kind late")


def check_other_leg(kind: str, leg: int | None, other: int | None) -> None:
    """Raises a `ConfigurationError` unless two swapped legs are two, and only they have an `other`."""
    if kind != "swapped" and other is not None:
        raise ConfigurationError("other", other, "null, but for kind swapped")
    if kind == "swapped" and (other is None or other == leg):
        raise ConfigurationError("other", other, f"another leg than {leg}, 0 to 5")
