"""Drake's plant behind the three methods of `ClosedChain`: for a loop that is not a Diagram."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.math import SpatialForce
from pydrake.multibody.plant import ExternallyAppliedSpatialForce
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from stewart_drake.errors import drake_guard
from stewart_drake.jit import new_record
from stewart_drake.plant.closed_chain import CHAIN_STATE
from stewart_drake.plant.multibody_plant import add_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.robot import RobotParameters


class SteppedPlant:
    """The `MultibodyPlant`, a step at a call."""

    def __init__(self, robot: RobotParameters, options: PlantOptions, gravity: float) -> None:
        builder = DiagramBuilder()
        self._robot, self._stewart = robot, add_plant(builder, robot, options, gravity)
        plant = self._stewart.plant
        with drake_guard("building the plant"):
            builder.ExportInput(self._stewart.torque_input_port, "torque")
            self._simulator = Simulator(builder.Build())
        self._context = self._simulator.get_mutable_context()
        self._force_port = plant.get_applied_spatial_force_input_port()
        self._plant_context = plant.GetMyMutableContextFromRoot(self._context)
        self._torque = self._simulator.get_system().GetInputPort("torque").FixValue(self._context, np.zeros(6))
        self._force = ExternallyAppliedSpatialForce()
        self._force.body_index = plant.GetBodyByName("platform").index()
        self._force.p_BoBq_B = np.zeros(3)
        self._push(np.zeros(6))
        self._period, self._steps = plant.time_step(), 0
        self._written = new_record(CHAIN_STATE)

    def initial(self, pose: np.ndarray, pose_rate: np.ndarray) -> np.ndarray:
        """`CHAIN_STATE` record at a pose (6,) and its rate (6,)."""
        self._stewart.set_state(self._context, pose, pose_rate)
        self._read(self._written)
        return self._written.copy()

    def step(self, torque: np.ndarray, wrench: np.ndarray, state: np.ndarray) -> None:
        """A step under torques (6,) [N m] and a wrench (6,) [N m, N] about P.

        Where `state` is not what the step before has left, the robot is put there first, friction without tension.
        """
        with drake_guard("a step of the plant"):
            if state.tobytes() != self._written.tobytes():
                self._stewart.set_state(self._context, state["pose"][0], state["pose_rate"][0])
            self._torque.GetMutableData().get_mutable_value().SetFromVector(torque)
            if (wrench != self._wrench).any():
                self._push(wrench)
            self._steps += 1
            self._simulator.AdvanceTo(self._steps * self._period)
        self._read(state)
        self._written[:] = state

    def _push(self, wrench: np.ndarray) -> None:
        self._wrench = wrench.copy()
        self._force.F_Bq_W = SpatialForce(tau=wrench[:3], f=wrench[3:])
        self._force_port.FixValue(self._plant_context, [self._force])

    def _read(self, state: np.ndarray) -> None:
        values = self._stewart.plant.GetPositionsAndVelocities(self._plant_context)
        state["pose"][0], state["pose_rate"][0] = self._stewart.pose_and_rate(values)
        state["twist"][0] = values[self._stewart.indices.twist]
        state["angles"][0] = self._stewart.crank_angles(values)
        state["crank_rate"][0] = values[self._stewart.indices.crank_rate]
