"""Sections for a user's class that makes parts of a loop: a sensor, an estimator or an adaptive law."""

from __future__ import annotations

from typing import ClassVar

from stewart_drake.base.families import UserMade
from stewart_drake.loop.part import LoopContext, Part


class UserParts(UserMade):
    """Base of sections for a user's class whose objects have the method `parts`."""

    asked = "parts(context) returns a tuple of Part"
    gives: ClassVar[str] = ""
    """Signal that one of the parts must give."""

    def parts(self, context: LoopContext | float) -> tuple[Part, ...]:
        """The parts of a new object; a sensor gets the period [s] of its readings in place of a context."""
        made = self.new_object({})
        if not callable(getattr(made, "parts", None)):
            raise self.refusal("one without parts")
        with self.code.blamed(self.code_key, f"a class whose {self.asked} and does not raise"):
            parts = made.parts(context)
        if not isinstance(parts, (tuple, list)) or not all(isinstance(part, Part) for part in parts):
            raise self.refusal(f"a {type(parts).__name__} of something else")
        for part in parts:
            if missing := set(part.outputs) - set(part.initial.dtype.names or part.outputs):
                raise self.refusal(f"an output {min(missing)} of {part.name}, which is not a field of its state")
        if self.gives and not any(part.signal(output) == self.gives for part in parts for output in part.outputs):
            raise self.refusal(f"parts without the output {self.gives}")
        return tuple(parts)
