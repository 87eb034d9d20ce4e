"""What the compiled functions share with their references in pure numpy, free of numba: numbers, and names of fields.

A flat vector is passed because an array of structures costs a call three microseconds more; its fields have names here.
"""

import itertools
from collections import namedtuple
from typing import Any

import numpy as np

_MAKE: Any = namedtuple  # mypy takes literal names alone


def _fields(name: str, **sizes: int) -> Any:
    """Where each field of a flat vector begins, by name; `size` is the length of all."""
    return _MAKE(name, [*sizes, "size"])(0, *itertools.accumulate(sizes.values()))


def filled(fields: Any, **values: Any) -> np.ndarray:
    """A flat vector of named values; each name once, or it is an error of ours."""
    if set(values) != set(fields._fields) - {"size"}:
        raise TypeError(f"fields {sorted(values)} are not those of {fields}")
    return np.concatenate([np.atleast_1d(np.asarray(values[name], dtype=float)) for name in fields._fields[:-1]])


NEWTON = 6
"""Steps of `spectral.spectral_factor`: five find all digits whatever the numbers."""

LQI_MEMORY = _fields("LqiMemory", torque=6, error=6, integral=6, gain=108, feedforward=6, weights=4, held=1)
"""See `lqi.LqiMemory`."""
LQI_NUMBERS = _fields(
    "LqiNumbers",
    period=1, gravity=1, length=1, min_transmission=1, min_conditioning=1, integral_angle=1, integral_position=1,
    reset_time=1,
)  # fmt: skip
"""[s], [m/s^2], [m], [-], [-], [rad s], [m s], [s]."""
LQI_CHOICES = _fields(
    "LqiChoices",
    exact_model=1, printed_map=1, feedforward=1, at_reference=1, exact_hold=1, saturation=1, bumpless=1,
)  # fmt: skip
"""Feedforward 0 to 3 for none, gravity, platform, full; saturation 0 to 2 for none, clamp, back_calculation."""
COMPUTED_TORQUE_NUMBERS = _fields(
    "ComputedTorqueNumbers",
    period=1, gravity=1, min_transmission=1, min_conditioning=1, frequency=1, damping=1, integral_frequency=1, limit=6,
)  # fmt: skip
"""[s], [m/s^2], [-], [-], [rad/s], [-], [rad/s], [N m] infinite for none."""
PID_NUMBERS = _fields(
    "PidNumbers",
    period=1, gravity=1, min_transmission=1, min_conditioning=1, kp=1, ki=1, kd=1, limit=6, given_back=1,
)  # fmt: skip
"""[s], [m/s^2] of the feedforward, [-], [-], [N m/rad], [N m/(rad s)], [N m s/rad], [N m] infinite for none, and
[rad s/(N m)] by which the integral is led back for what was cut; -1 where it stands still instead."""
ESTIMATOR_MEMORY = _fields("EstimatorMemory", pose=6, rate=6, angles=6, crank_rates=6, held=1, side=1, started=1)
"""See `estimator.MEMORY_SIZE`."""
ESTIMATOR_NUMBERS = _fields(
    "EstimatorNumbers", period=1, smoothing=1, max_speed=1, max_turn=1, max_shift=1, tolerance=1, iterations=1
)
"""[s], share of a new difference, [rad/s], [rad], [m], [m], Newton steps."""
RECENT = _fields("Recent", levels=5, drift=6, torque=6, ticks=1)
"""See `features.Recent`."""
TUNER_SITE = _fields(
    "TunerSite",
    period=1, noise=1, latency=1, length=1, kappa=1, rotation=1, position=1, change=1, of_surprise=1, of_drift=1,
    of_cost=1,
)  # fmt: skip
"""See `features.Site`; then what counts as one in the cost, [rad], [m] and, from tick to tick, 1/[N m]; `FLOORS`."""
TUNER_MEMORY = _fields(
    "TunerMemory",
    weights=4, disturbance=1, setting=4, outside=1, recent=RECENT.size, held=1,
)  # fmt: skip
"""What a tuner of settings says: weights, [rad/s^2 per sqrt(s)] for the observer, setting, and from 0 to
1 how far what it hears lies outside of its training; then `RECENT`, and [s] that a schedule goes on."""
OBSERVER_MEMORY = _fields(
    "ObserverMemory",
    pose=6, rate=6, pose_ahead=6, rate_ahead=6, compensation=6, innovation=6, surplus=6, missed=6, side=1,
)  # fmt: skip
"""See `observer.ObserverMemory`; its commands come after these."""
OBSERVER_NUMBERS = _fields(
    "ObserverNumbers", period=1, gravity=1, noise=1, max_innovation=1, hold_ticks=1, arrived=1, slip=1, rests=1
)
"""[s], [m/s^2], [rad], [rad], ticks, [rad] or negative for motors without friction, [rad/s^2], [rad/s]."""
WHITE_SHARE = 1.5
"""See `observer.SHARE`."""
SAFETY_MEMORY = _fields(
    "SafetyMemory",
    torque=6, level=1, monitor=1, leg=1, good=6, weight=6, held=1, at_limit=1, too_fast=1, since=1, side=1, ticks=1,
    first=5, worst=1, command=6, surprised=1,
)  # fmt: skip
"""See `safety.SafetyMemory`."""
SAFETY_NUMBERS = _fields(
    "SafetyNumbers",
    horizon=1, workspace_angle=1, workspace_position=1, transmission=1, conditioning=1, crank_speed=1,
    following_angle=1, following_position=1, torque_limit=6, torque_change=1, gravity=1, home=3, refill=1,
    usable_transmission=1, usable_conditioning=1,
)  # fmt: skip
"""[s], [rad], [m], [-], [-], [rad/s], [rad], [m], [N m], [N m] in a tick, [m/s^2], [m], ticks given back, [-], [-]."""
CHAIN_STATE = _fields("ChainState", pose=6, pose_rate=6, twist=6, angles=6, anchor=6, slip=6)
"""See `closed_chain.ChainState`."""

SMALLEST_SINGULAR_VALUE = 1e-13
"""Of M^-1 tau, as a share of the largest; below it the map counts as singular."""
MEAN_FLOOR = 1e-9
"""Window means below this share of the signal's scale count as zero; the density is 1 there."""
SAME_BRANCH = 1.0 - 1e-6
"""Cosine between a crank and the inverse kinematics of the pose found from it; below, it is the other branch's."""
