"""The robot for MuJoCo: MJCF from the same parameters as the SDF, and a simulation of it.

The text needs this package alone, `MujocoRobot` the extra `mujoco`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.whole import write_atomically
from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.plant.sdf_elements import exact_text
from stewart_drake.plant.sdf_model import HomeFrames, home_frames
from stewart_drake.robot import RobotParameters
from stewart_drake.robot.leg import LEGS

if TYPE_CHECKING:
    from stewart_drake.plant.state_map import StateMap

Integrator = Literal["Euler", "implicit", "implicitfast", "RK4"]
_BLUE, _ORANGE, _GREY, _DARK = "0.25 0.55 0.8 1", "0.9 0.48 0.15 1", "0.8 0.82 0.85 1", "0.35 0.37 0.4 1"


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

    Args:
        robot: Geometry, masses, stops, effort limit.
        gravity: [m/s^2] along -z.
        options: Of them count `time_step`, `universal_damping` and the motors' friction, of which MuJoCo has no
            break-away level; None takes the defaults.
        integrator: MuJoCo's.

    Returns:
        The text; the same robot always gives the same text.
    """
    options = PlantOptions() if options is None else options
    frames = home_frames(robot)
    root = ET.Element("mujoco", model="stewart")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    # Equalities alone are a linear problem: Newton's first step solves it, the second mends the rounding.
    linear = not any(_friction(options)[0]) and not np.isfinite(frames.stops).any()
    solver: dict[str, Any] = {
        "solver": "Newton",
        "iterations": "2" if linear else "20",
        "tolerance": "0" if linear else "1e-12",
    }
    step = options.time_step
    fall = exact_text([0.0, 0.0, -gravity])
    ET.SubElement(root, "option", gravity=fall, timestep=exact_text([step]), integrator=integrator, **solver)
    world, equality, actuator = (ET.SubElement(root, tag) for tag in ("worldbody", "equality", "actuator"))
    ET.SubElement(world, "light", pos="0 0 3", dir="0 0 -1")
    _platform(world, robot)
    for leg in range(LEGS):
        _leg(world, robot, frames, leg, options)
        ET.SubElement(
            equality,
            "connect",
            site1=f"end_{leg}",
            site2=f"seat_{leg}",
            # Negative: stiffness and damping themselves, not a time constant that MuJoCo would hold above two steps.
            solref=exact_text([-1.0 / step**2, -1.0 / step]),
            solimp="0.9999 0.9999 1 0.5 1",
        )
        effort = exact_text([-robot.effort_limits[leg], robot.effort_limits[leg]])
        ET.SubElement(actuator, "motor", name=f"motor_{leg}", joint=f"motor_{leg}", forcerange=effort)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def write_mjcf(robot: RobotParameters, path: str | Path, options: PlantOptions | None = None) -> None:
    """Writes `mjcf_text` to a file, whole or not at all.

    Raises:
        ConfigurationError: The folder is missing or not writable.
    """
    write_atomically(Path(path), mjcf_text(robot, options=options).encode())


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


def _body(parent: ET.Element, name: str, position: Any, rotation: np.ndarray) -> ET.Element:
    axes = exact_text(rotation.T[:2].ravel())
    return ET.SubElement(parent, "body", name=name, pos=exact_text(position), xyaxes=axes)


def _inertial(body: ET.Element, mass: float, centre: Any, moments: Any, products: Any = (0.0, 0.0, 0.0)) -> None:
    inertia: dict[str, Any] = {"diaginertia": exact_text(moments)}
    if any(products):
        inertia = {"fullinertia": exact_text((*moments, *products))}
    ET.SubElement(body, "inertial", pos=exact_text(centre), mass=exact_text([mass]), **inertia)


def _picture(body: ET.Element, kind: str, size: list[float], colour: str, **place: Any) -> None:
    ET.SubElement(body, "geom", type=kind, size=exact_text(size), rgba=colour, contype="0", conaffinity="0", **place)


def _platform(world: ET.Element, robot: RobotParameters) -> None:
    platform = _body(world, "platform", robot.home_pose[3:], np.eye(3))
    centre, products = robot.platform_center_of_mass, robot.platform_products
    _inertial(platform, robot.platform_mass, centre, robot.platform_inertia, products)
    ET.SubElement(platform, "freejoint", name="platform")
    _picture(platform, "cylinder", [robot.platform_radius, 0.8 * robot.link_radius], _BLUE)
    for leg in range(LEGS):
        ET.SubElement(platform, "site", name=f"seat_{leg}", pos=exact_text(robot.platform_joints[leg]))


def _friction(options: PlantOptions) -> tuple[Sequence[float], Sequence[float]]:
    """Coulomb [N m] and viscous [N m s/rad] friction of the six motors."""
    if options.friction is not None:
        return options.friction.coulomb, options.friction.viscous
    return [options.motor_friction] * LEGS, [options.motor_damping] * LEGS


def _leg(world: ET.Element, robot: RobotParameters, frames: HomeFrames, leg: int, options: PlantOptions) -> None:
    a, length, radius = float(robot.crank_lengths[leg]), float(robot.rod_lengths[leg]), robot.link_radius
    crank = _body(world, f"crank_{leg}", robot.shaft_positions[leg], frames.crank_rotation[leg])
    _inertial(crank, robot.crank_mass, [0.5 * a, 0.0, 0.0], robot.crank_inertia)
    coulomb, viscous = (each[leg] for each in _friction(options))
    motor = {"armature": robot.rotor_inertia, "damping": viscous, "frictionloss": coulomb}
    own: dict[str, Any] = {name: exact_text([value]) for name, value in motor.items() if value > 0.0}
    low, high = frames.stops[leg]
    if np.isfinite([low, high]).any():
        own["range"] = exact_text([low, high])
    ET.SubElement(crank, "joint", name=f"motor_{leg}", axis="0 -1 0", **own)
    _picture(crank, "capsule", [radius], _ORANGE, fromto=exact_text([0.0, 0.0, 0.0, a, 0.0, 0.0]))
    _picture(crank, "sphere", [2.0 * radius], _DARK)
    rod = _body(crank, f"rod_{leg}", [a, 0.0, 0.0], frames.rod_in_crank[leg])
    _inertial(rod, robot.rod_mass, [0.0, 0.0, 0.5 * length], robot.rod_inertia)
    damping: dict[str, Any] = (
        {"damping": exact_text([options.universal_damping])} if options.universal_damping > 0.0 else {}
    )
    for name, axis in (("x", "1 0 0"), ("y", "0 1 0")):
        ET.SubElement(rod, "joint", name=f"universal_{leg}_{name}", axis=axis, **damping)
    _picture(rod, "capsule", [0.8 * radius], _GREY, fromto=exact_text([0.0, 0.0, 0.0, 0.0, 0.0, length]))
    ET.SubElement(rod, "site", name=f"end_{leg}", pos=exact_text([0.0, 0.0, length]))
