"""Computed torque as a LeafSystem."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.computed_torque import ComputedTorqueMemory, ComputedTorqueOptions, computed_torque_tick
from stewart_drake.control_inputs import Measurement, Setpoint
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.ticked import TickedSystem


class ComputedTorque(TickedSystem):
    """Inverse dynamics around a linear loop; answers within the tick, z lives in the Context.

    Args:
        robot: As the controller believes it to be.
        options: See `ComputedTorqueOptions`.
        gravity: [m/s^2].

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose, pose rate, pose acceleration.
        torque: out (6,) [N m].
        error: out (6,) [rad, m], pose minus reference at the tick.
        integral: out (6,) [rad s, m s], z after the tick.
    """

    def __init__(self, robot: RobotParameters, options: ComputedTorqueOptions, gravity: float) -> None:
        super().__init__(options.period, np.zeros(18))
        self._robot, self._options, self._gravity = robot, options, gravity
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.reference = self.DeclareVectorInputPort("reference", 18)
        self._declare_result()
        self.torque = self._declare_output("torque", 0, 6)
        self.error = self._declare_output("error", 6, 6)
        self.integral = self._declare_output("integral", 12, 6)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `computed_torque.computed_torque_tick`."""
        now, wanted = self.measurement.Eval(context), self.reference.Eval(context)
        measurement, setpoint = Measurement(now[:6], now[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:])
        memory = ComputedTorqueMemory(previous[:6], previous[6:12], previous[12:])
        return np.concatenate(
            computed_torque_tick(self._robot, self._options, self._gravity, measurement, setpoint, memory)
        )
