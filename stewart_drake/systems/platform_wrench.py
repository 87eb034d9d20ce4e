"""Wrenches from outside on the platform."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.hardware.disturbances import Disturbance, total_wrench
from stewart_drake.plant.multibody_plant import StewartPlant


class PlatformWrench(LeafSystem):
    """The disturbances of a scenario, at the centre of the platform.

    Ports:
        wrench: out (6,) [N m, N], moment about P and force, in B.
        spatial_force: out, for the plant's port `applied_spatial_force`.
    """

    def __init__(self, plant: StewartPlant, disturbances: Sequence[Disturbance]) -> None:
        super().__init__()
        self._disturbances = tuple(disturbances)
        self._body = plant.plant.GetBodyByName("platform").index()
        self.wrench = self.DeclareVectorOutputPort("wrench", 6, self._calc, prerequisites_of_calc={self.time_ticket()})
        self.spatial_force = self.DeclareAbstractOutputPort(
            "spatial_force",
            lambda: Value[list[ExternallyAppliedSpatialForce]](),
            self._calc_force,
            prerequisites_of_calc={self.time_ticket()},
        )

    def _calc(self, context: Context, output: Any) -> None:
        output.SetFromVector(total_wrench(self._disturbances, context.get_time()))

    def _calc_force(self, context: Context, output: Any) -> None:
        wrench = self.wrench.Eval(context)
        force = ExternallyAppliedSpatialForce()
        force.body_index = self._body
        # The origin of the link `platform` is P.
        force.p_BoBq_B = np.zeros(3)
        force.F_Bq_W = SpatialForce(tau=wrench[:3], f=wrench[3:])
        output.set_value([force])
