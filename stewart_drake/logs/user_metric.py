"""A metric of the user's own, by import path."""

from __future__ import annotations

from typing import Any

from stewart_drake.errors import ConfigurationError
from stewart_drake.families import UserMade
from stewart_drake.files.user_code import UserClass
from stewart_drake.logs.metric_table import Metric


class _MetricSource(UserClass):
    """A `Metric` in a module or file of the user's."""

    def load(self) -> Any:
        """The metric.

        Raises:
            ConfigurationError: See `UserClass.named`; it is not a `Metric`.
        """
        found = self.named() if self.given is None else self.given
        if not isinstance(found, Metric):
            allowed = f"the path of a Metric(name, unit, text, function), not of a {type(found).__name__}"
            raise ConfigurationError(self.key, self.path, allowed)
        return found


class UserMetric(UserMade, key="metrics"):
    """A `Metric` that a module or file of the user's has; in Python it may stand here itself."""

    asked = "of(tally) returns plain values"

    def rules(self) -> None:
        """See `Section.rules`."""
        if self.arguments:
            raise ConfigurationError("arguments", self.arguments, "nothing, for a metric")

    @property
    def source(self) -> UserClass:
        """Where it comes from."""
        inner = super().source
        return _MetricSource(inner.path, inner.key)

    @property
    def made(self) -> Metric:
        """The metric.

        Raises:
            ConfigurationError: See `UserClass.named`; it is not a `Metric`.
        """
        found: Any = self.source.load()
        return found
