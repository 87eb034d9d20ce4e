"""The observer as a part of a loop: flat vectors in and out, tick by tick."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from stewart_drake.compiled.constants import OBSERVER_MEMORY
from stewart_drake.errors import ConfigurationError
from stewart_drake.hardware.estimator import EncoderOptions, estimate, initial_memory
from stewart_drake.hardware.observer import Observer, ObserverOptions, flat_observer
from stewart_drake.hardware.sensing import Estimate, LoopSite
from stewart_drake.hardware.sensor_faults import SensorOptions
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.sampling import Running, Sampled

_M = OBSERVER_MEMORY

FARTHEST = 0.3
"""[s] beyond which a prediction says nothing any more; assumed."""


def observer_part(observer: Observer, initial: np.ndarray, size: int, compiled: bool) -> Sampled:
    """A tick of the observer, of readings of any sensor.

    Args:
        observer: See there.
        initial: Memory before the first tick, see `Observer.initial`.
        size: Entries of a reading: 6 angles of the cranks [rad], or 12 of pose [rad, m] and its rate.
        compiled: See `Scenario.compiled`.

    Returns:
        Its tick takes a reading, `sent`, `reference` and `disturbance` (1,) as `observer.observe` does, and the memory.
    """

    def first_pose(angles: np.ndarray, guess: np.ndarray) -> np.ndarray:
        return estimate(observer.robot, EncoderOptions(), observer.period, angles, initial_memory(guess))[:6]

    observe = flat_observer(observer, first_pose, compiled)
    if size == 6:
        return Sampled(initial, observe)

    def tick(
        reading: np.ndarray, sent: np.ndarray, reference: np.ndarray, disturbance: np.ndarray, memory: np.ndarray
    ) -> np.ndarray:
        finite = np.isfinite(reading[:6]).all()
        angles = inverse_kinematics(observer.robot, reading[:6]) if finite else np.full(6, np.nan)
        return observe(angles, sent, reference, disturbance, memory)

    return Sampled(initial, tick)


class PlacedObserver(NamedTuple):
    """An observer in its loop: its memory before the first tick, and the ticks by which it looks ahead."""

    observer: Observer
    initial: np.ndarray
    ahead: int


def observer_at(options: ObserverOptions, site: LoopSite, sensors: SensorOptions) -> PlacedObserver:
    """The observer of a loop.

    Raises:
        ConfigurationError: A delay that is too long.
    """
    ahead = options.ahead(site.delay)
    if ahead * site.period > FARTHEST:
        key, value = ("command_delay", site.delay) if options.delay is None else ("estimator.delay", options.delay)
        most = int(FARTHEST / site.period)
        allowed = f"at most {most} ticks: an observer looks no farther ahead than {FARTHEST:g} s"
        raise ConfigurationError(key, value, allowed)
    observer = Observer(
        site.robot, options, site.gravity, site.period, sensors.reading_noise, site.friction, site.levels[1]
    )
    return PlacedObserver(observer, observer.initial(site.pose, site.pose_rate, site.still, ahead), ahead)


class ObserverEstimating:
    """`ObserverOptions` in one run; see `Estimating`."""

    live = False

    def __init__(self, options: ObserverOptions, site: LoopSite, sensors: SensorOptions, size: int) -> None:
        observer, initial, self.ahead = observer_at(options, site, sensors)
        self.surprise_scale = observer.surprise_scale
        self._own = np.array([options.disturbance])
        self._observe = Running(observer_part(observer, initial, size, site.compiled), site.guarded)

    @property
    def health(self) -> tuple[float, float]:
        """See `Estimating`."""
        return self._observe.health

    def __call__(
        self, time: float, reading: np.ndarray, sent: np.ndarray, reference: np.ndarray, disturbance: np.ndarray | None
    ) -> Estimate:
        """See `Estimating`."""
        told = self._observe(time, reading, sent, reference, self._own if disturbance is None else disturbance)
        parts = (_M.pose, _M.pose_ahead, _M.compensation, _M.innovation, _M.surplus)
        return Estimate(*(told[start:end] for start, end in itertools.pairwise(parts)))
