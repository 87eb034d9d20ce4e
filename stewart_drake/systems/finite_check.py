"""What ends a run whose torques are no numbers, where there is no safety layer."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.errors import NotFiniteError


class FiniteCheck(LeafSystem):
    """Passes torques on, as long as they are finite.

    Ports:
        torque: in (6,) [N m].
        checked: out (6,) [N m], the same.
    """

    def __init__(self) -> None:
        super().__init__()
        self.torque = self.DeclareVectorInputPort("torque", 6)
        self.checked = self.DeclareVectorOutputPort("checked", 6, self._calc)

    def _calc(self, context: Context, output: Any) -> None:
        torque = self.torque.Eval(context)
        if not np.isfinite(torque).all():
            error = NotFiniteError("torque", torque)
            error.time = context.get_time()
            raise error
        output.SetFromVector(torque)
