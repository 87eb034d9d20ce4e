"""Motions that were in no training data: what a surgical robot on this platform would meet; pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stewart_drake.references import SineReference, paper_reference
from stewart_drake.training.collect import six

_SEED = 20_210_602
"""Of the multi-axis mix."""
_MIXED = (0.25, 0.5, 0.75, 1.25, 1.5, 1.75, 2.25, 2.5)
"""[Hz] its frequencies."""
_AXES = ("roll", "pitch", "yaw", "x", "y", "z")
_QUARTER = math.pi / 2.0
"""[rad] a quarter of a period ahead: a cosine."""


@dataclass(frozen=True)
class Trajectory:
    """A named motion and how long to follow it.

    Attributes:
        name: Short, for tables and axes.
        text: What moves, and how.
        reference: The motion.
        duration: [s]; errors are judged over its second half.
    """

    name: str
    text: str
    reference: SineReference
    duration: float


def paper_trajectory(duration: float = 10.0) -> Trajectory:
    """(37), (38)."""
    return Trajectory("(37), (38)", "roll 30 deg and Z 50 mm, both at 2 rad/s", paper_reference(), duration)


def unseen_trajectories() -> tuple[Trajectory, ...]:
    """Eleven motions about home that share neither shape nor frequency with the paper's data (1 to 5 Hz, six axes).

    Each lasts twice a whole number of half periods of every axis, so that the second half, over which errors are
    judged, holds whole swings; what is left of the start has then decayed to less than a tenth at the slowest pole of
    the nine controllers (0.6 rad/s).
    """
    return (
        _sines("breathing", 10.0, roll=(3.0, 0.3, _QUARTER), z=(10.0, 0.3, 0.0)),
        _sines("heartbeat", 8.0, pitch=(2.0, 1.5, _QUARTER), x=(1.5, 1.5, 0.0), z=(3.0, 1.5, 0.0)),
        _sines("roll", 8.0, roll=(12.0, 0.5, 0.0)),
        _sines("pitch", 8.0, pitch=(8.0, 1.25, 0.0)),
        _sines("yaw", 8.0, yaw=(15.0, 0.75, 0.0)),
        _sines("surge", 8.0, x=(30.0, 0.25, 0.0)),
        _sines("heave", 8.0, z=(4.0, 2.5, 0.0)),
        _sines("circle", 8.0, x=(20.0, 0.5, _QUARTER), y=(20.0, 0.5, 0.0)),
        _sines("cone", 8.0, roll=(10.0, 0.75, 0.0), pitch=(10.0, 0.75, _QUARTER)),
        _sines("Lissajous", 8.0, x=(20.0, 0.25, 0.0), y=(20.0, 0.5, 0.0)),
        _mix(8.0),
    )


def _sines(name: str, duration: float, **axes: tuple[float, float, float]) -> Trajectory:
    """Sines about home: axis -> amplitude [deg or mm], frequency [Hz], phase [rad]."""
    amplitude, omega, phase = np.zeros(6), np.full(6, 2.0 * math.pi), np.zeros(6)
    words = []
    for axis, (size, frequency, start) in axes.items():
        index = _AXES.index(axis)
        turns = index < 3
        amplitude[index] = math.radians(size) if turns else 1e-3 * size
        omega[index], phase[index] = 2.0 * math.pi * frequency, start
        words.append(f"{axis if turns else axis.upper()} {size:g} {'deg' if turns else 'mm'} at {frequency:g} Hz")
    reference = SineReference(amplitude=six(amplitude), angular_frequency=six(omega), phase=six(phase))
    return Trajectory(name, ", ".join(words), reference, duration)


def _mix(duration: float) -> Trajectory:
    """All six axes at once; frequencies, peak speeds (at most 20 deg/s, 30 mm/s) and phases drawn at random."""
    rng = np.random.default_rng(_SEED)
    frequency = rng.choice(_MIXED, 6)
    size = np.repeat([20.0, 30.0], 3) * rng.uniform(0.5, 1.0, 6) / (2.0 * math.pi * frequency)
    phase = rng.uniform(0.0, 2.0 * math.pi, 6)
    drawn = zip(_AXES, size.round(1).tolist(), frequency.tolist(), phase.tolist(), strict=True)
    return _sines("mix", duration, **{axis: (a, f, p) for axis, a, f, p in drawn})
