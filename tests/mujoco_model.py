"""The same mechanism for MuJoCo, from the same parameters: what the tests compare Drake's plant with."""

import xml.etree.ElementTree as ET

import mujoco
import numpy as np

from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.plant.sdf_model import home_frames

LEGS = range(6)


def text(*values):
    """Numbers without loss."""
    return " ".join(repr(float(value)) for value in np.concatenate([np.ravel(value) for value in values]))


def mjcf(robot, gravity, time_step, integrator):
    """The robot in MJCF: every body where the home pose has it, rods on two hinges, six `connect` that close the loops.

    MuJoCo's `connect` is a spring and damper on the gap r: here d^2 r/dt^2 = -r / h^2 - dr/dt / h, by which one Euler
    step of length h closes a gap altogether. Its impedance is 0.9999 at most: a ten-thousandth of what would open the
    loops is left to the spring, which has it at a gap of order h^2.
    """
    frames = home_frames(robot)
    root = ET.Element("mujoco", model="stewart")
    ET.SubElement(
        root,
        "option",
        gravity=text([0.0, 0.0, -gravity]),
        timestep=text(time_step),
        integrator=integrator,
        # Equalities alone are a linear problem: Newton's first step solves it, the second mends the rounding.
        solver="Newton",
        iterations="2",
        tolerance="0",
    )
    world, equality, actuator = (ET.SubElement(root, tag) for tag in ("worldbody", "equality", "actuator"))

    def body(parent, name, position, rotation, mass, centre, moments):
        element = ET.SubElement(parent, "body", name=name, pos=text(position), xyaxes=text(rotation.T[:2]))
        ET.SubElement(element, "inertial", pos=text(centre), mass=text(mass), diaginertia=text(moments))
        return element

    a, length = robot.crank_length, robot.rod_length
    platform = body(
        world, "platform", robot.home_pose[3:], np.eye(3), robot.platform_mass, np.zeros(3), robot.platform_inertia
    )
    ET.SubElement(platform, "freejoint", name="platform")
    for leg in LEGS:
        crank = body(
            world,
            f"crank_{leg}",
            robot.shaft_positions[leg],
            frames.crank_rotation[leg],
            robot.crank_mass,
            [0.5 * a, 0.0, 0.0],
            robot.crank_inertia,
        )
        ET.SubElement(crank, "joint", name=f"motor_{leg}", axis="0 -1 0")
        rod = body(
            crank,
            f"rod_{leg}",
            [a, 0.0, 0.0],
            frames.rod_in_crank[leg],
            robot.rod_mass,
            [0.0, 0.0, 0.5 * length],
            robot.rod_inertia,
        )
        ET.SubElement(rod, "joint", name=f"universal_{leg}_x", axis="1 0 0")
        ET.SubElement(rod, "joint", name=f"universal_{leg}_y", axis="0 1 0")
        ET.SubElement(rod, "site", name=f"end_{leg}", pos=text([0.0, 0.0, length]))
        ET.SubElement(platform, "site", name=f"seat_{leg}", pos=text(robot.platform_joints[leg]))
        ET.SubElement(
            equality,
            "connect",
            site1=f"end_{leg}",
            site2=f"seat_{leg}",
            # Negative: stiffness and damping themselves, not a time constant that MuJoCo would hold above two steps.
            solref=text([-1.0 / time_step**2, -1.0 / time_step]),
            solimp="0.9999 0.9999 1 0.5 1",
        )
        ET.SubElement(actuator, "motor", joint=f"motor_{leg}")
    return ET.tostring(root, encoding="unicode")


class MujocoRobot:
    """MuJoCo's simulation of the robot, with the state of `StewartPlant.assemble` to start from."""

    def __init__(self, robot, gravity, time_step, integrator="Euler"):
        self.model = mujoco.MjModel.from_xml_string(mjcf(robot, gravity, time_step, integrator))
        self.data = mujoco.MjData(self.model)

    def set_state(self, stewart, state):
        """Takes over a state of a plant with universal joints."""
        index, data = stewart.indices, self.data
        mujoco.mj_resetData(self.model, data)
        for leg in LEGS:
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

    def advance(self, torque, steps):
        """Steps with constant motor torques (6,) [N m]."""
        self.data.ctrl = torque
        mujoco.mj_step(self.model, self.data, steps)

    @property
    def acceleration(self):
        """(6,) [rad/s^2, m/s^2] d(twist)/dt of the platform in the world, where MuJoCo evaluated it last."""
        own = self.data.joint("platform").qacc
        return np.concatenate([self.data.body("platform").xmat.reshape(3, 3) @ own[3:], own[:3]])

    @property
    def platform(self):
        """(7,) [m, -] X, Y, Z of the platform and its quaternion w, x, y, z."""
        return self.data.joint("platform").qpos.copy()

    @property
    def loop_gap(self):
        """(6,) [m] between rod ends and platform."""
        # MuJoCo's own points are those of its last evaluation, before the end of the step.
        mujoco.mj_kinematics(self.model, self.data)
        site = self.data.site
        return np.array([np.linalg.norm(site(f"end_{leg}").xpos - site(f"seat_{leg}").xpos) for leg in LEGS])
