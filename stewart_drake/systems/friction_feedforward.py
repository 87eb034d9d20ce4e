"""Torque against friction, along the reference."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.hardware.friction_feedforward import FrictionCompensation, flat_feedforward
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.ticked import TickedSystem


class FrictionFeedforward(TickedSystem):
    """What the command has to add for friction, see `hardware.friction_feedforward`; answers within the tick.

    Args:
        robot: As the controller believes it to be.
        options: See `FrictionCompensation`.
        period: [s] tick period.
        compiled: See `Scenario.compiled`.

    Ports:
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        torque: out (6,) [N m].
    """

    def __init__(
        self, robot: RobotParameters, options: FrictionCompensation, period: float, compiled: bool = False
    ) -> None:
        super().__init__(period, np.zeros(6))
        self._feedforward = flat_feedforward(robot, options, compiled)
        self.reference = self.DeclareVectorInputPort("reference", 18)
        self._declare_result()
        self.torque = self._declare_output("torque", 0, 6)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:  # noqa: ARG002
        """See `friction_feedforward.feedforward`."""
        return self._feedforward(self.reference.Eval(context))
