"""Sections for a user's class that makes parts of a loop: a sensor, an estimator or an adaptive law."""

from __future__ import annotations

from stewart_drake.base.families import UserMade
from stewart_drake.loop.part import LoopContext, Part


class UserParts(UserMade):
    """Base of sections for a user's class whose objects have the method `parts`."""

    asked = "parts(context) returns a tuple of Part"

    def parts(self, context: LoopContext | float) -> tuple[Part, ...]:
        """The parts of a new object; a sensor gets the period [s] of its readings in place of a context."""
        made = self.construct({})
        if not callable(getattr(made, "parts", None)):
            raise self.refusal("one without parts")
        with self.code.blamed(self.code_key, f"a class whose {self.asked} and does not raise"):
            parts = made.parts(context)
        if not isinstance(parts, (tuple, list)) or not all(isinstance(part, Part) for part in parts):
            raise self.refusal(f"a {type(parts).__name__} of something else")
        return tuple(parts)
