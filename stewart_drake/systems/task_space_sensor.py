"""What can be read of the plant, without error."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.plant.multibody_plant import StewartPlant


class TaskSpaceSensor(LeafSystem):
    """Pose and rate of P in B, and angles and rates of the cranks, exact.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] (Euler rates).
        crank_state: out (12,), angles of the cranks [rad] from the horizontal, not wrapped, then their rates [rad/s].
    """

    def __init__(self, plant: StewartPlant) -> None:
        super().__init__()
        self._plant = plant
        size = plant.plant.num_multibody_states()
        # A sensor asks at every tick: what `StateMap.crank_angles` does, without its generality.
        self._index = np.concatenate([plant.indices.crank, plant.indices.crank_rate])
        self._zero = np.concatenate([plant.crank_angles(np.zeros(size)), np.zeros(6)])
        self.plant_state = self.DeclareVectorInputPort("plant_state", size)
        needs = {self.input_port_ticket(self.plant_state.get_index())}
        self.measurement = self.DeclareVectorOutputPort("measurement", 12, self._pose, prerequisites_of_calc=needs)
        self.crank_state = self.DeclareVectorOutputPort("crank_state", 12, self._cranks, prerequisites_of_calc=needs)

    def _pose(self, context: Context, output: Any) -> None:
        pose, rate = self._plant.pose_and_rate(self.plant_state.Eval(context))
        output.SetFromVector(np.concatenate([pose, rate]))

    def _cranks(self, context: Context, output: Any) -> None:
        output.SetFromVector(self.plant_state.Eval(context)[self._index] + self._zero)
