"""A motion of the user's own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.families import UserMade


class UserReference(UserMade, key="reference"):
    """What a class of the user's own says with `evaluate(time)`: pose, rate and acceleration, as in `Reference`.

    It may take an array of times (n,) and return three of (n, 6), or one time and three of (6,).
    """

    asked = "evaluate(t) returns pose, rate and acceleration, (6,) each"

    def evaluate(self, time: float | np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `Reference.evaluate`.

        Raises:
            ConfigurationError: The class cannot be used, or answers something else.
        """
        time = np.asarray(time, dtype=float)
        if time.ndim == 0:
            return self._asked(time)
        pose, rate, acceleration = (np.reshape(part, (*time.shape, 6)) for part in self._along(time.ravel()))
        return pose, rate, acceleration

    def _along(self, times: np.ndarray) -> Sequence[np.ndarray]:
        """Three of (n, 6) at times (n,): asked for at once where the class takes arrays."""
        count = len(times)
        # Of six times (6, 6) could be the wrong way round, and nobody would see it.
        asked = np.append(times, times[-1]) if count == 6 else times
        try:
            return [part[:count] for part in self._asked(asked)]
        except (TypeError, ValueError, ConfigurationError):
            each = [self._asked(one) for one in times]
            return [np.array(part) for part in zip(*each, strict=True)] or [np.empty((0, 6))] * 3

    def _asked(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        answer = self.made.evaluate(time if time.ndim else float(time))
        if isinstance(answer, str) or not isinstance(answer, Iterable):
            raise self.refusal(f"a {type(answer).__name__}")
        parts = tuple(self.numbers(part) for part in answer)
        if len(parts) != 3 or any(part.shape != (*time.shape, 6) for part in parts):
            raise self.refusal(", ".join(str(part.shape) for part in parts) or "nothing")
        return parts[0], parts[1], parts[2]
