"""The joint-space PID as a LeafSystem."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.control_inputs import Measurement, Setpoint
from stewart_drake.joint_pid import PidMemory, PidOptions, pid_tick
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.ticked import TickedSystem


class JointPid(TickedSystem):
    """PID on the crank angles; answers within the tick, its integral lives in the Context.

    Args:
        robot: As the controller believes it to be.
        options: See `PidOptions`.
        gravity: [m/s^2].

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose, pose rate, pose acceleration.
        torque: out (6,) [N m].
    """

    def __init__(self, robot: RobotParameters, options: PidOptions, gravity: float) -> None:
        super().__init__(options.period, np.zeros(12))
        self._robot, self._options, self._gravity = robot, options, gravity
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.reference = self.DeclareVectorInputPort("reference", 18)
        self._declare_result()
        self.torque = self._declare_output("torque", 0, 6)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `joint_pid.pid_tick`."""
        now, wanted = self.measurement.Eval(context), self.reference.Eval(context)
        measurement, setpoint = Measurement(now[:6], now[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:])
        memory = PidMemory(previous[:6], previous[6:])
        return np.concatenate(pid_tick(self._robot, self._options, self._gravity, measurement, setpoint, memory))
