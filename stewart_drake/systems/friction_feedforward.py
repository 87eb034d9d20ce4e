"""Torque against friction, along the reference."""

from __future__ import annotations

from pydrake.systems.framework import InputPort, OutputPort

from stewart_drake.hardware.friction_feedforward import FrictionCompensation, feedforward_part
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.ticked import SampledSystem


class FrictionFeedforward(SampledSystem):
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

    reference: InputPort
    torque: OutputPort

    def __init__(
        self, robot: RobotParameters, options: FrictionCompensation, period: float, compiled: bool = False
    ) -> None:
        super().__init__(period, feedforward_part(robot, options, compiled), {"reference": 18}, {"torque": 6})
