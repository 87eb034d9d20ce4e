"""Wrenches from outside on the platform, as functions of time: exact, vectorised, seeded.

A wrench is [moment, force] in B, the moment about P: (6,) [N m, N], in the order of a twist [w, v].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from stewart_drake.errors import ConfigurationError
from stewart_drake.section import (
    SECTION,
    Natural,
    NotNegative,
    Positive,
    Real,
    Vector6,
    check_numbers,
    check_positive,
    check_real,
    check_seed,
    is_finite,
)

_SINES = 64
"""Enough that the sum passes for noise: near-normal, and it repeats after hours. Assumed."""


@dataclass(frozen=True, kw_only=True)
class ConstantWrench:
    """The same wrench all the time.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    wrench: Vector6
    """[N m, N] moment about P and force, in B."""
    kind: Literal["constant"] = "constant"

    def __post_init__(self) -> None:
        _check_vector("wrench", self.wrench)

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        """See `total_wrench`."""
        return np.broadcast_to(np.array(self.wrench), (*np.shape(time), 6))


@dataclass(frozen=True, kw_only=True)
class StepWrench:
    """A wrench from one time on, to another.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    wrench: Vector6
    """[N m, N] moment about P and force, in B."""
    time: NotNegative
    """[s] when it begins."""
    until: NotNegative | None = None
    """[s] when it ends, after `time`; null for never."""
    kind: Literal["step"] = "step"

    def __post_init__(self) -> None:
        _check_vector("wrench", self.wrench)
        check_real("disturbances.time", self.time)
        if self.until is not None and not (is_finite(self.until) and self.until > self.time):
            raise ConfigurationError("disturbances.until", self.until, f"a time after {self.time:g} s, or null")

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        """See `total_wrench`."""
        return _within(time, self.time, math.inf if self.until is None else self.until) * np.array(self.wrench)


@dataclass(frozen=True, kw_only=True)
class ImpulseWrench:
    """A blow: impulse / duration for a short while.

    The plant takes it step by step, and in full where `duration` is a whole number of its steps.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    impulse: Vector6
    """[N m s, N s] moment about P and force, in B, integrated over the blow."""
    time: NotNegative
    """[s] when it begins."""
    duration: Positive = 0.005
    """[s] of the blow."""
    kind: Literal["impulse"] = "impulse"

    def __post_init__(self) -> None:
        _check_vector("impulse", self.impulse)
        check_real("disturbances.time", self.time)
        check_positive("disturbances.duration", self.duration)

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        """See `total_wrench`."""
        during = _within(time, self.time, self.time + self.duration)
        return during * (np.array(self.impulse) / self.duration)


@dataclass(frozen=True, kw_only=True)
class SineWrench:
    """wrench sin(2 pi frequency t + phase).

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    wrench: Vector6
    """[N m, N] amplitude: moment about P and force, in B."""
    frequency: Positive
    """[Hz], above 0."""
    phase: Real = 0.0
    """[rad]"""
    kind: Literal["sine"] = "sine"

    def __post_init__(self) -> None:
        _check_vector("wrench", self.wrench)
        check_positive("disturbances.frequency", self.frequency)
        check_real("disturbances.phase", self.phase, -math.inf, "a finite number")

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        """See `total_wrench`."""
        angle = 2.0 * math.pi * self.frequency * np.asarray(time, dtype=float)[..., None] + self.phase
        return np.sin(angle) * np.array(self.wrench)


@dataclass(frozen=True, kw_only=True)
class NoiseWrench:
    """Noise of a flat spectrum between two frequencies, independent on each axis: a seeded sum of sines.

    One sine in each of 64 equal parts of the band, at a random place in it and of random phase.

    Raises:
        ConfigurationError: A value outside what the field says.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = SECTION

    rms: Vector6
    """[N m, N] of each axis: moment about P and force, in B."""
    low: NotNegative = 0.5
    """[Hz] lower end of the band."""
    high: Positive = 50.0
    """[Hz] upper end of the band, above `low`."""
    seed: Natural = 0
    """Of the sines."""
    kind: Literal["noise"] = "noise"

    def __post_init__(self) -> None:
        _check_vector("rms", self.rms)
        if min(self.rms) < 0.0:
            raise ConfigurationError("disturbances.rms", self.rms, "numbers, zero or positive")
        check_real("disturbances.low", self.low)
        if not (is_finite(self.high) and self.high > self.low):
            raise ConfigurationError("disturbances.high", self.high, f"above low, {self.low:g} Hz")
        check_seed("disturbances.seed", self.seed)

    def evaluate(self, time: float | np.ndarray) -> np.ndarray:
        """See `total_wrench`."""
        frequency, phase = self._sines
        angle = 2.0 * math.pi * frequency * np.asarray(time, dtype=float)[..., None, None] + phase
        return np.sqrt(2.0 / _SINES) * np.array(self.rms) * np.sin(angle).sum(axis=-1)

    @cached_property
    def _sines(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies [Hz] and phases [rad], (6, 64) each."""
        rng = np.random.default_rng(self.seed)
        share = (np.arange(_SINES) + rng.random((6, _SINES))) / _SINES
        return self.low + (self.high - self.low) * share, rng.uniform(0.0, 2.0 * math.pi, (6, _SINES))


Disturbance = Annotated[
    ConstantWrench | StepWrench | ImpulseWrench | SineWrench | NoiseWrench, Field(discriminator="kind")
]


def total_wrench(disturbances: Sequence[Disturbance], time: float | np.ndarray) -> np.ndarray:
    """Sum of disturbances.

    Args:
        disturbances: Any number of them.
        time: (...) [s].

    Returns:
        (..., 6) [N m, N] moment about P and force, in B.
    """
    total = np.zeros((*np.shape(time), 6))
    for one in disturbances:
        total += one.evaluate(time)
    return total


def _within(time: float | np.ndarray, start: float, end: float) -> np.ndarray:
    """(..., 1) 1 from `start` on, 0 from `end` on."""
    # Times of steps are stretched by 1.4e-10 of themselves (`sampling.on_grid`), never shrunk: >= finds the right one.
    time = np.asarray(time, dtype=float)
    return ((time >= start) & (time < end)).astype(float)[..., None]


def _check_vector(name: str, vector: Any) -> None:
    check_numbers(f"disturbances.{name}", vector, 6, "6 finite numbers [N m, N]")
