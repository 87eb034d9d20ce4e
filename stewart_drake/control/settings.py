"""What a tuner can change in a loop with an observer: four numbers, how they act, and what they start from.

A setting is the base times powers of ten:

    speed        of the regulator: q_pose by its fourth power, q_rate by its second, q_integral by its sixth, as the
                 poles of a chain of integrators move together
    damping      of the regulator: q_rate on top of that
    integral     action of the regulator: q_integral on top of that
    disturbance  that the observer expects, see `ObserverOptions`: its bandwidth moves by the third root

so that any combination within a box is a sensible loop, which four weights on their own are not.
"""

from __future__ import annotations

from typing import NamedTuple

from stewart_drake.mechanics.arrays import Array, namespace


class Setting(NamedTuple):
    """Decades above the base, [-]; arrays of one shape, or numbers."""

    speed: Array
    damping: Array
    integral: Array
    disturbance: Array


NAMES = Setting._fields
SIZE = len(NAMES)
STEP = 0.03
"""[-] share of its box by which a setting moves in a tick, at most. By shares of a second a slow robot would jump, and
its loop can grow by that: docs/results/tuner_safety.md."""


def weights_of(base: Array, setting: Array) -> Array:
    """Block weights (..., 4) q_pose, q_rate, q_integral, r of settings (..., 4), from those of the base (4,).

    Arrays of numpy or torch; gradients pass.
    """
    xp = namespace(setting)
    speed, damping, integral = (setting[..., k] for k in range(3))
    decades = xp.stack([4.0 * speed, 2.0 * speed + damping, 6.0 * speed + integral, 0.0 * speed], axis=-1)
    return base * 10.0**decades


def disturbance_of(base: float, setting: Array) -> Array:
    """Disturbance (...) [rad/s^2 per sqrt(s)] of settings (..., 4), from that of the base."""
    return base * 10.0 ** setting[..., 3]
