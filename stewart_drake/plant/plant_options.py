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

MIN_TIME_STEP, MAX_TIME_STEP = 1e-6, 0.1
"""[s] finer steps drown in rounding; coarser ones follow nothing."""

Place = Annotated[Real, Field(ge=-LARGEST, le=LARGEST)]


class BrokenRod(Section, key="plant.broken_rod"):
    """A rod that comes off the platform and hangs from its crank."""

    leg: LegNumber
    """0 to 5."""
    time: NotNegative
    """[s] when it breaks."""


# What only the plant of Drake can have.
_OF_DRAKE = ("rod_joint", "collision", "universal_damping", "platform_joint_damping", "broken_rod")


class PlantOptions(Section, key="plant"):
    """Options of the simulated robot."""

    time_step: Annotated[Real, Field(ge=MIN_TIME_STEP, le=MAX_TIME_STEP)] = 0.001
    """[s] period of the discrete plant."""
    engine: Literal["drake", "reduced"] = "drake"
    """drake: the MultibodyPlant, in a Diagram. reduced: the exact closed form of the robot, compiled, without a
    Diagram: several times faster, for searches, sweeps and comparisons. What it cannot have is refused."""
    rod_joint: RodJoint = "universal"
    """Joint between crank and rod; `ball` is the paper's, with six spins that nothing controls."""
    collision: Flag = False
    """Links collide: cranks, rods, platform and base, except where a joint holds them together."""
    motor_damping: Moderate = 0.0
    """[N m s/rad] viscous friction of each motor; implicit, stable at any step. Short for `friction.viscous`."""
    universal_damping: Moderate = 0.0
    """[N m s/rad] viscous friction about each axis of each joint between crank and rod; implicit."""
    platform_joint_damping: Moderate = 0.0
    """[N m s/rad] viscous friction of each ball between rod and platform; explicit, see `platform_damping_limit`. The
    same in all directions near home only: at 45 deg of swing it is 0.6 to 3.4 times as large, by direction."""
    motor_friction: Moderate = 0.0
    """[N m] dry friction of each motor, the same at rest and in sliding. Short for `friction.coulomb`."""
    friction: FrictionOptions | None = None
    """Friction of the motors, one by one and weaker in sliding, in place of these two; null for what they say."""
    payload_mass: Moderate = 0.0
    """[kg] of a point that the platform carries and nobody but the plant knows of: not `robot`, nor the controller."""
    payload_position: tuple[Place, Place, Place] = (0.0, 0.0, 0.0)
    """[m] of the payload, in P."""
    broken_rod: BrokenRod | None = None
    """A rod that breaks midway, see `simulation.run`; null for none."""

    def rules(self) -> None:
        """See `Section.rules`."""
        for name in _OF_DRAKE if self.engine == "reduced" else ():
            if getattr(self, name) != self.__pydantic_fields__[name].default:
                raise ConfigurationError("engine", "reduced", f"drake, where {name} is given")
        for name in ("motor_friction", "motor_damping"):
            if self.friction is not None and getattr(self, name) > 0.0:
                raise ConfigurationError(name, getattr(self, name), "0 where `friction` is given, which has this value")

    def friction_law(self, robot: RobotParameters) -> np.ndarray:
        """`FRICTION` record of the motors of a robot, with the bristles that the time step carries."""
        said = self.friction
        if said is None:
            said = FrictionOptions.from_dict({"coulomb": self.motor_friction, "viscous": self.motor_damping})
        return friction_law(*said.levels, robot.crank_axis_inertias, self.time_step)


def platform_damping_limit(robot: RobotParameters, options: PlantOptions) -> float:
    """Largest `platform_joint_damping` d [N m s/rad] that its explicit integration bears.

    A ball that turns at w takes the power d w^2, and w^2 <= 2 (w_rod^2 + w_platform^2). Against the rods' and the
    platform's own inertia alone, no motion decays faster than d max(2 / I_rod, 12 / I_platform); the limit makes that
    1 / time_step, half of what is stable. A rod between two balls may spin about its thin axis: I_rod is small then.
    """
    rod_inertia = min(robot.rod_inertia) if options.rod_joint == "ball" else robot.rod_inertia[0]
    fastest = max(2.0 / rod_inertia, 12.0 / robot.smallest_platform_inertia)
    return 1.0 / (options.time_step * fastest)
