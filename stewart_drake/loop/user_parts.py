"""A sensor, an estimator or an adaptive law by a class of the user's own: it makes the parts that run in the loop."""

from __future__ import annotations

from typing import Any

from stewart_drake.base.families import UserMade
from stewart_drake.loop.part import Part


class UserParts(UserMade):
    """Base of sections for a user's class whose objects have the method `parts`."""

    asked = "parts(context) returns a tuple of Part"

    def parts(self, context: Any) -> tuple[Part, ...]:
        """Those that a new object gives; of a sensor the argument is the period [s] of its readings."""
        made = self.new_object({})
        if not callable(getattr(made, "parts", None)):
            raise self.refusal("one without parts")
        with self.code.blamed(self.code_key, f"a class whose {self.asked} and does not raise"):
            parts = made.parts(context)
        if not isinstance(parts, (tuple, list)) or not all(isinstance(part, Part) for part in parts):
            raise self.refusal(f"a {type(parts).__name__} of something else")
        return tuple(parts)
