"""Gravity in the frame B of the base, and what an inertial unit on the base reads."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from stewart_drake.base.config import Real, check_value, with_message
from stewart_drake.robot.leg import LARGEST_SIZE, Signed3

Gravity = float | Sequence[float] | np.ndarray
"""[m/s^2] a number, along -z of B; or a vector (3,) in B; or a reading (9,) of the base's inertial unit, see
`base_reading`."""
FixedGravity = float | tuple[float, float, float]
"""[m/s^2] the same for a base at rest."""
GravityKey = Annotated[
    Annotated[Real, Field(ge=-LARGEST_SIZE, le=LARGEST_SIZE)] | Signed3,
    with_message("a number, along -z, or three numbers gx, gy, gz, such as 0, 0, -9.81"),
]
"""Gravity in a file."""
_Angle = Annotated[Real, Field(ge=-3.1417, le=3.1417)]  # As 3.1416 is written for half a turn.
Orientation = Annotated[
    tuple[_Angle, _Angle, _Angle],
    with_message("roll, pitch, yaw [rad]: three numbers within half a turn, not in degrees"),
]


def gravity_vector(gravity: Gravity) -> np.ndarray:
    """Gravity (3,) [m/s^2] in B."""
    return np.array([0.0, 0.0, -gravity]) if isinstance(gravity, (int, float)) else -base_reading(gravity)[:3]


def base_reading(gravity: Gravity) -> np.ndarray:
    """What an inertial unit at the origin of B reads (9,), in B; at rest, minus gravity and six zeros.

    Specific force [m/s^2], which is acceleration minus gravity, angular velocity [rad/s] and acceleration [rad/s^2].
    """
    if isinstance(gravity, (int, float)):
        return np.array([0.0, 0.0, gravity, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    numbers = np.asarray(gravity, dtype=float)
    if numbers.shape == (9,):
        return numbers
    check_gravity(gravity)
    return np.concatenate([-numbers, np.zeros(6)]) if numbers.shape else base_reading(float(numbers))


def check_gravity(gravity: Gravity) -> None:
    """Refuses what is neither a number nor a vector."""
    check_value("gravity", gravity, GravityKey)


def turned_gravity(gravity: FixedGravity, orientation: ArrayLike) -> FixedGravity:
    """Gravity in B of a base with these roll, pitch and yaw [rad]; a number stays a number where nothing turns."""
    if not np.any(orientation):
        return gravity
    (sr, sp, sy), (cr, cp, cy) = np.sin(orientation), np.cos(orientation)
    around_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    around_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    around_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    x, y, z = (around_z @ around_y @ around_x).T @ gravity_vector(gravity)
    return float(x), float(y), float(z)


def same_gravity(one: Gravity, other: Gravity) -> bool:
    """Whether two are the same to rounding."""
    return bool(np.allclose(gravity_vector(one), gravity_vector(other), rtol=0.0, atol=1e-12))


def gravity_text(gravity: Gravity) -> str:
    """Gravity in words of a report, in m/s^2."""
    return f"{gravity:g}" if isinstance(gravity, (int, float)) else ", ".join(f"{part:.4g}" for part in gravity)
