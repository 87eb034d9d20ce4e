"""Motor encoders."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np
from pydrake.systems.framework import Context, LeafSystem, OutputPort

from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.plant.multibody_plant import StewartPlant
from stewart_drake.sampling import on_grid


class MotorEncoders(LeafSystem):
    """Crank angles as the encoders read them.

    Args:
        plant: Whose motors.
        options: See `EncoderOptions`.
        period: [s] tick period, for the noise: one number a tick, however often it is asked for.
        compiled: See `Scenario.compiled`.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        angles: out (6,) [rad], from the horizontal.
    """

    def __init__(self, plant: StewartPlant, options: EncoderOptions, period: float, compiled: bool = False) -> None:
        super().__init__()
        self._read, self._period = options.reader(compiled), on_grid(period)
        # A sensor asks at every tick: what `crank_angles` does, without its generality.
        self._index = plant.indices.crank
        self._zero = plant.crank_angles(np.zeros(plant.plant.num_multibody_states()))
        self.plant_state = self.DeclareVectorInputPort("plant_state", plant.plant.num_multibody_states())
        noisy = {self.time_ticket()} if options.noise > 0.0 else set()
        prerequisites = {self.input_port_ticket(self.plant_state.get_index()), *noisy}
        self.angles = self.DeclareVectorOutputPort("angles", 6, self._calc, prerequisites_of_calc=prerequisites)

    def _calc(self, context: Context, output: Any) -> None:
        angles = self.plant_state.Eval(context)[self._index] + self._zero
        output.SetFromVector(self._read(angles, math.floor(context.get_time() / self._period + 1e-6)))


def add_encoders(wiring: Any, options: EncoderOptions) -> OutputPort:
    """Adds encoders to a closed loop; their readings (6,)."""
    encoders = MotorEncoders(wiring.plant, options, wiring.period, wiring.scenario.compiled)
    wiring.add("encoders", encoders, plant_state=wiring.plant.state_output_port)
    wiring.angles = wiring.with_faults(encoders.angles, options.faults)
    return cast(OutputPort, wiring.angles)
