"""A monitor of the user's own."""

from __future__ import annotations

from stewart_drake.errors import ConfigurationError
from stewart_drake.registry import UserMade
from stewart_drake.safety.memory import SafetyInputs


class UserMonitor(UserMade, key="safety.monitors"):
    """What a class of the user's own says with `look(inputs)`, once a tick.

    It gets `SafetyInputs` with a measurement that is finite, and returns the leg with which something is wrong, -1 for
    the robot as a whole, None for nothing. Where something is, the robot is taken from its controller.
    """

    @property
    def name(self) -> str:
        """Stable name, for the log."""
        return self.kind.rpartition(":")[2]

    def look(self, inputs: SafetyInputs) -> int | None:
        """Leg, -1, or None.

        Raises:
            ConfigurationError: The class cannot be used, or answers something else.
        """
        leg = self.made.look(inputs)
        if leg is not None and (isinstance(leg, bool) or leg not in range(-1, 6)):
            allowed = f"a class whose look(inputs) returns a leg, -1 or None, not {leg!r}"
            raise ConfigurationError(self.source.key, self.kind, allowed)
        return None if leg is None else int(leg)
