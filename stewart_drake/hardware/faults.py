"""What faults of sensors, commands and motors have in common. A kind is a `FaultKind` and a line in the registry."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.families import Table
from stewart_drake.section import NotNegative, Section
from stewart_drake.wording import describe, either


class FaultKind(NamedTuple):
    """What a kind of fault does.

    Attributes:
        spoil: Called with the section of the fault and with what it spoils, which it changes in place.
        needs: Key that this kind must have, and that is null for kinds that do not need it; empty for none.
        keeps: Whether it goes on from the last good reading, which is then kept; of sensors.
    """

    spoil: Callable[[Any, Any], None]
    needs: str = ""
    keeps: bool = False


class Fault(Section):
    """Base of the faults."""

    kinds: ClassVar[Table]
    kind: str
    time: NotNegative = 0.0
    """[s] when it begins."""

    @property
    def does(self) -> FaultKind:
        """What its kind does."""
        found: FaultKind = self.kinds[self.kind]
        return found

    def spoil(self, time: float, what: Any) -> bool:
        """Does what its kind does, if it is there at this time [s]; whether it is."""
        duration = getattr(self, "duration", None)
        acts = self.time <= time < self.time + (math.inf if duration is None else duration)
        if acts:
            self.does.spoil(self, what)
        return acts

    @property
    def channels(self) -> slice:
        """Entries that it spoils: of its leg, or all."""
        leg = getattr(self, "leg", None)
        return slice(None) if leg is None else slice(leg, leg + 1)

    def rules(self) -> None:
        """See `Section.rules`."""
        leg, other = getattr(self, "leg", None), getattr(self, "other", None)
        for key in ("delay", "other"):
            value, kinds = getattr(self, key, None), [n for n in self.kinds.names if self.kinds[n].needs == key]
            if value is not None and self.kind not in kinds:
                raise ConfigurationError(key, value, f"null, but for kind {either(kinds)}")
            if value is None and self.kind in kinds:
                field = self.__pydantic_fields__[key]
                raise ConfigurationError(key, value, f"{describe(field.annotation)}, for kind {self.kind}")
        if other is not None and (leg is None or leg == other):
            key, value = ("leg", leg) if leg is None else ("other", other)
            raise ConfigurationError(key, value, f"a leg from 0 to 5, other than {other if leg is None else leg}")


def swap(fault: Any, values: np.ndarray) -> None:
    """Each of two legs has the other's number."""
    pair = np.array([fault.leg, fault.other], dtype=int)
    values[pair] = values[pair[::-1]]
