"""What every reference motion is, and what several of them share: checks of their keys and a smooth step."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from stewart_drake import section as option_checks
from stewart_drake.errors import ConfigurationError
from stewart_drake.section import Vector6

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


def check_vectors(reference: object, *names: str) -> None:
    """Raises a `ConfigurationError` for the first of these keys that is not 6 finite numbers."""
    for name in names:
        if not is_six(getattr(reference, name)):
            raise ConfigurationError(f"reference.{name}", getattr(reference, name), "6 finite numbers")


def check_numbers(reference: object, low: float, high: float, allowed: str, *names: str) -> None:
    """Raises a `ConfigurationError` for the first of these keys that is not a finite number from `low` to `high`."""
    for name in names:
        option_checks.check_real(f"reference.{name}", getattr(reference, name), low, allowed, high)


def check_positive(reference: object, *names: str) -> None:
    """Raises a `ConfigurationError` for the first of these keys that is not a finite number above 0."""
    for name in names:
        option_checks.check_positive(f"reference.{name}", getattr(reference, name))


def check_whole(reference: object, low: int, high: int, *names: str) -> None:
    """Raises a `ConfigurationError` for the first of these keys that is not a whole number from `low` to `high`."""
    for name in names:
        option_checks.check_whole(f"reference.{name}", getattr(reference, name), low, high)


def check_poses(reference: object, name: str, least: int) -> None:
    """Raises a `ConfigurationError` if a key is not a list of at least `least` vectors of 6 finite numbers."""
    poses = getattr(reference, name)
    if len(poses) < least:
        raise ConfigurationError(f"reference.{name}", poses, f"at least {least} poses")
    for pose in poses:
        if not is_six(pose):
            raise ConfigurationError(f"reference.{name}", pose, "vectors of 6 finite numbers")


def is_six(value: Any) -> bool:
    """Whether a value is a vector of 6 finite numbers."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return False
    return array.shape == (6,) and bool(np.isfinite(array).all())
