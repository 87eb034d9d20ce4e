"""A metric of the user's own, by import path."""

from __future__ import annotations

from stewart_drake.errors import ConfigurationError
from stewart_drake.families import UserMade
from stewart_drake.logs.metric_table import Metric


class UserMetric(UserMade, key="metrics"):
    """A `Metric` that a module or file of the user's has; in Python it may stand here itself."""

    asked = "of(tally) returns plain values"

    def rules(self) -> None:
        """See `Section.rules`."""
        if self.arguments:
            raise ConfigurationError("arguments", self.arguments, "nothing, for a metric")

    def load(self) -> Metric:
        """The metric.

        Raises:
            ConfigurationError: See `CodePath.load`; it is not a `Metric`.
        """
        found = self.code.load(self.code_key)
        if not isinstance(found, Metric):
            allowed = f"the path of a Metric(name, unit, text, function), not of a {type(found).__name__}"
            raise ConfigurationError(self.code_key, self.code, allowed)
        return found

    @property
    def made(self) -> Metric:
        """The metric; see `load`."""
        return self.load()
