"""A pose held, sines, and bursts of sines."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Positive, Section, SixNumbers, Vector6
from stewart_drake.errors import ConfigurationError
from stewart_drake.references.base import HOME, ZERO, smoothstep
from stewart_drake.robot.robot_scale import HOME_POSE, LENGTH


class HoldReference(Section, key="reference"):
    """A pose held still."""

    kind: Literal["hold"] = "hold"
    pose: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] by default the robot's home."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`."""
        shape = (*np.shape(time), 6)
        return np.broadcast_to(np.array(self.pose), shape).copy(), np.zeros(shape), np.zeros(shape)


class SineReference(Section, key="reference"):
    """center + amplitude sin(angular_frequency t + phase) on each axis.

    The defaults are the paper's (37), (38): roll pi/6 sin(2 t), Z = 0.05 sin(2 t) + 0.3, the rest zero; for another
    robot about its home, with lengths in proportion.
    """

    kind: Literal["sine"] = "sine"
    center: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] by default the robot's home."""
    amplitude: Annotated[Vector6, LENGTH] = (math.pi / 6.0, 0.0, 0.0, 0.0, 0.0, 0.05)
    """[rad, m]"""
    angular_frequency: SixNumbers = (2.0, 2.0, 2.0, 2.0, 2.0, 2.0)
    """[rad/s]"""
    phase: SixNumbers = ZERO
    """[rad]"""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`."""
        omega, amplitude = np.array(self.angular_frequency), np.array(self.amplitude)
        angle = omega * np.asarray(time, dtype=float)[..., None] + np.array(self.phase)
        wave = amplitude * np.sin(angle)
        return np.array(self.center) + wave, amplitude * omega * np.cos(angle), -(omega**2) * wave


class SineBurstsReference(Section, key="reference"):
    """Bursts of sines one after the other, each with its own frequency and amplitudes, faded in and out.

    The paper's data covers 1 to 5 Hz; this puts them into one run that starts and ends every burst at rest in the
    centre. The fade is a quintic smoothstep, so accelerations are continuous. After the last burst the centre is held.
    """

    kind: Literal["sine_bursts"] = "sine_bursts"
    frequency: Annotated[tuple[Positive, ...], Field(min_length=1)]
    """[Hz] one per burst."""
    amplitude: tuple[Vector6, ...]
    """[rad, m] one vector per burst."""
    center: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] by default the robot's home."""
    phase: SixNumbers = ZERO
    """[rad] per axis, the same in every burst."""
    burst_duration: Positive = 1.6
    """[s]"""
    fade: Positive = 0.2
    """[s] at each end of a burst."""

    def rules(self) -> None:
        """See `Section.rules`."""
        if len(self.amplitude) != len(self.frequency):
            raise ConfigurationError("amplitude", self.amplitude, f"{len(self.frequency)} vectors of 6 numbers")
        if not self.burst_duration >= 2.0 * self.fade:
            raise ConfigurationError("burst_duration", self.burst_duration, "at least twice the fade")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`."""
        time = np.asarray(time, dtype=float)
        count = len(self.frequency)
        index = np.clip(np.floor(time / self.burst_duration).astype(int), 0, count - 1)
        local = np.clip(time - index * self.burst_duration, 0.0, self.burst_duration)[..., None]
        omega = 2.0 * np.pi * np.array(self.frequency)[index][..., None]
        amplitude = np.array(self.amplitude)[index]
        env, env_rate, env_acceleration = self._envelope(local)
        angle = omega * local + np.array(self.phase)
        sine, cosine = np.sin(angle), np.cos(angle)
        pose = np.array(self.center) + amplitude * env * sine
        rate = amplitude * (env_rate * sine + env * omega * cosine)
        acceleration = amplitude * (env_acceleration * sine + 2.0 * env_rate * omega * cosine - env * omega**2 * sine)
        return pose, rate, acceleration

    def _envelope(self, local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`smoothstep` of the distance to the nearer end, and its derivatives."""
        rising = local < 0.5 * self.burst_duration
        distance = np.where(rising, local, self.burst_duration - local)
        value, slope, curvature = smoothstep(distance / self.fade)
        return value, np.where(rising, slope, -slope) / self.fade, curvature / self.fade**2


def paper_reference() -> SineReference:
    """(37), (38): roll pi/6 sin(2 t), Z = 0.05 sin(2 t) + 0.3, the rest zero."""
    return SineReference()
