"""Ideal task-space sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem, OutputPort

from stewart_drake.hardware.sensors import IdealSensors
from stewart_drake.plant.multibody_plant import StewartPlant


class TaskSpaceSensor(LeafSystem):
    """Pose and rate of P in B, exact.

    Ports:
        plant_state: in (nq + nv,), state of the MultibodyPlant.
        measurement: out (12,), pose [rad, m] then pose rate [rad/s, m/s] (Euler rates).
    """

    def __init__(self, plant: StewartPlant) -> None:
        super().__init__()
        self._plant = plant
        size = plant.plant.num_multibody_states()
        self.plant_state = self.DeclareVectorInputPort("plant_state", size)
        self.measurement = self.DeclareVectorOutputPort("measurement", 12, self._calc)

    def _calc(self, context: Context, output: Any) -> None:
        pose, rate = self._plant.pose_and_rate(self.plant_state.Eval(context))
        output.SetFromVector(np.concatenate([pose, rate]))


def add_ideal_sensor(wiring: Any, options: IdealSensors) -> OutputPort:
    """Adds the sensor to a closed loop; its measurement (12,)."""
    sensor = wiring.add("sensor", TaskSpaceSensor(wiring.plant), plant_state=wiring.plant.state_output_port)
    return wiring.with_faults(sensor.measurement, options.faults)
