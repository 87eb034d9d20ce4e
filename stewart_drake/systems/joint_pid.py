"""The joint-space PID as a LeafSystem."""

from __future__ import annotations

from stewart_drake.control.joint_pid import PidMemory, pid_tick
from stewart_drake.systems.tracking_controller import PureController


class JointPid(PureController):
    """PID on the crank angles, see `joint_pid.pid_tick`; its integral lives in the Context."""

    law = staticmethod(pid_tick)
    memory = PidMemory
