"""What can be read of the plant, without error."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.plant.multibody_plant import StewartPlant


class TaskSpaceSensor(LeafSystem):
    """Pose and rate of P in B, and the angles of the cranks, exact.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] (Euler rates).
        crank_angles: out (6,) [rad], from the horizontal, not wrapped.
    """

    def __init__(self, plant: StewartPlant) -> None:
        super().__init__()
        self._plant = plant
        size = plant.plant.num_multibody_states()
        # A sensor asks at every tick: what `StateMap.crank_angles` does, without its generality.
        self._index, self._zero = plant.indices.crank, plant.crank_angles(np.zeros(size))
        self.plant_state = self.DeclareVectorInputPort("plant_state", size)
        needs = {self.input_port_ticket(self.plant_state.get_index())}
        self.measurement = self.DeclareVectorOutputPort("measurement", 12, self._pose, prerequisites_of_calc=needs)
        self.crank_angles = self.DeclareVectorOutputPort("crank_angles", 6, self._angles, prerequisites_of_calc=needs)

    def _pose(self, context: Context, output: Any) -> None:
        pose, rate = self._plant.pose_and_rate(self.plant_state.Eval(context))
        output.SetFromVector(np.concatenate([pose, rate]))

    def _angles(self, context: Context, output: Any) -> None:
        output.SetFromVector(self.plant_state.Eval(context)[self._index] + self._zero)
