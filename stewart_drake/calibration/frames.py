"""Rigid motions, of numbers and of complex ones: an imaginary step gives a derivative, exact but for rounding."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

_STEP, _TINY = 1e-20, 1e-30


class Frame(NamedTuple):
    """A rigid motion: `turn` (3, 3) [-] or (n, 3, 3), and `shift` (3,) [m] or (n, 3)."""

    turn: np.ndarray
    shift: np.ndarray

    def after(self, other: Frame) -> Frame:
        """This motion of what the other has moved."""
        return Frame(self.turn @ other.turn, np.einsum("...ij,...j->...i", self.turn, other.shift) + self.shift)

    def inverse(self) -> Frame:
        """What undoes it."""
        back = np.swapaxes(self.turn, -1, -2)
        return Frame(back, -np.einsum("...ij,...j->...i", back, self.shift))

    def moved(self, turn: np.ndarray, shift: np.ndarray) -> Frame:
        """This motion, and then a turn (3,) [rad] about where it leads, and a shift (3,) [m]."""
        return Frame(exponential(turn) @ self.turn, self.shift + shift)

    def minus(self, other: Frame) -> np.ndarray:
        """Turn and shift (n, 6) [rad, m] from another motion to this one."""
        turn = logarithm(self.turn @ np.swapaxes(other.turn, -1, -2))
        return np.concatenate([turn, self.shift - other.shift], axis=-1)

    def steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Turns [rad] and shifts [m] (n, 3) to each of n motions from the one before it, in a ring."""
        back = np.swapaxes(np.roll(self.turn, 1, axis=0), -1, -2)
        return logarithm(self.turn @ back), self.shift - np.roll(self.shift, 1, axis=0)

    def rows(self, chosen: np.ndarray) -> Frame:
        """Some of n motions."""
        return Frame(self.turn[chosen], self.shift[chosen])


STILL = Frame(np.eye(3), np.zeros(3))


def derivative(function: Callable[[np.ndarray], np.ndarray], size: int) -> np.ndarray:
    """Derivatives (..., size) at zero of a function (...) of `size` numbers, by imaginary steps."""
    return np.stack([function(1j * _STEP * row).imag for row in np.eye(size)], axis=-1) / _STEP


def exponential(turn: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    angle = np.sqrt(np.sum(turn * turn, axis=-1) + _TINY)[..., None, None]
    x, y, z = np.moveaxis(turn, -1, 0)
    o = np.zeros_like(x)
    cross = np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*turn.shape, 3)
    return np.eye(3) + np.sin(angle) / angle * cross + 2.0 * (np.sin(0.5 * angle) / angle) ** 2 * (cross @ cross)


def logarithm(rotation: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3), by less than half a turn."""
    across = np.stack([rotation[..., i, j] - rotation[..., j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=-1)
    square = 0.25 * (3.0 - np.trace(rotation, axis1=-2, axis2=-1))
    square = np.where(square.real < _TINY, _TINY, np.where(square.real > 1.0 - 1e-12, 1.0 - 1e-12, square))
    sine = np.sqrt(square)  # Of half the angle.
    return 0.5 * across * (np.arcsin(sine) / (sine * np.sqrt(1.0 - square)))[..., None]
