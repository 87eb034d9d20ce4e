"""External wrenches [moment, force] on the platform about P in B, (6,) [N m, N], as functions of time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Literal, Protocol

import numpy as np

from stewart_drake.base.config import NotNegative, Phase, Positive, Section, Seed, Vector6
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.families import UserMade
from stewart_drake.base.registry import DISTURBANCES
from stewart_drake.references.surgical import random_sines

_SINES = 64  # The sum is close to normal, and repeats after hours. Assumed.


class ConstantWrench(Section, key="disturbances"):
    """A constant wrench."""

    wrench: Vector6
    """[N m, N] moment about P and force, in the base frame B."""
    kind: Literal["constant"] = "constant"

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        return _active(time)[..., None] * np.array(self.wrench)


class StepWrench(Section, key="disturbances"):
    """A constant wrench that begins at one time and ends at another."""

    wrench: Vector6
    """[N m, N] moment about P and force, in the base frame B."""
    time: NotNegative
    """[s] when the wrench begins."""
    until: NotNegative | None = None
    """[s] when the wrench ends, after `time`; null for never."""
    kind: Literal["step"] = "step"

    def rules(self) -> None:
        if self.until is not None and not self.until > self.time:
            raise ConfigurationError("until", self.until, f"a time after {self.time:g} s, or null")

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        until = math.inf if self.until is None else self.until
        return _active(time, self.time, until)[..., None] * np.array(self.wrench)


class ImpulseWrench(Section, key="disturbances"):
    """A blow: the constant wrench impulse / duration for a short time.

    It is exact if `duration` is a whole number of the plant's steps.
    """

    impulse: Vector6
    """[N m s, N s] time integral of the moment about P and of the force, in the base frame B."""
    time: NotNegative
    """[s] when the blow begins."""
    duration: Positive = 0.005
    """[s] duration of the blow."""
    kind: Literal["impulse"] = "impulse"

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        active = _active(time, self.time, self.time + self.duration)
        return active[..., None] * (np.array(self.impulse) / self.duration)


class SineWrench(Section, key="disturbances"):
    """A sinusoidal wrench: wrench sin(2 pi frequency t + phase)."""

    wrench: Vector6
    """[N m, N] amplitude: moment about P and force, in the base frame B."""
    frequency: Positive
    """[Hz] frequency, above 0."""
    phase: Phase = 0.0
    """[rad] phase at time 0."""
    kind: Literal["sine"] = "sine"

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        angle = 2.0 * math.pi * self.frequency * np.asarray(time, dtype=float)[..., None] + self.phase
        return np.sin(angle) * np.array(self.wrench)


class NoiseWrench(Section, key="disturbances"):
    """Band-limited noise with a flat spectrum, independent by axis: one seeded sine per 64th of the band."""

    rms: tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]
    """[N m, N] RMS by axis: moment about P and force, in the base frame B."""
    low: NotNegative = 0.5
    """[Hz] lower end of the band."""
    high: Positive = 50.0
    """[Hz] upper end of the band, above `low`."""
    seed: Seed = 0
    """Seed of the noise."""
    kind: Literal["noise"] = "noise"

    def rules(self) -> None:
        if not self.high > self.low:
            raise ConfigurationError("high", self.high, f"above low, {self.low:g} Hz")

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        frequency, phase = self._sines
        angle = 2.0 * math.pi * frequency * np.asarray(time, dtype=float)[..., None, None] + phase
        return np.sqrt(2.0 / _SINES) * np.array(self.rms) * np.sin(angle).sum(axis=-1)

    @cached_property
    def _sines(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies [Hz] and phases [rad], (6, 64) each."""
        return random_sines(self.seed, (self.low, self.high), 6, _SINES)


def _active(time: float | np.ndarray, start: float = -math.inf, end: float = math.inf) -> np.ndarray:
    """(...) 1 from `start` on, 0 from `end` on."""
    # Times of steps are rounded up by a factor of 1 + 1.4e-10 (`sampling.on_grid`), so that >= finds the right one.
    time = np.asarray(time, dtype=float)
    return ((time >= start) & (time < end)).astype(float)


class UserDisturbance(UserMade, key="disturbances"):
    """A disturbance by your own class: `evaluate(time)` returns a wrench (6,) [N m, N]."""

    asked = "evaluate(t) returns a wrench (6,)"

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        times = np.asarray(time, dtype=float)
        wrenches = [self.numbers(self.made.evaluate(float(t))) for t in times.ravel()]
        wrong = [wrench.shape for wrench in wrenches if wrench.shape != (6,)]
        if wrong:
            raise self.refusal(str(wrong[0]))
        return np.reshape(wrenches, (*times.shape, 6))


class Disturbance(Protocol):
    """An external wrench on the platform."""

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        """Wrench (..., 6) [N m, N] at times (...) [s]."""


AnyDisturbance = Annotated[Disturbance, DISTURBANCES]


def total_wrench(disturbances: Sequence[Disturbance], time: float | np.ndarray) -> np.ndarray:
    """Sum of disturbances (..., 6) [N m, N] at times (...) [s]."""
    return sum((disturbance.evaluate(time) for disturbance in disturbances), np.zeros((*np.shape(time), 6)))
