"""Base of the controllers that come with the package."""

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
    """Answers within the tick with the torque that leads the platform after its reference; state lives in the Context.

    A subclass says by which pure function, `law` of robot, options, gravity, measurement, setpoint and memory, or has a
    `tick` of its own.

    Args:
        robot: As the controller believes it to be.
        options: Of the controller; its `results` are ports: torque, and error and integral where it tells them.
        gravity: [m/s^2].
        guarded: See `TickedSystem`.
    """

    law: Callable[..., Any]
    memory: Any
    """NamedTuple of (6,) arrays that `law` takes and gives; it begins with the results."""
    torque: OutputPort

    def __init__(
        self, robot: RobotParameters, options: OwnControllerOptions, gravity: float, guarded: bool = False
    ) -> None:
        super().__init__(options.period, np.zeros(self._memory_size()), guarded)
        self._believed = robot, options, gravity
        self.measurement = self.DeclareVectorInputPort("measurement", 12)
        self.reference = self.DeclareVectorInputPort("reference", 18)
        self._declare_more()
        self._declare_result()
        for place, name in enumerate(("torque", "error", "integral")[: len(options.results)]):
            setattr(self, name, self._declare_output(name, 6 * place, 6))

    @classmethod
    def build(cls, options: Any, site: ControllerSite) -> TrackingController:
        """The system for the options of a scenario."""
        return cls(site.robot, options, site.gravity, guarded=site.guarded)

    @classmethod
    def _memory_size(cls) -> int:
        return 6 * len(cls.memory._fields)

    def _declare_more(self) -> None:
        """Declares further input ports."""

    def tick(self, context: Context, previous: np.ndarray) -> np.ndarray:
        """See `TickedSystem.tick`: the law's answer."""
        now, wanted = self.measurement.Eval(context), self.reference.Eval(context)
        seen = Measurement(now[:6], now[6:]), Setpoint(wanted[:6], wanted[6:12], wanted[12:])
        return np.concatenate(self.law(*self._believed, *seen, self.memory(*previous.reshape(-1, 6))))
