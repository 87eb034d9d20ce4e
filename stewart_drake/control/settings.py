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

from typing import Any

import numpy as np

from stewart_drake.jit import njit

NAMES = ("speed", "damping", "integral", "disturbance")
SIZE = len(NAMES)
STEP = 0.03
"""[-] share of its box by which a setting moves in a tick, at most. By shares of a second a slow robot would jump, and
its loop can grow by that: docs/results/tuner_safety.md."""


@njit
def weights_of(base: Any, setting: Any) -> Any:
    """Block weights (4,) q_pose, q_rate, q_integral, r of a setting (4,), from those of the base (4,)."""
    speed, damping, integral = setting[0], setting[1], setting[2]
    weights = np.empty(4)
    weights[0] = base[0] * 10.0 ** (4.0 * speed)
    weights[1] = base[1] * 10.0 ** (2.0 * speed + damping)
    weights[2] = base[2] * 10.0 ** (6.0 * speed + integral)
    weights[3] = base[3]
    return weights


@njit
def disturbance_of(base: float, setting: Any) -> float:
    """Disturbance [rad/s^2 per sqrt(s)] of a setting (4,), from that of the base."""
    return base * 10.0 ** setting[3]
