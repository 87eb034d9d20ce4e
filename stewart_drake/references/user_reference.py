"""A motion of the user's own."""

from __future__ import annotations

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.registry import UserMade


class UserReference(UserMade, key="reference"):
    """What a class of the user's own says with `evaluate(time)`: pose, rate and acceleration, as in `Reference`.

    It may take an array of times (...) and return three of (..., 6), or one time and three of (6,).
    """

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`.

        Raises:
            ConfigurationError: The class cannot be used, or answers something else.
        """
        time = np.asarray(time, dtype=float)
        try:
            return self._asked(time)
        except (TypeError, ValueError, ConfigurationError):
            if time.ndim == 0:
                raise
        each = [self._asked(one) for one in time.ravel()]
        pose, rate, acceleration = (np.reshape(part, (*time.shape, 6)) for part in zip(*each, strict=True))
        return pose, rate, acceleration

    def _asked(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        answer = self.made.evaluate(time if time.ndim else float(time))
        parts = tuple(np.asarray(part, dtype=float) for part in answer)
        if len(parts) != 3 or any(part.shape != (*time.shape, 6) for part in parts):
            shapes = ", ".join(str(part.shape) for part in parts)
            allowed = f"a class whose evaluate(t) returns pose, rate and acceleration, (6,) each, not {shapes}"
            raise ConfigurationError(self.source.key, self.kind, allowed)
        return parts[0], parts[1], parts[2]
