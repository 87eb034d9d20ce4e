"""Options of the LQI controller."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from stewart_drake.control.controller_options import OwnControllerOptions
from stewart_drake.control.riccati import RiccatiSolver
from stewart_drake.control.state_space import Discretization
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.force_map import ForceMapKind
from stewart_drake.part import Part
from stewart_drake.robot.leg import LARGEST
from stewart_drake.robot.robot_scale import CHARACTERISTIC_LENGTH
from stewart_drake.section import Flag, Natural, Positive, PositivePair

Model = Literal["paper", "exact"]
Feedforward = Literal["none", "gravity", "platform", "full"]
FeedforwardAt = Literal["measured", "reference"]
Saturation = Literal["none", "clamp", "back_calculation"]


class LqiOptions(OwnControllerOptions):
    """Options of the LQI controller; the defaults are the paper's, with gravity compensated."""

    kind: Literal["lqi"] = "lqi"
    """The default kind."""
    period: Positive = 0.005
    model: Model = "paper"
    """paper: (9), the platform's mass alone, moments as accelerations of Euler angles. exact: inertia of the whole
    closed chain at the measured pose."""
    force_map: ForceMapKind = "statics"
    """tau_2 of (15) as printed, or by statics; the exact model has its own map."""
    feedforward: Feedforward = "gravity"
    """none: the paper, (34) alone. gravity: adds the static torque of all bodies at the measured pose. platform: adds
    to that M q''_d of (9) through the force map at the measured pose. full: inverse dynamics of the exact model for the
    reference's acceleration."""
    feedforward_at: FeedforwardAt = "measured"
    """Pose and rate at which `full` is evaluated: the measured ones, or the reference's."""
    weight_length: Annotated[Positive | None, Field(le=LARGEST), CHARACTERISTIC_LENGTH] = 1.0
    """[m] rotations in Q are multiplied by this, so that they compare with metres; 1 is the paper, the platform's joint
    radius 0.11 makes an error of the joints count alike in both. In a scenario null takes the robot's
    `characteristic_length`."""
    discretization: Discretization = "exact"
    """Zero-order hold of (25): exact, or first order (euler)."""
    solver: RiccatiSolver = "drake"
    """drake: one equation of 18 states. split: six of 3 states, without Drake."""
    saturation: Saturation = "none"
    """none: the torque asked for may exceed what the motors have. clamp: it is limited, and z stands still meanwhile.
    back_calculation: it is limited, and z is led back by what was cut off."""
    reset_time: Positive = 0.05
    """[s] time in which back-calculation takes z back."""
    integral_limit: PositivePair | None = None
    """[rad s, m s] largest |z| of rotations and translations; null for none."""
    bumpless: Flag = False
    """When the weights change, z changes too, so that the torque by z does not."""
    hold_ticks: Annotated[Natural, Field(le=1000)] = 0
    """Ticks in a row for which a pose near a singularity, a gain that does not exist or a measurement that is not
    finite is bridged by the last good gain and torque, before the run ends."""

    @property
    def length(self) -> float:
        """[m] `weight_length`.

        Raises:
            ConfigurationError: It is null, and no scenario has put the robot's in.
        """
        if self.weight_length is None:
            raise ConfigurationError("controller.weight_length", None, "a length, outside of a scenario")
        return self.weight_length

    @property
    def label(self) -> str:
        """In a few words, for titles."""
        model = "exact model" if self.model == "exact" else f"force map {self.force_map}"
        return f"{model}, feedforward {self.feedforward}"

    @property
    def weighted(self) -> bool:
        """Whether it takes the weights of a tuner."""
        return True

    def parts(self, setup: Any) -> tuple[Part, ...]:
        """The controller in a loop, see `part.Setup`."""
        from stewart_drake.control.lqi import lqi_part

        solver: RiccatiSolver | None = "split" if setup.split else None
        return (lqi_part(self, setup.robot, setup.gravity, len(setup.weights), solver),)
