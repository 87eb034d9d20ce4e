"""A monitor of the user's own."""

from __future__ import annotations

import reprlib

import numpy as np

from stewart_drake.families import UserMade
from stewart_drake.safety.memory import SafetyInputs


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
