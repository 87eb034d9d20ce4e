"""What every reference must keep to, with its own derivatives as the only witnesses."""

import math

import numpy as np
from hypothesis import strategies as st
from strategies import vectors

from stewart_drake import HoldReference, SineReference
from stewart_drake.references import (
    AdjustedReference,
    BreathingReference,
    HeartbeatReference,
    MinimumJerkReference,
    SineBurstsReference,
    SplineReference,
    SumReference,
    TremorReference,
)


def differences(reference, time, h=1e-4):
    """Rate and acceleration (6,) by central differences of fourth order."""
    weight = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * h)
    pose, rate, _ = reference.evaluate(time + h * np.array([-2.0, -1.0, 1.0, 2.0]))
    return weight @ (pose - pose[0]), weight @ (rate - rate[0])


def check_derivatives(reference, time, h=1e-4, rtol=1e-7):
    """Rate and acceleration are the derivatives of the pose, where no piece of the motion ends within 2 h of `time`."""
    _, rates, accelerations = reference.evaluate(time + np.linspace(-0.05, 0.05, 41))
    _, rate, acceleration = reference.evaluate(time)
    by_differences = differences(reference, time, h)
    np.testing.assert_allclose(by_differences[0], rate, atol=1e-10 + rtol * np.abs(rates).max())
    np.testing.assert_allclose(by_differences[1], acceleration, atol=1e-10 + rtol * np.abs(accelerations).max())


def check_smooth(reference, times, jerk):
    """Pose, rate and acceleration do not jump at these times."""
    step = 1e-7
    before, after = (reference.evaluate(np.asarray(times) + side) for side in (-step, step))
    for earlier, later in zip(before, after, strict=True):
        np.testing.assert_allclose(later, earlier, atol=4.0 * step * jerk + 1e-12)


six = vectors(6).map(tuple)
lasts = st.floats(0.3, 3.0)


@st.composite
def _bursts(draw):
    frequency = tuple(draw(st.lists(st.floats(0.3, 5.0), min_size=1, max_size=4)))
    fade = draw(st.floats(0.1, 0.5))
    return SineBurstsReference(
        frequency=frequency,
        amplitude=tuple(draw(six) for _ in frequency),
        center=draw(six),
        phase=draw(six),
        fade=fade,
        burst_duration=draw(st.floats(2.0, 6.0)) * fade,
    )


@st.composite
def _moves(draw):
    poses = draw(st.lists(six, min_size=2, max_size=5))
    durations = tuple(draw(lasts) for _ in poses[1:])
    each = st.lists(st.floats(0.0, 1.0), min_size=len(durations), max_size=len(durations))
    return MinimumJerkReference(poses=tuple(poses), durations=durations, dwell=tuple(draw(st.just([]) | each)))


@st.composite
def _splines(draw):
    poses = draw(st.lists(six, min_size=2, max_size=6))
    times = draw(st.floats(0.0, 1.0)) + np.cumsum([0.0, *(draw(lasts) for _ in poses[1:])])
    return SplineReference(times=tuple(times.tolist()), poses=tuple(poses))


@st.composite
def heartbeats(draw, premature=None):
    harmonics = draw(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=6).filter(lambda a: max(map(abs, a)) > 0.1))
    first = draw(st.lists(st.integers(2, 4), max_size=3)) if premature is None else premature
    return HeartbeatReference(
        center=draw(six),
        excursion=draw(six),
        rate=draw(st.floats(0.8, 2.5)),
        phase=draw(six),
        harmonics=tuple(harmonics),
        harmonic_phase=tuple(draw(st.floats(-4.0, 4.0)) for _ in harmonics),
        respiratory_variation=draw(st.floats(0.0, 0.4)),
        respiratory_frequency=draw(st.floats(0.1, 0.4)),
        slow_variation=draw(st.floats(0.0, 0.4)),
        seed=draw(st.integers(0, 100)),
        premature_beats=tuple(np.cumsum(first).tolist()),
        prematurity=draw(st.floats(0.0, 0.7)),
    )


holds = st.builds(HoldReference, pose=six)
sines = st.builds(SineReference, center=six, amplitude=six, angular_frequency=vectors(6, 12.0).map(tuple), phase=six)
bursts, moves, splines = _bursts(), _moves(), _splines()
breathings = st.builds(
    BreathingReference,
    center=six,
    excursion=six,
    frequency=st.floats(0.1, 0.5),
    order=st.integers(1, 3),
    phase=st.floats(-4.0, 4.0),
)
tremors = st.builds(
    TremorReference, center=six, rms=six, low=st.floats(1.0, 6.0), high=st.floats(7.0, 15.0), seed=st.integers(0, 100)
)
simple = sines | breathings
sums = st.builds(SumReference, parts=st.lists(simple, min_size=1, max_size=3).map(tuple), center=st.none() | six)
adjusted = st.builds(
    AdjustedReference,
    motion=simple | sums,
    scale=st.floats(0.0, 2.0),
    slowdown=st.floats(0.5, 4.0),
    fade_in=st.just(0.0) | st.floats(0.3, 2.0),
    center=st.none() | six,
)
KINDS = {
    **{"hold": holds, "sine": sines, "bursts": bursts, "moves": moves, "spline": splines, "breathing": breathings},
    **{"heart": heartbeats(premature=()), "tremor": tremors},
    **{"sum": sums, "adjusted": adjusted, "faded in": adjusted.filter(lambda reference: reference.fade_in)},
}


def ends(reference):
    """Times at which pieces of the motion end; those of a heart's beats are not told."""
    match reference:
        case SplineReference():
            return np.array(reference.times)
        case MinimumJerkReference():
            dwell = reference.dwell or (0.0,) * len(reference.durations)
            return np.cumsum(np.ravel([dwell, reference.durations], order="F"))
        case AdjustedReference():
            return np.array([0.0, reference.fade_in * reference.slowdown])
        case SineBurstsReference():
            begin = np.arange(len(reference.frequency)) * reference.burst_duration
            fade, burst = reference.fade, reference.burst_duration
            return np.ravel(begin[:, None] + [0.0, fade, burst - fade, burst])
    return np.array([math.inf])
