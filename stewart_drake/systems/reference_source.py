"""Source of the reference motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.references import Reference


class ReferenceSource(LeafSystem):
    """A reference motion as a signal.

    Ports:
        reference: out (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
    """

    def __init__(self, reference: Reference) -> None:
        super().__init__()
        self._reference = reference
        self.reference = self.DeclareVectorOutputPort(
            "reference", 18, self._calc, prerequisites_of_calc={self.time_ticket()}
        )

    def _calc(self, context: Context, output: Any) -> None:
        output.SetFromVector(np.concatenate(self._reference.evaluate(context.get_time())))
