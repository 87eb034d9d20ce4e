"""Computed torque as a LeafSystem."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.control.computed_torque import ComputedTorqueMemory, ComputedTorqueOptions, computed_torque_tick
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.tracking_controller import TrackingController


class ComputedTorque(TrackingController):
    """Inverse dynamics around a linear loop; answers within the tick, z lives in the Context.

    Args:
        robot: As the controller believes it to be.
        options: See `ComputedTorqueOptions`.
        gravity: [m/s^2].
        guarded: See `TickedSystem`.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        torque: out (6,) [N m].
        error: out (6,) [rad, m], pose minus reference at the tick.
        integral: out (6,) [rad s, m s], z after the tick.
    """

    def __init__(
        self, robot: RobotParameters, options: ComputedTorqueOptions, gravity: float, guarded: bool = False
    ) -> None:
        super().__init__(options.period, 18, guarded)
        self._robot, self._options, self._gravity = robot, options, gravity
        self._declare_torque()
        self.error = self._declare_output("error", 6, 6)
        self.integral = self._declare_output("integral", 12, 6)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `computed_torque.computed_torque_tick`."""
        memory = ComputedTorqueMemory(previous[:6], previous[6:12], previous[12:])
        return np.concatenate(
            computed_torque_tick(self._robot, self._options, self._gravity, *self._seen(context), memory)
        )
