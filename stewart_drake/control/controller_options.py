"""What every controller's options tell the rest of the loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np

from stewart_drake.control.inputs import SingularityLimits
from stewart_drake.errors import ConfigurationError
from stewart_drake.part import AnyPart, Setup
from stewart_drake.robot import RobotParameters
from stewart_drake.section import Fraction, Positive, Section


class _UsualLimits(NamedTuple):
    min_transmission: float = 0.02
    min_conditioning: float = 0.005


class ControllerOptions(Section, ABC, key="controller"):
    """Base of the options of controllers; wiring, checks, logs and plots ask these, not which kind it is."""

    own_keys = frozenset({"feedforward", "saturation"})
    kind: str
    """Of controller."""
    period: Positive
    """[s] control period, > 0, a whole multiple of the plant's time step."""

    @classmethod
    def from_older(cls, data: dict[str, Any]) -> dict[str, Any]:
        """See `Section.from_older`."""
        if "compiled" in data:
            allowed = "no such key: it is the scenario's now, such as Scenario(compiled=True)"
            raise ConfigurationError("controller.compiled", data["compiled"], allowed)
        return data

    @property
    def label(self) -> str:
        """In a few words, for titles."""
        return f"controller {self.kind}"

    @property
    def near_singularity(self) -> SingularityLimits:
        """How near to a singularity it may start."""
        return _UsualLimits()

    @property
    def weighted(self) -> bool:
        """Whether one that comes with the package takes the weights of a tuner."""
        return False

    @property
    def asks_for_more(self) -> bool:
        """Whether its torque may exceed the limit, which then says that it has been cut."""
        return getattr(self, "saturation", "") == "none"

    @property
    def code(self) -> Any:
        """What of a user's code it runs, a `CodePath`; None for what comes with the package."""
        return None

    @abstractmethod
    def parts(self, setup: Setup) -> tuple[AnyPart, ...]:
        """The controller in a loop, one part: from measurement and reference to torque, error and integral."""

    def limit(self, robot: RobotParameters) -> np.ndarray:
        """(6,) [N m] of the motors' torques."""
        return robot.effort_limits


class OwnControllerOptions(ControllerOptions):
    """Base of the options of the controllers that come with the package."""

    kind: str
    period: Positive
    min_transmission: Fraction = 0.02
    """[-] a crank with |e_l . e_N| below this counts as at its dead centre."""
    min_conditioning: Fraction = 0.005
    """[-] sigma_min / sigma_max of the rods' lines below this counts as a parallel singularity."""

    @property
    def near_singularity(self) -> SingularityLimits:
        """How near to a singularity it goes."""
        return self
