"""How sensors, commands and motors fail: on a leg, or on all, from a time on, for a while; and chance, tick by tick.

What a kind of fault does is one function of the fault and of the signal that it spoils, and a line in the registry.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.config import LegNumber, NotNegative, Positive, Real, Section, Text, either
from stewart_drake.errors import ConfigurationError
from stewart_drake.families import Table
from stewart_drake.registry import COMMAND_FAULTS, ENCODER_FAULTS, MOTOR_FAULTS, POSE_FAULTS

_BLOCK = 1024


def tick_numbers(seed: int, stream: int, tick: int, size: int, normal: bool) -> np.ndarray:
    """Random numbers (size,) of a tick, standard normal or in [0, 1): the same whenever and as often as it is asked.

    Different streams of one seed are independent.
    """
    return _block(seed, stream, tick // _BLOCK, size, normal)[tick % _BLOCK]


@lru_cache(maxsize=64)
def _block(seed: int, stream: int, block: int, size: int, normal: bool) -> np.ndarray:
    # Philox counts: a block is reached without drawing those before it. The low counter words run within the block.
    generator = np.random.Generator(np.random.Philox(key=[seed, stream], counter=[0, 0, 0, block]))
    values = generator.standard_normal((_BLOCK, size)) if normal else generator.random((_BLOCK, size))
    values.flags.writeable = False
    return values


@dataclass
class Signal:
    """What a fault finds, and spoils in place.

    Attributes:
        says: (n,) readings or torques, as the faults before have left them.
        time: [s].
        tick: Of the controller.
        good: (n,) the last readings before one of the faults that keep them; of sensors.
        late: (n,) true readings of as many ticks ago as the fault says; of sensors.
    """

    says: np.ndarray
    time: float = 0.0
    tick: int = 0
    good: Any = None
    late: Any = None


class FaultKind(NamedTuple):
    """What a kind of fault does.

    Attributes:
        spoil: Called with the section of the fault and with a `Signal`, whose `says` it changes in place.
        needs: Key that this kind must have, and that is null for kinds that do not need it; empty for none.
        keeps: Whether it goes on from the last good reading, which is then kept; of sensors.
    """

    spoil: Callable[[Any, Any], None]
    needs: str = ""
    keeps: bool = False


def _kind(value: Callable[[Any, Signal, Any], Any], needs: str = "", keeps: bool = False) -> FaultKind:
    """A kind by what its channels say instead, of fault, signal and what they say now."""

    def spoil(fault: Any, signal: Signal) -> None:
        signal.says[fault.channels] = value(fault, signal, signal.says[fault.channels])

    return FaultKind(spoil, needs, keeps)


def _swapped(fault: Any, signal: Signal) -> None:
    pair = [fault.leg, fault.other]
    signal.says[pair] = signal.says[pair[::-1]]


NAN, INF = _kind(lambda *_: math.nan), _kind(lambda *_: math.inf)
FREEZE = _kind(lambda f, s, now: s.good[f.channels], keeps=True)  # noqa: ARG005
REVERSED = _kind(lambda f, s, now: 2.0 * s.good[f.channels] - now, keeps=True)
LATE = _kind(lambda f, s, now: s.late[f.channels], needs="delay")  # noqa: ARG005
JUMP = _kind(lambda f, s, now: now + f.size)  # noqa: ARG005
DRIFT = _kind(lambda f, s, now: now + f.size * (s.time - f.time))
CHATTER = _kind(lambda f, s, now: now + f.size * (-1.0) ** s.tick)
INVERTED = _kind(lambda f, s, now: -now)  # noqa: ARG005
SWAPPED = FaultKind(_swapped, needs="other")


class Fault(Section):
    """Base of the faults; one that has no key `leg`, `duration`, `delay` or `other` acts as where that is null."""

    kinds: ClassVar[Table]
    kind: str
    time: NotNegative = 0.0
    """[s] when it begins."""

    def _key(self, name: str) -> Any:
        return getattr(self, name, None)

    def spoil(self, signal: Signal) -> bool:
        """Does what its kind does, if it is there at the signal's time; whether it is."""
        duration = self._key("duration")
        acts = self.time <= signal.time < self.time + (math.inf if duration is None else duration)
        if acts:
            self.kinds[self.kind].spoil(self, signal)
        return acts

    @property
    def channels(self) -> slice:
        """Entries that it spoils: of its leg, or all."""
        leg = self._key("leg")
        return slice(None) if leg is None else slice(leg, leg + 1)

    def ticks_late(self, period: float) -> int:
        """Whole ticks of a period [s] by which it delays a reading; 0 for a kind that does not."""
        return math.ceil((self._key("delay") or 0.0) / period - 1e-6)

    def rules(self) -> None:
        """The keys that the kind needs, and no others."""
        leg, other = self._key("leg"), self._key("other")
        for key, words in (("delay", "a positive number"), ("other", "a leg from 0 to 5")):
            kinds, value = [name for name in self.kinds.names if self.kinds[name].needs == key], self._key(key)
            if (value is None) == (self.kind in kinds):
                raise ConfigurationError(key, value, f"{words} for kind {either(kinds)}" if kinds else "null")
        if other is not None and leg in (None, other):
            key, given, apart = ("leg", leg, other) if leg is None else ("other", other, leg)
            raise ConfigurationError(key, given, f"a leg from 0 to 5, other than {apart}")


Delay = Annotated[Positive, Field(le=1.0)]
"""[s] by which a reading may be late; so many readings are kept."""


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


class CommandFault(Fault, key="link.faults"):
    """Commands that a broken controller would send."""

    kinds: ClassVar[Table] = COMMAND_FAULTS
    kind: Annotated[Text, COMMAND_FAULTS]
    """nan and inf in place of the torque; offset: `size` is added; chatter: `size` is added in one tick and
    subtracted in the next."""
    leg: LegNumber | None = None
    """0 to 5; null for all."""
    duration: Positive | None = None
    """[s] after which commands are correct again; null for never."""
    size: Real = 0.0
    """[N m] of offset and chatter."""


class MotorFault(Fault, key="motors.faults"):
    """Motors wired wrong, for good."""

    kinds: ClassVar[Table] = MOTOR_FAULTS
    kind: Annotated[Text, MOTOR_FAULTS]
    """reversed: a torque of the other sign. swapped: each of two motors gives the other's torque."""
    leg: LegNumber
    """0 to 5."""
    other: LegNumber | None = None
    """0 to 5, of swapped motors."""
