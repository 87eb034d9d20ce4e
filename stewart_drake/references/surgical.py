"""Motions of a patient and of a surgeon's hand: breathing, heartbeat, tremor."""

from __future__ import annotations

import itertools
import math
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stewart_drake.base.config import Count, NotNegative, Phase, Positive, Real, Section, Seed, Share, Vector6
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.references.motions import HOME, SixPhases, bump
from stewart_drake.robot.robot_scale import HOME_POSE

_SLOW_BAND = (0.04, 0.15)
"""[Hz] low-frequency band of heart-rate variability, Task Force of the ESC and NASPE, Circulation 93 (1996) 1043."""
_SLOW_SINES = 3
_TREMOR_SINES = 24
"""The sum looks like noise: it repeats after minutes, and its peaks are near-normal. Assumed."""


class BreathingReference(Section, key="reference"):
    """Breathing: center + excursion cos^(2 order)(pi frequency t - phase) by axis, longest at end-exhale.

    A. E. Lujan et al., Med. Phys. 26 (1999) 715, with z0 = center, b = -excursion; default size of lower lung lobes, 12
    mm cranio-caudal and 2 mm across: Y. Seppenwoolde et al., Int. J. Radiat. Oncol. Biol. Phys. 53 (2002) 822; axes
    assumed.
    """

    own_keys = frozenset({"phase"})
    kind: Literal["breathing"] = "breathing"
    center: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] pose at end-exhale, where breathing rests longest."""
    excursion: Vector6 = (0.0, 0.0, 0.0, 0.002, 0.002, 0.012)
    """[rad, m] from end-exhale to end-inhale, peak to peak; its sign is the direction."""
    frequency: Positive = 0.25
    """[Hz] breathing rate, above 0."""
    order: Annotated[Count, Field(ge=1, le=3)] = 2
    """Exponent n of the waveform, 1 to 3; larger rests longer at end-exhale."""
    phase: Phase = math.pi / 2.0
    """[rad] phase phi of the waveform; pi/2 starts at end-exhale, at rest."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        omega, power = math.pi * self.frequency, 2 * self.order
        angle = omega * np.asarray(time, dtype=float)[..., None] - self.phase
        cosine, sine, size = np.cos(angle), np.sin(angle), np.array(self.excursion)
        pose = np.array(self.center) + size * cosine**power
        rate = -size * omega * power * cosine ** (power - 1) * sine
        bend = (power - 1) * cosine ** (power - 2) * sine**2 - cosine**power
        return pose, rate, size * omega**2 * power * bend


class HeartbeatReference(Section, key="reference"):
    """A heartbeat: a periodic wave of several harmonics at a varying rate, optionally with premature beats.

    By axis center + excursion w(2 pi beats(t) - phase), w(x) = sum a_k cos(k x - p_k) scaled to 1 from end to end:
    R. Ginhoux et al., IEEE Trans. Robot. 21 (2005) 67; the default harmonics, sizes and phases of the axes are assumed.

    The rate is rate (1 + respiratory_variation sin(2 pi respiratory_frequency t) + slow part), the slow part a seeded
    sum of sines at 0.04-0.15 Hz, of sizes by P. E. McSharry et al., IEEE Trans. Biomed. Eng. 50 (2003) 289. A premature
    beat begins `prematurity` of a beat early and the next one on time: K.-M. Park et al., Korean Circ. J. 45 (2015)
    294.
    """

    kind: Literal["heartbeat"] = "heartbeat"
    center: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] mean of the wave; by default the robot's home."""
    excursion: Vector6 = (0.0, 0.0, 0.0, 0.003, 0.002, 0.006)
    """[rad, m] peak-to-peak size by axis; its sign is the direction."""
    rate: Positive = 1.25
    """[Hz] mean heart rate, above 0; 1-2 Hz is usual."""
    phase: SixPhases = (0.0, 0.0, 0.0, 0.8, 0.4, 0.0)
    """[rad] lag by axis, 2 pi for a beat; different lags turn the line into a loop."""
    harmonics: Annotated[tuple[Real, ...], Field(min_length=1, max_length=20)] = (1.0, 0.6, 0.35, 0.15, 0.05)
    """[-] relative amplitudes a_k of the harmonics 1, 2, ... of the rate; at most 20."""
    harmonic_phase: tuple[Phase, ...] = (0.0, 0.5, 1.0, 1.5, 2.0)
    """[rad] phases p_k, one per harmonic."""
    respiratory_variation: Share = 0.02
    """[-] amplitude of the rate's variation with breathing (respiratory sinus arrhythmia), relative to the rate."""
    respiratory_frequency: Positive = 0.25
    """[Hz] breathing frequency of `respiratory_variation`. With a `breathing` motion of this frequency the rate is
    highest during inhalation."""
    slow_variation: Share = 0.015
    """[-] largest slow variation of the rate, relative to it; below 1 together with respiratory_variation."""
    seed: Seed = 0
    """Seed of the slow variation."""
    premature_beats: tuple[Annotated[Count, Field(ge=1, le=10**6)], ...] = ()
    """Numbers of the premature beats, ascending, at least 2 apart; beat 0 begins at t = 0."""
    prematurity: Annotated[NotNegative, Field(le=0.7)] = 0.4
    """[-] how early premature beats come, as a fraction of a beat, 0 to 0.7."""

    def rules(self) -> None:
        if not any(self.harmonics):
            raise ConfigurationError("harmonics", self.harmonics, "numbers, not all of them zero")
        if len(self.harmonic_phase) != len(self.harmonics):
            allowed = f"{len(self.harmonics)} numbers, one per harmonic"
            raise ConfigurationError("harmonic_phase", self.harmonic_phase, allowed)
        if self.respiratory_variation + self.slow_variation >= 1.0:
            allowed = "a sum with respiratory_variation below 1; a heart does not beat backwards"
            raise ConfigurationError("slow_variation", self.slow_variation, allowed)
        beats = self.premature_beats
        if any(later - beat < 2 for beat, later in itertools.pairwise(beats)):
            raise ConfigurationError("premature_beats", beats, "ascending numbers, at least 2 apart")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        beats, speed, change = (2.0 * math.pi * values[..., None] for values in self.beats(time))
        order, lag = np.arange(1, len(self.harmonics) + 1), np.array(self.harmonic_phase)
        angle = order * (beats - np.array(self.phase))[..., None] - lag
        cosine, sine = np.cos(angle), np.sin(angle)
        weights, size = self._weights, np.array(self.excursion)
        wave, slope, curvature = cosine @ weights, -sine @ (order * weights), -cosine @ (order**2 * weights)
        return np.array(self.center) + size * wave, size * slope * speed, size * (curvature * speed**2 + slope * change)

    def beats(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Number of beats (...) [-], its first and second derivative; premature ones are blended in smoothly."""
        t = np.asarray(time, dtype=float)
        omega, share, start = self._variation
        angle = omega * t[..., None] + start
        count = self.rate * (t + (np.cos(start) - np.cos(angle)) @ (share / omega))
        speed = self.rate * (1.0 + np.sin(angle) @ share)
        change = self.rate * (np.cos(angle) @ (share * omega))
        # Without premature beats, one long ago.
        beats, most = np.array(self.premature_beats or [-1e9], dtype=float), self.prematurity
        beat = beats[np.minimum(np.searchsorted(beats + 1.0, count), len(beats) - 1)]
        bumps = bump(count, beat - 1.0, beat - most, beat - most, beat + 1.0)
        early, slope, curvature = (most * values for values in bumps)
        return count + early, (1.0 + slope) * speed, curvature * speed**2 + (1.0 + slope) * change

    @cached_property
    def _variation(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Angular frequencies [rad/s], shares of the rate [-] and phases [rad] of the sines in the heart rate."""
        frequency, phase = random_sines(self.seed, _SLOW_BAND, 1, _SLOW_SINES)
        omega = 2.0 * math.pi * np.append(self.respiratory_frequency, frequency[0])
        share = np.append(self.respiratory_variation, np.full(_SLOW_SINES, self.slow_variation / _SLOW_SINES))
        return omega, share, np.append(0.0, phase[0])

    @cached_property
    def _weights(self) -> np.ndarray:
        """Harmonics (k,), for a wave of 1 from end to end; extrema by roots of a polynomial in exp(i x)."""
        weights = np.array(self.harmonics) / np.abs(self.harmonics).max()
        order, lag = np.arange(1, len(weights) + 1), np.array(self.harmonic_phase)
        # Negligible weights would overflow.
        weights_used = np.where(np.abs(weights) > 1e-12, weights, 0.0)
        half = 1j * order * weights_used * np.exp(-1j * lag)
        places = np.angle(np.roots(np.concatenate([half[::-1], [0.0], half.conj()])))
        wave = np.cos(order * places[:, None] - lag) @ weights
        return weights / (wave.max() - wave.min())


class TremorReference(Section, key="reference"):
    """Physiological tremor of a hand: by axis a seeded sum of sines in a frequency band.

    A peak at 6-12 Hz, errors of 0.14 to 0.29 mm RMS over three axes: T. S. Wells et al., IEEE SMC (2013). That the axes
    are independent, and the spectrum flat within the band, is assumed.
    """

    kind: Literal["tremor"] = "tremor"
    center: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] centre of the motion; by default the robot's home."""
    rms: Vector6 = (0.0, 0.0, 0.0, 1e-4, 1e-4, 1e-4)
    """[rad, m] RMS by axis over a long time; peaks are some three times as large."""
    low: Positive = 6.0
    """[Hz] lower end of the band, above 0."""
    high: Positive = 12.0
    """[Hz] upper end of the band, above `low`."""
    seed: Seed = 0
    """Seed of frequencies and phases."""

    def rules(self) -> None:
        if self.high <= self.low:
            raise ConfigurationError("high", self.high, f"above low, {self.low:g} Hz")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        frequency, phase = self._sines
        omega, size = 2.0 * math.pi * frequency, np.array(self.rms) * math.sqrt(2.0 / _TREMOR_SINES)
        angle = omega * np.asarray(time, dtype=float)[..., None, None] + phase
        sine = np.sin(angle)
        pose = np.array(self.center) + size * sine.sum(axis=-1)
        rate = size * (omega * np.cos(angle)).sum(axis=-1)
        return pose, rate, -size * (omega**2 * sine).sum(axis=-1)

    @cached_property
    def _sines(self) -> tuple[np.ndarray, np.ndarray]:
        return random_sines(self.seed, (self.low, self.high), 6, _TREMOR_SINES)


def random_sines(seed: int, band: tuple[float, float], rows: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and phases [rad], (rows, count); one frequency in every one of `count` equal parts of a band."""
    rng = np.random.default_rng(seed)
    low, high = band
    frequency = low + (high - low) * (np.arange(count) + rng.uniform(size=(rows, count))) / count
    return frequency, rng.uniform(0.0, 2.0 * math.pi, (rows, count))
