"""A monitor of the user's own."""

from __future__ import annotations

import reprlib
from typing import NamedTuple

import numpy as np

from stewart_drake.families import UserMade


class SafetyInputs(NamedTuple):
    """What a monitor of the user's own gets.

    Attributes:
        command: (6,) [N m].
        pose: (6,) [rad, m] measured.
        pose_rate: (6,) [rad/s, m/s] measured.
        reference: (6,) [rad, m] pose that is wanted.
        age: [ticks] of the command.
        sensor: What is wrong with the estimator, see `errors.FAILURES`, and its leg or -1.
        controller: What is wrong with the controller, likewise.
        surprise: [rad/s^2] acceleration of a crank that the largest innovation of an observer speaks of.
    """

    command: np.ndarray
    pose: np.ndarray
    pose_rate: np.ndarray
    reference: np.ndarray
    age: float = 0.0
    sensor: tuple[float, float] = (0.0, -1.0)
    controller: tuple[float, float] = (0.0, -1.0)
    surprise: float = 0.0


class UserMonitor(UserMade, key="safety.monitors"):
    """What a class of the user's own says with `look(inputs)`, once a tick.

    It gets `SafetyInputs` with a measurement that is finite, and returns the leg with which something is wrong, -1 for
    the robot as a whole, None for nothing. Where something is, the robot is taken from its controller.
    """

    asked = "look(inputs) returns a leg, -1 or None"

    @property
    def name(self) -> str:
        """Stable name, for the log."""
        return self.code.name

    def look(self, inputs: SafetyInputs) -> int | None:
        """Leg, -1, or None.

        Raises:
            ConfigurationError: The class cannot be used, or answers something else.
        """
        leg = self.made.look(inputs)
        if leg is None:
            return None
        number = isinstance(leg, (int, float, np.number)) and not isinstance(leg, bool)
        if not number or leg not in range(-1, 6):
            raise self.refusal(reprlib.repr(leg))
        return int(leg)
