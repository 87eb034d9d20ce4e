"""Base of the controllers that come with the package."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context

from stewart_drake.control.inputs import Measurement, Setpoint
from stewart_drake.robot import RobotParameters
from stewart_drake.systems.ticked import TickedSystem


class ControllerSite(NamedTuple):
    """What a controller is built for.

    Attributes:
        robot: As the controller believes it to be.
        gravity: [m/s^2].
        weights: Size of the weights that the tuner gives.
        guarded: See `TickedSystem`.
        compiled: See `Scenario.compiled`.
    """

    robot: RobotParameters
    gravity: float
    weights: int = 2
    guarded: bool = False
    compiled: bool = False


class TrackingController(TickedSystem):
    """Answers within the tick with the torque that leads the platform after its reference.

    Args:
        period: [s] control period.
        memory: Size of what a tick leaves for the next one; its first 6 are the torque.
        guarded: See `TickedSystem`.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        torque: out (6,) [N m].
    """

    def __init__(self, period: float, memory: int, guarded: bool) -> None:
        super().__init__(period, np.zeros(memory), guarded)
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.reference = self.DeclareVectorInputPort("reference", 18)

    @classmethod
    def build(cls, options: Any, site: ControllerSite) -> TrackingController:
        """The system for the options of a scenario."""
        made: Any = cls
        return made(site.robot, options, site.gravity, guarded=site.guarded)

    def _declare_torque(self) -> None:
        """Declares the result and, as part of it, the port `torque`; called once the input ports exist."""
        self._declare_result()
        self.torque = self._declare_output("torque", 0, 6)

    def _seen(self, context: Context) -> tuple[Measurement, Setpoint]:
        """What the input ports say."""
        now, wanted = self.measurement.Eval(context), self.reference.Eval(context)
        return Measurement(now[:6], now[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:])
