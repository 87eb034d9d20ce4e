"""Motors that are not perfect."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.hardware.motors import MotorOptions
from stewart_drake.plant.multibody_plant import StewartPlant


class MotorDrive(LeafSystem):
    """Torque of the motors for the torque asked for, see `MotorOptions.torque`.

    Ports:
        torque: in (6,) [N m], asked for.
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        torque_applied: out (6,) [N m], for the plant.
    """

    def __init__(self, plant: StewartPlant, options: MotorOptions) -> None:
        super().__init__()
        self._options = options
        size = plant.plant.num_multibody_states()
        self._index, self._zero = plant.indices.crank, plant.crank_angles(np.zeros(size))
        self.torque = self.DeclareVectorInputPort("torque", 6)
        self.plant_state = self.DeclareVectorInputPort("plant_state", size)
        self.torque_applied = self.DeclareVectorOutputPort("torque_applied", 6, self._calc)

    def _calc(self, context: Context, output: Any) -> None:
        angles = self.plant_state.Eval(context)[self._index] + self._zero
        # Times of steps are stretched slightly, see `sampling.on_grid`.
        output.SetFromVector(self._options.torque(self.torque.Eval(context), angles, context.get_time()))
