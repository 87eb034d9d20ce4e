"""What a tuner hears of its loop, in numbers that compare between robots: arrays of numpy or torch, any leading axes.

The densities (35), (36) are the paper's. A density has no scale, so sizes stand beside it: errors and torque changes in
the units of the cost, innovations of the observer in those of the noise of a reading.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from stewart_drake.compiled.constants import RECENT, TUNER_SITE, filled
from stewart_drake.control.objective import CostScales
from stewart_drake.mechanics.arrays import Array, namespace

FEATURES = (
    "surprise",
    "surprise_slow",
    "drift",
    "error",
    "error_slow",
    "torque_change",
    "error_density",
    "torque_density",
    "speed",
    "acceleration",
    "noise",
    "latency",
    "kappa",
)
"""Names of what `features` gives, all but the last decimal logarithms."""
TIMES = (0.010, 0.100, 0.020, 0.200, 0.020)
"""[s] over which surprise, surprise_slow, error, error_slow and torque_change are averaged."""
DRIFT_TIME = 0.020
"""[s] over which innovations are averaged with their signs: what pushes the robot has one."""
FLOORS = (1e-2, 1e-3, 1e-6)
"""Added before the logarithm of a square: of surprises, of the drift, of errors and torque changes."""


class Site(NamedTuple):
    """What a tuner is built for; numbers, or arrays of the leading axes.

    Attributes:
        period: [s] of a tick.
        noise: [rad] of a reading, as the observer believes it.
        latency: [s] from a reading to the torque that it causes.
        length: [m] characteristic length of the robot.
        kappa: [-] from stiff, -1, to quiet, 1: the scale of torque changes in the cost is divided by 10^kappa.
        scales: What counts as one in the cost.
    """

    period: Array
    noise: Array
    latency: Array
    length: Array
    kappa: Array = 0.0
    scales: CostScales = CostScales()


class Heard(NamedTuple):
    """What a tuner hears at a tick, each on the last axis.

    Attributes:
        density: (..., 12) [-] of errors and torques, see `density.density`.
        error: (..., 6) [rad, m] that the controller saw.
        torque: (..., 6) [N m] that it asks for.
        innovation: (..., 6) [rad] of the observer.
        reference: (..., 18) that the controller follows: pose, its rate and its acceleration.
    """

    density: Array
    error: Array
    torque: Array
    innovation: Array
    reference: Array


class Recent(NamedTuple):
    """What the features need of the ticks before.

    Attributes:
        levels: (..., 5) [-] mean squares, over `TIMES`.
        drift: (..., 6) [-] mean innovations over the noise.
        torque: (..., 6) [N m] of the tick before.
        ticks: (..., 1) done.
    """

    levels: Array
    drift: Array
    torque: Array
    ticks: Array

    def flat(self) -> np.ndarray:
        """Of one loop, in one vector (18,), in the order of the attributes."""
        return np.concatenate(self)

    @classmethod
    def from_flat(cls, values: np.ndarray) -> Recent:
        """Inverse of `flat`."""
        return cls(*(values[start:end] for start, end in itertools.pairwise(RECENT)))


def nothing_yet(like: Array) -> Recent:
    """Before the first tick; `like` is any array (..., 6)."""
    xp = namespace(like)
    none = 0.0 * like
    one = none[..., :1]
    levels = xp.concat([one + 1.0, one + 1.0, one, one, one], axis=-1)
    return Recent(levels, none, none, one)


def features(site: Site, heard: Heard, before: Recent) -> tuple[Array, Recent]:
    """Features (..., 13) [-] at a tick, see `FEATURES`, and what the next one needs."""
    xp = namespace(heard.error)
    noisy = heard.innovation / _last(site.noise)
    surprise = xp.mean(noisy * noisy, axis=-1)
    scales = site.scales
    rotation, position = (
        _square(part) / scale**2
        for part, scale in (
            (heard.error[..., :3], math.radians(scales.rotation)),
            (heard.error[..., 3:], 1e-3 * scales.position),
        )
    )
    change = (heard.torque - before.torque) * _last(1e-3 / site.period)
    restless = xp.mean(change * change, axis=-1) / scales.torque_change**2
    restless = xp.where(before.ticks[..., 0] > 0.0, restless, 0.0 * restless)
    error = rotation + position
    now = xp.stack([surprise, surprise, error, error, restless], axis=-1)
    levels = xp.stack(
        [_eased(site, time, before.levels[..., k], now[..., k]) for k, time in enumerate(TIMES)],
        axis=-1,
    )
    share = _last(_share(site, DRIFT_TIME))
    drift = before.drift + share * (noisy - before.drift)
    rate, gain = (heard.reference[..., start : start + 6] for start in (6, 12))
    length = _last(site.length)
    speed, acceleration = (
        xp.sqrt(_square(length * each[..., :3]) + _square(each[..., 3:]) + 1e-12) for each in (rate, gain)
    )
    of_surprise, of_drift, of_cost = FLOORS
    dense = [xp.mean(heard.density[..., part], axis=-1) for part in (slice(6), slice(6, 12))]
    same = 0.0 * speed
    found = [
        levels[..., 0] + of_surprise,
        levels[..., 1] + of_surprise,
        xp.mean(drift * drift, axis=-1) + of_drift,
        *(levels[..., k] + of_cost for k in (2, 3, 4)),
        *(xp.abs(each) + 0.1 for each in dense),
        speed + 1e-3,
        acceleration + 1e-2,
        site.noise / 1e-5 + same,
        site.latency / 1e-3 + same,
    ]
    logs = [xp.log10(each) for each in found]
    recent = Recent(levels, drift, heard.torque, before.ticks + 1.0)
    return xp.stack([*logs, site.kappa + same], axis=-1), recent


def _eased(site: Site, time: float, before: Array, now: Array) -> Array:
    """A mean over a time [s], an exponential one."""
    return before + _share(site, time) * (now - before)


def _share(site: Site, time: float) -> Array:
    """Of a new value in a mean over a time [s]."""
    return site.period / (site.period + time)


def _square(vectors: Array) -> Array:
    """Squared lengths."""
    return (vectors * vectors).sum(-1)


def _last(value: Array) -> Array:
    """A number of the leading axes, to go with vectors."""
    return value if isinstance(value, float) else value[..., None]


def flat_features(site: Site, compiled: bool) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """`features` of one loop on flat vectors, compiled or not: what `Heard` has and `Recent.flat` in, both out."""
    if not compiled:

        def hear(*given: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            found, recent = features(site, Heard(*given[:-1]), Recent.from_flat(given[-1]))
            return found, recent.flat()

        return hear
    # numba takes half a second to import, and compiles on first use.
    from stewart_drake.compiled.policy import features as fast

    packed = filled(
        TUNER_SITE,
        period=site.period,
        noise=site.noise,
        latency=site.latency,
        length=site.length,
        kappa=site.kappa,
        rotation=math.radians(site.scales.rotation),
        position=1e-3 * site.scales.position,
        change=1e-3 / (site.period * site.scales.torque_change),
        of_surprise=FLOORS[0],
        of_drift=FLOORS[1],
        of_cost=FLOORS[2],
    )
    times = np.array([*TIMES, DRIFT_TIME])

    def quick(
        density: np.ndarray,
        error: np.ndarray,
        torque: np.ndarray,
        innovation: np.ndarray,
        reference: np.ndarray,
        before: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        found, recent = np.empty(len(FEATURES)), np.empty(RECENT.size)
        fast(packed, times, density, error, torque, innovation, reference, before, found, recent)
        return found, recent

    return quick
