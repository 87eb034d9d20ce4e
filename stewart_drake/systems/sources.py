"""What has no tick: the reference motion, what can be read of the plant without error, and pushes from outside."""

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
from stewart_drake.references import Reference, in_blocks


class ReferenceSource(LeafSystem):
    """A reference motion as a signal.

    Args:
        reference: The motion.
        period: [s] at whose multiples the signal is mostly asked for; they are evaluated some hundred at a time, which
            costs a tenth. Other times are answered too.
        ahead: [s] by which it is ahead of its time.

    Ports:
        reference: out (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
    """

    def __init__(self, reference: Reference, period: float | None = None, ahead: float = 0.0) -> None:
        super().__init__()
        self._reference, self._ahead = reference, ahead
        self._blocks = None if period is None else in_blocks(reference, period)
        needs = {self.time_ticket()}
        self.reference = self.DeclareVectorOutputPort("reference", 18, self._calc, prerequisites_of_calc=needs)

    def _calc(self, context: Context, output: Any) -> None:
        time = context.get_time() + self._ahead
        if self._blocks is not None:
            at, value = self._blocks.at(round(time / self._blocks.period))
            if at == time:
                output.SetFromVector(value)
                return
        output.SetFromVector(np.concatenate(self._reference.evaluate(time)))


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
        output.SetFromVector(np.concatenate(self._plant.pose_and_rate(self.plant_state.Eval(context))))

    def _cranks(self, context: Context, output: Any) -> None:
        output.SetFromVector(self.plant_state.Eval(context)[self._index] + self._zero)


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
        needs, forces = {self.time_ticket()}, Value[list[ExternallyAppliedSpatialForce]]
        self.wrench = self.DeclareVectorOutputPort("wrench", 6, self._calc, prerequisites_of_calc=needs)
        self.spatial_force = self.DeclareAbstractOutputPort(
            "spatial_force", lambda: forces(), self._calc_force, prerequisites_of_calc=needs
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
