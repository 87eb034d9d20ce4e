"""What the simulated robot has beyond rigid bodies and ideal joints; pure, so that a scenario needs no Drake."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from stewart_drake.config import Flag, LegNumber, NotNegative, Real, Section
from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.friction import friction_law
from stewart_drake.plant.sdf_model import RodJoint
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LARGEST, FrictionOptions, Moderate

MIN_TIME_STEP, MAX_TIME_STEP = 1e-6, 0.01  # [s] finer steps drown in rounding; coarser ones follow nothing.

Place = Annotated[Real, Field(ge=-LARGEST, le=LARGEST)]


class BrokenRod(Section, key="plant.broken_rod"):
    """A rod that comes off the platform and hangs from its crank."""

    leg: LegNumber
    """Number of the leg, 0 to 5."""
    time: NotNegative
    """[s] when the rod breaks."""


# What only the plant of Drake can have.
_OF_DRAKE = ("rod_joint", "collision", "universal_damping", "platform_joint_damping", "broken_rod")


class PlantOptions(Section, key="plant"):
    """Options of the simulated robot."""

    time_step: Annotated[Real, Field(ge=MIN_TIME_STEP, le=MAX_TIME_STEP)] = 0.001
    """[s] time step of the discrete plant."""
    engine: Literal["drake", "reduced"] = "drake"
    """Simulation engine. drake: MultibodyPlant in a Diagram. reduced: exact closed-form dynamics, compiled, without a
    Diagram; several times faster, for searches, sweeps and comparisons. It rejects options that it does not support."""
    rod_joint: RodJoint = "universal"
    """Joint between crank and rod; `ball` is the paper's and leaves the rods' six spins uncontrolled."""
    collision: Flag = False
    """Whether cranks, rods, platform and base collide; bodies that a joint connects never do."""
    motor_damping: Moderate = 0.0
    """[N m s/rad] viscous friction of each motor; implicit, stable at any step. Short for `friction.viscous`."""
    universal_damping: Moderate = 0.0
    """[N m s/rad] viscous friction about each axis of the joints between crank and rod; implicit."""
    platform_joint_damping: Moderate = 0.0
    """[N m s/rad] viscous friction of each ball joint between rod and platform; explicit, see `platform_damping_limit`.
    It is isotropic near home only: at 45 deg of swing it is 0.6 to 3.4 times as large, by direction."""
    motor_friction: Moderate = 0.0
    """[N m] dry (Coulomb) friction of each motor, the same at rest and in motion. Short for `friction.coulomb`."""
    friction: FrictionOptions | None = None
    """Friction of the motors with stiction, for each motor; null takes `motor_damping` and `motor_friction`."""
    payload_mass: Moderate = 0.0
    """[kg] point mass on the platform that only the plant has; neither `robot` nor the controller knows it."""
    payload_position: tuple[Place, Place, Place] = (0.0, 0.0, 0.0)
    """[m] position of the payload in the platform's frame P."""
    broken_rod: BrokenRod | None = None
    """A rod that breaks during the run; null for none."""

    def rules(self) -> None:
        for name in _OF_DRAKE if self.engine == "reduced" else ():
            if getattr(self, name) != self.__pydantic_fields__[name].default:
                raise ConfigurationError("engine", "reduced", f"drake, because {name} is given")
        for name in ("motor_friction", "motor_damping"):
            if self.friction is not None and getattr(self, name) > 0.0:
                raise ConfigurationError(name, getattr(self, name), "0, because `friction` is given and has this value")

    def friction_law(self, robot: RobotParameters) -> np.ndarray:
        """`FRICTION` record of a robot's motors."""
        said = self.friction
        if said is None:
            said = FrictionOptions.from_dict({"coulomb": self.motor_friction, "viscous": self.motor_damping})
        return friction_law(*said.levels, robot.crank_axis_inertias, self.time_step)


def platform_damping_limit(robot: RobotParameters, options: PlantOptions) -> float:
    """Largest `platform_joint_damping` d [N m s/rad] that its explicit integration bears.

    A ball that turns at w takes the power d w^2, and w^2 <= 2 (w_rod^2 + w_platform^2): no motion decays faster than d
    max(2 / I_rod, 12 / I_platform). The limit makes that 1 / time_step, half of what is stable. I_rod is small about
    the axis of a rod that may spin between two balls.
    """
    rod_inertia = min(robot.rod_inertia) if options.rod_joint == "ball" else robot.rod_inertia[0]
    fastest = max(2.0 / rod_inertia, 12.0 / robot.smallest_platform_inertia)
    return 1.0 / (options.time_step * fastest)
