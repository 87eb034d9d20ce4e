"""Base of the controllers that come with the package."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydrake.systems.framework import InputPort, OutputPort

from stewart_drake.control.controller_options import OwnControllerOptions
from stewart_drake.control.parts import ControllerSite
from stewart_drake.robot import RobotParameters
from stewart_drake.sampling import Sampled
from stewart_drake.systems.ticked import SampledSystem


class TrackingController(SampledSystem):
    """Answers within the tick with the torque that leads the platform after its reference; state lives in the Context.

    Args:
        robot: As the controller believes it to be.
        options: Of the controller; its `results` are ports: torque, and error and integral where it tells them.
        gravity: [m/s^2].
        weights: Size of the port `weights`, of controllers that take them.
        guarded: See `TickedSystem`.
        compiled: See `Scenario.compiled`.
    """

    part: Callable[[Any, ControllerSite], Sampled]
    """What a subclass does."""
    measurement: InputPort
    reference: InputPort
    torque: OutputPort

    def __init__(
        self,
        robot: RobotParameters,
        options: OwnControllerOptions,
        gravity: float,
        weights: int = 2,
        guarded: bool = False,
        compiled: bool = False,
    ) -> None:
        site = ControllerSite(robot, gravity, weights, guarded, compiled)
        inputs = {"measurement": 12, "reference": 18, **({"weights": weights} if options.weighted else {})}
        outputs = dict(zip(("torque", "error", "integral"), options.results, strict=False))
        super().__init__(options.period, type(self).part(options, site), inputs, outputs, guarded)

    @classmethod
    def build(cls, options: Any, site: ControllerSite) -> TrackingController:
        """The system for the options of a scenario."""
        return cls(site.robot, options, site.gravity, site.weights, site.guarded, site.compiled)
