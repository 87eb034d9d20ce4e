"""Bases of the controllers that come with the package."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, OutputPort

from stewart_drake.control.controller_options import OwnControllerOptions
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
        options: Of the controller.
        memory: Size of what a tick leaves for the next one; it begins with `options.results`.
        guarded: See `TickedSystem`.

    Ports:
        measurement: in (12,), pose [rad, m], pose rate [rad/s, m/s].
        reference: in (18,), pose [rad, m], pose rate [rad/s, m/s], pose acceleration [rad/s^2, m/s^2].
        torque: out (6,) [N m].
        error: out (6,) [rad, m], pose minus reference at the tick; of controllers that tell it.
        integral: out (6,) [rad s, m s], z after the tick, likewise.
    """

    torque: OutputPort

    def __init__(self, options: OwnControllerOptions, memory: int, guarded: bool) -> None:
        super().__init__(options.period, np.zeros(memory), guarded)
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.reference = self.DeclareVectorInputPort("reference", 18)

    @classmethod
    def build(cls, options: Any, site: ControllerSite) -> TrackingController:
        """The system for the options of a scenario."""
        made: Any = cls
        return made(site.robot, options, site.gravity, guarded=site.guarded)

    def _declare_results(self, options: OwnControllerOptions) -> None:
        """Declares the result and its parts as ports; called once the input ports exist."""
        self._declare_result()
        for place, name in enumerate(("torque", "error", "integral")[: len(options.results)]):
            setattr(self, name, self._declare_output(name, 6 * place, 6))


class PureController(TrackingController):
    """A controller whose tick is a pure function of robot, options, gravity, measurement, setpoint and memory.

    Args:
        robot: As the controller believes it to be.
        options: Of the controller.
        gravity: [m/s^2].
        guarded: See `TickedSystem`.
    """

    law: Callable[..., Any]
    """The tick."""
    memory: type
    """NamedTuple of (6,) arrays that the tick takes and gives; it begins with the results."""

    def __init__(
        self, robot: RobotParameters, options: OwnControllerOptions, gravity: float, guarded: bool = False
    ) -> None:
        self._parts = len(self.memory._fields)  # type: ignore[attr-defined] # of every NamedTuple
        super().__init__(options, 6 * self._parts, guarded)
        self._believed = robot, options, gravity
        self._declare_results(options)

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """The law's answer as one vector."""
        now, wanted = self.measurement.Eval(context), self.reference.Eval(context)
        seen = Measurement(now[:6], now[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:])
        return np.concatenate(self.law(*self._believed, *seen, self.memory(*np.split(previous, self._parts))))
