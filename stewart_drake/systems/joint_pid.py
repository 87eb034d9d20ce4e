"""The joint-space PID as a LeafSystem."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.control.joint_pid import PidMemory, PidOptions, pid_tick
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.tracking_controller import TrackingController


class JointPid(TrackingController):
    """PID on the crank angles; answers within the tick, its integral lives in the Context.

    Args:
        robot: As the controller believes it to be.
        options: See `PidOptions`.
        gravity: [m/s^2].
        guarded: See `TickedSystem`.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        torque: out (6,) [N m].
    """

    def __init__(self, robot: RobotParameters, options: PidOptions, gravity: float, guarded: bool = False) -> None:
        super().__init__(options.period, 12, guarded)
        self._robot, self._options, self._gravity = robot, options, gravity
        self._declare_torque()

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `joint_pid.pid_tick`."""
        memory = PidMemory(previous[:6], previous[6:])
        return np.concatenate(pid_tick(self._robot, self._options, self._gravity, *self._seen(context), memory))
