"""Sensors that fail: readings that freeze, jump, drift, come late, of the wrong sign or from another leg; pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.compiled.constants import CHAIN_STATE
from stewart_drake.families import Table
from stewart_drake.hardware.faults import Fault, FaultKind, swap
from stewart_drake.hardware.sensing import LoopSite
from stewart_drake.registry import ENCODER_FAULTS, POSE_FAULTS
from stewart_drake.sampling import Running, Sampled
from stewart_drake.section import LegNumber, Positive, Real, Section, Text

Delay = Annotated[Positive, Field(le=1.0)]
"""[s] by which a reading may be late; so many readings are kept."""


class Reading(NamedTuple):
    """What a fault of a sensor finds.

    Attributes:
        says: (n,) what the sensor says, as the faults before have left it.
        good: (n,) the last reading before one of them that keeps it.
        late: (n,) true reading of as many ticks ago as the fault says.
        time: [s].
    """

    says: np.ndarray
    good: np.ndarray
    late: np.ndarray
    time: float


def _freeze(fault: Any, now: Reading) -> None:
    now.says[fault.channels] = now.good[fault.channels]


def _nan(fault: Any, now: Reading) -> None:
    now.says[fault.channels] = np.nan


def _late(fault: Any, now: Reading) -> None:
    now.says[fault.channels] = now.late[fault.channels]


def _jump(fault: Any, now: Reading) -> None:
    now.says[fault.channels] += fault.size


def _drift(fault: Any, now: Reading) -> None:
    now.says[fault.channels] += fault.size * (now.time - fault.time)


def _reversed(fault: Any, now: Reading) -> None:
    now.says[fault.channels] = 2.0 * now.good[fault.channels] - now.says[fault.channels]


def _inverted(fault: Any, now: Reading) -> None:
    now.says[fault.channels] *= -1.0


FREEZE, NAN, LATE = FaultKind(_freeze, keeps=True), FaultKind(_nan), FaultKind(_late, needs="delay")
JUMP, DRIFT, REVERSED = FaultKind(_jump), FaultKind(_drift), FaultKind(_reversed, keeps=True)
INVERTED, SWAPPED = FaultKind(_inverted), FaultKind(lambda fault, now: swap(fault, now.says), needs="other")


class EncoderFault(Fault, key="sensors.faults"):
    """One encoder that fails, or all six at once."""

    kinds: ClassVar[Table] = ENCODER_FAULTS
    kind: Annotated[Text, ENCODER_FAULTS]
    """freeze: repeats its last good reading. nan: not a number. jump: off by `size`, as after slipped counts. late:
    says what it read `delay` ago. drift: off by `size` more each second. reversed: counts backwards from its last good
    reading. inverted: says the negative angle. swapped: `leg` and `other` say each other's angle."""
    leg: LegNumber | None
    """0 to 5; null for all."""
    duration: Positive | None = None
    """[s] after which the encoder works again; null for never."""
    size: Real = 0.0
    """[rad] of a jump, [rad/s] of a drift."""
    delay: Delay | None = None
    """[s] of a late reading, up to 1; rounded up to whole ticks."""
    other: LegNumber | None = None
    """0 to 5, of swapped encoders."""


class PoseFault(Fault, key="sensors.faults"):
    """A sensor of pose and rate that fails as a whole."""

    kinds: ClassVar[Table] = POSE_FAULTS
    kind: Annotated[Text, POSE_FAULTS]
    """freeze: repeats its last good reading. nan: not a number. late: says what it read `delay` ago."""
    duration: Positive | None = None
    """[s] after which the sensor works again; null for never."""
    delay: Delay | None = None
    """[s] of a late reading, up to 1; rounded up to whole ticks."""


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

    @property
    def reading_noise(self) -> float:
        """[rad] standard deviation of a crank's angle as it is read."""
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


Faults = Sequence[EncoderFault] | Sequence[PoseFault]


def kept_readings(faults: Faults, period: float) -> int:
    """Rows of the memory of `faulty_reading`: the last good readings, and as many before as the latest fault needs."""
    return 1 + max((ticks_late(fault, period) for fault in faults), default=0)


def ticks_late(fault: EncoderFault | PoseFault, period: float) -> int:
    """Whole ticks by which a fault delays a reading; 0 for one that does not."""
    return 0 if fault.delay is None else math.ceil(fault.delay / period - 1e-6)


def faulty_reading(
    faults: Faults, reading: np.ndarray, time: float, period: float, memory: np.ndarray
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
    says, kept = np.array(reading, dtype=float), np.zeros(len(reading), dtype=bool)
    for fault in faults:
        if fault.spoil(time, Reading(says, memory[0], memory[ticks_late(fault, period)], time)):
            kept[fault.channels] |= fault.does.keeps
    after = np.vstack([np.where(kept, memory[0], reading), reading, memory[1:]])[: len(memory)]
    return says, after


def faulty_sensor(faults: Faults, size: int, period: float) -> Sampled:
    """`faulty_reading` of readings (size,) and the time [s], tick by tick; what it says, first, and its memory."""
    rows = kept_readings(faults, period)

    def tick(reading: np.ndarray, time: float, before: np.ndarray) -> np.ndarray:
        memory = before[size:-1].reshape(rows, size)
        if before[-1] == 0.0:
            # A sensor that fails from the start repeats what was there at the start.
            memory = np.tile(reading, (rows, 1))
        says, memory = faulty_reading(faults, reading, time, period, memory)
        return np.concatenate([says, memory.ravel(), [1.0]])

    return Sampled(np.zeros((1 + rows) * size + 1), tick)


class IdealSensing:
    """`IdealSensors` in one run; see `Sensing`."""

    size = 12
    angles = None

    def __init__(self, options: IdealSensors, site: LoopSite) -> None:
        self._faulty = Running(faulty_sensor(options.faults, 12, site.period)) if options.faults else None
        self.live = not options.faults

    def __call__(self, time: float, tick: int, state: np.ndarray) -> np.ndarray:  # noqa: ARG002 - no noise
        """See `Sensing`."""
        # A copy, because the state goes on.
        true = state[: CHAIN_STATE.twist].copy()
        return true if self._faulty is None else self._faulty(time, true, time)[:12]
