"""Temporary faults of sensors, commands and motors; a kind is a function and a line in the registry."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Flag, LegNumber, NotNegative, Positive, Real, Section, Text
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import Table
from stewart_drake.base.keys import join_or
from stewart_drake.base.records import Record
from stewart_drake.base.registry import COMMAND_FAULTS, ENCODER_FAULTS, IMU_FAULTS, MOTOR_FAULTS, POSE_FAULTS
from stewart_drake.loop.part import Part

_BLOCK = 1024


def tick_numbers(seed: int, stream: int, tick: int, size: int, normal: bool) -> np.ndarray:
    """Random numbers (size,) of a tick, normal or in [0, 1): a function of the arguments, independent by stream."""
    return _block(seed, stream, tick // _BLOCK, size, normal)[tick % _BLOCK]


@lru_cache(maxsize=64)
def _block(seed: int, stream: int, block: int, size: int, normal: bool) -> np.ndarray:
    # Philox has a counter: a block is reached without drawing the blocks before it. Its low words count in the block.
    generator = np.random.Generator(np.random.Philox(key=[seed, stream], counter=[0, 0, 0, block]))
    values = generator.standard_normal((_BLOCK, size)) if normal else generator.random((_BLOCK, size))
    values.flags.writeable = False
    return values


@dataclass
class Signal:
    """A signal, which faults change in place."""

    values: np.ndarray  # (n,) readings or torques, after the faults before.
    time: float = 0.0  # [s].
    tick: int = 0  # Number of the controller's tick.
    good: np.ndarray | None = None  # (n,) readings of a sensor before a fault that keeps them.
    stale: np.ndarray | None = None  # (n,) true readings of a sensor, `delay` of the fault ago.


class FaultKind(NamedTuple):
    """A kind of fault."""

    # From a fault and its signal; changes `values` of the signal in place.
    spoil: Callable[..., None]
    needs: str = ""  # Key that this kind must have, and that is null for kinds that do not need it; empty for none.
    keeps: bool = False  # Whether it continues from the last good reading of a sensor, which is then kept.


def _kind(value: Callable[..., float | np.ndarray], needs: str = "", keeps: bool = False) -> FaultKind:
    """A kind by the values of its channels, from fault, signal and the values without it."""

    def spoil(fault: Fault, signal: Signal) -> None:
        signal.values[fault.channels] = value(fault, signal, signal.values[fault.channels])

    return FaultKind(spoil, needs, keeps)


def _swapped(fault: LegFault, signal: Signal) -> None:
    pair = np.array([fault.leg, fault.other])
    signal.values[pair] = signal.values[pair[::-1]]


NAN, INF = _kind(lambda *_: math.nan), _kind(lambda *_: math.inf)
FREEZE = _kind(lambda f, s, now: np.where(np.isnan(now), now, s.good[f.channels]), keeps=True)
REVERSED = _kind(lambda f, s, now: 2.0 * s.good[f.channels] - now, keeps=True)
LATE = _kind(lambda f, s, now: s.stale[f.channels], needs="delay")  # noqa: ARG005
JUMP = _kind(lambda f, s, now: now + f.size, needs="size")  # noqa: ARG005
DRIFT = _kind(lambda f, s, now: now + f.size * (s.time - f.time), needs="size")
CHATTER = _kind(lambda f, s, now: now + f.size * (-1.0) ** s.tick, needs="size")
INVERTED = _kind(lambda f, s, now: -now)  # noqa: ARG005
SWAPPED = FaultKind(_swapped, needs="other")


_AXES = [f"{name}_{axis}" for name in ("gyro", "accelerometer") for axis in "xyz"]
IMU_CHANNELS = Table(
    {"gyro": slice(3), "accelerometer": slice(3, 6)} | {name: slice(k, k + 1) for k, name in enumerate(_AXES)}
)
"""Names of channels of an inertial sensor, and their places in its reading."""


class Fault(Section):
    """Base of the faults of a signal: the kinds that are allowed for it, and common keys."""

    kinds: ClassVar[Table]
    kind: str
    time: NotNegative = 0.0
    """[s] when the fault begins."""
    duration: Positive | None = None
    """[s] how long the fault lasts; null for the rest of the run."""
    size: Real | None = None
    """[rad] size of a jump, or [rad/s] of a drift."""
    delay: Annotated[Positive, Field(le=1.0)] | None = None
    """[s] delay of a late reading, up to 1; rounded up to whole ticks."""

    def spoil(self, signal: Signal) -> bool:
        """Changes the signal if the fault is active at its time; returns whether it is."""
        active = self.time <= signal.time < self.time + (math.inf if self.duration is None else self.duration)
        if active:
            self.kinds[self.kind].spoil(self, signal)
        return active

    @property
    def channels(self) -> slice:
        """Those of the signal that fail."""
        return slice(None)

    def ticks_late(self, period: float) -> int:
        """Delay of a reading in whole ticks of a period [s]."""
        return math.ceil((self.delay or 0.0) / period - 1e-6)

    def rules(self) -> None:
        for key, words in (("size", "a number"), ("delay", "a positive number"), ("other", "a leg from 0 to 5")):
            kinds, value = (
                [name for name in self.kinds.names if self.kinds[name].needs == key],
                getattr(self, key, None),
            )
            if (value is None) == (self.kind in kinds):
                raise ConfigurationError(key, value, f"{words} for kind {join_or(kinds)}" if kinds else "null")


class LegFault(Fault):
    """Base of the faults of a signal with a channel for each leg."""

    leg: LegNumber | None = None
    """Number of the leg, 0 to 5; null for all."""
    other: LegNumber | None = None
    """The second leg of swapped ones, 0 to 5."""

    @property
    def channels(self) -> slice:
        return slice(None) if self.leg is None else slice(self.leg, self.leg + 1)

    def rules(self) -> None:
        super().rules()
        if self.other is not None and self.leg in (None, self.other):
            key, value, other = ("leg", None, self.other) if self.leg is None else ("other", self.other, self.leg)
            raise ConfigurationError(key, value, f"a leg from 0 to 5, other than {other}")


class EncoderFault(LegFault, key="sensors.faults"):
    """One encoder that fails, or all six at once."""

    kinds = ENCODER_FAULTS
    kind: Annotated[Text, ENCODER_FAULTS]
    """Kind of fault. freeze: repeats its last good reading. nan: reads not a number. jump: is off by `size`, as after
    slipped counts. late: gives its reading of `delay` ago. drift: is off by `size` more each second. reversed: counts
    backwards from its last good reading. inverted: gives the negative angle. swapped: `leg` and `other` give each
    other's angle."""
    in_servo: Flag = False
    """Where motors take angles: true for a fault of the servo's own sensor, which misleads its position loop too, so
    that it turns the crank; without a reading it gives no torque. false for one on the way to the controller."""


class PoseFault(LegFault, key="sensors.faults"):
    """A fault of a sensor of pose and rate, in all its readings."""

    kinds = POSE_FAULTS
    kind: Annotated[Text, POSE_FAULTS]
    """Kind of fault. freeze: repeats its last good reading. nan: reads not a number. late: gives its reading of `delay`
    ago."""

    def rules(self) -> None:
        super().rules()
        if self.leg is not None:
            raise ConfigurationError("leg", self.leg, "null; a pose has no legs")


class ImuFault(Fault, key="sensors.imu.faults"):
    """The inertial sensor on the platform fails, in all its readings or some of them."""

    kinds = IMU_FAULTS
    kind: Annotated[Text, IMU_FAULTS]
    """Kind of fault. freeze: repeats its last good reading. nan: gives no readings any more. jump: is off by `size`.
    drift: is off by `size` more each second. late: gives its reading of `delay` ago. inverted: has the wrong sign."""
    channel: Annotated[Text, IMU_CHANNELS] | None = None
    """Channels that fail, such as gyro_z, or gyro for three; null for all six."""
    size: Real | None = None
    """Size of a jump, or of a drift in a second: in rad/s for gyroscopes, in m/s^2 for accelerometers."""

    @property
    def channels(self) -> slice:
        return IMU_CHANNELS[self.channel] if self.channel else slice(None)

    def rules(self) -> None:
        super().rules()
        if self.size is not None and self.channel is None:
            allowed = "channels of one unit for a size, such as gyro_z or accelerometer"
            raise ConfigurationError("channel", self.channel, allowed)


class CommandFault(LegFault, key="link.faults"):
    """Corrupted commands, as from a broken controller."""

    kinds = COMMAND_FAULTS
    kind: Annotated[Text, COMMAND_FAULTS]
    """Kind of fault. nan: sends not a number. inf: sends infinity. offset: adds `size`. chatter: adds `size` in one
    tick and subtracts it in the next."""
    size: Real | None = None
    """[N m] size of an offset or chatter; [rad] for motors that take angles."""


class MotorFault(LegFault, key="motors.faults"):
    """Motors that are wired wrongly."""

    kinds = MOTOR_FAULTS
    kind: Annotated[Text, MOTOR_FAULTS]
    """Kind of fault. reversed: the torque has the opposite sign. swapped: two motors get each other's torque."""


class FaultySensorState(Record):
    """State of a sensor of `size` channels that may fail."""

    reading: Annotated[np.ndarray, ("size",)]
    good: Annotated[np.ndarray, ("size",)]  # The last readings before a fault that keeps them.
    history: Annotated[np.ndarray, ("rows", "size")]  # True readings of this tick and those before, newest first.
    ticks: float  # Done.


def faulty_sensor_part(faults: Sequence[Fault], size: int, period: float) -> Part:
    """A sensor that may fail: true `reading` (n,) and `time` (1,) [s] -> `reading` (n,), with all faults in order."""
    delays = tuple(fault.ticks_late(period) for fault in faults)
    constants, inputs = {"faults": faults, "delays": delays}, {"reading": size, "time": 1}
    first = FaultySensorState.sized(size=size, rows=1 + max(delays, default=0)).new()
    return Part("faulty_sensor", _fail, constants, inputs, ("reading",), first)


def _fail(
    faults: Sequence[Fault], delays: Sequence[int], reading: np.ndarray, time: np.ndarray, state: FaultySensorState
) -> None:
    good, history, now = state["good"][0], state["history"][0], reading.copy()
    if state["ticks"][0] == 0.0:
        # A sensor that fails from the start repeats its first true reading.
        good[:] = history[:] = reading
    history[1:] = history[:-1].copy()
    history[0] = reading
    # An inertial sensor has no new reading in every tick, a frozen one too.
    kept = np.isnan(reading)
    for fault, delay in zip(faults, delays, strict=True):
        if fault.spoil(Signal(now, float(time[0]), int(state["ticks"][0]), good, history[delay])):
            kept[fault.channels] |= fault.kinds[fault.kind].keeps
    good[~kept] = reading[~kept]
    state["reading"][0] = now
    state["ticks"] += 1.0
