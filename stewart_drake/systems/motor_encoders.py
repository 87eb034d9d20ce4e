"""Motor encoders."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from stewart_drake.estimator import EncoderOptions
from stewart_drake.plant import StewartPlant


class MotorEncoders(LeafSystem):
    """Crank angles as the encoders read them.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        angles: out (6,) [rad], from the horizontal.
    """

    def __init__(self, plant: StewartPlant, options: EncoderOptions) -> None:
        super().__init__()
        self._options = options
        # A sensor asks at every tick: what `crank_angles` does, without its generality.
        self._index = plant.indices.crank
        self._zero = plant.crank_angles(np.zeros(plant.plant.num_multibody_states()))
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.plant.num_multibody_states())
        self.angles = self.DeclareVectorOutputPort("angles", 6, self._calc)

    def _calc(self, context: Context, output: Any) -> None:
        output.SetFromVector(self._options.read(self.plant_state.Eval(context)[self._index] + self._zero))
