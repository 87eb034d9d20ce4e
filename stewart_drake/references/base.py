"""What every reference motion is, and a smooth step that several of them share."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from stewart_drake.config import Vector6
from stewart_drake.sampling import InBlocks

HOME: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.3)
ZERO: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Reference(Protocol):
    """Anything that tells where the platform should be."""

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, rate and acceleration.

        Args:
            time: (...) [s].

        Returns:
            pose (..., 6) [rad, m], rate (..., 6) [rad/s, m/s], acceleration (..., 6) [rad/s^2, m/s^2].
        """


def smoothstep(u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """6 u^5 - 15 u^4 + 10 u^3, from 0 at u <= 0 to 1 at u >= 1, and its derivatives; both vanish at the ends.

    The path of least integrated squared jerk from rest to rest: T. Flash, N. Hogan, J. Neurosci. 5 (1985) 1688.

    Args:
        u: (...) [-].

    Returns:
        Value, first and second derivative, (...) [-] each.
    """
    u = np.clip(u, 0.0, 1.0)
    value = u**3 * (u * (6.0 * u - 15.0) + 10.0)
    return value, 30.0 * u**2 * (1.0 - u) ** 2, 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u)


def in_blocks(reference: Reference, period: float) -> InBlocks:
    """Pose, rate and acceleration (18,) of a motion at multiples of a period [s]."""
    return InBlocks(lambda times: np.concatenate(reference.evaluate(times), axis=-1), period)
