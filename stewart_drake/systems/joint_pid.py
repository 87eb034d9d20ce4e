"""The joint-space PID as a LeafSystem."""

from __future__ import annotations

from stewart_drake.control.joint_pid import pid_part
from stewart_drake.systems.tracking_controller import TrackingController


class JointPid(TrackingController):
    """PID on the crank angles, see `joint_pid.pid_tick`; its integral lives in the Context.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        torque: out (6,) [N m].
    """

    part = staticmethod(pid_part)
