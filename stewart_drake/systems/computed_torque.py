"""Computed torque as a LeafSystem."""

from __future__ import annotations

from stewart_drake.control.computed_torque import ComputedTorqueMemory, computed_torque_tick
from stewart_drake.systems.tracking_controller import PureController


class ComputedTorque(PureController):
    """Inverse dynamics around a linear loop, see `computed_torque.computed_torque_tick`; z lives in the Context."""

    law = staticmethod(computed_torque_tick)
    memory = ComputedTorqueMemory
