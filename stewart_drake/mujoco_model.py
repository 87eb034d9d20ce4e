"""The robot for MuJoCo: MJCF from the same parameters as the SDF."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.plant.sdf_model import home_frames, render
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

Integrator = Literal["Euler", "implicit", "implicitfast", "RK4"]


def mjcf_text(
    robot: RobotParameters,
    gravity: float = STANDARD_GRAVITY,
    options: PlantOptions | None = None,
    integrator: Integrator = "Euler",
) -> str:
    """The robot in MJCF: every body where the home pose has it, rods on two hinges, six `connect` that close the loops.

    MuJoCo's `connect` is a spring and damper on the gap r: here d^2 r/dt^2 = -r / h^2 - dr/dt / h, by which one Euler
    step of length h closes a gap altogether. Its impedance is 0.9999 at most: a ten-thousandth of what would open the
    loops is left to the spring, which has it at a gap of order h^2. Behind heavy rotors that is much in a single
    acceleration, and little in the motion.

    Motors `motor_0..5` take torques [N m] within the effort limit; their joints are zero at home. Links are drawn, but
    do not collide.

    Of the options count `time_step`, `universal_damping` and the motors' friction, of which MuJoCo has no break-away
    level. Gravity is in m/s^2 along -z.
    """
    options = PlantOptions() if options is None else options
    frames, friction = home_frames(robot), options.friction
    coulomb: Sequence[float] = [options.motor_friction] * LEGS
    viscous: Sequence[float] = [options.motor_damping] * LEGS
    if friction is not None:
        coulomb, viscous = friction.coulomb, friction.viscous
    return render(
        "robot.mjcf.j2",
        robot=robot,
        frames=frames,
        gravity=gravity,
        step=options.time_step,
        integrator=integrator,
        linear=not any(coulomb) and not np.isfinite(frames.stops).any(),
        coulomb=coulomb,
        viscous=viscous,
        universal_damping=options.universal_damping,
    )
