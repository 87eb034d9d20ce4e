"""Reference motions: the protocol, formulas, paths through poses, and combinations of motions."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Literal, Protocol, runtime_checkable

import numpy as np
from pydantic import Field

from stewart_drake.base.config import NotNegative, Phase, Positive, Real, Section, SixNumbers, Vector6, one_for_six
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.registry import REFERENCES
from stewart_drake.robot.robot_scale import HOME_POSE, LENGTH

HOME: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.3)
ZERO: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
Curve = Callable[[float | np.ndarray], np.ndarray]  # Function of time (n,) [s].
SixPhases = Annotated[tuple[Phase, Phase, Phase, Phase, Phase, Phase], one_for_six(Phase)]


@runtime_checkable
class Reference(Protocol):
    """A motion of the platform."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose (..., 6) [rad, m], rate [rad/s, m/s], acceleration [rad/s^2, m/s^2] at times (...) [s]."""


def smoothstep(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """6 u^5 - 15 u^4 + 10 u^3, 0 at u <= 0 and 1 at u >= 1, and its two derivatives."""
    u = np.clip(u, 0.0, 1.0)
    value = u**3 * (u * (6.0 * u - 15.0) + 10.0)
    return value, 30.0 * u**2 * (1.0 - u) ** 2, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)


def bump(
    x: np.ndarray, begin: float | np.ndarray, top: float | np.ndarray, fall: float | np.ndarray, end: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Smooth step from 0 at `begin` to 1 at `top`, and from 1 at `fall` to 0 at `end`; with two derivatives."""
    rising = x < top
    width = np.where(rising, top - begin, end - fall)
    value, slope, curvature = smoothstep(np.where(rising, x - begin, end - x) / width)
    return value, np.where(rising, slope, -slope) / width, curvature / width**2


class HoldReference(Section, key="reference"):
    """A constant pose."""

    kind: Literal["hold"] = "hold"
    pose: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] the pose; by default the robot's home."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        shape = (*np.shape(time), 6)
        return np.broadcast_to(np.array(self.pose), shape).copy(), np.zeros(shape), np.zeros(shape)


class SineReference(Section, key="reference"):
    """Sines on all axes: center + amplitude sin(angular_frequency t + phase).

    By default the paper's (37), (38): roll pi/6 sin(2 t), Z = 0.05 sin(2 t) + 0.3, the rest zero.
    """

    kind: Literal["sine"] = "sine"
    center: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] centre of the motion; by default the robot's home."""
    amplitude: Annotated[Vector6, LENGTH] = (math.pi / 6.0, 0.0, 0.0, 0.0, 0.0, 0.05)
    """[rad, m] amplitude by axis."""
    angular_frequency: SixNumbers = (2.0, 2.0, 2.0, 2.0, 2.0, 2.0)
    """[rad/s] angular frequency by axis."""
    phase: SixPhases = ZERO
    """[rad] phase by axis at time 0."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        omega, amplitude = np.array(self.angular_frequency), np.array(self.amplitude)
        angle = omega * np.asarray(time, dtype=float)[..., None] + np.array(self.phase)
        wave = amplitude * np.sin(angle)
        return np.array(self.center) + wave, amplitude * omega * np.cos(angle), -(omega**2) * wave


paper_reference = SineReference


class SineBurstsReference(Section, key="reference"):
    """A sequence of sine bursts with different frequencies and amplitudes, faded in and out.

    Every burst starts and ends at rest in the centre; the fades are quintic, so accelerations are continuous. After the
    last burst the centre is held.
    """

    kind: Literal["sine_bursts"] = "sine_bursts"
    frequency: Annotated[tuple[Positive, ...], Field(min_length=1)]
    """[Hz] frequencies of the bursts."""
    amplitude: tuple[Vector6, ...]
    """[rad, m] amplitude by axis, one vector per burst."""
    center: Annotated[Vector6, HOME_POSE] = HOME
    """[rad, m] centre of the motion; by default the robot's home."""
    phase: SixPhases = ZERO
    """[rad] phase by axis, the same in every burst."""
    burst_duration: Positive = 1.6
    """[s] duration of a burst, its fades included."""
    fade: Positive = 0.2
    """[s] duration of the fade at each end of a burst."""

    def rules(self) -> None:
        if len(self.amplitude) != len(self.frequency):
            raise ConfigurationError("amplitude", self.amplitude, f"{len(self.frequency)} vectors of 6 numbers")
        if not self.burst_duration >= 2.0 * self.fade:
            raise ConfigurationError("burst_duration", self.burst_duration, "at least twice the fade")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        time = np.asarray(time, dtype=float)
        count = len(self.frequency)
        index = np.clip(np.floor(time / self.burst_duration).astype(int), 0, count - 1)
        local = np.clip(time - index * self.burst_duration, 0.0, self.burst_duration)[..., None]
        omega = 2.0 * np.pi * np.array(self.frequency)[index][..., None]
        amplitude = np.array(self.amplitude)[index]
        burst, fade = self.burst_duration, self.fade
        env, env_rate, env_acceleration = bump(local, 0.0, fade, burst - fade, burst)
        angle = omega * local + np.array(self.phase)
        sine, cosine = np.sin(angle), np.cos(angle)
        pose = np.array(self.center) + amplitude * env * sine
        rate = amplitude * (env_rate * sine + env * omega * cosine)
        acceleration = amplitude * (env_acceleration * sine + 2.0 * env_rate * omega * cosine - env * omega**2 * sine)
        return pose, rate, acceleration


class MinimumJerkReference(Section, key="reference"):
    """Straight minimum-jerk moves from pose to pose, with rest at every pose.

    After the last move the pose is held. The profile is 6 u^5 - 15 u^4 + 10 u^3 of a hand's reach: T. Flash, N. Hogan,
    J. Neurosci. 5 (1985) 1688.
    """

    kind: Literal["minimum_jerk"] = "minimum_jerk"
    poses: Annotated[tuple[Vector6, ...], Field(min_length=2)]
    """[rad, m] the poses, at least 2; the motion starts at the first."""
    durations: tuple[Positive, ...]
    """[s] durations of the moves, one fewer than poses."""
    dwell: tuple[NotNegative, ...] = ()
    """[s] rests before the moves, as many as moves; empty for none."""

    def rules(self) -> None:
        moves = len(self.poses) - 1
        if len(self.durations) != moves:
            raise ConfigurationError("durations", self.durations, f"{moves} positive numbers, one per move")
        if len(self.dwell) not in (0, moves):
            raise ConfigurationError("dwell", self.dwell, f"{moves} numbers, one per move, or none")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        time, poses, durations = np.asarray(time, dtype=float), np.array(self.poses), np.array(self.durations)
        dwell = np.array(self.dwell) if len(self.dwell) else np.zeros_like(durations)
        starts = np.cumsum(dwell + durations) - durations
        move = np.clip(np.searchsorted(starts, time, side="right") - 1, 0, len(durations) - 1)
        duration = durations[move][..., None]
        value, slope, curvature = smoothstep((time - starts[move])[..., None] / duration)
        step = poses[move + 1] - poses[move]
        return poses[move] + step * value, step * slope / duration, step * curvature / duration**2


class SplineReference(Section, key="reference"):
    """A quintic spline through timed poses, at rest at both ends; the end poses are held before and after."""

    kind: Literal["spline"] = "spline"
    times: tuple[NotNegative, ...]
    """[s] times of the poses: ascending, at least 2, the first not below 0."""
    poses: Annotated[tuple[Vector6, ...], Field(min_length=2)]
    """[rad, m] the poses, one per time."""

    def rules(self) -> None:
        if len(self.times) != len(self.poses):
            raise ConfigurationError("times", self.times, f"{len(self.poses)} numbers, one per pose, none below 0")
        if not np.all(np.diff(self.times) > 0.0):
            raise ConfigurationError("times", self.times, "ascending numbers")

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        time = np.clip(np.asarray(time, dtype=float), self.times[0], self.times[-1])
        pose, rate, acceleration = (spline(time) for spline in self._splines)
        return pose, rate, acceleration

    @cached_property
    def _splines(self) -> tuple[Curve, ...]:
        from scipy.interpolate import make_interp_spline

        rest = [(1, np.zeros(6)), (2, np.zeros(6))]
        spline = make_interp_spline(np.array(self.times), np.array(self.poses), k=5, bc_type=(rest, rest))
        return spline, spline.derivative(1), spline.derivative(2)


Motion = Annotated[Reference, REFERENCES.excluding("sum", "adjusted")]
Scale = Annotated[Real, Field(ge=0.0, le=1e6)]


class SumReference(Section, key="reference"):
    """Sum of several motions, such as breathing, heartbeat and tremor: center + sum (part - centre of the part).

    Angles are added as angles: exact for one axis, a good approximation while tilts are small.
    """

    kind: Literal["sum"] = "sum"
    parts: Annotated[tuple[Motion, ...], Field(min_length=1)]
    """Motions to add, at least one, relative to their centres: `center` of a wave; the first pose of a path, a
    recording or a hold."""
    center: Vector6 | None = None
    """[rad, m] centre of the sum; null takes the first part's."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        motions = [part.evaluate(time) for part in self.parts]
        pose, rate, acceleration = (np.sum(values, axis=0) for values in zip(*motions, strict=True))
        return pose - sum(map(center_of, self.parts)) + center_of(self), rate, acceleration


class AdjustedReference(Section, key="reference"):
    """A motion scaled, slowed or faded in: center + scale fade(s) (motion(s) - center) at s = t / slowdown.

    Slowing by k divides rates by k and accelerations by k^2.
    """

    kind: Literal["adjusted"] = "adjusted"
    motion: Annotated[Reference, REFERENCES.excluding("adjusted")]
    """The motion to adjust."""
    scale: Scale = 1.0
    """[-] size of the motion about the centre, at least 0."""
    slowdown: Annotated[Real, Field(ge=1e-6, le=1e6)] = 1.0
    """[-] factor by which the motion takes longer, 1e-6 to 1e6."""
    fade_in: Scale = 0.0
    """[s] duration of the quintic fade-in from rest in the centre, before slowing; 0 for none."""
    center: Vector6 | None = None
    """[rad, m] centre of the scaling; null takes that of the motion: `center` of a wave; the first pose of a path, a
    recording or a hold."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        motion_time = np.asarray(time, dtype=float) / self.slowdown
        pose, rate, acceleration = self.motion.evaluate(motion_time)
        center = center_of(self)
        offset = pose - center
        if self.fade_in > 0.0:
            fade, slope, curvature = (values[..., None] for values in smoothstep(motion_time / self.fade_in))
            slope, curvature = slope / self.fade_in, curvature / self.fade_in**2
            acceleration = fade * acceleration + 2.0 * slope * rate + curvature * offset
            rate = fade * rate + slope * offset
            offset = fade * offset
        rate_scale, acceleration_scale = self.scale / self.slowdown, self.scale / self.slowdown**2
        return center + self.scale * offset, rate_scale * rate, acceleration_scale * acceleration


AnyReference = Annotated[Reference, REFERENCES]


def center_of(reference: Reference) -> np.ndarray:
    """The pose (6,) [rad, m] about which a motion is scaled: its `center`, its motion's, or its first pose."""
    if (center := getattr(reference, "center", None)) is not None:
        return np.array(center)
    if isinstance(reference, (SumReference, AdjustedReference)):
        return center_of(reference.parts[0] if isinstance(reference, SumReference) else reference.motion)
    return reference.evaluate(0.0)[0]
