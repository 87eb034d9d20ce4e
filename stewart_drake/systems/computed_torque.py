"""Computed torque as a LeafSystem."""

from __future__ import annotations

from stewart_drake.control.computed_torque import computed_torque_part
from stewart_drake.systems.tracking_controller import TrackingController


class ComputedTorque(TrackingController):
    """Inverse dynamics around a linear loop, see `computed_torque.computed_torque_tick`; z lives in the Context.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        torque: out (6,) [N m].
        error: out (6,) [rad, m], pose minus reference at the tick.
        integral: out (6,) [rad s, m s], z after the tick.
    """

    part = staticmethod(computed_torque_part)
