"""The robot for MuJoCo: MJCF from the same parameters as the SDF, and a simulation of it.

The text needs this package alone, `MujocoRobot` the extra `mujoco`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.plant.sdf_model import home_frames, render
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

if TYPE_CHECKING:
    from stewart_drake.plant.sdf_model import StateMap

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


class MujocoRobot:
    """MuJoCo's simulation of a robot, with the state of `StewartPlant.assemble` to start from.

    Attributes:
        model: `mujoco.MjModel`.
        data: `mujoco.MjData`.

    Raises:
        ConfigurationError: MuJoCo is not installed.
    """

    def __init__(
        self,
        robot: RobotParameters,
        gravity: float = STANDARD_GRAVITY,
        options: PlantOptions | None = None,
        integrator: Integrator = "Euler",
    ) -> None:
        try:
            import mujoco
        except ImportError:
            allowed = "a Python with MuJoCo: pip install 'stewart-drake[mujoco]'"
            raise ConfigurationError("mujoco", "not installed", allowed) from None
        self._engine = mujoco
        self.model: Any = mujoco.MjModel.from_xml_string(mjcf_text(robot, gravity, options, integrator))
        self.data: Any = mujoco.MjData(self.model)

    def set_state(self, stewart: StateMap, state: np.ndarray) -> None:
        """Takes over a state of a plant of the same robot with universal joints."""
        index, data = stewart.indices, self.data
        self._engine.mj_resetData(self.model, data)
        for leg in range(LEGS):
            names = (f"motor_{leg}", f"universal_{leg}_x", f"universal_{leg}_y")
            positions = (index.crank[leg], *index.rod[leg])
            rates = (index.crank_rate[leg], *index.rod_rate[leg])
            for name, position, rate in zip(names, positions, rates, strict=True):
                data.joint(name).qpos, data.joint(name).qvel = state[position], state[rate]
        platform = data.joint("platform")
        platform.qpos = np.concatenate([state[index.position], state[index.quaternion]])
        rotation = rotation_matrix(stewart.pose_and_rate(state)[0][:3])
        # A free joint's angular velocity is in the body's own axes, and comes after the linear one.
        platform.qvel = np.concatenate([state[index.twist[3:]], rotation.T @ state[index.twist[:3]]])

    def advance(self, torque: np.ndarray, steps: int) -> None:
        """Steps with constant motor torques (6,) [N m]."""
        self.data.ctrl = torque
        self._engine.mj_step(self.model, self.data, steps)

    @property
    def acceleration(self) -> np.ndarray:
        """(6,) [rad/s^2, m/s^2] d(twist)/dt of the platform in the world, where MuJoCo evaluated it last."""
        own = self.data.joint("platform").qacc
        return np.concatenate([self.data.body("platform").xmat.reshape(3, 3) @ own[3:], own[:3]])

    @property
    def platform(self) -> np.ndarray:
        """(7,) [m, -] X, Y, Z of the platform and its quaternion w, x, y, z."""
        return np.array(self.data.joint("platform").qpos)

    @property
    def loop_gap(self) -> np.ndarray:
        """(6,) [m] between rod ends and platform."""
        # MuJoCo's own points are those of its last evaluation, before the end of the step.
        self._engine.mj_kinematics(self.model, self.data)
        site = self.data.site
        return np.array([np.linalg.norm(site(f"end_{leg}").xpos - site(f"seat_{leg}").xpos) for leg in range(LEGS)])
